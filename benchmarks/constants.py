"""What moves when a constant of the package changes: each by a factor of 1.5, up and down.

    python -m benchmarks.constants registration --json docs/bench/constants_registration.json
    python -m benchmarks.constants count

A stage runs its smallest honest benchmark on validation cases for each change. What no case feels
may go, with the branch that it guards; that is then tried on many more cases. Values that another
constant or a default was made of when it was imported keep their old parts.
"""

import ast
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any

import cv2
import numpy as np
import typer

from benchmarks.registration.stability.clips import Clip, SweepCase, list_cases, make_clip
from benchmarks.registration.stability.sweep import run_geoaim
from benchmarks.results import ROOT, JsonFile, print_rows, write_rows

PACKAGE = ROOT / "geoaim"
FACTOR = 1.5
SAME_ERROR = 0.02  # relative change of the error that counts as none
# kinds and ranks of validation clips: what is filmed, and each hardship at two levels
REGISTRATION_CLIPS = {
    "plain": (2, 4),
    "flowing traffic": (0, 2),
    "coherent traffic": (2, 4),
    "still camera": (0, 2),
    "solar panels": (0, 2),
    "water": (0, 3),
    "parallax": (1, 3),
    "swaying trees": (1, 3),
    "rolling shutter": (1, 3),
    "compression": (2, 4),
    "overlay text": (1, 2),
    "frozen part": (1, 3),
    "defocus": (2, 4),
    "noise": (1, 3),
    "night": (1, 3),
    "overlap": (2, 4),
    "jump": (2, 4),
    "jpeg": (2, 4),
}


@dataclass(frozen=True)
class Constant:
    """A number, or numbers, that a module names in capitals."""

    module: str
    name: str
    value: Any

    def scale(self, factor: float) -> Any:
        """The value times a factor, of the same type; whole numbers change by one at least."""
        if isinstance(self.value, tuple):
            return tuple(Constant("", "", part).scale(factor) for part in self.value)
        if isinstance(self.value, int):
            changed = round(self.value * factor)
            return changed if changed != self.value else self.value + (1 if factor > 1 else -1)
        return self.value * factor


def list_constants(folder: Path) -> Iterator[Constant]:
    """List the constants of a folder that are numbers or tuples of numbers."""
    for path in sorted(folder.rglob("*.py")):
        module = ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts)
        for name in _name_constants(ast.parse(path.read_text("utf-8"))):
            value = getattr(import_module(module), name)
            if _is_number(value) or (isinstance(value, tuple) and all(map(_is_number, value))):
                yield Constant(module, name, value)


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _name_constants(tree: ast.Module) -> Iterator[str]:
    """Name what a module assigns to names in capitals."""
    for node in tree.body:
        if isinstance(node, ast.Assign):
            targets = node.targets
        elif isinstance(node, ast.AnnAssign):
            targets = [node.target]
        else:
            continue
        for target in targets:
            parts = target.elts if isinstance(target, ast.Tuple) else [target]
            yield from (p.id for p in parts if isinstance(p, ast.Name) and p.id.isupper())


@contextmanager
def change(constant: Constant, value: Any) -> Iterator[None]:
    """Give a constant another value in its module and in those that import it by name."""
    modules = [module for module in map(sys.modules.get, _list_users(constant)) if module]
    try:
        for module in modules:
            setattr(module, constant.name, value)
        yield
    finally:
        for module in modules:
            setattr(module, constant.name, constant.value)


def _list_users(constant: Constant) -> list[str]:
    users = [constant.module]
    for name, module in list(sys.modules.items()):
        if name.startswith("geoaim.") and constant.name in vars(module):
            users += [name] * _imports(module, constant)
    return users


def _imports(module: ModuleType, constant: Constant) -> bool:
    source = Path(module.__file__ or "").read_text("utf-8")
    return any(
        isinstance(node, ast.ImportFrom)
        and node.module == constant.module
        and constant.name in (alias.name for alias in node.names)
        for node in ast.parse(source).body
    )


def make_registration_clips() -> list[tuple[SweepCase, Clip]]:
    """Make the clips: the easier level of one generator, the harder of the other."""
    chosen: list[SweepCase] = []
    for kind, ranks in REGISTRATION_CLIPS.items():
        wanted = dict(zip(ranks, ("town", "junction"), strict=True))
        cases = list_cases("validation", [kind])
        chosen += [case for case in cases if wanted.get(case.rank) == case.base]
    return [(case, make_clip(case, count=8)) for case in chosen]


def measure_registration(clips: Sequence[tuple[SweepCase, Clip]]) -> Mapping[str, float]:
    """Count the verdicts on all frames, and average the logarithm of right frames' errors."""
    rows = [row for case, clip in clips for row in run_geoaim(case, clip)]
    counts = Counter(row["verdict"] for row in rows)
    errors = [row["error"] for row in rows if row["verdict"] == "right"]
    return {
        "right": counts["right"],
        "refused": counts["rejected"],
        "wrong, and said": counts["wrong but uncertain"],
        "wrong, and sure": counts["wrong and overconfident"] + counts["understated"],
        "error, px": float(np.exp(np.mean(np.log(np.maximum(errors, 1e-4))))),
    }


STAGES: dict[str, tuple[Path, Callable[[], Any], Callable[[Any], Mapping[str, float]]]] = {
    "registration": (
        PACKAGE / "mapping" / "registration",
        make_registration_clips,
        measure_registration,
    )
}


def ask(stage: str) -> Iterator[dict[str, Any]]:
    """Change each constant of a stage; rows with what moved, the first without any change."""
    folder, prepare, measure = STAGES[stage]
    cases = prepare()
    usual = measure(cases)
    yield {"constant": "none", "module": "", "value": "", "change": "", **usual, "felt": ""}
    for constant in list_constants(folder):
        for factor in (FACTOR, 1 / FACTOR):
            try:
                with change(constant, constant.scale(factor)):
                    found = measure(cases)
            except Exception as error:  # an impossible value is felt
                found = dict.fromkeys(usual, float("nan"))
                print(f"{constant.name} times {factor:.2g}: {type(error).__name__}: {error}")
            yield {
                "constant": constant.name,
                "module": constant.module.rpartition(".")[2],
                "value": str(constant.value),
                "change": f"{factor:.2g}",
                **found,
                "felt": "yes" if _differs(found, usual) else "no",
            }


def _differs(found: Mapping[str, float], usual: Mapping[str, float]) -> bool:
    same = all(found[name] == value for name, value in usual.items() if name != "error, px")
    return not (same and abs(found["error, px"] / usual["error, px"] - 1) < SAME_ERROR)


def count_constants() -> Iterator[dict[str, Any]]:
    """Count the names of numbers in each part of the package."""
    counts: Counter[str] = Counter()
    for path in PACKAGE.rglob("*.py"):
        tree = ast.parse(path.read_text("utf-8"))
        parts = path.relative_to(PACKAGE).parts
        counts["/".join(parts[: 1 + (parts[0] == "mapping")])] += len(list(_name_constants(tree)))
    for name, count in counts.most_common():
        if count:
            yield {"part": name, "names in capitals": count}
    yield {"part": "all", "names in capitals": counts.total()}


def main(
    stage: Annotated[str, typer.Argument(help=f"{', '.join(STAGES)}, or count")],
    json: JsonFile = None,
) -> None:
    """Ask the constants of a stage what moves with them."""
    cv2.setNumThreads(1)
    rows = print_rows(count_constants() if stage == "count" else ask(stage))
    write_rows(rows, json, command=f"python -m benchmarks.constants {stage}")


if __name__ == "__main__":
    typer.run(main)
