"""A hovering camera over a still of the ground: frames whose pose is known exactly."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Int, UInt8, UInt64
from numpy import ndarray as Array

from geoaim.geometry import image_corners, transform_points, translation
from geoaim.synthetic.exact import ROWS, blur, pack, premultiplied, resize, warp

CORNERS = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]
SHADOW = 140  # of 255: how dark a vehicle's shadow is
FINER = 2  # the still is kept at twice the frames' resolution, blurred; then linear warps do
NOISE_SHIFT = 256  # px: the noise of each frame is one field, cut at a random place


@dataclass(frozen=True)
class Hover:
    """How the camera hovers and what it does to the picture.

    Attributes:
        count: number of frames.
        frame_rate: frames per second.
        drift: mean distance of the image centre from where frame 0 saw it, frame pixels.
        yaw: standard deviation of the camera's heading, radians.
        zoom: standard deviation of the scale, relative.
        perspective: standard deviation of the corners' shift by tilt, frame pixels.
        vibration: standard deviation of the shift from frame to frame, frame pixels.
        blur: standard deviation of the lens blur, frame pixels.
        noise: standard deviation of the sensor noise, grey levels.
        exposure: standard deviation of the gain over the clip; frame 0 has gain 1.
    """

    count: int = 120
    frame_rate: float = 30.0
    drift: float = 28.0
    yaw: float = 0.006
    zoom: float = 0.004
    perspective: float = 1.5
    vibration: float = 0.4
    blur: float = 0.6
    noise: float = 2.0
    exposure: float = 0.03


@dataclass(frozen=True)
class Traffic:
    """Vehicles over time, in pixels of the background (corner origin).

    Attributes:
        sprites: one (h, w, 4) RGBA picture per vehicle, seen from above, heading right.
        sizes: (N, 2) length and width of the body, centred in its sprite.
        poses: (T, N, 3) centre u, v and heading (radians, counter-clockwise as seen: heading
            pi/2 drives up the image); NaN where the vehicle is absent.
        shadow: right and down, how far the sun casts the bodies' shadows; (0, 0) casts none.
        types: what each one is, where that is known.
    """

    sprites: tuple[UInt8[Array, "_ _ 4"], ...]
    sizes: Float[Array, "N 2"]
    poses: Float[Array, "T N 3"]
    shadow: tuple[float, float] = (0.0, 0.0)
    types: tuple[str, ...] = ()


@dataclass(frozen=True)
class Clip:
    """A hover video that is not rendered yet: all its truth, and what `render_frame` needs.

    Attributes:
        height: rows of a frame.
        width: columns of a frame.
        times: (T,) seconds.
        frame_from_background: (T, 3, 3) exact pose: still pixels to frame pixels, corner origin.
        gains: (T,) exposure relative to frame 0.
        traffic: the vehicles, in pixels of the still.
        hover: the parameters it was made with.
        base: the still as the lens blurs it, at twice the resolution of the frames, packed.
        base_from_background: (3, 3) the resizing of the still, a pure scale.
        base_sprites: the sprites, resized and blurred alike; premultiplied colours, and alphas.
        noise: field of noise, 128 +- 32.
        noise_starts: (T, 2) row and column where each frame cuts its noise.
    """

    height: int
    width: int
    times: Float[Array, "T"]
    frame_from_background: Float[Array, "T 3 3"]
    gains: Float[Array, "T"]
    traffic: Traffic
    hover: Hover
    base: UInt64[Array, "_ _"]
    base_from_background: Float[Array, "3 3"]
    base_sprites: tuple[tuple[UInt64[Array, "_ _"], UInt64[Array, "_ _"]], ...]
    noise: UInt8[Array, "_ _ 3"]
    noise_starts: Int[Array, "T 2"]


def film(
    background: UInt8[Array, "_ _ 3"],
    traffic: Traffic,
    hover: Hover,
    *,
    height: int,
    width: int,
    generator: np.random.Generator,
) -> Clip:
    """Plan a hover video over a still: the frames see as much of it as they can, never past it.

    Raises:
        ValueError: the traffic does not have `hover.count` steps.
    """
    if len(traffic.poses) != hover.count:
        raise ValueError(f"traffic has {len(traffic.poses)} steps for {hover.count} frames")
    nominal_from_frame, gains = _hover_poses(hover, height, width, generator)
    corners = transform_points(nominal_from_frame, image_corners(height, width))
    reach = np.abs(corners - [width / 2, height / 2]).max(axis=(0, 1)) + 4
    rows, columns = background.shape[:2]
    scale = FINER * max(2 * reach[0] / columns, 2 * reach[1] / rows)
    base = _scaled(background, scale)
    down, right = base.shape[0] / rows, base.shape[1] / columns
    nominal_from_base = np.diag([1 / FINER, 1 / FINER, 1.0])
    nominal_from_base[:2, 2] = (np.array([width, height]) - base.shape[1::-1] / np.array(FINER)) / 2
    base_from_background = np.diag([right, down, 1.0])
    return Clip(
        height=height,
        width=width,
        times=np.arange(hover.count) / hover.frame_rate,
        frame_from_background=np.linalg.inv(nominal_from_frame)
        @ nominal_from_base
        @ base_from_background,
        gains=gains,
        traffic=traffic,
        hover=hover,
        base=pack(blur(base, FINER * hover.blur)),
        base_from_background=base_from_background,
        base_sprites=_prepare_sprites(traffic.sprites, scale, FINER * hover.blur),
        noise=_noise_field((height + NOISE_SHIFT, width + NOISE_SHIFT, 3), generator),
        noise_starts=generator.integers(0, NOISE_SHIFT, (hover.count, 2)),
    )


def hover_frames(clip: Clip) -> Iterator[UInt8[Array, "H W 3"]]:
    """Render all frames of a clip in order."""
    for index in range(len(clip.times)):
        yield render_frame(clip, index)


def render_frame(clip: Clip, index: int) -> UInt8[Array, "H W 3"]:
    """What the camera records: ground and vehicles through the lens, with gain and noise."""
    image = clean_frame(clip, index)
    for patch in _vehicle_patches(clip, index, clip.frame_from_background[index]):
        _blend(image, *patch)
    row, column = clip.noise_starts[index]
    noise = clip.noise[row : row + clip.height, column : column + clip.width]
    return _exposed(image, noise, float(clip.gains[index]), clip.hover.noise / 32)


def clean_frame(clip: Clip, index: int = 0) -> UInt8[Array, "H W 3"]:
    """The truth of a background: what the camera would record without traffic, noise and gain.

    Linear interpolation is right here, since the base is smooth at its scale.
    """
    base_from_frame = clip.base_from_background @ np.linalg.inv(clip.frame_from_background[index])
    return warp(clip.base, base_from_frame, clip.height, clip.width)


def reference_from_frames(clip: Clip, reference: int = 0) -> Float[Array, "T 3 3"]:
    """The exact transform of every frame's pixels to those of the reference frame."""
    return clip.frame_from_background[reference] @ np.linalg.inv(clip.frame_from_background)


