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
from dataclasses import dataclass, replace
from importlib import import_module
from itertools import product
from pathlib import Path
from types import ModuleType
from typing import Annotated, Any

import cv2
import numpy as np
import pandas as pd
import typer

from benchmarks.alignment.benchmark import list_methods, measure_pair
from benchmarks.alignment.mosaics import LAYOUTS, PRIOR, displace_parts, judge_mosaic
from benchmarks.alignment.pairs import Pair, make_pairs, misplace_picture, move_to_aim
from benchmarks.alignment.real import align_trials
from benchmarks.background.drawn_queue import draw_queue
from benchmarks.background.methods import METHODS as BACKGROUNDS
from benchmarks.background.methods import measure_background
from benchmarks.background.queue_clips import QueueClip
from benchmarks.georeference.methods import METHODS, measure_sets
from benchmarks.georeference.simulated_points import NOISES, PointSet, draw_sets
from benchmarks.registration.stability.clips import Clip, SweepCase, list_cases, make_clip
from benchmarks.registration.stability.sweep import run_geoaim
from benchmarks.results import ROOT, JsonFile, print_rows, write_rows
from benchmarks.tracking.benchmark import VALIDATION_SEED, measure_case
from benchmarks.tracking.cases import DetectorErrors, TrackingCase, make_drawn_case
from benchmarks.tracking.hard import BURSTS, FALSE, take_frames
from benchmarks.tracking.lanes import make_lanes_case
from geoaim.imagery.alignment.evidence import AimEvidence
from geoaim.imagery.mosaic import Mosaic
from geoaim.tracking.pipeline import track_boxes

PACKAGE = ROOT / "geoaim"
FACTOR = 1.5
SAME_ERROR = 0.02  # relative change of the error that counts as none
# files that no stage's cases reach: vehicles without boxes, and pictures
UNREACHED = ("find_vehicles", "shadows", "frame_poses", "overlay", "scale")
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


def make_tracking_cases() -> list[TrackingCase]:
    """Make boxes of lanes, a junction and a roundabout, each under its own errors."""
    seed, size = VALIDATION_SEED, (1080, 1920)
    lanes = make_lanes_case(seed, seconds=10, errors=BURSTS)
    false = replace(FALSE, lost_s=2.0, doubled=0.2, types=False)
    junction = make_drawn_case("junction", seed, size, seconds=8, errors=false)
    errors = DetectorErrors(lasting_px=2.0, flying_height=100.0)
    roundabout = make_drawn_case("roundabout", seed + 1, size, seconds=8, errors=errors)
    slow = make_drawn_case("junction", seed + 2, size, seconds=16, errors=BURSTS)
    return [lanes, junction, roundabout, take_frames(slow, 8)]


def measure_tracking(cases: Sequence[TrackingCase]) -> Mapping[str, float]:
    """Average what vehicles lack of the best scores, and their errors."""
    rows = pd.DataFrame([next(iter(measure_case(case, track_boxes))) for case in cases])
    means = rows.mean(numeric_only=True)
    lacking = {f"1 - {name}": 1 - float(means[name]) for name in ("IDF1", "HOTA")}
    names = [
        name for name in map(str, means.index) if name.startswith(("position", "heading", "speed"))
    ]
    return lacking | {str(name): float(means[name]) for name in names}


def make_point_sets() -> list[PointSet]:
    """Draw control points with each kind of noise, few and many."""
    draws = product(NOISES, (4, 5, 6, 8, 20))
    return [one for noise, count in draws for one in draw_sets(noise, count, 6, seed=1)]


def measure_points(sets: Sequence[PointSet]) -> Mapping[str, float]:
    """Count refused sets; the corners' errors, and how their statements hold."""
    found = measure_sets(sets, METHODS[:1])
    held = found.error <= found.stated
    return {
        "refused": len(sets) - found["set"].nunique(),
        "outside, %": round(100 * float(1 - held.mean()), 1),
        "stated, px": float(found.stated.median()),
        "error, px": float(np.exp(np.log(found.error + 1e-3).mean())),
    }


