"""Videos of real junctions with their own cars: some drive, some wait and leave, some are parked.

The ground is what several stills of a junction show between its cars, which are cut out of them
(Minsk, CC BY-SA 4.0; no detector of geoaim was trained on it). Nothing of it is in the repository.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from benchmarks.background.queue_sprites import cut_place
from benchmarks.hover_videos import follow_lane, smooth_lane
from benchmarks.synthetic.camera import HoverClip, SpriteTracks, film
from benchmarks.synthetic.sample import HOVER, VIDEOS

SPACING_M = 5.8  # between cars that wait
ACCELERATION = 2.5  # of a queue that leaves, m/s²


@dataclass(frozen=True)
class Junction:
    """A junction of stills; places in their pixels, read off them."""

    resolution: float  # metres per pixel, by the lengths of cars
    lanes: tuple[tuple[tuple[int, int], ...], ...]  # in driving order
    stops: dict[int, int]  # lanes with a queue, and where along them it stands, pixels
    parked: tuple[tuple[float, float, float], ...]  # middles and headings


JUNCTIONS = {
    "minsk_junction": Junction(
        0.055,
        (
            ((1920, 517), (1400, 517), (790, 462), (0, 435)),
            ((1920, 563), (1400, 563), (633, 496), (0, 485)),
            ((0, 626), (555, 644), (1310, 659), (1920, 663)),
            ((0, 688), (546, 694), (1310, 712), (1920, 718)),
            ((0, 742), (400, 744), (700, 760), (860, 900), (860, 1080)),
            ((990, 0), (962, 396), (970, 630), (1050, 1080)),
            ((1110, 1080), (1060, 660), (1097, 495), (1134, 0)),
        ),
        {2: 540, 3: 530, 5: 110},
        (
            *((150.0 + 52 * k, 900.0, np.pi / 2) for k in range(6)),
            *((1500.0 + 115 * k, 860.0, 0.0) for k in range(3)),
        ),
    ),
    # on which nothing was chosen; the sun shines between long shadows
    "minsk_street": Junction(
        0.072,
        (
            ((1920, 345), (1450, 336), (920, 345), (0, 345)),
            ((1920, 306), (1320, 306), (920, 316), (0, 320)),
            ((0, 508), (790, 508), (1055, 490), (1920, 461)),
            ((0, 547), (920, 547), (1920, 517)),
            ((910, 396), (877, 633), (864, 1080)),
            ((1042, 1080), (1002, 633), (982, 396)),
        ),
        {3: 640, 5: 380},
        (
            *((690.0, 740.0 + 110 * k, np.pi / 2) for k in range(3)),
            *((1140.0, 940.0 + 110 * k, np.pi / 2) for k in range(2)),
        ),
    ),
}


@dataclass(frozen=True)
class Condition:
    """How a video of the junction is made."""

    size: str = "1080p"
    moving: int = 24  # cars that drive
    queue: int = 4  # cars that wait in each queue
    shadow: tuple[float, float] = (0.0, 0.0)  # pixels right and down
    frame_rate: float = 15.0


CONDITIONS = {
    "plain": Condition(),
    "720p": Condition(size="720p"),
    "shadows": Condition(shadow=(22.0, 15.0)),
    "queue": Condition(moving=12, queue=6),
}


def film_junction(place: str, condition: str, seed: int, *, count: int) -> HoverClip:
    """Film a junction.

    Args:
        place: one of `JUNCTIONS`.
        condition: one of `CONDITIONS`.
        seed: of traffic and camera.
        count: number of frames; queues leave after 60 % of them.

    Returns:
        The clip, in pixels of the stills.
    """
    wanted, generator = CONDITIONS[condition], np.random.default_rng([seed, len(condition)])
    hover = replace(HOVER, count=count, frame_rate=wanted.frame_rate)
    ground, sprites = cut_place(place, width=1920)
    poses = _drive(JUNCTIONS[place], wanted, count, generator)
    chosen = generator.integers(0, len(sprites), (poses.shape[1],)).tolist()
    traffic = SpriteTracks(
        tuple(sprites[k] for k in chosen),
        np.array([_measure_body(sprites[k]) for k in chosen], float),
        poses,
        shadow=wanted.shadow,
    )
    height, width = VIDEOS[wanted.size]
    return film(ground, traffic, hover, height=height, width=width, generator=generator)


def _measure_body(sprite: UInt8[Array, "h w 4"]) -> tuple[int, int]:
    """Measure the length and width of what is opaque; the stills' boxes are larger than cars."""
    opaque = sprite[..., 3] > 127
    return int(opaque.any(axis=0).sum()), int(opaque.any(axis=1).sum())


def _drive(
    junction: Junction, wanted: Condition, count: int, generator: np.random.Generator
) -> Float[Array, "T N 3"]:
    """Poses of the cars: those that drive, wait, and are parked."""
    times = np.arange(count) / wanted.frame_rate
    lanes = [smooth_lane(list(lane)) for lane in junction.lanes]
    spacing, acceleration = SPACING_M / junction.resolution, ACCELERATION / junction.resolution
    paths = []
    for number, stop in junction.stops.items():
        leaving = acceleration / 2 * (times - 0.6 * times[-1]).clip(0) ** 2
        paths += [
            follow_lane(lanes[number], 300 + stop - spacing * k + leaving, loop=False)
            for k in range(wanted.queue)
        ]
    free = [lane for number, lane in enumerate(lanes) if number not in junction.stops]
    speeds = generator.uniform(120, 280, len(free))  # one speed for each lane
    for rank in range(wanted.moving):
        number, row = rank % len(free), rank // len(free)
        share = (row + generator.uniform(-0.2, 0.2)) / -(-wanted.moving // len(free))
        along = share * len(free[number]) + speeds[number] * times
        paths.append(follow_lane(free[number], along, loop=True))
    paths += [np.tile(place, (count, 1)) for place in junction.parked]
    return np.stack(paths, axis=1)
