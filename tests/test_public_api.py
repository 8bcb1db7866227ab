import inspect
import re
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import ModuleType

import pytest

import geoaim
from geoaim.base import errors

CLASSES = ["AIM", "Evidence", "HDMap", "Lights", "Scene", "Tracks", "Video", "World"]
EXCEPTIONS = ["GeoaimError", "GeoaimWarning"]
FUNCTIONS = [
    "align_tiles",
    "build_aim",
    "detect",
    "draw_alignment",
    "draw_hdmap",
    "draw_quicklook",
    "explore",
    "find_vehicles",
    "pick",
    "place_by_imagery",
    "place_video",
    "export_texture",
    "make_scene",
    "open_video",
    "read_aim",
    "read_texture",
    "read_control_points",
    "read_detections",
    "track_video",
    "read_hdmap",
    "read_imagery",
    "read_lights",
    "read_tracks",
    "rectify",
    "register",
    "write_aim",
    "write_tracks",
]
SUBPACKAGES = [
    "catalog",
    "detection",
    "hdmap",
    "imagery",
    "mapping",
    "prediction",
    "rendering",
    "simulation",
    "tracking",
    "tracks",
]
ERRORS = [kind for _, kind in inspect.getmembers(errors, inspect.isclass)]
PACKAGE = Path(geoaim.__file__).parent
ROOT = PACKAGE.parent


def section(docstring: str, name: str) -> str:
    """The lines of a Google-style section such as Args; empty when there is none."""
    found = re.search(rf"^{name}:\n((?:[ ]+.*\n?|\n)+)", docstring + "\n", re.MULTILINE)
    return found[1] if found else ""


def first_line(docstring: str) -> str:
    return docstring.split("\n", 1)[0]


def test_public_names_are_these():
    assert sorted(geoaim.__all__) == sorted([*CLASSES, *EXCEPTIONS, *FUNCTIONS, *SUBPACKAGES])
    assert set(geoaim.__all__) <= set(dir(geoaim))


def test_names_stay_the_same_objects_and_are_not_hidden_by_modules_of_their_names():
    for name in [*CLASSES, *EXCEPTIONS, *FUNCTIONS]:
        first, again = getattr(geoaim, name), getattr(geoaim, name)
        assert first is again
        assert not isinstance(again, ModuleType)
    for name in SUBPACKAGES:
        assert getattr(geoaim, name).__name__ == f"geoaim.{name}"


def test_functions_state_their_arguments_and_what_they_return():
    for name in FUNCTIONS:
        function = getattr(geoaim, name)
        docstring, signature = inspect.getdoc(function) or "", inspect.signature(function)
        assert first_line(docstring).endswith((".", ":")), "a sentence comes first"
        arguments = section(docstring, "Args")
        if len(signature.parameters) >= 3:
            documented = re.findall(r"^    (\w+):", arguments, re.MULTILINE)
            named = [p.name for p in signature.parameters.values() if p.kind is not p.VAR_KEYWORD]
            assert documented[: len(named)] == named, name
            if signature.return_annotation is not None:
                assert section(docstring, "Returns"), name


def test_functions_have_an_example():
    files = [*PACKAGE.rglob("*.py"), ROOT / "README.md", *ROOT.glob("docs/**/*.md")]
    text = "".join(path.read_text("utf-8") for path in [*files, *ROOT.glob("notebooks/*.ipynb")])
    assert [name for name in FUNCTIONS if not re.search(rf"\bgeoaim\.{name}\(", text)] == []


def test_classes_have_a_docstring_of_their_own_with_all_attributes():
    for name in CLASSES:
        kind = getattr(geoaim, name)
        docstring = inspect.cleandoc(kind.__dict__["__doc__"])
        assert not docstring.startswith(f"{name}("), "the signature that dataclasses generate"
        if is_dataclass(kind):
            documented = re.findall(r"^    (\w+):", section(docstring, "Attributes"), re.MULTILINE)
            assert set(documented) == {field.name for field in fields(kind)}, name


def test_errors_say_when_they_are_raised_and_functions_announce_them():
    sources = "".join(path.read_text() for path in PACKAGE.rglob("*.py"))
    for kind in ERRORS:
        assert len(kind.__dict__["__doc__"].split()) >= 5, kind
        if kind not in (errors.GeoaimError, errors.GeoaimWarning):
            assert re.search(rf"raise {kind.__name__}\(", sources), kind
            assert re.search(rf"^ +{kind.__name__}: \w", sources, re.MULTILINE), kind


def test_name_that_does_not_exist_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'no_such_name'"):
        geoaim.no_such_name  # noqa: B018


def test_one_except_clause_catches_every_error_about_data():
    raised = [kind for kind in ERRORS if not issubclass(kind, Warning)]
    assert all(issubclass(kind, geoaim.GeoaimError) for kind in raised)
    assert issubclass(geoaim.GeoaimWarning, UserWarning)