def frame_boxes(clip: Clip, index: int) -> Float[Array, "n 4"]:
    """Boxes (left, top, right, bottom) in pixels of a frame, around the vehicles that it shows."""
    return boxed_agents(clip, index)[1]


def boxed_agents(clip: Clip, index: int) -> tuple[Int[Array, "n"], Float[Array, "n 4"]]:
    """The numbers of the agents that a frame shows, and their boxes."""
    poses = clip.traffic.poses[index]
    present = np.flatnonzero(np.isfinite(poses).all(axis=-1))
    corners = clip.traffic.sizes[present][:, None] / 2 * np.array(CORNERS)
    frame_from_vehicle = clip.frame_from_background[index] @ _background_from_vehicle(
        poses[present]
    )
    corners = transform_points(frame_from_vehicle, corners)
    limit = [clip.width, clip.height]
    boxes = np.hstack([corners.min(axis=1).clip(0, limit), corners.max(axis=1).clip(0, limit)])
    seen = ((boxes[:, 2:] - boxes[:, :2]) >= 2).all(axis=1)
    return present[seen], boxes[seen]


def traffic_share(clip: Clip, reference: int = 0) -> Float32[Array, "H W"]:
    """The share of the clip in which a vehicle or its shadow covers each pixel of the reference."""
    counts = np.zeros((clip.height, clip.width), np.float32)
    covered = np.zeros_like(counts)
    pose = clip.frame_from_background[reference]
    for index in range(len(clip.times)):
        windows = []
        for window, _, alpha in _vehicle_patches(clip, index, pose):
            np.maximum(covered[window], alpha > 5, out=covered[window])
            windows.append(window)
        for window in windows:  # clearing at once: where windows overlap, a pixel counts once
            counts[window] += covered[window]
            covered[window] = 0
    return counts / len(clip.times)


