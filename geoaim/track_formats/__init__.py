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

   Units are seconds, metres with x east and y north, and radians counter-clockwise from +x:
   degrees clockwise from the image's right become `-np.radians(angle)`, degrees clockwise from
   north `np.pi / 2 - np.radians(angle)`. `make_tracks` wraps headings of up to 2 pi either way;
   only larger ones need `wrap_angle` of `geoaim.geometry`.

   A reader of files in pixels takes `resolution` (metres per pixel; `read_tracks` refuses values
   that are not positive) and gives `World(None)`; `geoaim.mapping.place_tracks` then moves such
   tracks onto the map of their video. A reader of files in metres that state no CRS is
   `read_example(path, *, world: World | None = None)`, and its format has `options=("world",)`.

   `map_types` takes names, and warns of those that it does not know. Where a file has numbers of
   classes, look them up first, and name an unknown number "class 9", as `geotrax.py` does.
   `fill_sizes` replaces sizes that are 0 or missing; call it also where the file gives sizes.

   `half_window` (s) averages out the noise of the positions: 0.25 for smooth tracks, 0.5 for boxes
   of a detector. `estimate_velocity` widens it where states are further apart.

   A file with headings ends with `make_tracks` of `geoaim.track_tables` instead. With speeds too:

           columns |= {"x": table["x"], "y": table["y"]}
           columns |= {"heading": table["yaw"], "speed": table["v"]}
           rows = pd.DataFrame(columns | {"length": table["l"], "width": table["w"]})
           rows[["length", "width"]] = shared.fill_sizes(rows)
           return make_tracks(rows, world or World(None))

   With velocities instead of speeds, `compute_signed_speed` of `motion.py` makes the column; with
   neither, the last line is

           tracks = make_tracks(rows.assign(speed=0.0), world or World(None))
           return derive_speeds(tracks, half_window=0.25)
2. Add the value to `FORMATS` in `formats.py`. The first format that matches is used: a format
   whose columns include all those of another one comes before it.
3. Export the reader below. If `world` or `resolution` means something special for this format, say
   so in the docstring of `read_tracks`.
4. Test the reader in `tests/track_formats/test_<name>.py` (some older ones are in
   `test_readers.py`), and add a first line of the format, imported from there, to the cases of
   `test_formats.py`. Add the text of a valid file to `TABLES` in `tests/faults/seeds.py`, and
   `"tracks: NAME": _tracks("name.csv")`, with its options, to `READERS` in
   `tests/faults/readers.py`: `tests/faults/test_readers.py` then damages that file.
5. Add a row to the table of `docs/formats/tracks.md` and a line to `CHANGELOG.md`.
6. Run `pytest tests/track_formats tests/faults/test_readers.py -k NAME`, then `make lint`.
'''

from geoaim.track_formats.formats import read_tracks
from geoaim.track_formats.geotrax import read_geotrax
from geoaim.track_formats.interaction import read_interaction, read_sind
from geoaim.track_formats.levelx import read_highd, read_ind
from geoaim.track_formats.motion import derive_motion, derive_speeds
from geoaim.track_formats.stanford import read_sdd, read_trajnet

__all__ = [
    "derive_motion",
    "derive_speeds",
    "read_geotrax",
    "read_highd",
    "read_ind",
    "read_interaction",
    "read_sdd",
    "read_sind",
    "read_tracks",
    "read_trajnet",
]
