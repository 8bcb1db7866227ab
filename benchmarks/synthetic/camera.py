"""Video of a hovering camera over a still of the ground, with exactly known poses."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Int, UInt8, UInt64
from numpy import ndarray as Array

from benchmarks.synthetic.compositing import (
    SpritePatch,
    blend_patch,
    compute_background_from_sprite,
    warp_sprite,
)
from benchmarks.synthetic.exact import ROWS, blur, pack, premultiply, resize, warp
from geoaim.base.geometry import image_corners, transform_points, translation

CORNERS = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]
SHADOW_ALPHA = 140  # opacity of a vehicle's shadow, out of 255
SUPERSAMPLING = 2  # the still is kept blurred at twice the frames' resolution, for linear warps
NOISE_SHIFT = 256  # px, range of the random origin at which each frame crops the noise field


@dataclass(frozen=True)
class Hover:
    """Motion and image quality of a hovering camera."""

    count: int = 120  # number of frames
    frame_rate: float = 30.0  # frames per second
    drift: float = 28.0  # mean distance of the image centre from where frame 0 saw it, frame pixels
    yaw: float = 0.006  # standard deviation of the camera's heading, radians
    zoom: float = 0.004  # standard deviation of the scale, relative
    perspective: float = 1.5  # standard deviation of the corners' shift by tilt, frame pixels
    vibration: float = 0.4  # standard deviation of the shift from frame to frame, frame pixels
    blur: float = 0.6  # standard deviation of the lens blur, frame pixels
    noise: float = 2.0  # standard deviation of the sensor noise, grey levels
    exposure: float = 0.03  # standard deviation of the gain over the clip; frame 0 has gain 1


@dataclass(frozen=True)
class SpriteTracks:
    """Sprites of agents over time, in pixels of the background (corner origin)."""

    # one (h, w, 4) RGBA image per agent, seen from above, heading right
    sprites: tuple[UInt8[Array, "_ _ 4"], ...]
    sizes: Float[Array, "N 2"]  # length and width of the body, centred in its sprite
    # (T, N, 3) centre u, v and heading (radians, counter-clockwise as seen: heading pi/2 drives up
    # the image); NaN where the vehicle is absent
    poses: Float[Array, "T N 3"]
    # right and down, how far the sun casts the bodies' shadows; (0, 0) casts none
    shadow: tuple[float, float] = (0.0, 0.0)
    types: tuple[str, ...] = ()  # type of each agent, if known


@dataclass(frozen=True)
class HoverClip:
    """A hover video before rendering: its truth, and what `render_frame` needs."""

    height: int  # rows of a frame
    width: int  # columns of a frame
    times: Float[Array, "T"]  # seconds
    # exact pose: still pixels to frame pixels, corner origin
    frame_from_background: Float[Array, "T 3 3"]
    gains: Float[Array, "T"]  # exposure relative to frame 0
    traffic: SpriteTracks  # the agents, in pixels of the still
    hover: Hover  # the camera
    # the still at twice the frames' resolution, blurred by the lens, packed
    base: UInt64[Array, "_ _"]
    base_from_background: Float[Array, "3 3"]  # still pixels to base pixels, a pure scale
    # the sprites, resized and blurred alike; premultiply colours, and alphas
    base_sprites: tuple[tuple[UInt64[Array, "_ _"], UInt64[Array, "_ _"]], ...]
    noise: UInt8[Array, "_ _ 3"]  # noise field, mean 128 and standard deviation 32
    noise_starts: Int[Array, "T 2"]  # row and column at which each frame crops the noise field


def film(
    background: UInt8[Array, "_ _ 3"],
    traffic: SpriteTracks,
    hover: Hover,
    *,
    height: int,
    width: int,
    generator: np.random.Generator,
) -> HoverClip:
    """Plan a hover video over a still; frames show as much of the still as fits, and nothing else.

    Args:
        background: the still, RGB.
        traffic: agents in pixels of the still, with a step for each frame.
        hover: the camera.
        height: rows of a frame.
        width: columns of a frame.
        generator: source of the camera's motion and of the noise.

    Returns:
        The clip; `render_frame` renders its frames.

    Raises:
        ValueError: the traffic does not have `hover.count` steps.
    """
    if len(traffic.poses) != hover.count:
        raise ValueError(
            f"traffic has {len(traffic.poses)} steps and hover {hover.count} frames; one step each"
        )
    nominal_from_frame, gains = _simulate_poses(hover, height, width, generator)
    corners = transform_points(nominal_from_frame, image_corners(height, width))
    extent = np.abs(corners - [width / 2, height / 2]).max(axis=(0, 1)) + 4
    rows, columns = background.shape[:2]
    scale = SUPERSAMPLING * max(2 * extent[0] / columns, 2 * extent[1] / rows)
    base = _rescale(background, scale)
    down, right = base.shape[0] / rows, base.shape[1] / columns
    nominal_from_base = np.diag([1 / SUPERSAMPLING, 1 / SUPERSAMPLING, 1.0])
    shown = base.shape[1::-1] / np.array(SUPERSAMPLING)
    nominal_from_base[:2, 2] = (np.array([width, height]) - shown) / 2
    frame_from_base = np.linalg.inv(nominal_from_frame) @ nominal_from_base
    base_from_background = np.diag([right, down, 1.0])
    return HoverClip(
        height=height,
        width=width,
        times=np.arange(hover.count) / hover.frame_rate,
        frame_from_background=frame_from_base @ base_from_background,
        gains=gains,
        traffic=traffic,
        hover=hover,
        base=pack(blur(base, SUPERSAMPLING * hover.blur)),
        base_from_background=base_from_background,
        base_sprites=_prepare_sprites(traffic.sprites, scale, SUPERSAMPLING * hover.blur),
        noise=_make_noise_field((height + NOISE_SHIFT, width + NOISE_SHIFT, 3), generator),
        noise_starts=generator.integers(0, NOISE_SHIFT, (hover.count, 2)),
    )


def render_frames(clip: HoverClip) -> Iterator[UInt8[Array, "H W 3"]]:
    """Render all frames of a clip in order; see `render_frame`."""
    for index in range(len(clip.times)):
        yield render_frame(clip, index)


def render_frame(clip: HoverClip, index: int) -> UInt8[Array, "H W 3"]:
    """Render frame `index` as RGB, 0 to 255: ground and agents, with blur, gain and noise."""
    image = render_background(clip, index)
    for patch in _render_agents(clip, index, clip.frame_from_background[index]):
        blend_patch(image, patch)
    row, column = clip.noise_starts[index]
    noise = clip.noise[row : row + clip.height, column : column + clip.width]
    return _expose(image, noise, float(clip.gains[index]), clip.hover.noise / 32)


def render_background(clip: HoverClip, index: int = 0) -> UInt8[Array, "H W 3"]:
    """Render a frame without traffic, noise and gain: the true background.

    Linear interpolation suffices, since the base is smooth at its scale.
    """
    base_from_frame = clip.base_from_background @ np.linalg.inv(clip.frame_from_background[index])
    return warp(clip.base, base_from_frame, clip.height, clip.width)


def reference_from_frames(clip: HoverClip, reference: int = 0) -> Float[Array, "T 3 3"]:
    """Compute the exact transforms from pixels of all frames to those of frame `reference`."""
    return clip.frame_from_background[reference] @ np.linalg.inv(clip.frame_from_background)


def list_boxes(clip: HoverClip, index: int) -> Float[Array, "n 4"]:
    """List the boxes (left, top, right, bottom; pixels) of the agents visible in a frame."""
    return list_boxed_agents(clip, index)[1]


def list_boxed_agents(clip: HoverClip, index: int) -> tuple[Int[Array, "n"], Float[Array, "n 4"]]:
    """List the indices in `clip.traffic` and the boxes of the agents visible in a frame.

    Boxes are (left, top, right, bottom) in pixels, clipped to the frame, of at least 2 px.
    """
    poses = clip.traffic.poses[index]
    present = np.flatnonzero(np.isfinite(poses).all(axis=-1))
    corners = clip.traffic.sizes[present][:, None] / 2 * np.array(CORNERS)
    background_from_sprite = compute_background_from_sprite(poses[present])
    corners = transform_points(clip.frame_from_background[index] @ background_from_sprite, corners)
    limit = [clip.width, clip.height]
    boxes = np.hstack([corners.min(axis=1).clip(0, limit), corners.max(axis=1).clip(0, limit)])
    visible = ((boxes[:, 2:] - boxes[:, :2]) >= 2).all(axis=1)
    return present[visible], boxes[visible]


def measure_traffic_share(clip: HoverClip) -> Float32[Array, "H W"]:
    """Measure the share of frames (0 to 1) in which agents or shadows cover a pixel of frame 0."""
    counts = np.zeros((clip.height, clip.width), np.float32)
    covered = np.zeros_like(counts)
    pose = clip.frame_from_background[0]
    for index in range(len(clip.times)):
        windows = []
        for window, _, alpha in _render_agents(clip, index, pose):
            np.maximum(covered[window], alpha > 5, out=covered[window])
            windows.append(window)
        for window in windows:  # cleared at once, so that a pixel counts once where windows overlap
            counts[window] += covered[window]
            covered[window] = 0
    return counts / len(clip.times)


def _simulate_poses(
    hover: Hover, height: int, width: int, generator: np.random.Generator
) -> tuple[Float[Array, "T 3 3"], Float[Array, "T"]]:
    """Simulate transforms from frame pixels to those of a camera that does not move, and gains."""
    times = np.arange(hover.count) / hover.frame_rate
    slow = np.stack([_make_slow_noise(times, generator) for _ in range(7)])
    path = slow[:2] - slow[:2, :1]
    length = np.hypot(*path).mean()
    path = path * (hover.drift / length if length > 0 else 0.0)
    path += hover.vibration * generator.standard_normal(path.shape)
    radius = np.hypot(height, width) / 2
    centre, back = translation(width / 2, height / 2), translation(-width / 2, -height / 2)
    poses = np.empty((hover.count, 3, 3))
    for i in range(hover.count):
        angle, size = hover.yaw * slow[2, i], 1 + hover.zoom * slow[3, i]
        cosine, sine = size * np.cos(angle), size * np.sin(angle)
        rotation = np.array([[cosine, sine, path[0, i]], [-sine, cosine, path[1, i]], [0, 0, 1]])
        tilt = np.eye(3)
        tilt[2, :2] = hover.perspective * slow[4:6, i] / radius**2
        poses[i] = centre @ rotation @ tilt @ back
    return poses, 1 + hover.exposure * (slow[6] - slow[6, 0])


def _make_slow_noise(times: Float[Array, "T"], generator: np.random.Generator) -> Float[Array, "T"]:
    """Sum sinusoids with periods of 2.5 to 25 s, the longer the stronger; unit variance."""
    frequencies = 0.04 * 10 ** generator.uniform(0, 1, 8)
    phases = generator.uniform(0, 2 * np.pi, 8)
    weights = frequencies[0] / frequencies
    waves = np.sin(2 * np.pi * frequencies * times[:, None] + phases)
    return np.asarray(waves @ weights / np.sqrt((weights**2).sum() / 2))


def _make_noise_field(
    shape: tuple[int, int, int], generator: np.random.Generator
) -> UInt8[Array, "_ _ 3"]:
    field = generator.standard_normal(shape, dtype=np.float32)
    return np.asarray(np.rint(128 + 32 * field).clip(0, 255), np.uint8)


def _expose(
    image: UInt8[Array, "H W 3"], noise: UInt8[Array, "H W 3"], gain: float, strength: float
) -> UInt8[Array, "H W 3"]:
    """Apply the sensor's gain and noise, a few rows at a time to stay in the cache."""
    exposed = np.empty_like(image)
    for top in range(0, len(image), ROWS):
        rows = slice(top, top + ROWS)
        light = image[rows].astype(np.float32) * np.float32(gain)
        light += (noise[rows].astype(np.float32) - np.float32(128)) * np.float32(strength)
        exposed[rows] = np.rint(np.minimum(np.maximum(light, 0), 255))
    return exposed


