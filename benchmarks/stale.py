"""List the published results whose stage has changed since they were measured.

    python -m benchmarks stale

A result is a JSON file in docs/bench or docs/experiments. It states the commit on which its command
ran; its stage is the package folders that `STAGES` names for the command. A change of comments,
docstrings, imports, layout or a file's name is none.
"""

import ast
import json
from collections.abc import Iterator

from benchmarks.results import ROOT, run_git

RESULTS = ("docs/bench", "docs/experiments")
# the folders whose code the results of a command depend on, by how the command begins; the first
# that fits counts
STAGES = {
    "python -m benchmarks.alignment": ("imagery",),
    "python -m benchmarks.background.own_boxes": ("mapping/background", "detection"),
    "python -m benchmarks.background": ("mapping/background", "mapping/registration"),
    "python -m benchmarks.catalog": ("catalog",),
    "python -m benchmarks.detection": ("detection",),
    "python -m benchmarks.georeference": ("mapping/georeference",),
    "python -m benchmarks.pipeline": ("mapping",),
    "python -m benchmarks.plain_script": ("mapping",),
    "python -m benchmarks.prediction": ("prediction",),
    "python -m benchmarks.registration": ("mapping/registration",),
    "python -m benchmarks.rendering": ("rendering",),
    "python -m benchmarks.short_clips": ("mapping/registration", "mapping/background"),
    "python -m benchmarks.simulation": ("simulation",),
    "python -m benchmarks.synthetic": (),  # the generator alone, which is no part of the package
    "python -m benchmarks.tracking": ("tracking",),
    "python -m benchmarks.viewer": ("web",),
    "python -m tests.faults": (),  # what it hurts is the whole package: run before each release
}


def list_stale() -> Iterator[tuple[str, str, str]]:
    """List results that are out of date.

    Yields:
        The result's file, the command that makes it, and why it is out of date.
    """
    for folder in RESULTS:
        for path in sorted((ROOT / folder).glob("*.json")):
            content = json.loads(path.read_text("utf-8"))
            reason = explain_staleness(content)
            if reason:
                yield path.relative_to(ROOT).as_posix(), content.get("command", ""), reason


def explain_staleness(content: dict[str, object]) -> str:
    """Explain why a result is out of date; the text is empty where it is not."""
    missing = [key for key in ("command", "commit", "date") if not content.get(key)]
    if missing:
        return f"states no {', '.join(missing)}"
    if content.get("uncommitted"):
        return "was measured on code that was not committed"
    command, commit = str(content["command"]), str(content["commit"])
    folders = [stage for start, stage in STAGES.items() if command.startswith(start)]
    if not folders:
        return "has a command that benchmarks/stale.py does not know"
    changed = [name for name in folders[0] if count_changes(commit, f"geoaim/{name}")]
    return f"{' and '.join(changed)} changed since {commit}" if changed else ""


def count_changes(commit: str, folder: str) -> int:
    """Count the modules of a folder whose code no module of it had at a commit."""
    names = run_git("ls-tree", "-r", "--name-only", commit, folder).splitlines()
    before = {strip(run_git("show", f"{commit}:{name}")) for name in names if name.endswith(".py")}
    now = {strip(path.read_text("utf-8")) for path in (ROOT / folder).rglob("*.py")}
    return len(now - before)


def strip(source: str) -> str:
    """Strip comments, docstrings, imports and layout from code."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            body = node.body[1:] if ast.get_docstring(node) is not None else node.body
            node.body = [x for x in body if not isinstance(x, ast.Import | ast.ImportFrom)]
    return ast.dump(tree)


def main() -> None:
    """Print each result that is out of date, why, and the command that makes it anew."""
    stale = list(list_stale())
    for name, command, reason in stale:
        print(f"{name}: {reason}\n    {command}")
    raise SystemExit(1 if stale else 0)