def make_queues() -> list[QueueClip]:
    """Draw queues that stand for a part of the time."""
    return [draw_queue(standing=share, seed=3 + n, count=24) for n, share in enumerate((0.3, 0.6))]


def measure_queues(clips: Sequence[QueueClip]) -> Mapping[str, float]:
    """Average the errors of backgrounds without boxes, and what is marked contested."""
    method = BACKGROUNDS["geoaim"]
    rows = pd.DataFrame([measure_background(clip, method) for clip in clips]).drop(columns="ms")
    return {str(name): float(value) for name, value in rows.mean().items()}


def make_alignment_pairs() -> list[Pair]:
    """Make places whose pictures are misplaced, which the benchmark of alignment does not use."""
    generator = np.random.default_rng(7)
    return [misplace_picture(pair, generator) for pair in make_pairs(1, first=21)]


def measure_alignment(pairs: Sequence[Pair]) -> Mapping[str, float]:
    """Align pictures of the place, of another one and in two parts, and to tracks."""
    align = list_methods()["geoaim"]
    other = move_to_aim(replace(pairs[0], aim=pairs[1].aim))
    errors = np.array([measure_pair(pair, align)[:2] for pair in [*pairs[:3], other]])
    tracked = [
        one
        for pair in pairs[2:4]
        if pair.tracks is not None
        for one in align_trials(pair.picture, pair.tracks, 1)
        if one is not None
    ]
    halves = _measure_halves(pairs[3])
    return {
        "answered": int(np.isfinite(errors[:3, 0]).sum()),
        "accepted for another place": int(np.isfinite(errors[3, 0])),
        "to tracks": len(tracked),
        "error, px": float(np.nanmean(errors[:3, 0])),
        "stated, px": float(np.nanmean(errors[:3, 1])),
        "error to tracks, m": float(np.mean([np.linalg.norm(one[0]) for one in tracked])),
        **halves,
    }


def _measure_halves(pair: Pair) -> dict[str, float]:
    """Align a picture in one file whose halves are displaced by 4 m to the east and the north."""
    picture = replace(pair.picture, world_from_image=_undo(pair))
    shifts = np.array([[4.0, 0.0], [0.0, 4.0]])
    moved, labels = displace_parts(picture, LAYOUTS["halves"], shifts)
    found = judge_mosaic(
        Mosaic(moved, None, ("1.tif", "2.tif")), AimEvidence(pair.aim, PRIOR), labels, shifts
    )
    errors = found["errors_m"] or [float("nan")]
    return {"parts": found.get("parts", 0), "error of parts, m": float(np.max(errors))}


def _undo(pair: Pair) -> Any:
    return np.linalg.inv(pair.stated_from_true) @ pair.picture.world_from_image


STAGES: dict[str, tuple[str, Callable[[], Any], Callable[[Any], Mapping[str, float]]]] = {
    "registration": ("mapping/registration", make_registration_clips, measure_registration),
    "tracking": ("tracking", make_tracking_cases, measure_tracking),
    "georeference": ("mapping/georeference", make_point_sets, measure_points),
    "background": ("mapping/background", make_queues, measure_queues),
    "alignment": ("imagery/alignment", make_alignment_pairs, measure_alignment),
}


def ask(stage: str) -> Iterator[dict[str, Any]]:
    """Change each constant of a stage; rows with what moved, the first without any change."""
    folder, prepare, measure = STAGES[stage]
    cases = prepare()
    usual = measure(cases)
    yield {"constant": "none", "module": "", "value": "", "change": "", **usual, "felt": ""}
    for constant in list_constants(PACKAGE / folder):
        if constant.module.endswith(UNREACHED):
            continue
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
    """Whether a count differs at all, or an error or a share by more than a little."""
    return not all(
        found[name] == value
        if isinstance(value, int)
        else abs(found[name] - value) <= SAME_ERROR * abs(value)
        for name, value in usual.items()
    )


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
