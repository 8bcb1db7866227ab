"""Notebooks are short, and begin with few imports; `make test` runs them."""

import ast
import json
from pathlib import Path

import pytest

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_short_and_begins_with_few_imports(path):
    cells = json.loads(path.read_text("utf-8"))["cells"]
    code = [cell for cell in cells if cell["cell_type"] == "code"]
    assert len(code) <= 8
    assert all(cell["outputs"] == [] for cell in code)
    first = [line for line in code[0]["source"] if not line.startswith("%")]
    imports = [n for n in ast.walk(ast.parse("".join(first))) if isinstance(n, ast.Import)]
    imports += [n for n in ast.walk(ast.parse("".join(first))) if isinstance(n, ast.ImportFrom)]
    names = {alias.name for node in imports for alias in node.names}
    assert len(names - {"geoaim"}) <= 3
