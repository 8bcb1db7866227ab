'''Tracks from the files of public datasets; `geoaim.read_tracks` detects the format.

To add a format, say "drone-local" (`drone_local` in names of modules, readers and tests, where no
hyphen is allowed; `DRONE_LOCAL` for the constant):

1. Write `track_formats/drone_local.py` with a reader and, at its end, a `TrackFormat` that
    describes it. Start from the file below that is nearer to your format.
2. Add `DRONE_LOCAL` to `FORMATS` in `formats.py`. The first format that matches is used: put the
    format with the more specific `has_columns` first.
3. Export `read_drone_local` from this package. If `world` or `resolution` means something special
    for this format, say so in the docstring of `read_tracks`.
4. Test the reader in `tests/tracks/formats/test_drone_local.py`, with the format's first line in a
    constant `HEAD`. Then add

    - to the cases of `test_formats.py`, which imports your test file:
      `(test_drone_local.HEAD, "drone-local")`;
    - to `TABLES` in `tests/faults/seeds.py`, the text of a valid file: `"drone_local.csv": ...`;
    - to `READERS` in `tests/faults/readers.py`, with the reader's options:
      `"tracks: drone-local": _tracks("drone_local.csv")`; `test_readers.py` then damages that file.

5. Add a row to the table of `docs/formats/tracks.md` and a line to `CHANGELOG.md`.
6. Run these and `make lint`:

        .venv/bin/pytest tests/tracks/formats/test_drone_local.py
        .venv/bin/pytest tests/tracks/formats/test_formats.py
        .venv/bin/pytest tests/faults/test_readers.py -k drone-local

A file for tables with positions only, in pixels:

    import os

    import numpy as np
    import pandas as pd

    from geoaim.tracks.files import read_table
    from geoaim.tracks.formats import shared
    from geoaim.tracks.formats.motion import make_tracks_from_positions
    from geoaim.tracks.tracks import Tracks
    from geoaim.base.world import World


    def read_drone_local(path: str | os.PathLike[str], *, resolution: float) -> Tracks:
        """Read a drone-local .csv: `id;class;ms;u;v`, in pixels of `resolution` metres."""
        table = read_table(path, text=("id", "class"), delimiter=";")
        shared.check_columns(path, table, numbers=("ms", "u", "v"), others=("id", "class"))
        rows = pd.DataFrame(
            {
                "id": table["id"],
                "type": shared.map_types(path, table["class"]),
                "time": table["ms"] / 1000,
                "x": resolution * table["u"],
                "y": -resolution * table["v"],
                "length": np.nan,
                "width": np.nan,
            }
        )
        rows[["length", "width"]] = shared.fill_sizes(rows)
        return make_tracks_from_positions(rows, World(None), half_window=0.5)


    DRONE_LOCAL = shared.TrackFormat(
        "drone-local",
        shared.has_columns("id", "class", "ms", delimiter=";"),
        read_drone_local,
        options=("resolution",),
        required=("resolution",),
    )

A file for tables with headings and speeds, in metres:

    import os

    import numpy as np
    import pandas as pd

    from geoaim.base.geometry import wrap_angle
    from geoaim.tracks.files import read_table
    from geoaim.tracks.formats import shared
    from geoaim.tracks.tables import make_tracks
    from geoaim.tracks.tracks import Tracks
    from geoaim.base.world import World

    NUMBERS = ("t", "x", "y", "yaw", "kmh", "l", "w")


    def read_drone_local(path: str | os.PathLike[str], *, world: World | None = None) -> Tracks:
        """Read a drone-local .csv: `id,class,t,x,y,yaw,kmh,l,w`, yaw in degrees from +x."""
        table = read_table(path, text=("id", "class"))
        shared.check_columns(path, table, numbers=NUMBERS, others=("id", "class"))
        rows = pd.DataFrame(
            {
                "id": table["id"],
                "type": shared.map_types(path, table["class"]),
                "time": table["t"],
                "x": table["x"],
                "y": table["y"],
                "heading": wrap_angle(np.radians(table["yaw"].to_numpy(np.float64))),
                "speed": table["kmh"] / 3.6,
                "length": table["l"],
                "width": table["w"],
            }
        )
        rows[["length", "width"]] = shared.fill_sizes(rows)
        return make_tracks(rows, world or World(None))


    DRONE_LOCAL = shared.TrackFormat(
        "drone-local",
        shared.has_columns("id", "class", "yaw", "kmh"),
        read_drone_local,
        options=("world",),
    )

Units of the rows:

- `time` in seconds; `length` and `width` in metres.
- `x` and `y` in metres, x east and y north; from pixels, x right and y up, as in the first file.
- `speed` in m/s, negative in reverse.
- `heading` in radians, counter-clockwise from +x. From degrees clockwise from the image's right, it
  is `-np.radians(degrees)`; from degrees clockwise from north, `np.pi / 2 - np.radians(degrees)`.
  `make_tracks` wraps headings of up to 2 pi either way; larger ones need `wrap_angle`.

For other tables, change the second file; the functions are in `motion.py`:

- In pixels with headings or sizes: take x, y, `World(None)` and the options from the first file,
  and multiply sizes by `resolution`.
- Headings missing in some rows: pass `fill_headings(rows)` to `make_tracks`.
- Velocities instead of speeds: `compute_signed_speed` makes the column.
- Neither velocities nor speeds: call `make_tracks(rows.assign(speed=0.0), ...)`, and return
  `derive_speeds(tracks, half_window=0.25)`.
- Classes as numbers: look up their names before `map_types`, which warns of names that it does not
  know, and name an unknown number "class 9", as `geotrax.py` does.

`half_window` (s) averages out the noise of the positions: 0.25 for smooth tracks, 0.5 for boxes of
a detector. `fill_sizes` replaces sizes that are 0 or missing; call it also where the file has
sizes. `read_tracks` refuses a `resolution` that is not positive. `geoaim.mapping.place_tracks`
moves tracks in pixels onto the map of their video.
'''

from geoaim.tracks.formats.argoverse import read_argoverse
from geoaim.tracks.formats.formats import read_tracks
from geoaim.tracks.formats.geopackage import read_geopackage, write_geopackage
from geoaim.tracks.formats.geotrax import read_geotrax, write_geotrax
from geoaim.tracks.formats.geotrax_pixels import read_geotrax_pixels
from geoaim.tracks.formats.interaction import read_interaction, read_sind
from geoaim.tracks.formats.levelx import read_highd, read_ind
from geoaim.tracks.formats.motion import derive_motion, derive_speeds
from geoaim.tracks.formats.pixels import read_pixels
from geoaim.tracks.formats.scenarionet import read_scenarionet, read_scenarionet_lights
from geoaim.tracks.formats.stanford import read_sdd, read_trajnet
from geoaim.tracks.formats.waymo import list_waymo_scenarios, read_waymo, read_waymo_lights

__all__ = [
    "derive_motion",
    "derive_speeds",
    "list_waymo_scenarios",
    "read_argoverse",
    "read_geopackage",
    "read_geotrax",
    "read_geotrax_pixels",
    "read_highd",
    "read_ind",
    "read_interaction",
    "read_pixels",
    "read_scenarionet",
    "read_scenarionet_lights",
    "read_sdd",
    "read_sind",
    "read_tracks",
    "read_trajnet",
    "read_waymo",
    "read_waymo_lights",
    "write_geopackage",
    "write_geotrax",
]
