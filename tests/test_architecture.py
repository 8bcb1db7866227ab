"""The rules of docs/architecture.md that a program can check."""

import ast
import json
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import geoaim

PACKAGE = Path(geoaim.__file__).parent
ROOT = PACKAGE.parent
SOURCES = sorted(PACKAGE.rglob("*.py"))
HEAVY = ("torch", "matplotlib", "cv2", "rasterio", "av", "pandas", "pyproj")


def run_python(code: str) -> str:
    return subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True, cwd=ROOT
    ).stdout


def public_definitions(path: Path) -> list[ast.FunctionDef | ast.ClassDef]:
    """Functions and classes of a file, and methods of its classes, without a leading underscore."""
    tree = ast.parse(path.read_text())
    classes = [node for node in tree.body if isinstance(node, ast.ClassDef)]
    bodies = [tree.body, *(node.body for node in classes if not node.name.startswith("_"))]
    kinds = (ast.FunctionDef, ast.ClassDef)
    found = [node for body in bodies for node in body if isinstance(node, kinds)]
    return [node for node in found if not node.name.startswith("_")]


def test_imports_point_backwards_along_the_way():
    found = subprocess.run(
        [sys.executable, "-c", "from importlinter.cli import lint_imports_command as run; run()"],
        capture_output=True,
        text=True,
        cwd=ROOT,
    )
    assert found.returncode == 0, found.stdout + found.stderr


def test_layers_contract_names_every_room():
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    layers = next(c["layers"] for c in contracts["contracts"] if c["type"] == "layers")
    named = {part.strip(" ()") for layer in layers for part in layer.split("|")}
    rooms = {f"geoaim.{path.stem}" for path in PACKAGE.glob("*.py") if path.stem != "__init__"}
    rooms |= {f"geoaim.{path.parent.name}" for path in PACKAGE.glob("*/__init__.py")}
    assert rooms - named == set()


def test_import_geoaim_loads_nothing_heavy():
    code = f"import sys, json, geoaim; print(json.dumps([m for m in {HEAVY} if m in sys.modules]))"
    assert json.loads(run_python(code)) == []


def test_mapping_loads_no_torch():
    assert run_python("import sys, geoaim.mapping; print('torch' in sys.modules)") == "False\n"


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_file_is_short_and_says_what_it_holds(path):
    assert len(path.read_text().splitlines()) <= 400
    assert path.stem not in {"utils", "helpers", "common", "misc"}
    if path.read_text().strip():
        assert ast.get_docstring(ast.parse(path.read_text()))


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(PACKAGE)))
def test_public_names_have_docstrings(path):
    silent = [node.name for node in public_definitions(path) if not ast.get_docstring(node)]
    assert silent == []


def test_functions_have_at_most_six_parameters():
    for path in SOURCES:
        for node in public_definitions(path):
            # a command's parameters are its flags; another's interface is as it is
            command = path.parent.name == "cli" or path.name == "torchdrivesim.py"
            command |= path.parent.name == "bench" and node.name == "main"
            if isinstance(node, ast.FunctionDef) and not command:
                given = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
                assert len([a for a in given if a.arg != "self"]) <= 6, f"{path}: {node.name}"


def test_tests_mirror_the_package():
    tests = {path.relative_to(ROOT / "tests") for path in (ROOT / "tests").rglob("test_*.py")}
    folders = {path.parent for path in tests}
    assert folders <= {path.parent.relative_to(PACKAGE) for path in SOURCES}


def test_pins_cover_every_dependency():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = project["dependencies"] + project["optional-dependencies"]["test"]
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pinned = {line.split("==")[0] for line in lines if "==" in line}
    assert {name.split(">")[0].split("[")[0] for name in wanted} - pinned == set()
