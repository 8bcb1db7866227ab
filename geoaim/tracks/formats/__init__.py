'''Tracks from the files of public datasets; `geoaim.read_tracks` detects the format.

A new format needs two files. One is a module here with a reader and a `TrackFormat`, which is found
when the package is imported:

    import os

    import numpy as np
    import pandas as pd

    from geoaim.base.geometry import wrap_angle
    from geoaim.base.world import World
    from geoaim.tracks.files import read_table
    from geoaim.tracks.formats import shared
    from geoaim.tracks.tables import make_tracks
    from geoaim.tracks.tracks import Tracks

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

The other is its test, `tests/tracks/formats/test_drone_local.py`. Where others should know it, add
a row to `docs/formats/tracks.md`.

Rows are in seconds and metres, x east and y north (from pixels: x right and y up, times
`resolution`, as in `stanford.py`); speeds in m/s, negative in reverse; headings in radians,
counter-clockwise from +x (from degrees clockwise from north: `np.pi / 2 - np.radians(degrees)`).
Without headings and speeds, `motion.make_tracks_from_positions` derives both; without speeds alone,
`motion.derive_speeds`; with velocities, `motion.compute_signed_speed`.
'''

from geoaim.tracks.formats.argoverse import read_argoverse
from geoaim.tracks.formats.formats import read_tracks
from geoaim.tracks.formats.geopackage import read_geopackage, write_geopackage
from geoaim.tracks.formats.geotrax import read_geotrax, read_geotrax_pixels
from geoaim.tracks.formats.interaction import read_interaction, read_sind
from geoaim.tracks.formats.levelx import read_highd, read_ind
from geoaim.tracks.formats.motion import derive_motion, derive_speeds
from geoaim.tracks.formats.pixels import read_pixels
from geoaim.tracks.formats.scenarionet import read_scenarionet
from geoaim.tracks.formats.stanford import read_sdd, read_trajnet

__all__ = [
    "derive_motion",
    "derive_speeds",
    "read_argoverse",
    "read_geopackage",
    "read_geotrax",
    "read_geotrax_pixels",
    "read_highd",
    "read_ind",
    "read_interaction",
    "read_pixels",
    "read_scenarionet",
    "read_sdd",
    "read_sind",
    "read_tracks",
    "read_trajnet",
    "write_geopackage",
]