def _render_agents(
    clip: HoverClip, index: int, frame_from_background: Float[Array, "3 3"]
) -> Iterator[SpritePatch]:
    """Yield windows of a frame with premultiplied colour and alpha; shadows come first."""
    poses = clip.traffic.poses[index]
    present = np.flatnonzero(np.isfinite(poses).all(axis=-1))
    background_from_sprite = compute_background_from_sprite(poses)
    frame_from_sprite = frame_from_background @ background_from_sprite
    frame_from_shadow = (
        frame_from_background @ translation(*clip.traffic.shadow) @ background_from_sprite
    )
    unscale, shape = np.linalg.inv(clip.base_from_background), (clip.height, clip.width)
    for number in present if any(clip.traffic.shadow) else ():
        matrix = frame_from_shadow[number] @ unscale
        for window, colour, alpha in warp_sprite(clip.base_sprites[number], matrix, shape):
            dark = (alpha.astype(np.uint16) * SHADOW_ALPHA // 255).astype(np.uint8)
            yield window, np.zeros_like(colour), dark
    for number in present:
        matrix = frame_from_sprite[number] @ unscale
        yield from warp_sprite(clip.base_sprites[number], matrix, shape)


def _prepare_sprites(
    sprites: tuple[UInt8[Array, "_ _ 4"], ...], scale: float, sigma: float
) -> tuple[tuple[UInt64[Array, "_ _"], UInt64[Array, "_ _"]], ...]:
    """Premultiply, resize and blur sprites; sprites that are one object are prepared once."""
    prepared: dict[int, tuple[UInt64[Array, "_ _"], UInt64[Array, "_ _"]]] = {}
    margin = int(np.ceil(3 * sigma)) + 2
    for sprite in sprites:
        if id(sprite) not in prepared:
            light = _rescale(premultiply(sprite), scale)
            light = np.minimum(light, light[..., 3:])  # Lanczos overshoots
            light = blur(np.pad(light, ((margin, margin), (margin, margin), (0, 0))), sigma)
            prepared[id(sprite)] = pack(light[..., :3]), pack(light[..., 3:])
    return tuple(prepared[id(sprite)] for sprite in sprites)


def _rescale(image: UInt8[Array, "_ _ c"], scale: float) -> UInt8[Array, "_ _ c"]:
    rows, columns = (max(1, round(side * scale)) for side in image.shape[:2])
    return resize(image, (rows, columns))