def _hover_poses(
    hover: Hover, height: int, width: int, generator: np.random.Generator
) -> tuple[Float[Array, "T 3 3"], Float[Array, "T"]]:
    """nominal_from_frame and gain for each frame; frame 0 is one pose among the others."""
    times = np.arange(hover.count) / hover.frame_rate
    slow = np.stack([_slow_noise(times, generator) for _ in range(7)])
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
        turn = np.array([[cosine, sine, path[0, i]], [-sine, cosine, path[1, i]], [0, 0, 1]])
        tilt = np.eye(3)
        tilt[2, :2] = hover.perspective * slow[4:6, i] / radius**2
        poses[i] = centre @ turn @ tilt @ back
    return poses, 1 + hover.exposure * (slow[6] - slow[6, 0])


def _noise_field(
    shape: tuple[int, int, int], generator: np.random.Generator
) -> UInt8[Array, "_ _ 3"]:
    field = generator.standard_normal(shape, dtype=np.float32)
    return np.asarray(np.rint(128 + 32 * field).clip(0, 255), np.uint8)


def _slow_noise(times: Float[Array, "T"], generator: np.random.Generator) -> Float[Array, "T"]:
    """Unit-variance sum of sinusoids of 2.5 to 25 s, the longer the stronger."""
    frequencies = 0.04 * 10 ** generator.uniform(0, 1, 8)
    phases = generator.uniform(0, 2 * np.pi, 8)
    weights = frequencies[0] / frequencies
    waves = np.sin(2 * np.pi * frequencies * times[:, None] + phases)
    return np.asarray(waves @ weights / np.sqrt((weights**2).sum() / 2))


def paste(
    image: UInt8[Array, "H W 3"],
    sprites: Sequence[UInt8[Array, "_ _ 4"]],
    poses: Float[Array, "N 3"],
) -> None:
    """Lay sprites on a picture at poses in its pixels, as in `Traffic`; absent ones are NaN."""
    for sprite, pose in zip(sprites, poses, strict=True):
        if np.isfinite(pose).all():
            light = premultiplied(sprite)
            packed = pack(light[..., :3]), pack(light[..., 3:])
            for patch in _place(packed, _background_from_vehicle(pose), image.shape[:2]):
                _blend(image, *patch)


