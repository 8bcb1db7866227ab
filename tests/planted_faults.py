"""Plant small faults in geoaim, one at a time in a copy, and count those that tests notice.

    python -m tests.planted_faults --count 40 --seed 1 -o faults.json

A fault swaps an operator, drops a `not`, or changes a constant. The tests that import the changed
module run; those marked slow run where the others notice nothing. A fault that nothing notices may
change nothing: look at each one. A run goes on where its output stops.
"""

import argparse
import ast
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path
from random import Random

from tests.changed import ROOT, find_folder, find_importing

SWAPS = {
    ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"),
    ast.Mult: ("*", "/"),
    ast.Div: ("/", "*"),
    ast.Lt: ("<", ">"),
    ast.Gt: (">", "<"),
    ast.LtE: ("<=", "<"),
    ast.GtE: (">=", ">"),
    ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="),
    ast.And: ("and", "or"),
    ast.Or: ("or", "and"),
}
LEFT_OUT = ("torchdrivesim.py", "__main__.py", "__init__.py")
KEPT = ("benchmarks", "docs", "geoaim", "notebooks", "samples", "tests", "*.md", "*.toml", "*.txt")


@dataclass(frozen=True)
class Fault:
    """A change of a part of a line of a file."""

    path: str
    line: int
    begin: int
    end: int
    text: str


def list_faults(path: str) -> list[Fault]:
    """List all faults that can be planted in a file."""
    source = (ROOT / path).read_text("utf-8")
    lines = source.splitlines()
    return [fault for node in ast.walk(ast.parse(source)) for fault in _change(path, lines, node)]


def _change(path: str, lines: list[str], node: ast.AST) -> Iterator[Fault]:
    if isinstance(node, ast.BinOp):
        yield from _swap(path, lines, node.op, (node.left, node.right))
    elif isinstance(node, ast.Compare):
        parts = [node.left, *node.comparators]
        for operator, pair in zip(node.ops, pairwise(parts), strict=True):
            yield from _swap(path, lines, operator, pair)
    elif isinstance(node, ast.BoolOp):
        yield from _swap(path, lines, node.op, (node.values[0], node.values[1]))
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        if node.lineno == node.operand.lineno:
            begin = node.col_offset
            yield _make(path, lines, node.lineno, begin, begin + len("not "), "")
    elif isinstance(node, ast.Constant) and type(node.value) in (bool, int, float):
        changed = not node.value if isinstance(node.value, bool) else node.value + 1
        if node.lineno == node.end_lineno:
            yield _make(
                path, lines, node.lineno, node.col_offset, node.end_col_offset, str(changed)
            )


def _swap(
    path: str, lines: list[str], operator: ast.AST, operands: tuple[ast.expr, ast.expr]
) -> Iterator[Fault]:
    """Swap the operator between two operands that stand on one line."""
    before, after = operands
    if type(operator) not in SWAPS or before.end_lineno != after.lineno:
        return
    old, new = SWAPS[type(operator)]
    line = lines[after.lineno - 1].encode()
    found = re.search(re.escape(old.encode()), line[before.end_col_offset : after.col_offset])
    if found:
        begin = before.end_col_offset + found.start()
        yield _make(path, lines, after.lineno, begin, begin + len(old), new)


def _make(path: str, lines: list[str], line: int, begin: int, end: int, text: str) -> Fault:
    """Make a fault; columns of the syntax tree count bytes, and those of a fault characters."""
    content = lines[line - 1].encode()
    return Fault(path, line, len(content[:begin].decode()), len(content[:end].decode()), text)


def choose_faults(count: int, seed: int) -> list[Fault]:
    """Choose faults, each in a line of the package that is drawn at random."""
    random, faults = Random(seed), []
    for path in sorted((ROOT / "geoaim").rglob("*.py")):
        if path.name not in LEFT_OUT:
            faults += list_faults(str(path.relative_to(ROOT)))
    return random.sample(faults, count)


def plant(fault: Fault, folder: Path) -> tuple[str, str]:
    """Plant a fault in a copy of the project; returns the line before and after."""
    path = folder / fault.path
    lines = path.read_text("utf-8").splitlines(keepends=True)
    before = lines[fault.line - 1]
    after = before[: fault.begin] + fault.text + before[fault.end :]
    lines[fault.line - 1] = after
    path.write_text("".join(lines), "utf-8")
    return before.strip(), after.strip()


def order_tests(path: str) -> list[str]:
    """List the tests of a module: those of its name first, then those of its folder."""
    stem, folder = Path(path).stem, Path(find_folder(Path(path)))
    tests = find_importing(Path(path)) or {str(folder)}
    return sorted(
        tests, key=lambda name: (stem not in Path(name).name, Path(name).parent != folder, name)
    )


def notice(tests: list[str], folder: Path, marks: str) -> str | None:
    """Run tests in a copy; returns the first that fails, or None if all pass."""
    command = [sys.executable, "-m", "pytest", "-x", "-q", "--no-header", "-p", "no:cacheprovider"]
    result = subprocess.run(
        [*command, "-m", marks, *tests],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(folder), "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    if result.returncode in (0, 5):  # 5: no test has these marks
        return None
    failed = re.search(r"^(?:FAILED|ERROR) (.*)", result.stdout, flags=re.M)
    return failed[1][:150] if failed else result.stdout[-150:] + result.stderr[-150:]


def try_fault(fault: Fault, folder: Path) -> dict[str, object]:
    """Plant a fault, run the tests of its module, and take it back."""
    before, after = plant(fault, folder)
    try:
        tests = order_tests(fault.path)
        noticed = notice(tests, folder, "not slow") or notice(tests, folder, "slow")
    finally:
        shutil.copyfile(ROOT / fault.path, folder / fault.path)
    return {**asdict(fault), "before": before, "after": after, "noticed": noticed}


def main() -> None:
    """Plant faults, and write which are noticed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=40, help="faults")
    parser.add_argument("--seed", type=int, default=1, help="of their choice")
    parser.add_argument("-o", "--output", type=Path, required=True, help="JSON to write")
    arguments = parser.parse_args()
    path = arguments.output
    rows = json.loads(path.read_text()) if path.exists() else []
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary, "project")
        folder.mkdir()
        for source in (found for pattern in KEPT for found in ROOT.glob(pattern)):
            copy = shutil.copytree if source.is_dir() else shutil.copyfile
            copy(source, folder / source.name)
        for fault in choose_faults(arguments.count, arguments.seed)[len(rows) :]:
            rows.append(try_fault(fault, folder))
            print(json.dumps(rows[-1]), flush=True)
            path.write_text(json.dumps(rows, indent=1) + "\n")
    print(f"{sum(bool(row['noticed']) for row in rows)} of {len(rows)} noticed")


if __name__ == "__main__":
    main()
