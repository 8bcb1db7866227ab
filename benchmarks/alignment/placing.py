"""Maps that are placed by imagery of another day, from a start that is far off.

    python -m benchmarks.alignment.placing --json docs/bench/placing.json

What a drone sees of a made place, turned by any angle; its scale is wrong by up to 20 %, and its
middle is said to be up to 30 m away. The picture is of another day and sensor. Errors are those of
the map's corners, in pixels of the picture; places are smaller than a turned view, so that many of
them lie where nothing is drawn, and those that show the ground are judged apart. Then maps of a
camera that is tilted by about 1 degree, and pictures of other places, which must be refused.
"""

import time
from dataclasses import replace
from typing import Annotated, Any

import cv2
import numpy as np
import typer
from jaxtyping import Float
from numpy import ndarray as Array

from benchmarks.alignment.pairs import Pair, make_pairs, move_to_aim
from benchmarks.results import JsonFile, Row, print_rows, write_rows
from geoaim.aim.aim import AIM
from geoaim.base.errors import AlignmentError, GeoreferenceError
from geoaim.base.geometry import make_similarity, to_opencv, transform_points, translation
from geoaim.base.progress import no_progress
from geoaim.base.world import World, change_world, lonlat_from_world
from geoaim.imagery.alignment.place_by_imagery import MAX_CORNER_PX, place_by_imagery

VALIDATION_SEED, TEST_SEED = 11, 51  # of the first places, one of each kind
SEEDS = 3  # of places, and so of resolutions of the picture
TRIALS, TILTED, OTHERS = 5, 3, 2  # views of each place; tilted ones; with another one's picture
SIZE_PX = (540, 960)  # of a view
RESOLUTIONS = (0.15, 0.2)  # metres per pixel, between which a view's lies
MAX_OFF_M, MAX_SCALING = 30.0, 0.2
TILT = 0.016  # of tilted views, per half of the diagonal; 1 degree for a field of view of 84
MAX_ERROR_PX = 2.0  # of a corner; a larger one is wrong


def look_at(pair: Pair, generator: np.random.Generator, tilt: float = 0.0) -> AIM:
    """Look at a part of a place from a drone, in any direction: the map in its true place.

    The scale of a tilted map changes by that share (one sigma) over half of its diagonal.
    """
    height, width = SIZE_PX
    resolution, angle = generator.uniform(*RESOLUTIONS), generator.uniform(-np.pi, np.pi)
    low, high = pair.aim.corners.min(axis=0), pair.aim.corners.max(axis=0)
    middle = (low + high) / 2 + generator.uniform(-0.1, 0.1, 2) * (high - low)
    turn = make_similarity(np.zeros(2), angle, resolution) @ np.diag([1.0, -1.0, 1.0])
    turn[:2, 2] = middle
    lean = np.eye(3)
    lean[2, :2] = generator.normal(0.0, 2 * tilt / np.hypot(height, width), 2)
    turn = turn @ lean @ translation(-width / 2, -height / 2)
    turn = turn / turn[2, 2]
    matrix = to_opencv(np.linalg.inv(turn) @ pair.aim.world_from_image)
    image, covered = (
        cv2.warpPerspective(one, matrix, (width, height), flags=cv2.INTER_AREA)
        for one in (pair.aim.image, np.ones(pair.aim.coverage.shape, np.uint8))
    )
    aim = AIM.from_image(np.asarray(image, np.uint8), turn, pair.aim.world, pair.name)
    return replace(aim, coverage=np.asarray(covered, np.uint16))


def measure_case(pair: Pair, view: AIM, generator: np.random.Generator) -> dict[str, Any]:
    """Place a view from a start that is far off: errors of its corners, and what is stated."""
    pixel, scale = pair.picture.resolution, 1 + generator.uniform(-MAX_SCALING, MAX_SCALING)
    angle, off = generator.uniform(0, 2 * np.pi), generator.uniform(0, MAX_OFF_M)
    middle = view.corners.mean(axis=0) + off * np.array([np.cos(angle), np.sin(angle)])
    [[longitude, latitude]] = lonlat_from_world(view.world, middle[None]).tolist()
    plane = np.diag([1.0, -1.0, 1.0])
    plane[:2] *= view.resolution * scale
    rough = replace(view, world=World(None), world_from_image=plane, report={})
    row: dict[str, Any] = {"place": pair.name, "picture": pair.picture.report["source"]}
    start = time.process_time()
    try:
        placed = place_by_imagery(
            rough, pair.picture, near=(latitude, longitude), progress=no_progress
        )
    except (AlignmentError, GeoreferenceError):
        return row | {"placed": False, "s": time.process_time() - start}
    row |= {"placed": True, "s": time.process_time() - start}
    corners = change_world(placed.world, view.world, placed.corners)
    errors = np.linalg.norm(corners - view.corners, axis=1)
    bounds = np.array(placed.report["georeference"]["corner_uncertainty_m"])
    shown = view.coverage[[0, 0, -1, -1], [0, -1, -1, 0]] > 0  # at the corners
    values = {"errors_px": errors / pixel, "bounds_px": bounds / pixel, "shown": shown}
    inside = measure_inside(view, placed)
    values |= {"ground_errors_px": inside[0] / pixel, "ground_bounds_px": inside[1] / pixel}
    return row | {name: value.tolist() for name, value in values.items()}


