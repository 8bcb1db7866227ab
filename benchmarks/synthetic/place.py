"""A synthetic place: roads, scenery and world; the same seed gives the same place."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from benchmarks.synthetic.roads.layouts import PlaceKind
from benchmarks.synthetic.roads.plan import HEIGHT_M, WIDTH_M, Roads, make_roads
from benchmarks.synthetic.scenery.canvas import make_canvas
from benchmarks.synthetic.scenery.day import Day
from benchmarks.synthetic.scenery.ground import draw_ground_layers
from benchmarks.synthetic.scenery.objects import draw_objects, grade_colours
from benchmarks.synthetic.scenery.plots import place_scenery
from benchmarks.synthetic.scenery.scenery import Scenery
from geoaim.base.world import World

RESOLUTION = 0.05  # m/px, default
WORLD = World("EPSG:32635", (583000.0, 6062000.0))
PLAN, SCENERY, GROUND, DAY = range(4)  # streams of random numbers


@dataclass(frozen=True, eq=False)
class Place:
    """A synthetic place."""

    seed: int  # random seed of everything in it
    roads: Roads  # the roads, in plan metres: from the middle, x right and y up as drawn
    scenery: Scenery  # the surroundings of the roads
    world: World  # the world of its tracks
    # (3, 3) plan metres to world metres, a rotation and a shift
    world_from_plan: Float[Array, "3 3"]


def make_place(seed: int, *, kind: PlaceKind = "junction") -> Place:
    """Make a place: "junction", "t", "roundabout", "street", "park" or "campus".

    Raises:
        ValueError: there is no such kind.
    """
    roads = make_roads(kind, np.random.default_rng([seed, PLAN]))
    generator = np.random.default_rng([seed, SCENERY])
    turn = generator.uniform(-np.pi, np.pi)  # no drone flies along the grid
    c, s = np.cos(turn), np.sin(turn)
    world_from_plan = np.array([[c, -s, 180.0], [s, c, 240.0], [0, 0, 1.0]])
    return Place(seed, roads, place_scenery(roads, generator), WORLD, world_from_plan)


def draw_place(
    place: Place, day: Day | None = None, *, resolution: float = RESOLUTION
) -> UInt8[Array, "H W 3"]:
    """Draw a place from above, without traffic.

    Textures differ between resolutions: for two images of the same ground, draw the finer one and
    resize it.

    Args:
        place: the place.
        day: the day; None takes day 0.
        resolution: metres per pixel.

    Returns:
        RGB of `HEIGHT_M` by `WIDTH_M` metres; `world_from_image` tells where.
    """
    day = Day() if day is None else day
    canvas = make_canvas(resolution, np.random.default_rng([place.seed, GROUND]))
    generator = np.random.default_rng([place.seed, DAY, day.number])
    draw_ground_layers(canvas, place.roads, place.scenery, day, generator)
    draw_objects(canvas, place.scenery, day, generator)
    grade_colours(canvas, day)
    return np.rint(np.minimum(np.maximum(canvas.image, 0), 255)).astype(np.uint8)


def world_from_image(place: Place, resolution: float = RESOLUTION) -> Float[Array, "3 3"]:
    """Compute the transform from pixels of the image from `draw_place` to its world."""
    return place.world_from_plan @ plan_from_image(resolution)


def plan_from_image(resolution: float = RESOLUTION) -> Float[Array, "3 3"]:
    """Compute the transform from pixels of the image from `draw_place` to plan metres."""
    m = resolution
    left, top = (-m * round(side / m) / 2 for side in (WIDTH_M, HEIGHT_M))
    return np.array([[m, 0, left], [0, -m, -top], [0, 0, 1.0]])
