"""How often real vehicles are on the drivable area of HD maps: Karlsruhe's junctions, the sample.

python -m benchmarks.simulation.drivable --json docs/bench/drivable.json
"""

from typing import Any

import numpy as np
import shapely
import typer
from jaxtyping import Float
from numpy import ndarray as Array
from shapely import MultiPolygon

from benchmarks.data import require_data
from benchmarks.results import JsonFile, print_rows, write_rows
from geoaim import read_tracks
from geoaim.hdmap.drivable import find_drivable_area
from geoaim.hdmap.lanelet2 import read_hdmap
from geoaim.tracks.agent_types import select_group
from geoaim.tracks.formats import read_interaction
from geoaim.tracks.tracks import Tracks

JUNCTIONS = ("k729_2022-03-16", "k733_2018-05-02")
NEAR_M = 0.7  # distance from the area: half a lane beside a queue


def _list_positions(tracks: Tracks) -> Float[Array, "m 2"]:
    """Positions of vehicles at all steps, metres."""
    vehicles = select_group(tracks.types, "vehicle")
    return tracks.states[vehicles][tracks.present[vehicles]][:, :2]


def _read_junction(junction: str) -> tuple[MultiPolygon, Float[Array, "m 2"]]:
    """Read the drivable area of a junction of Karlsruhe, and the positions of its vehicles."""
    folder = require_data("tracks/karlsruhe")
    files = sorted((folder / "tracks" / junction).glob("vehicle_tracks*.csv"))
    recordings = [read_interaction(file) for file in files]
    hdmap = read_hdmap(folder / "maps" / f"{junction}.osm", recordings[0].world)
    positions = [_list_positions(tracks) for tracks in recordings]
    return find_drivable_area(hdmap), np.concatenate(positions)


def _measure_share(name: str, area: MultiPolygon, positions: Float[Array, "m 2"]) -> dict[str, Any]:
    """Measure the share of positions on a drivable area, and the distances of the others."""
    shapely.prepare(area)
    distances = shapely.distance(area, shapely.points(positions))
    return {
        "map": name,
        "places": len(positions),
        "on the drivable area, %": 100 * float((distances == 0).mean()),
        f"within {NEAR_M} m of it, %": 100 * float((distances < NEAR_M).mean()),
        "furthest, m": float(distances.max()),
    }


def main(json: JsonFile = None) -> None:
    """Measure how often vehicles are on the drivable areas of the sample's map and of real maps."""
    tracks = read_tracks("samples/tracks.csv")
    sample = find_drivable_area(read_hdmap("samples/map_full.osm", tracks.world))
    cases = {"sample": (sample, _list_positions(tracks))}
    cases |= {junction: _read_junction(junction) for junction in JUNCTIONS}
    rows = print_rows(_measure_share(name, *case) for name, case in cases.items())
    write_rows(rows, json, command="python -m benchmarks.simulation.drivable")


if __name__ == "__main__":
    typer.run(main)