def measure_inside(view: AIM, placed: AIM) -> Float[Array, "2 n"]:
    """Measure errors and stated radii (m) where the view shows ground, on the report's grid."""
    bounds = np.array(placed.report["georeference"]["uncertainty"]["map_m"])
    height, width = view.coverage.shape
    v, u = np.linspace(0, height, bounds.shape[0]), np.linspace(0, width, bounds.shape[1])
    pixels = np.stack(np.meshgrid(u, v), axis=-1).reshape(-1, 2)
    row, column = (pixels[:, ::-1].astype(int).clip(0, [height - 1, width - 1])).T
    true = transform_points(view.world_from_image, pixels)
    found = transform_points(placed.world_from_image, pixels)
    errors = np.linalg.norm(change_world(placed.world, view.world, found) - true, axis=1)
    return np.stack([errors, bounds.ravel()])[:, view.coverage[row, column] > 0]


def summarize(name: str, cases: list[Row]) -> dict[str, Any]:
    """Summarize the cases of one kind of picture in a row."""
    placed = [case for case in cases if case["placed"]]
    errors = np.array([case["errors_px"] for case in placed]).reshape(-1, 4)
    bounds = np.array([case["bounds_px"] for case in placed]).reshape(-1, 4)
    row: dict[str, Any] = {"picture of": name, "cases": len(cases), "placed": len(placed)}
    shown = np.array([case["shown"] for case in placed], bool).reshape(-1, 4)
    for kind, where in (("corners", np.ones_like(shown)), ("corners that show ground", shown)):
        if where.any():
            row |= {
                kind: int(where.sum()),
                f"median error of {kind}, px": float(np.median(errors[where])),
                f"largest of {kind}, px": float(errors[where].max()),
                f"{kind} in their 95 % regions, %": 100 * float((errors <= bounds)[where].mean()),
                f"stated 95 % radius of {kind}, px": float(np.median(bounds[where])),
            }
    if placed:
        ground, stated = (
            np.concatenate([case[f"ground_{kind}_px"] for case in placed])
            for kind in ("errors", "bounds")
        )
        row |= {
            "ground inside the frame in its 95 % regions, %": 100
            * float(np.mean(ground <= stated)),
            "median error of ground, px": float(np.median(ground)),
            "stated 95 % radius of ground, px": float(np.median(stated)),
        }
    # of corners that show ground, as the warning names them
    wrong = (errors * shown).max(axis=1, initial=0) > MAX_ERROR_PX
    warned = (bounds * shown).max(axis=1, initial=0) > MAX_CORNER_PX
    return row | {
        "over 2 px": int(wrong.sum()),
        "of these not warned of": int((wrong & ~warned).sum()),
        "warned of without need": int((warned & ~wrong).sum()),
        "s": float(np.median([case["s"] for case in cases])),
    }


def main(
    json: JsonFile = None,
    validation: Annotated[bool, typer.Option(help="the validation places")] = False,
) -> None:
    """Measure maps that are placed by imagery."""
    cv2.setNumThreads(2)
    seed = VALIDATION_SEED if validation else TEST_SEED
    generator = np.random.default_rng(seed)
    pairs = list(make_pairs(SEEDS, first=seed))
    here: list[Row] = []
    tilted: list[Row] = []
    elsewhere: list[Row] = []
    for pair, other in zip(pairs, pairs[1:] + pairs[:1], strict=True):
        views = [look_at(pair, generator) for _ in range(TRIALS)]
        here += print_rows(measure_case(pair, view, generator) for view in views)
        leaning = [look_at(pair, generator, TILT) for _ in range(TILTED)]
        tilted += print_rows(measure_case(pair, view, generator) for view in leaning)
        wrong = move_to_aim(replace(other, aim=pair.aim))
        elsewhere += print_rows(measure_case(wrong, view, generator) for view in views[:OTHERS])
    rows = print_rows(
        summarize(name, cases)
        for name, cases in (
            ("the place, another day", here),
            ("the same, the map tilted", tilted),
            ("another place", elsewhere),
        )
    )
    write_rows(rows, json, command="python -m benchmarks.alignment.placing")


if __name__ == "__main__":
    typer.run(main)
