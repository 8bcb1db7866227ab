"""A hover clip of a synthetic place and its traffic."""

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from geoaim.geometry import transform_points
from geoaim.synthetic.camera import HoverClip, SpriteTracks, film
from geoaim.synthetic.hover import Hover
from geoaim.synthetic.place import RESOLUTION, Place, draw_place, world_from_image
from geoaim.synthetic.scenery.day import Day, compute_shadow_offset
from geoaim.synthetic.scenery.objects import CAR_HEIGHT_M, PAINTS
from geoaim.synthetic.scenery.sprites import draw_pedestrian, draw_vehicle
from geoaim.tracks import Tracks

CLOTHES = ((58, 62, 78), (150, 60, 52), (198, 190, 178), (70, 96, 128), (90, 98, 72), (36, 36, 40))
CAMERA, COLOURS = 20, 21  # streams of random numbers


def film_place(
    place: Place,
    day: Day,
    tracks: Tracks,
    hover: Hover,
    *,
    size: tuple[int, int],
    resolution: float = RESOLUTION,
) -> HoverClip:
    """Plan a hover clip of a place and its traffic; `render_frames(clip)` renders it.

    Args:
        place: the place.
        day: the day.
        tracks: the traffic, at the times of the frames.
        hover: the camera.
        size: height and width of a frame, pixels.
        resolution: metres per pixel of the drawn place.

    Returns:
        The clip.

    Raises:
        ValueError: the tracks do not have a time for each frame.
    """
    shadow = CAR_HEIGHT_M * compute_shadow_offset(day) * (1 - day.clouds) / resolution
    colours = np.random.default_rng([place.seed, COLOURS])
    traffic = SpriteTracks(
        sprites=draw_agents(tracks, resolution, colours),
        sizes=tracks.sizes / resolution,
        poses=compute_image_poses(place, tracks, resolution),
        shadow=(float(shadow[0]), float(-shadow[1])),
        types=tracks.types,
    )
    generator = np.random.default_rng([place.seed, CAMERA])
    still = draw_place(place, day, resolution=resolution)
    return film(still, traffic, hover, height=size[0], width=size[1], generator=generator)


def compute_image_poses(place: Place, tracks: Tracks, resolution: float) -> Float[Array, "T N 3"]:
    """Compute the agents' poses in the drawn place.

    Args:
        place: the place.
        tracks: N agents at T times.
        resolution: metres per pixel of the drawn place.

    Returns:
        (T, N, 3) pixels and heading, counter-clockwise as seen.
    """
    image_from_world = np.linalg.inv(world_from_image(place, resolution))
    pixels = transform_points(image_from_world, tracks.states[..., :2])
    turn = np.arctan2(place.world_from_plan[1, 0], place.world_from_plan[0, 0])
    poses = np.concatenate([pixels, tracks.states[..., 2:3] - turn], axis=-1)
    return np.swapaxes(poses, 0, 1)


def draw_agents(
    tracks: Tracks, resolution: float, generator: np.random.Generator
) -> tuple[UInt8[Array, "_ _ 4"], ...]:
    """Draw a sprite of each agent, in random colours.

    Args:
        tracks: the agents.
        resolution: metres per pixel.
        generator: source of randomness.

    Returns:
        RGBA sprites, heading right.
    """
    sprites = []
    for kind, (length, width) in zip(tracks.types, tracks.sizes.tolist(), strict=True):
        paint = PAINTS[int(generator.integers(len(PAINTS)))]
        cloth = CLOTHES[int(generator.integers(len(CLOTHES)))]
        if kind in ("pedestrian", "cyclist"):
            sprites.append(draw_pedestrian(cloth, resolution, cycle=kind == "cyclist"))
        else:
            sprites.append(draw_vehicle(length, width, paint, resolution))
    return tuple(sprites)
