"""Do real vehicles drive where HD maps say that they may? Karlsruhe's junctions, and the sample.

    python -m geoaim.bench.drivable --json docs/bench/drivable.json

`--picture FILE` shows where they do not; that stays out of the repository, as real tracks do.
"""

import csv
from pathlib import Path
from typing import Annotated, Any

import matplotlib.pyplot as plt
import numpy as np
import shapely
import typer
from jaxtyping import Float
from numpy import ndarray as Array
from shapely import MultiPolygon

from geoaim.bench.data import find_data
from geoaim.bench.report import format_table, write_rows
from geoaim.hdmap.drivable import find_drivable_area
from geoaim.hdmap.lanelet2 import read_hdmap
from geoaim.simulation.layers import KINDS
from geoaim.track_files import read_tracks
from geoaim.track_formats import read_interaction
from geoaim.tracks import Tracks
from geoaim.world import LONLAT, World, transform_crs

JUNCTIONS = ("k729_2022-03-16", "k733_2018-05-02")
CRS = "EPSG:32632"
NEAR = 0.7  # m


def places_of(tracks: Tracks) -> Float[Array, "m 2"]:
    """Where vehicles were."""
    wheels = np.array([kind in KINDS["vehicle"] for kind in tracks.types])
    return tracks.states[wheels][tracks.present[wheels]][:, :2]


def karlsruhe(junction: str) -> tuple[MultiPolygon, Float[Array, "m 2"]]:
    """The drivable area of a junction about its tracks' origin, and the places of its vehicles."""
    data = find_data()
    if data is None:
        raise FileNotFoundError("no folder of real data; name it in GEOAIM_DATA")
    folder = data / "tracks" / "karlsruhe"
    with open(folder / "tracks" / junction / "meta_data.csv", encoding="utf-8") as file:
        meta = next(csv.DictReader(file))
    corner = np.array([[float(meta["originLon"]), float(meta["originLat"])]])
    east, north = transform_crs(LONLAT, CRS, corner)[0].tolist()
    hdmap = read_hdmap(folder / "maps" / f"{junction}.osm", World(CRS, (east, north)))
    files = sorted((folder / "tracks" / junction).glob("vehicle_tracks*.csv"))
    places = [places_of(read_interaction(file)) for file in files]
    return find_drivable_area(hdmap), np.concatenate(places)


def row(name: str, area: MultiPolygon, places: Float[Array, "m 2"]) -> dict[str, Any]:
    """The share of places in the area, and how far off it the others are."""
    shapely.prepare(area)
    off = shapely.distance(area, shapely.points(places))
    return {
        "map": name,
        "places": len(places),
        "on the drivable area, %": 100 * float((off == 0).mean()),
        f"within {NEAR} m of it, %": 100 * float((off < NEAR).mean()),
        "furthest, m": float(off.max()),
    }


def main(
    json: Annotated[Path | None, typer.Option(help="where to write the figures")] = None,
    picture: Annotated[Path | None, typer.Option(help="where to draw places off the area")] = None,
) -> None:
    """Count vehicles on the drivable areas of the sample's map and of real ones."""
    tracks = read_tracks("samples/tracks.csv")
    sample = find_drivable_area(read_hdmap("samples/map_full.osm", tracks.world))
    found = {"sample": (sample, places_of(tracks))}
    found |= {junction: karlsruhe(junction) for junction in JUNCTIONS}
    rows = [row(name, *both) for name, both in found.items()]
    print(format_table(rows))
    write_rows(rows, json, command="python -m geoaim.bench.drivable")
    if picture is None:
        return
    figure, axes = plt.subplots(1, len(found), figsize=(7 * len(found), 6), layout="constrained")
    for axis, (name, (area, places)) in zip(axes, found.items(), strict=True):
        for part in area.geoms:
            for ring, colour in [(part.exterior, "0.8"), *((hole, "w") for hole in part.interiors)]:
                axis.fill(*np.asarray(ring.coords).T, color=colour)
        off = ~shapely.contains_xy(area, places)
        axis.plot(*places[~off].T, ",", color="C0")
        axis.plot(*places[off].T, ".", color="C3", ms=2)
        axis.set(title=f"{name}: {off.mean():.1%} off", aspect="equal")
    figure.savefig(picture, dpi=80)


if __name__ == "__main__":
    typer.run(main)