def _blend(
    image: UInt8[Array, "H W 3"],
    window: tuple[slice, slice],
    colour: UInt8[Array, "h w 3"],
    alpha: UInt8[Array, "h w"],
) -> None:
    """Lay a premultiplied picture over a window."""
    ground = image[window].astype(np.uint16) * (255 - alpha[..., None].astype(np.uint16))
    image[window] = np.minimum((ground + 127) // 255 + colour, 255).astype(np.uint8)


def _exposed(
    image: UInt8[Array, "H W 3"], noise: UInt8[Array, "H W 3"], gain: float, strength: float
) -> UInt8[Array, "H W 3"]:
    """The sensor's gain and noise, a few rows at a time."""
    exposed = np.empty_like(image)
    for top in range(0, len(image), ROWS):
        rows = slice(top, top + ROWS)
        light = image[rows].astype(np.float32) * np.float32(gain)
        light += (noise[rows].astype(np.float32) - np.float32(128)) * np.float32(strength)
        exposed[rows] = np.rint(np.minimum(np.maximum(light, 0), 255))
    return exposed


_Patch = tuple[tuple[slice, slice], UInt8[Array, "_ _ 3"], UInt8[Array, "_ _"]]


def _vehicle_patches(
    clip: Clip, index: int, frame_from_background: Float[Array, "3 3"]
) -> Iterator[_Patch]:
    """Windows of a frame, and premultiplied colour and alpha over each; shadows come first."""
    poses = clip.traffic.poses[index]
    present = np.flatnonzero(np.isfinite(poses).all(axis=-1))
    frame_from_vehicle = frame_from_background @ _background_from_vehicle(poses)
    frame_from_shadow = (
        frame_from_background @ translation(*clip.traffic.shadow) @ _background_from_vehicle(poses)
    )
    shape = clip.height, clip.width
    if any(clip.traffic.shadow):
        for number in present:
            sprite = clip.base_sprites[number]
            for window, colour, alpha in _place(
                sprite, frame_from_shadow[number] @ _unscale(clip), shape
            ):
                dark = (alpha.astype(np.uint16) * SHADOW // 255).astype(np.uint8)
                yield window, np.zeros_like(colour), dark
    for number in present:
        sprite = clip.base_sprites[number]
        yield from _place(sprite, frame_from_vehicle[number] @ _unscale(clip), shape)


def _place(
    sprite: tuple[UInt64[Array, "h w"], UInt64[Array, "h w"]],
    frame_from_centred: Float[Array, "3 3"],
    shape: tuple[int, int],
) -> Iterator[_Patch]:
    """One sprite warped into its window of the frame; nothing when it lies outside."""
    rows, columns = sprite[0].shape
    frame_from_sprite = frame_from_centred @ translation(-columns / 2, -rows / 2)
    corners = transform_points(frame_from_sprite, image_corners(rows, columns))
    left, top = np.floor(corners.min(axis=0)).clip(0, shape[::-1]).astype(int).tolist()
    right, bottom = np.ceil(corners.max(axis=0)).clip(0, shape[::-1]).astype(int).tolist()
    if right > left and bottom > top:
        matrix = np.linalg.inv(frame_from_sprite) @ translation(left, top)
        colour, alpha = (warp(part, matrix, bottom - top, right - left) for part in sprite)
        yield (slice(top, bottom), slice(left, right)), colour, alpha[..., 0]


def _unscale(clip: Clip) -> Float[Array, "3 3"]:
    return np.linalg.inv(clip.base_from_background)


def _background_from_vehicle(pose: Float[Array, "*n 3"]) -> Float[Array, "*n 3 3"]:
    """Vehicle pixels (x forward, y to its right, as images have it) to background pixels."""
    cosine, sine = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    zero, one = np.zeros_like(cosine), np.ones_like(cosine)
    rows = [[cosine, sine, pose[..., 0]], [-sine, cosine, pose[..., 1]], [zero, zero, one]]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def _prepare_sprites(
    sprites: tuple[UInt8[Array, "_ _ 4"], ...], scale: float, sigma: float
) -> tuple[tuple[UInt64[Array, "_ _"], UInt64[Array, "_ _"]], ...]:
    """Premultiplied, at the base's resolution, blurred; an object that comes twice is shared."""
    prepared: dict[int, tuple[UInt64[Array, "_ _"], UInt64[Array, "_ _"]]] = {}
    air = int(np.ceil(3 * sigma)) + 2
    for sprite in sprites:
        if id(sprite) not in prepared:
            light = _scaled(premultiplied(sprite), scale)
            light = np.minimum(light, light[..., 3:])  # Lanczos overshoots
            light = blur(np.pad(light, ((air, air), (air, air), (0, 0))), sigma)
            prepared[id(sprite)] = pack(light[..., :3]), pack(light[..., 3:])
    return tuple(prepared[id(sprite)] for sprite in sprites)


def _scaled(image: UInt8[Array, "_ _ c"], scale: float) -> UInt8[Array, "_ _ c"]:
    rows, columns = (max(1, round(side * scale)) for side in image.shape[:2])
    return resize(image, (columns, rows))
