"""List the published results whose stage has changed since they were measured.

    python -m benchmarks stale

A result is a JSON file in docs/bench or docs/experiments. It states the commit on which its command
ran; its stage is what `STAGES` names for the command. A change of comments, docstrings,
annotations, imports, the texts of errors, layout or a definition's file is none.
"""

import ast
import json
from collections.abc import Iterator
from functools import cache

from benchmarks.results import ROOT, run_git

RESULTS = ("docs/bench", "docs/experiments")
# the folders or files whose code the results of a command depend on, by how the command begins; the
# first that fits counts
STAGES = {
    "python -m benchmarks.alignment": ("geoaim/imagery",),
    "python -m benchmarks.background.own_boxes": ("geoaim/mapping/background", "geoaim/detection"),
    "python -m benchmarks.background": ("geoaim/mapping/background", "geoaim/mapping/registration"),
    "python -m benchmarks.catalog": ("geoaim/catalog",),
    "python -m benchmarks.detection": ("geoaim/detection",),
    "python -m benchmarks.georeference": ("geoaim/mapping/georeference",),
    "python -m benchmarks.pipeline": ("geoaim/mapping",),
    "python -m benchmarks.plain_script": ("geoaim/mapping",),
    "python -m benchmarks.prediction": ("geoaim/prediction",),
    "python -m benchmarks.realism": ("benchmarks/synthetic",),
    "python -m benchmarks.registration": ("geoaim/mapping/registration",),
    "python -m benchmarks.rendering.exactness": ("geoaim/rendering/coverage.py",),
    "python -m benchmarks.rendering": ("geoaim/rendering",),
    "python -m benchmarks.short_clips": (
        "geoaim/mapping/registration",
        "geoaim/mapping/background",
    ),
    "python -m benchmarks.simulation": ("geoaim/simulation",),
    "python -m benchmarks.tracking": ("geoaim/tracking",),
    "python -m benchmarks.viewer": ("geoaim/web",),
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
    changed = [name for name in folders[0] if has_changed(commit, name)]
    return f"{' and '.join(changed)} changed since {commit}" if changed else ""


def has_changed(commit: str, folder: str) -> bool:
    """Tell whether a folder or file has a definition that it had not at a commit."""
    names = run_git("ls-tree", "-r", "--name-only", commit, folder).splitlines()
    sources = (run_git("show", f"{commit}:{name}") for name in names if name.endswith(".py"))
    before = {definition for source in sources for definition in strip(source)}
    path = ROOT / folder
    paths = [path] if path.is_file() else path.rglob("*.py")
    return any(not before.issuperset(strip(path.read_text("utf-8"))) for path in paths)


@cache
def strip(source: str) -> frozenset[str]:
    """List a module's definitions and other statements, without what no result can feel."""
    tree = _Stripping().visit(ast.parse(source))
    return frozenset(ast.dump(statement) for statement in tree.body)


class _Stripping(ast.NodeTransformer):
    """Removes docstrings, imports, annotations and the texts of errors."""

    def visit_Expr(self, node: ast.Expr) -> ast.AST | None:
        return None if isinstance(node.value, ast.Constant) else self.generic_visit(node)

    def visit_Import(self, node: ast.AST) -> None:
        pass

    visit_ImportFrom = visit_Import

    def visit_If(self, node: ast.If) -> ast.AST | None:
        types_only = ast.unparse(node.test) == "TYPE_CHECKING"
        return None if types_only else self.generic_visit(node)

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        node.returns = None
        return self.generic_visit(node)

    def visit_arg(self, node: ast.arg) -> ast.AST:
        node.annotation = None
        return node

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST:
        node.annotation = ast.Constant(None)
        return self.generic_visit(node)

    def visit_Raise(self, node: ast.Raise) -> ast.AST:
        for part in ast.walk(node):
            if isinstance(part, ast.Constant) and isinstance(part.value, str):
                part.value = ""
        return node


def main() -> None:
    """Print each result that is out of date, why, and the command that makes it anew."""
    stale = list(list_stale())
    for name, command, reason in stale:
        print(f"{name}: {reason}\n    {command}")
    raise SystemExit(1 if stale else 0)
