"""Tracks from the files of public datasets; `read_any` detects the format.

To add a format:

1. Write `track_formats/<name>.py` with a reader and, at its end, a `TrackFormat` that describes it:

       def read_example(path: str | os.PathLike[str], *, world: World | None = None) -> Tracks:
           table = read_table(path, text=("id", "class"), delimiter=";")
           check_columns(path, table, numbers=("ms", "x", "y"), others=("id", "class"))
           columns = {"id": table["id"], "type": map_types(table["class"])}
           columns |= {"time": table["ms"] / 1000, "x": table["x"], "y": table["y"]}
           rows = pd.DataFrame(columns).assign(length=np.nan, width=np.nan)
           rows[["length", "width"]] = fill_sizes(rows)
           return make_tracks_from_positions(rows, world or World(None), half_window=0.5)

       EXAMPLE = TrackFormat(
           "example", has_columns("id", "class", "ms", delimiter=";"), read_example, ("world",)
       )

   Units are seconds, metres with x east and y north, and radians counter-clockwise from +x. A
   file with headings and speeds ends with `make_tracks(rows, world)`. A reader takes `world` if
   its files do not say where they lie, and `resolution` (metres per pixel) if they are in pixels.
2. Add the value to `FORMATS` in `formats.py`. The first format that matches is used: a format
   whose columns include all those of another one comes before it.
3. Export the reader below. Test it in `tests/track_formats/test_<name>.py`, and add a first line
   of the format to the cases of `tests/track_formats/test_formats.py`.
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
