"""Pairs for the benchmark of alignment: an AIM, and a picture of the place that is misplaced."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.aim import AIM
from geoaim.geometry import similarity_about, transform_points
from geoaim.synthetic import draw_place, make_place, make_sample, tracks_of, world_from_image
from geoaim.synthetic.imagery import Sensor, make_other_day, photograph
from geoaim.synthetic.roads.layouts import STANDARD_KINDS
from geoaim.tracks import Tracks

RESOLUTIONS = (0.3, 0.4, 0.5, 0.6)  # m a pixel
GROUND = 0.2  # m a pixel of the AIM
DRAWN = 0.1  # of what the sensor sees: finer, so that not one grain is that of the AIM
REACH, TURN, ZOOM = 15.0, 5.0, 0.05
GRID = 5  # places each way at which errors are taken


@dataclass(frozen=True, eq=False)
class Pair:
    """A picture of a place, misplaced by `stated_from_true`, and the AIM that it belongs on."""

    name: str
    aim: AIM
    picture: AIM
    stated_from_true: Float[Array, "3 3"]
    tracks: Tracks | None = None


def misplaced(pair: Pair, generator: np.random.Generator) -> Pair:
    """The same pair, misplaced anew."""
    angle, reach = generator.uniform(0, 2 * np.pi), generator.uniform(0, REACH)
    turn = np.radians(generator.uniform(-TURN, TURN))
    matrix = similarity_about(
        pair.aim.corners.mean(axis=0), turn, 1 + generator.uniform(-ZOOM, ZOOM)
    )
    matrix[:2, 2] += reach * np.array([np.cos(angle), np.sin(angle)])
    moved = replace(pair.picture, world_from_image=matrix @ pair.picture.world_from_image)
    return replace(pair, picture=moved, stated_from_true=matrix)


def made_pairs(seeds: int) -> Iterator[Pair]:
    """A place of each kind and seed, and what another sensor saw of it on another day."""
    for seed in range(1, seeds + 1):
        for kind in STANDARD_KINDS:
            place = make_place(seed, kind=kind)
            resolution = RESOLUTIONS[seed % len(RESOLUTIONS)]
            tracks = tracks_of(make_sample(seed, kind=kind, minutes=1.0, video=None))
            sensor = Sensor(resolution=resolution)
            photo = photograph(place, make_other_day(place), tracks, sensor, resolution=DRAWN)
            ground = draw_place(place, resolution=GROUND)
            yield Pair(
                f"{kind} {seed}",
                AIM.from_image(ground, world_from_image(place, GROUND), place.world, "drawn"),
                AIM.from_image(photo, world_from_image(place, resolution), place.world, "drawn"),
                np.eye(3),
                tracks,
            )


def error(pair: Pair, true_from_stated: Float[Array, "3 3"]) -> float:
    """Metres, a mean over the place."""
    height, width = pair.aim.image.shape[:2]
    u, v = np.meshgrid(np.linspace(0, width, GRID), np.linspace(0, height, GRID))
    places = transform_points(pair.aim.world_from_image, np.stack([u, v], -1).reshape(-1, 2))
    found = transform_points(true_from_stated @ pair.stated_from_true, places)
    return float(np.linalg.norm(found - places, axis=1).mean())
