import inspect
import re
from dataclasses import fields, is_dataclass
from pathlib import Path
from types import ModuleType

import pytest

import geoaim
from geoaim.base import errors

CLASSES = ["AIM", "HDMap", "Lights", "Scene", "Tracks", "Video", "World"]
EXCEPTIONS = ["GeoaimError", "GeoaimWarning"]
FUNCTIONS = [
    "align_tiles",
    "build_aim",
    "draw_alignment",
    "draw_hdmap",
    "draw_quicklook",
    "explore",
    "pick",
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
    "hdmap",
    "imagery",
    "mapping",
    "prediction",
    "simulation",
    "synthetic",
    "tracking",
    "tracks",
]
ERRORS = [kind for _, kind in inspect.getmembers(errors, inspect.isclass)]
PACKAGE = Path(geoaim.__file__).parent


def section(docstring: str, name: str) -> str:
    """The lines of a Google-style section such as Args; empty when there is none."""
    found = re.search(rf"^{name}:\n((?:[ ]+.*\n?|\n)+)", docstring + "\n", re.MULTILINE)
    return found[1] if found else ""


def first_line(docstring: str) -> str:
    return docstring.split("\n", 1)[0]


def test_public_names_are_these():
    assert sorted(geoaim.__all__) == sorted([*CLASSES, *EXCEPTIONS, *FUNCTIONS, *SUBPACKAGES])
    assert set(geoaim.__all__) <= set(dir(geoaim))


@pytest.mark.parametrize("name", [*CLASSES, *EXCEPTIONS, *FUNCTIONS])
def test_name_stays_the_same_object_and_is_not_hidden_by_a_module_of_its_name(name):
    first, again = getattr(geoaim, name), getattr(geoaim, name)
    assert first is again
    assert not isinstance(again, ModuleType)
    assert not (PACKAGE / f"{name}.py").exists()


@pytest.mark.parametrize("name", SUBPACKAGES)
def test_subpackage_is_an_attribute(name):
    assert getattr(geoaim, name).__name__ == f"geoaim.{name}"


@pytest.mark.parametrize("name", FUNCTIONS)
def test_function_states_its_arguments_and_what_it_returns(name):
    function = getattr(geoaim, name)
    docstring, signature = inspect.getdoc(function) or "", inspect.signature(function)
    assert first_line(docstring).endswith((".", ":")), "a sentence comes first"
    arguments = section(docstring, "Args")
    if len(signature.parameters) >= 3:
        documented = re.findall(r"^    (\w+):", arguments, re.MULTILINE)
        named = [p.name for p in signature.parameters.values() if p.kind is not p.VAR_KEYWORD]
        assert documented[: len(named)] == named
        if signature.return_annotation is not None:
            assert section(docstring, "Returns")


@pytest.mark.parametrize("name", CLASSES)
def test_class_has_a_docstring_of_its_own_with_all_attributes(name):
    kind = getattr(geoaim, name)
    docstring = inspect.cleandoc(kind.__dict__["__doc__"])
    assert not docstring.startswith(f"{name}("), "the signature that dataclasses generate"
    if is_dataclass(kind):
        documented = re.findall(r"^    (\w+):", section(docstring, "Attributes"), re.MULTILINE)
        assert set(documented) == {field.name for field in fields(kind)}


@pytest.mark.parametrize("kind", ERRORS)
def test_error_says_when_it_is_raised_and_functions_announce_it(kind):
    docstring = kind.__dict__["__doc__"]
    assert docstring.endswith(".")
    assert len(docstring.split()) >= 5
    sources = "".join(path.read_text() for path in PACKAGE.rglob("*.py"))
    if kind not in (errors.GeoaimError, errors.GeoaimWarning):
        assert re.search(rf"raise {kind.__name__}\(", sources)
        assert re.search(rf"^ +{kind.__name__}: \w", sources, re.MULTILINE)


def test_a_notebook_needs_only_the_package():
    assert callable(geoaim.mapping.register)
    assert callable(geoaim.simulation.render)


def test_name_that_does_not_exist_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'no_such_name'"):
        geoaim.no_such_name  # noqa: B018


def test_one_except_clause_catches_every_error_about_data():
    raised = [kind for kind in ERRORS if not issubclass(kind, Warning)]
    assert all(issubclass(kind, geoaim.GeoaimError) for kind in raised)
    assert issubclass(geoaim.GeoaimWarning, UserWarning)
