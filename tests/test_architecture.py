"""The rules of docs/architecture.md that a program can check."""

import ast
import json
import re
import statistics
import subprocess
import sys
import tomllib
from functools import cache
from pathlib import Path

import pytest

import geoaim

PACKAGE = Path(geoaim.__file__).parent
ROOT = PACKAGE.parent
SOURCES = sorted([*PACKAGE.rglob("*.py"), *(ROOT / "benchmarks").rglob("*.py")])
COMMANDS = {"main", "experiment"}  # of benchmarks
HEAVY = ("torch", "matplotlib", "cv2", "rasterio", "av", "pandas", "pyproj")


def run_python(code: str) -> str:
    return subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True, cwd=ROOT
    ).stdout


@cache
def parse(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


def public_definitions(path: Path) -> list[ast.FunctionDef | ast.ClassDef]:
    """Functions and classes of a file, and methods of its classes, without a leading underscore."""
    tree = parse(path)
    classes = [node for node in tree.body if isinstance(node, ast.ClassDef)]
    bodies = [tree.body, *(node.body for node in classes if not node.name.startswith("_"))]
    kinds = (ast.FunctionDef, ast.ClassDef)
    found = [node for body in bodies for node in body if isinstance(node, kinds)]
    return [node for node in found if not node.name.startswith("_")]


def find_functions() -> list[tuple[Path, ast.FunctionDef]]:
    return [
        (path, node)
        for path in SOURCES
        for node in ast.walk(parse(path))
        if isinstance(node, ast.FunctionDef)
    ]


def parameters(node: ast.FunctionDef) -> list[str]:
    given = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
    return [argument.arg for argument in given if argument.arg not in {"self", "cls"}]


def count_lines(node: ast.FunctionDef) -> int:
    """Lines of a function without its docstring."""
    first = node.body[0]
    is_documented = ast.get_docstring(node) is not None
    documentation = first.end_lineno - first.lineno + 1 if is_documented else 0
    return node.end_lineno - node.lineno + 1 - documentation


def name_module(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def find_imports(path: Path) -> set[str]:
    """Modules that a file imports, by their names or through a public name of geoaim."""
    text = path.read_text()
    imported = set()
    for node in ast.walk(parse(path)):
        if isinstance(node, ast.ImportFrom) and node.module:
            imported |= {node.module, *(f"{node.module}.{name.name}" for name in node.names)}
        elif isinstance(node, ast.Import):
            imported |= {name.name for name in node.names}
    names = re.findall(r"\bgeoaim\.(\w+)", text)
    return imported | {
        geoaim._MODULE_OF_NAME[name] for name in names if name in geoaim._MODULE_OF_NAME
    }


def is_command(path: Path, node: ast.FunctionDef) -> bool:
    """Whether typer reads the function's parameters as flags."""
    return path.parent.name == "cli" or ("benchmarks" in path.parts and node.name in COMMANDS)


@pytest.mark.slow  # `make lint` checks it, too
def test_imports_point_backwards_along_the_way():
    found = subprocess.run(
        [sys.executable, "-c", "from importlinter.cli import lint_imports_command as run; run()"],
        capture_output=True,
        text=True,
        cwd=ROOT,
    )
    assert found.returncode == 0, found.stdout + found.stderr


def test_the_package_has_few_entries():
    assert len([*PACKAGE.glob("*.py"), *PACKAGE.glob("*/__init__.py")]) <= 14


def test_benchmarks_use_public_names_alone():
    private = re.compile(
        r"^from geoaim[\w.]* import .*\b_[a-z]|\b(?!self\.)[a-z]\w*\._[a-z]\w+\(", re.M
    )
    texts = {path: path.read_text("utf-8") for path in (ROOT / "benchmarks").rglob("*.py")}
    assert [path.name for path, text in texts.items() if private.search(text)] == []


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


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_file_is_short_and_says_what_it_holds(path):
    assert len(path.read_text().splitlines()) <= 400
    assert path.stem not in {"utils", "helpers", "common", "misc"}
    if path.read_text().strip():
        assert ast.get_docstring(parse(path))


def test_most_files_and_functions_are_short():
    lines = [len(path.read_text().splitlines()) for path in SOURCES]
    functions = [count_lines(node) for _, node in find_functions()]
    assert statistics.median(lines) <= 120
    assert statistics.quantiles(functions, n=10)[-1] <= 25


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_public_names_have_docstrings(path):
    silent = [node.name for node in public_definitions(path) if not ast.get_docstring(node)]
    assert silent == []


def test_functions_have_at_most_six_parameters():
    crowded = [
        f"{path.relative_to(ROOT)}: {node.name}"
        for path, node in find_functions()
        # a command's parameters are its flags; another program's interface is as it is
        if not is_command(path, node) and path.name != "torchdrivesim.py"
        if len(parameters(node)) > 6
    ]
    assert crowded == []


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: str(path.relative_to(ROOT)))
def test_public_functions_with_three_parameters_document_them(path):
    silent = []
    for node in public_definitions(path):
        if not isinstance(node, ast.FunctionDef) or is_command(path, node):
            continue
        if path.name == "torchdrivesim.py":  # the interface of another program
            continue
        docstring = ast.get_docstring(node) or ""
        returns = ast.unparse(node.returns) if node.returns else "None"
        if len(parameters(node)) >= 3 and not (
            "Args:" in docstring
            and (returns == "None" or "Returns:" in docstring or "Yields:" in docstring)
        ):
            silent.append(node.name)
    assert silent == []


def test_every_module_is_imported_by_a_test():
    """By its own name, or by a module of the same room that a test imports."""
    modules = {name_module(path): find_imports(path) for path in SOURCES}
    reached = set().union(*(find_imports(path) for path in (ROOT / "tests").rglob("*.py")))
    while True:
        rooms = {".".join(module.split(".")[:2]): set() for module in modules}
        for module in reached & set(modules):
            rooms[".".join(module.split(".")[:2])] |= modules[module]
        further = {
            module
            for room, imported in rooms.items()
            for module in imported
            if module.startswith(room + ".")
        }
        if further <= reached:
            break
        reached |= further
    files = {name_module(path) for path in SOURCES if path.stem not in {"__init__", "__main__"}}
    assert files - reached == set()


def test_tests_mirror_the_package():
    tests = {path.relative_to(ROOT / "tests") for path in (ROOT / "tests").rglob("test_*.py")}
    folders = {path.parent for path in tests} - {Path("faults")}  # across rooms
    rooms = {path.parent.relative_to(PACKAGE) for path in SOURCES if path.is_relative_to(PACKAGE)}
    assert folders <= rooms | {path.parent.relative_to(ROOT) for path in SOURCES}


def test_pins_cover_every_dependency():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = project["dependencies"] + project["optional-dependencies"]["test"]
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pinned = {line.split("==")[0] for line in lines if "==" in line}
    names = {name.split(">")[0].split("[")[0] for name in wanted}
    assert names - pinned - {"geoaim"} == set()  # an extra may name another one


def test_lowest_versions_are_the_lower_bounds_of_the_dependencies():
    wanted = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    lines = (ROOT / "constraints-lowest.txt").read_text().splitlines()
    lowest = dict(line.split("==") for line in lines if "==" in line)
    for dependency in wanted:
        name, bound = dependency.split(",")[0].split(">=")
        assert f"{lowest[name]}.".startswith(f"{bound}."), dependency
