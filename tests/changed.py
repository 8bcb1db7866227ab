"""Find the tests of changed files, and run them.

    python tests/changed.py PYTEST_ARGUMENTS...

Without a change since the last commit, the tests of the last commit's files run.
"""

import ast
import re
import subprocess
import sys
from collections.abc import Iterable
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
GENERAL = ("tests/test_conventions.py", "tests/test_public_api.py")  # read every module
NO_TESTS = 5  # pytest's exit code


def find_tests(changed: Iterable[str]) -> list[str]:
    """Find the tests of changed files.

    Args:
        changed: paths, relative to the project's folder.

    Returns:
        Files and folders of tests, relative to the project's folder, sorted: for a module those
        of its folder that import it, or else its folder; for a file of the tests itself, or the
        tests that import it; for pages those of the documentation.
    """
    found: set[str] = set()
    for name in changed:
        path = Path(name)
        if path.match("test_*.py"):
            found.add(name)
        elif path.name == "conftest.py":
            found.add(str(path.parent))
        elif path.suffix == ".py" and path.parts[0] in ("geoaim", "benchmarks", "tests"):
            found |= find_tests_of_module(path)
        elif path.suffix == ".md":
            found.add("tests/test_docs.py")
    return sorted(name for name in found if (ROOT / name).exists())


def find_tests_of_module(path: Path) -> set[str]:
    """Find the tests of a module's folder that import it, or else the folder; and its doctests."""
    if path.parts[0] == "tests":
        return find_importing(path)
    folder = find_folder(path)
    near = {name for name in find_importing(path) if name.startswith(f"{folder}/")}
    has_examples = (ROOT / path).exists() and ">>> " in (ROOT / path).read_text("utf-8")
    return {*GENERAL, *([str(path)] if has_examples else []), *(near or {folder})}


def find_importing(path: Path) -> set[str]:
    """Find the files of tests that import a module, or name it in a patch."""
    parts = path.with_suffix("").parts
    module = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
    return {name for name, imported in list_imports().items() if module in imported}


def find_folder(path: Path) -> str:
    """Find the folder of tests that mirrors a module's folder, or the nearest one above it."""
    mirrored = path.parts[1:-1] if path.parts[0] == "geoaim" else path.parts[:-1]
    folder = Path("tests", *mirrored)
    while not (ROOT / folder).is_dir():
        folder = folder.parent
    return str(folder)


@cache
def list_imports() -> dict[str, set[str]]:
    """List what each file of tests imports: modules, and names with their modules."""
    imports = {}
    for path in sorted((ROOT / "tests").rglob("test_*.py")):
        text, imported = path.read_text("utf-8"), set()
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.ImportFrom) and node.module:
                imported |= {node.module, *(f"{node.module}.{name.name}" for name in node.names)}
            elif isinstance(node, ast.Import):
                imported |= {name.name for name in node.names}
        # patches name modules in strings
        imported |= set(re.findall(r'"((?:geoaim|benchmarks)(?:\.\w+)+)\.\w+"', text))
        imports[str(path.relative_to(ROOT))] = imported
    return imports


def list_changed() -> list[str]:
    """List what differs from the last commit, or else that commit's files; nothing without git."""
    new = _run_git("ls-files", "--others", "--exclude-standard")
    return _run_git("diff", "--name-only", "HEAD") + new or _run_git(
        "show", "--name-only", "--format=", "HEAD"
    )


def _run_git(*arguments: str) -> list[str]:
    command = ["git", "-C", str(ROOT), *arguments]
    try:
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
    except (OSError, subprocess.CalledProcessError):  # no git, or no clone
        return []


def main(arguments: list[str]) -> int:
    """Run the tests of changed files with arguments of pytest; returns the exit code."""
    tests = find_tests(list_changed())
    print(f"tests of changed files: {' '.join(tests) or 'none'}", flush=True)
    if not tests:
        return 0
    command = [sys.executable, "-m", "pytest", *arguments, *tests]
    code = subprocess.run(command, check=False, cwd=ROOT).returncode
    return 0 if code == NO_TESTS else code


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
