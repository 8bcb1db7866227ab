"""The files that the checklist for new formats shows, in the docstring of `tracks.formats`."""

import re
import textwrap
from pathlib import Path

import numpy as np

from geoaim.base.world import World
from geoaim.tracks import formats as track_formats
from geoaim.tracks.formats.shared import TrackFormat

FILES = [
    textwrap.dedent(block)
    for block in re.findall(r"\n\n((?: {4}.*\n|\n)+)", track_formats.__doc__ or "")
    if block.lstrip().startswith("import os")
]
POSITIONS, STATES = FILES


def load(code: str) -> TrackFormat:
    """Run a file of the checklist, and take its format."""
    names: dict[str, TrackFormat] = {}
    exec(compile(code, "drone_local.py", "exec"), names)
    return names["DRONE_LOCAL"]


def write(folder: Path, text: str) -> Path:
    path = folder / "drone_local.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_file_with_positions_in_pixels_reads_its_table(tmp_path):
    path = write(tmp_path, "id;class;ms;u;v\n07;Car;0;0;100\n07;Car;1000;50;100\n")
    form = load(POSITIONS)
    assert form.matches(path, "id;class;ms;u;v")
    tracks = form.read(path, resolution=0.1)
    assert (tracks.ids, tracks.types, tracks.world) == (("07",), ("car",), World(None))
    np.testing.assert_allclose(tracks.states[0], [[0, -10, 0, 5], [5, -10, 0, 5]])
    np.testing.assert_allclose(tracks.sizes, [[4.5, 1.8]])


def test_file_with_headings_and_speeds_reads_its_table(tmp_path):
    path = write(tmp_path, "id,class,t,x,y,yaw,kmh,l,w\n07,Car,0,3,4,270,36,5,0\n")
    form = load(STATES)
    assert form.matches(path, "id,class,t,x,y,yaw,kmh,l,w")
    tracks = form.read(path)
    np.testing.assert_allclose(tracks.states[0], [[3, 4, -np.pi / 2, 10]])
    np.testing.assert_allclose(tracks.sizes, [[5.0, 1.8]])  # the width is the typical one
