"""Days of one place by `build_catalog`: how far their maps lie from the first one's.

    python -m benchmarks.catalog.days --json docs/bench/catalog_days.json

The days are three parts of one real recording (Minsk), of which the last one is also turned by 180
degrees and darker, and another street, which is no day of this place. Points are made for the
first day alone. SIFT features of two maps, which no map is registered by, tell how far apart they
are: the median of those in each of 24 parts of the map.
"""

import shutil
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
import typer
from jaxtyping import Float
from numpy import ndarray as Array

from benchmarks.data import find_data
from benchmarks.results import JsonFile, Row, print_rows, write_rows
from geoaim import AIM, read_aim
from geoaim.aim.position import CHI2_2D
from geoaim.aim.rectification import resample
from geoaim.catalog import Cluster, build_catalog

RESOLUTION, NOISE_M = 0.055, 0.02  # of the made control points
POINTS = [(u, v) for u in (100, 960, 1820) for v in (80, 540, 1000)]
PARTS = (4, 6)  # of a map, rows and columns
MIN_MATCHES = 10  # in a part, else it tells nothing
FARTHEST_M = 1.0  # of two features that are one
RATIO = 0.7  # Lowe's, of the nearest and the next feature


def write_days(pictures: Path, street: Path, folder: Path) -> Path:
    """Write the pictures of four days, the points of the first one, and their table."""
    files = sorted(pictures.glob("*.jpg"))
    parts: dict[str, Sequence[Path]] = dict(
        zip(("first", "second", "third"), (files[:9], files[9:18], files[18:]), strict=True)
    )
    parts |= {"turned": parts["third"], "street": sorted(street.glob("*.jpg"))}
    for name, chosen in parts.items():
        (folder / name).mkdir(parents=True)
        for file in chosen:
            shutil.copy(file, folder / name)
            if name == "turned":
                picture = np.asarray(cv2.imread(str(file)))
                cv2.imwrite(
                    str(folder / name / file.name), (picture[::-1, ::-1] * 0.6).astype(np.uint8)
                )
    generator = np.random.default_rng(1)
    lines = ["# crs: EPSG:32635", "name,u,v,x,y"]
    for number, (u, v) in enumerate(POINTS):
        x, y = np.array([u, -v]) * RESOLUTION + generator.normal(0.0, NOISE_M, 2)
        lines.append(f"p{number},{u},{v},{540000 + x:.3f},{5970000 + y:.3f}")
    (folder / "points.csv").write_text("\n".join(lines))
    rows = [f"{name},junction,{name}," + "points.csv" * (name == "first") for name in parts]
    (folder / "table.csv").write_text("\n".join(["name,place,video,gcps", *rows]) + "\n")
    return folder / "table.csv"


def measure_distances(day: AIM, first: AIM) -> Float[Array, "n 2"]:
    """Measure how far a map lies from another one, in its parts that have features, metres."""
    image = resample(day, first.grid)
    sift = cv2.SIFT_create(20_000)  # type: ignore[attr-defined]
    found = []
    for aim in (first, image):
        seen = ((aim.coverage > 0) & ~aim.contested).astype(np.uint8)
        points, features = sift.detectAndCompute(cv2.cvtColor(aim.image, cv2.COLOR_RGB2GRAY), seen)
        found.append((np.array([point.pt for point in points]), features))
    (here, one), (there, other) = found
    pairs = cv2.BFMatcher().knnMatch(one, other, k=2)
    best = [near for near, next_one in pairs if near.distance < RATIO * next_one.distance]
    start = here[[match.queryIdx for match in best]]
    moved = (there[[match.trainIdx for match in best]] - start) * first.resolution
    near = np.hypot(*moved.T) < FARTHEST_M
    start, moved = start[near], moved[near]
    place = np.floor(start[:, ::-1] / first.grid.shape * PARTS) @ [PARTS[1], 1]
    of_parts = [moved[place == part] for part in range(PARTS[0] * PARTS[1])]
    return np.array([np.median(part, axis=0) for part in of_parts if len(part) >= MIN_MATCHES])


def measure_days(table: Path, maps: Path) -> list[Row]:
    """Build the days of a place, and compare each with the first one."""
    catalog, rows = build_catalog(table, maps, cluster=Cluster(workers=1)), list[Row]()
    first = read_aim(maps / "recordings/first/aim.tif")
    for name, record in catalog.records.items():
        row: dict[str, Any] = {
            "day": name,
            "status": record.status,
            "processor time, s": round(record.processor_seconds, 1),
        }
        position = record.report.get("position", {})
        if name != "first" and record.status == "built":
            day = read_aim(maps / f"recordings/{name}/aim.tif")
            assert day.world == first.world
            covariance = np.array(position["relative_covariance_m2"])
            apart = measure_distances(day, first)
            inside = np.einsum("ni,ij,nj->n", apart, np.linalg.inv(covariance), apart) < CHI2_2D
            row |= {
                "stated, m (95 %)": round(float(np.sqrt(CHI2_2D * covariance.max())), 3),
                "apart, m (median)": round(float(np.median(np.hypot(*apart.T))), 3),
                "apart, m (worst part)": round(float(np.hypot(*apart.T).max()), 3),
                "parts": len(apart),
                "parts in the stated region": int(inside.sum()),
            }
        rows.append(row)
    return sorted(rows, key=len, reverse=True)  # what was compared comes first


def main(json: JsonFile = None) -> None:
    """Measure days of one place; print a table and write JSON."""
    data = find_data()
    if data is None:
        raise SystemExit("no real data: set GEOAIM_DATA to a folder that holds hover/")
    with TemporaryDirectory() as name:
        hover, folder = data / "hover", Path(name)
        table = write_days(hover / "minsk_junction", hover / "minsk_street", folder / "days")
        rows = measure_days(table, folder / "maps")
    print_rows(rows)
    write_rows(rows, json, command="python -m benchmarks.catalog.days")


if __name__ == "__main__":
    typer.run(main)
