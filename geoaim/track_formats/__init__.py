"""Tracks from the files of public datasets; `read_any` detects the format.

To add a format:

1. Write `track_formats/<name>.py` with a function `read_<name>(path) -> Tracks`. Read the table
   with `read_table` (its `delimiter`, `header` and `text` say how the file is written), refuse
   unusable files with `check_columns`, and name agent types with `map_types`.
   Convert to x east and y north in metres, radians counter-clockwise from +x, seconds.
   - The file has headings and speeds: finish with `make_tracks(rows, world)`.
   - The file has positions only: finish with `make_tracks_from_positions(rows, world, ...)`.
   Files that do not say where they lie take `world`, files in pixels take `resolution` (metres
   per pixel), both as keywords.
2. At the end of that file describe the format as a `TrackFormat`: its name, how its first line
   looks (`has_columns(...)`), the reader, and which of "world" and "resolution" it takes.
3. Add the value to `FORMATS` in `formats.py`. The first format that matches is used, so a format
   whose columns include those of another comes before it.
4. Export the reader below, and test it in `tests/track_formats/test_<name>.py` on a few lines of
   the format; add its first line to the cases of `tests/track_formats/test_formats.py`.
"""

from geoaim.track_formats.formats import read_any
from geoaim.track_formats.geotrax import read_geotrax
from geoaim.track_formats.interaction import read_interaction
from geoaim.track_formats.levelx import read_highd, read_ind
from geoaim.track_formats.motion import derive_motion
from geoaim.track_formats.sind import read_sind
from geoaim.track_formats.stanford import read_sdd, read_trajnet

__all__ = [
    "derive_motion",
    "read_any",
    "read_geotrax",
    "read_highd",
    "read_ind",
    "read_interaction",
    "read_sdd",
    "read_sind",
    "read_trajnet",
]
