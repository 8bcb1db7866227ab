"""The file that the docstring of `tracks.formats` shows makes a format of its own."""

import re
import textwrap

import numpy as np
import pytest

from geoaim.tracks import formats as package
from geoaim.tracks.formats import formats


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder of further modules of the package."""
    [code] = re.findall(r"\n\n((?: {4}import os\n)(?: {4}.*\n|\n)+)", package.__doc__)
    (tmp_path / "drone_local.py").write_text(textwrap.dedent(code))
    monkeypatch.setattr(package, "__path__", [*package.__path__, str(tmp_path)])
    formats.list_formats.cache_clear()
    yield tmp_path
    formats.list_formats.cache_clear()


def test_module_in_the_package_is_all_that_a_new_format_needs(folder):
    path = folder / "a.csv"
    path.write_text("id,class,t,x,y,yaw,kmh,l,w\n07,Car,0,3,4,270,36,5,0\n")
    assert formats.detect_format(path).name == "drone-local"
    tracks = package.read_tracks(path)
    np.testing.assert_allclose(tracks.states[0], [[3, 4, -np.pi / 2, 10]])
    np.testing.assert_allclose(tracks.sizes, [[5.0, 1.8]])  # the width is the typical one
