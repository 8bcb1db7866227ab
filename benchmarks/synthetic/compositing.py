"""Sprites of agents: drawn, warped into an image and blended over it."""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float, UInt8, UInt64
from numpy import ndarray as Array

from benchmarks.synthetic.exact import pack, premultiply, warp
from benchmarks.synthetic.place import Place, world_from_image
from benchmarks.synthetic.scenery.objects import PAINTS
from benchmarks.synthetic.scenery.sprites import draw_pedestrian, draw_vehicle
from geoaim.base.geometry import image_corners, transform_points, translation
from geoaim.tracks.tracks import Tracks

CLOTHES = ((58, 62, 78), (150, 60, 52), (198, 190, 178), (70, 96, 128), (90, 98, 72), (36, 36, 40))
SpritePatch = tuple[tuple[slice, slice], UInt8[Array, "_ _ 3"], UInt8[Array, "_ _"]]


def paste(
    image: UInt8[Array, "H W 3"],
    sprites: Sequence[UInt8[Array, "_ _ 4"]],
    poses: Float[Array, "N 3"],
) -> None:
    """Paste sprites onto an image, in place.

    Args:
        image: RGB.
        sprites: an RGBA picture of each of N agents, seen from above, heading right.
        poses: (N, 3) centre u, v in pixels (corner origin) and heading (radians); NaN if absent.
    """
    for sprite, pose in zip(sprites, poses, strict=True):
        if np.isfinite(pose).all():
            light = premultiply(sprite)
            packed = pack(light[..., :3]), pack(light[..., 3:])
            for patch in warp_sprite(packed, compute_background_from_sprite(pose), image.shape[:2]):
                blend_patch(image, patch)


def blend_patch(image: UInt8[Array, "H W 3"], patch: SpritePatch) -> None:
    """Blend a patch (window, premultiplied colours, opacity) into an image, in place."""
    window, colour, alpha = patch
    ground = image[window].astype(np.uint16) * (255 - alpha[..., None].astype(np.uint16))
    image[window] = np.minimum((ground + 127) // 255 + colour, 255).astype(np.uint8)


def warp_sprite(
    sprite: tuple[UInt64[Array, "h w"], UInt64[Array, "h w"]],
    frame_from_centred: Float[Array, "3 3"],
    shape: tuple[int, int],
) -> Iterator[SpritePatch]:
    """Warp a sprite into its window of an image.

    Args:
        sprite: premultiplied colour and alpha, each from `pack`.
        frame_from_centred: (3, 3) sprite pixels around its centre to image pixels.
        shape: height and width of the image.

    Yields:
        One patch for `blend_patch`; nothing if the sprite lies outside.
    """
    rows, columns = sprite[0].shape
    frame_from_sprite = frame_from_centred @ translation(-columns / 2, -rows / 2)
    corners = transform_points(frame_from_sprite, image_corners(rows, columns))
    left, top = np.floor(corners.min(axis=0)).clip(0, shape[::-1]).astype(int).tolist()
    right, bottom = np.ceil(corners.max(axis=0)).clip(0, shape[::-1]).astype(int).tolist()
    if right > left and bottom > top:
        matrix = np.linalg.inv(frame_from_sprite) @ translation(left, top)
        colour, alpha = (warp(part, matrix, bottom - top, right - left) for part in sprite)
        yield (slice(top, bottom), slice(left, right)), colour, alpha[..., 0]


def compute_background_from_sprite(pose: Float[Array, "*n 3"]) -> Float[Array, "*n 3 3"]:
    """Compute transforms to background pixels from sprite pixels (x forward, y right, centred).

    Poses are u, v (pixels) and heading (radians, counter-clockwise as seen).
    """
    cosine, sine = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    zero, one = np.zeros_like(cosine), np.ones_like(cosine)
    rows = [[cosine, sine, pose[..., 0]], [-sine, cosine, pose[..., 1]], [zero, zero, one]]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


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
