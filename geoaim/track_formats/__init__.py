'''Tracks from the files of public datasets; `geoaim.read_tracks` detects the format.

To add a format:

1. Write `track_formats/<name>.py` with a reader and, at its end, a `TrackFormat` that describes it:

       import os

       import numpy as np
       import pandas as pd

       from geoaim.track_files import read_table
       from geoaim.track_formats import shared
       from geoaim.track_formats.motion import make_tracks_from_positions
       from geoaim.tracks import Tracks
       from geoaim.world import World


       def read_example(path: str | os.PathLike[str], *, resolution: float) -> Tracks:
           """Read an example .csv: `id;class;ms;u;v`, in pixels of `resolution` metres."""
           table = read_table(path, text=("id", "class"), delimiter=";")
           shared.check_columns(path, table, numbers=("ms", "u", "v"), others=("id", "class"))
           columns = {"id": table["id"], "type": shared.map_types(path, table["class"])}
           columns |= {"time": table["ms"] / 1000, "x": resolution * table["u"]}
           columns |= {"y": -resolution * table["v"]}
           rows = pd.DataFrame(columns).assign(length=np.nan, width=np.nan)
           rows[["length", "width"]] = shared.fill_sizes(rows)
           return make_tracks_from_positions(rows, World(None), half_window=0.5)


       EXAMPLE = shared.TrackFormat(
           "example",
           shared.has_columns("id", "class", "ms", delimiter=";"),
           read_example,
           options=("resolution",),
           required=("resolution",),
       )

   Units are seconds, metres with x east and y north, and radians counter-clockwise from +x; a
   heading in degrees clockwise on an image becomes `-np.radians(angle)`, and `wrap_angle` of
   `geoaim.geometry` brings headings beyond 2 pi into [-pi, pi). A reader of files in pixels takes
   `resolution` (metres per pixel; `read_tracks` refuses values that are not positive) and gives
   `World(None)`; `geoaim.mapping.place_tracks` then moves such tracks onto the map of their
   video. `map_types` takes names; look numbers of classes up first, as `geotrax.py` does.

   A file in metres with headings and speeds ends with `make_tracks(rows, world)` of
   `geoaim.track_tables` instead; `rows` has the columns id, type, time, x, y, heading, speed,
   length and width. If the file states no CRS, the signature is `read_example(path, *, world:
   World | None = None)`, and the format has `options=("world",)`. A file with headings and
   velocities gets speeds from `compute_signed_speed`, one with headings alone from
   `estimate_velocity`, both in `motion.py`. `half_window` (s) averages out the noise of the
   positions: 0.25 for smooth tracks, 0.5 for boxes of a detector; it is widened where states are
   further apart.
2. Add the value to `FORMATS` in `formats.py`. The first format that matches is used: a format
   whose columns include all those of another one comes before it.
3. Export the reader below, and name the format in the docstring of `read_tracks` where an option
   means something particular for it. Test it in `tests/track_formats/test_<name>.py`, and add a
   first line of the format to the cases of `tests/track_formats/test_formats.py`, and a valid
   file to `tests/faults/seeds.py` with its reader in `tests/faults/readers.py`, which then damage
   it.
4. Add a row to the table of `docs/formats/tracks.md` and a line to `CHANGELOG.md`.
'''

from geoaim.track_formats.formats import read_tracks
from geoaim.track_formats.geotrax import read_geotrax
from geoaim.track_formats.interaction import read_interaction, read_sind
from geoaim.track_formats.levelx import read_highd, read_ind
from geoaim.track_formats.motion import derive_motion
from geoaim.track_formats.stanford import read_sdd, read_trajnet

__all__ = [
    "derive_motion",
    "read_geotrax",
    "read_highd",
    "read_ind",
    "read_interaction",
    "read_sdd",
    "read_sind",
    "read_tracks",
    "read_trajnet",
]
