"""The rules of docs/architecture.md that lint does not check."""

import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import geoaim

PACKAGE = Path(geoaim.__file__).parent
ROOT = PACKAGE.parent
HEAVY = ("torch", "matplotlib", "cv2", "rasterio", "av", "pandas", "pyproj", "scipy", "numpy")


def run_python(code: str) -> str:
    return subprocess.run(
        [sys.executable, "-c", code], check=True, capture_output=True, text=True, cwd=ROOT
    ).stdout


def test_layers_contract_names_every_folder():
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    layers = next(c["layers"] for c in contracts["contracts"] if c["type"] == "layers")
    named = {part.strip(" ()") for layer in layers for part in layer.split("|")}
    folders = {f"geoaim.{path.stem}" for path in PACKAGE.glob("*.py") if path.stem != "__init__"}
    folders |= {f"geoaim.{path.parent.name}" for path in PACKAGE.glob("*/__init__.py")}
    assert folders - named == set()


@pytest.mark.parametrize("module", ["geoaim", "geoaim.cli"])
def test_import_loads_nothing_heavy(module):
    code = f"import sys, {module}; print([m for m in {HEAVY} if m in sys.modules])"
    assert run_python(code) == "[]\n"


def test_import_of_a_build_loads_neither_torch_nor_pandas():
    code = "import sys, geoaim.mapping.build_map; print({'torch', 'pandas'} & {*sys.modules})"
    assert run_python(code) == "set()\n"


def test_pins_cover_every_dependency_and_lowest_versions_are_the_lower_bounds():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = project["dependencies"] + project["optional-dependencies"]["test"]
    names = {name.split(">")[0].split("[")[0] for name in wanted}
    assert names - set(read_pins("constraints.txt")) - {"geoaim"} == set()
    lowest = read_pins("constraints-lowest.txt")
    for dependency in project["dependencies"]:
        name, bound = dependency.split(",")[0].split(">=")
        assert f"{lowest[name]}.".startswith(f"{bound}."), dependency


def read_pins(name: str) -> dict[str, str]:
    lines = (ROOT / name).read_text().splitlines()
    return dict(line.split("==") for line in lines if "==" in line)
