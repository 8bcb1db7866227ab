"""Pairs for the alignment benchmark: an AIM, and a misplaced picture of the same place."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from benchmarks.synthetic import draw_place, make_place, make_sample, tracks_of, world_from_image
from benchmarks.synthetic.imagery import make_other_day, photograph
from benchmarks.synthetic.roads.layouts import STANDARD_KINDS
from geoaim.aim.aim import AIM
from geoaim.base.geometry import make_similarity, transform_points, translation
from geoaim.tracks.tracks import Tracks

PICTURE_RESOLUTIONS = (0.3, 0.4, 0.5, 0.6)  # m a pixel
AIM_RESOLUTION = 0.2  # m a pixel
SCENE_RESOLUTION = 0.1  # m a pixel, of what the sensor sees; finer than the AIM, as its noise is
MAX_SHIFT_M, MAX_ROTATION_DEGREES, MAX_SCALING = 15.0, 5.0, 0.05
ERROR_GRID = 5  # points each way at which errors are measured


@dataclass(frozen=True, eq=False)
class Pair:
    """An AIM and a picture of the same place."""

    name: str  # kind and seed of the place
    aim: AIM  # the AIM
    picture: AIM  # misplaced
    stated_from_true: Float[Array, "3 3"]  # metres, by which it is misplaced
    tracks: Tracks | None = None  # a minute of traffic there


def misplace_picture(pair: Pair, generator: np.random.Generator) -> Pair:
    """Misplace the picture of a pair at random, by up to 15 m, 5 degrees and 5 %."""
    angle, shift = generator.uniform(0, 2 * np.pi), generator.uniform(0, MAX_SHIFT_M)
    rotation = np.radians(generator.uniform(-MAX_ROTATION_DEGREES, MAX_ROTATION_DEGREES))
    scale = 1 + generator.uniform(-MAX_SCALING, MAX_SCALING)
    matrix = make_similarity(pair.aim.corners.mean(axis=0), rotation, scale)
    matrix[:2, 2] += shift * np.array([np.cos(angle), np.sin(angle)])
    moved = replace(pair.picture, world_from_image=matrix @ pair.picture.world_from_image)
    return replace(pair, picture=moved, stated_from_true=matrix)


def make_pairs(seeds: int, first: int = 1) -> Iterator[Pair]:
    """Make places of each kind with some seeds, and a picture of each, not misplaced.

    A picture is of another day and by another sensor than the AIM.
    """
    for seed in range(first, first + seeds):
        for kind in STANDARD_KINDS:
            place = make_place(seed, kind=kind)
            resolution = PICTURE_RESOLUTIONS[seed % len(PICTURE_RESOLUTIONS)]
            tracks = tracks_of(make_sample(seed, kind=kind, minutes=1.0, video=None))
            photo = photograph(
                place,
                make_other_day(place),
                tracks,
                sensor_resolution=resolution,
                resolution=SCENE_RESOLUTION,
            )
            ground = draw_place(place, resolution=AIM_RESOLUTION)
            aim, picture = (
                AIM.from_image(image, world_from_image(place, metres), place.world, "drawn")
                for image, metres in ((ground, AIM_RESOLUTION), (photo, resolution))
            )
            yield Pair(f"{kind} {seed}", aim, picture, np.eye(3), tracks)


def move_to_aim(case: Pair) -> Pair:
    """Move the picture of another place to where the AIM is."""
    shift = case.aim.corners.mean(axis=0) - case.picture.corners.mean(axis=0)
    matrix = translation(*shift) @ case.picture.world_from_image
    return replace(
        case, picture=replace(case.picture, world_from_image=matrix, world=case.aim.world)
    )


def measure_error(pair: Pair, true_from_stated: Float[Array, "3 3"]) -> float:
    """Measure the mean error of an alignment of a pair's picture over the place, metres."""
    height, width = pair.aim.grid.shape
    u, v = np.meshgrid(np.linspace(0, width, ERROR_GRID), np.linspace(0, height, ERROR_GRID))
    points = transform_points(pair.aim.world_from_image, np.stack([u, v], -1).reshape(-1, 2))
    aligned = transform_points(true_from_stated @ pair.stated_from_true, points)
    return float(np.linalg.norm(aligned - points, axis=1).mean())
