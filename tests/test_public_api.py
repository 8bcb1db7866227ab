import inspect

import pytest

import geoaim
from geoaim import errors

NAMES = [
    "AIM",
    "GeoaimError",
    "GeoaimWarning",
    "Tracks",
    "World",
    "align_tiles",
    "build_aim",
    "export_texture",
    "mapping",
    "read_aim",
    "read_tracks",
    "rectify",
    "write_aim",
    "write_tracks",
]


def test_public_names_are_these():
    assert sorted(geoaim.__all__) == NAMES
    assert set(NAMES) <= set(dir(geoaim))


@pytest.mark.parametrize("name", NAMES)
def test_public_name_exists_and_says_what_it_is(name):
    assert inspect.getdoc(getattr(geoaim, name))


def test_mapping_gives_its_stages():
    assert callable(geoaim.mapping.register)


def test_name_that_does_not_exist_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'build_map'"):
        geoaim.build_map  # noqa: B018


def test_one_except_clause_catches_every_error_about_data():
    kinds = [kind for _, kind in inspect.getmembers(errors, inspect.isclass)]
    raised = [kind for kind in kinds if not issubclass(kind, Warning)]
    assert all(issubclass(kind, geoaim.GeoaimError) for kind in raised)
    assert issubclass(geoaim.GeoaimWarning, UserWarning)
