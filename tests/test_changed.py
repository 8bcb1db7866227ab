"""A change leads to its tests, and a planted fault to the line where it is."""

import ast
from pathlib import Path

import pytest

from tests import planted_faults
from tests.changed import ROOT, find_tests


def find_module(stem):
    return next(str(path.relative_to(ROOT)) for path in (ROOT / "geoaim").rglob(f"{stem}.py"))


def test_a_module_leads_to_the_tests_that_import_it():
    tests = find_tests([find_module("cutting")])
    assert "test_segments.py" in {Path(name).name for name in tests}
    assert "test_tiles.py" not in {Path(name).name for name in tests}
    folders = {Path(name).parts[1] for name in find_tests([find_module("geometry")])}
    assert folders == {"base", "test_conventions.py", "test_public_api.py"}  # of its folder alone


def test_tests_lead_to_themselves_and_pages_to_those_of_the_documentation():
    here = str(Path(__file__).relative_to(ROOT))
    assert find_tests([here, "docs/index.md", "gone.py"]) == [here, "tests/test_docs.py"]
    assert "tests/test_changed.py" in find_tests(["tests/changed.py"])
    assert find_tests(["tests/web/conftest.py"]) == ["tests/web"]
    assert find_tests(["LICENSE"]) == []


@pytest.mark.parametrize(
    ("code", "changed"),
    [
        ("a = b + c", ["a = b - c"]),
        ("a = (b) <= c < d", ["a = (b) < c < d", "a = (b) <= c > d"]),
        ("a = 'é' and not b", ["a = 'é' or not b", "a = 'é' and b"]),
        ("a = f(2.5, True)", ["a = f(3.5, True)", "a = f(2.5, False)"]),
        ("a = 'text'", []),
    ],
)
def test_faults_change_one_place(code, changed, tmp_path, monkeypatch):
    monkeypatch.setattr(planted_faults, "ROOT", tmp_path)
    found = []
    for fault in _list_faults(tmp_path, code):
        planted_faults.plant(fault, tmp_path)
        found.append((tmp_path / "a.py").read_text().strip())
        (tmp_path / "a.py").write_text(code + "\n")
    assert sorted(found) == sorted(changed)


def _list_faults(folder, code):
    (folder / "a.py").write_text(code + "\n")
    return planted_faults.list_faults("a.py")


def test_chosen_faults_are_valid_code(tmp_path):
    for fault in planted_faults.choose_faults(30, seed=3):
        copy = tmp_path / fault.path
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_text((ROOT / fault.path).read_text())
        before, after = planted_faults.plant(fault, tmp_path)
        assert before != after
        ast.parse(copy.read_text())
