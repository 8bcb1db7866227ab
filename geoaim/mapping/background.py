"""The ground as registered frames show it: streaming means, in memory that no length changes.

`average_frames` is the mean of stabilised frames, masked where boxes are given. `remove_traffic`
needs no boxes: it reads the frames twice, first small to find the traffic. Frames of video are
averaged as Y, U and V planes, so that only the result is converted to RGB.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8, UInt16
from numpy import ndarray as Array

from geoaim.errors import BackgroundError
from geoaim.geometry import image_corners, to_opencv, transform_boxes, transform_points
from geoaim.mapping.ghosts import Traffic, find_traffic
from geoaim.mapping.video import Frame, image_from_planes

Registered = tuple[Frame, Float[Array, "3 3"]]  # a frame and its reference_from_frame
View = tuple[Frame, Float[Array, "3 3"], UInt8[Array, "H W"] | None]  # image_from_frame and mask
Boxes = Callable[[Frame], Float[Array, "N 4"] | None]

GROW = 1.12  # boxes as detectors draw them leave out shadows and mirrors
INSET = 1.5  # px along a frame's border where cubic interpolation would extrapolate
SMALL = 1024  # px, longest side of the frames in which traffic is looked for
GRID = 16  # px between the points where exposure is compared
BLOCK = 8  # px; change is judged on means of such blocks: noise is gone, ghosts are not
FIRST_CHECK = 16  # frames before the first question whether more are needed


@dataclass(frozen=True, eq=False)
class Background:
    """The ground, and how many frames tell of it.

    Attributes:
        image: (H, W, 3) RGB at the first frame's exposure; 0 where no frame reaches.
        coverage: (H, W) frames averaged at each pixel; 0 where none showed the ground.
        contested: (H, W) the ground is in doubt: masked in every frame (the image then shows the
            mean with traffic, and coverage is 0), or two lasting states dispute it.
        frames_used: frames that were read and averaged.
        change: grey levels by which the latter half of the frames moved the image: 99.9 % of its
            blocks of 8 x 8 pixels moved less. NaN with fewer than 32 frames.
        gains: (frames_used,) factors that bring each frame to the exposure of the first.
    """

    image: UInt8[Array, "H W 3"]
    coverage: UInt16[Array, "H W"]
    contested: Bool[Array, "H W"]
    frames_used: int
    change: float
    gains: Float[Array, "frames_used"]


@dataclass(frozen=True, eq=False)
class _Plane:
    """Sums over one plane of the canvas at 1/scale of its size; written to in place."""

    scale: int
    neutral: float  # the value that a change of exposure leaves as it is
    total: Float32[Array, "h w *c"]
    weight: UInt16[Array, "h w"]
    spare: Float32[Array, "h w *c"]  # masked pixels, as long as no frame has shown them clean
    spare_weight: UInt16[Array, "h w"]


def average_frames(
    frames: Iterable[Registered],
    *,
    size: tuple[int, int],
    image_from_reference: Float[Array, "3 3"] | None = None,
    boxes: Boxes | None = None,
    tolerance: float = 0.0,
    bands: int = 1,
) -> Background:
    """Mean of registered frames, of what lies outside their boxes where boxes are given.

    Each pixel is the mean of all frames that show it; with `bands` it is the mean of every
    `bands`-th frame: each frame is warped only onto one of as many stripes of rows, in turn.

    Args:
        frames: each with its reference_from_frame, read once.
        size: (height, width) of the image, pixels.
        image_from_reference: where the image lies; by default it begins at the reference's corner.
        boxes: what to leave out of a frame, as left, top, right, bottom in its pixels; grown by
            12 %. None for a frame of which nothing is known: it is then left out as a whole.
        tolerance: stop when `Background.change` is at most this (grey levels); give the frames in
            an order that spreads over the video, as `spread_order` does. 0 takes all frames.
        bands: stripes that the image is cut into.

    Raises:
        BackgroundError: not one frame.
    """
    place = np.eye(3) if image_from_reference is None else image_from_reference

    def views() -> Iterator[View]:
        for frame, reference_from_frame in frames:
            image_from_frame = place @ reference_from_frame
            if boxes is None:
                yield frame, image_from_frame, None
            elif (known := boxes(frame)) is not None:
                yield frame, image_from_frame, _mask_boxes(known, image_from_frame, size)

    return _average(views(), size, tolerance, bands)


def remove_traffic(
    frames: Iterable[Registered],
    *,
    size: tuple[int, int],
    image_from_reference: Float[Array, "3 3"] | None = None,
    tolerance: float = 0.0,
) -> Background:
    """Mean of what `ghosts.find_traffic` takes for ground in registered frames.

    Some 30 to 60 frames spread over the video are enough, and memory grows by 5 MB with each.

    Args:
        frames: each with its reference_from_frame; read twice, so no one-shot iterator.
        size: (height, width) of the image, pixels.
        image_from_reference: where the image lies; by default it begins at the reference's corner.
        tolerance: as in `average_frames`.

    Raises:
        BackgroundError: fewer than 4 frames.
        TypeError: the frames can be read only once.
    """
    if iter(frames) is frames:
        raise TypeError("the frames are read twice: give a list, or make __iter__ start anew")
    place = np.eye(3) if image_from_reference is None else image_from_reference
    traffic, change = _watch_traffic(frames, place, size, tolerance)

    def views() -> Iterator[View]:
        for (frame, reference_from_frame), moving in zip(frames, traffic.moving, strict=False):
            clean = cv2.resize((~moving).view(np.uint8), size[::-1], interpolation=cv2.INTER_NEAREST)
            yield frame, place @ reference_from_frame, np.asarray(clean, np.uint8)

    result = _average(views(), size, 0.0, 1)
    doubt = cv2.resize(traffic.contested.view(np.uint8), size[::-1], interpolation=cv2.INTER_NEAREST)
    contested = result.contested | (doubt.astype(bool) & (result.coverage > 0))
    return Background(
        result.image, result.coverage, contested, result.frames_used, change, result.gains
    )


def spread_order(count: int) -> list[int]:
    """The numbers 0 to count - 1 so that any first part of them is spread over the whole.

    Bits reversed, as in van der Corput's sequence.

    >>> spread_order(6)
    [0, 4, 2, 1, 5, 3]
    """
    digits = max(count - 1, 0).bit_length()
    mirrored = (int(format(i, f"0{digits}b")[::-1], 2) if digits else 0 for i in range(1 << digits))
    return [i for i in mirrored if i < count]


def _average(
    views: Iterable[View], size: tuple[int, int], tolerance: float, bands: int
) -> Background:
    planes: tuple[_Plane, ...] = ()
    gains: list[float] = []
    blocks, change, level = None, np.nan, np.zeros((size[0] // GRID, size[1] // GRID), np.float32)
    frame = None
    for frame, matrix, mask in views:
        planes = planes or _empty_planes(frame, size)
        gain = _gain(frame, matrix, level, gains[-1] if gains else 1.0)
        rows = _band(len(gains) % bands, bands, size[0])
        _add(planes, frame, matrix, mask, gain, rows)
        gains.append(gain)
        if len(gains) >= FIRST_CHECK * bands and len(gains).bit_count() == 1:
            before, blocks = blocks, _block_means(planes[0])
            change = np.nan if before is None else _change(before, blocks)
            if change <= tolerance:
                break
    if frame is None:
        raise BackgroundError("no registered frame to average; see the registration's reasons")
    return _finish(planes, frame, size, change, np.array(gains))


def _empty_planes(frame: Frame, size: tuple[int, int]) -> tuple[_Plane, ...]:
    """Sums for Y, U, V of a video, or for RGB of anything else."""
    if frame.planes is None:
        kinds = [(1, 0.0, (3,))]
    else:
        kinds = [(1, _black(frame), ()), (2, 128.0, ()), (2, 128.0, ())]
    planes = []
    for scale, neutral, channels in kinds:
        shape = (-(-size[0] // scale), -(-size[1] // scale))
        sums = [np.zeros((*shape, *channels), np.float32) for _ in range(2)]
        weights = [np.zeros(shape, np.uint16) for _ in range(2)]
        planes.append(_Plane(scale, neutral, sums[0], weights[0], sums[1], weights[1]))
    return tuple(planes)


def _black(frame: Frame) -> float:
    return 16.0 if frame.planes is not None and not frame.colour.full_range else 0.0


def _gain(
    frame: Frame, matrix: Float[Array, "3 3"], level: Float32[Array, "h w"], last: float
) -> float:
    """Median ratio of grey levels to those first seen, at points of a grid; fills `level`."""
    shrink = np.diag([1 / GRID, 1 / GRID, 1.0])
    at = cv2.warpPerspective(
        frame.grey, to_opencv(shrink @ matrix), level.shape[::-1], flags=cv2.INTER_NEAREST
    )
    black = _black(frame)
    usable = (at > black + 20) & (at < 225)
    common = usable & (level > 0)
    grey = at.astype(np.float32) - np.float32(black)
    gain = float(np.median(level[common] / grey[common])) if common.sum() >= 50 else last
    np.copyto(level, grey * np.float32(gain), where=usable & (level == 0))
    return gain


def _add(
    planes: tuple[_Plane, ...],
    frame: Frame,
    image_from_frame: Float[Array, "3 3"],
    mask: UInt8[Array, "H W"] | None,
    gain: float,
    rows: slice,
) -> None:
    """Warp one frame onto some rows of the canvas and add it, masked pixels apart."""
    height, width = rows.stop - rows.start, planes[0].total.shape[1]
    shifted = np.array([[1.0, 0, 0], [0, 1.0, -rows.start], [0, 0, 1.0]]) @ image_from_frame
    reached = _footprint(frame.grey.shape, shifted, (height, width))
    for plane, pixels in zip(planes, frame.planes or (frame.image,), strict=True):
        scale = np.diag([plane.scale, plane.scale, 1.0])
        part = slice(rows.start // plane.scale, -(-rows.stop // plane.scale))
        total, weight = plane.total[part], plane.weight[part]
        matrix = to_opencv(np.linalg.inv(scale) @ shifted @ scale)
        warped = _warp(pixels, matrix, weight.shape[::-1])
        if abs(gain - 1) > 0.002:  # less is under half a grey level
            offset = plane.neutral * (1 - gain)
            warped = cv2.convertScaleAbs(warped, dst=warped, alpha=gain, beta=offset)
        inside = np.ascontiguousarray(reached[:: plane.scale, :: plane.scale])
        clean = inside
        if mask is not None:
            clean = cv2.bitwise_and(inside, np.ascontiguousarray(mask[rows][:: plane.scale, :: plane.scale]))
        cv2.accumulate(warped, total, clean)
        weight += clean
        if mask is not None:
            missing = inside * (weight == 0)
            cv2.accumulate(warped, plane.spare[part], missing)
            plane.spare_weight[part] += missing


def _warp(
    pixels: UInt8[Array, "H W *c"], matrix: Float[Array, "3 3"], size: tuple[int, ...]
) -> UInt8[Array, "h w *c"]:
    """Cubic: linear interpolation would lose 9 % of the gradient. `matrix` is OpenCV's."""
    options = {"flags": cv2.INTER_CUBIC, "borderMode": cv2.BORDER_REPLICATE}
    if np.allclose(matrix[2], [0, 0, 1], rtol=0, atol=1e-12):
        return np.asarray(cv2.warpAffine(pixels, matrix[:2], size, **options), np.uint8)
    return np.asarray(cv2.warpPerspective(pixels, matrix, size, **options), np.uint8)


def _footprint(
    frame_size: tuple[int, ...], matrix: Float[Array, "3 3"], size: tuple[int, int]
) -> UInt8[Array, "h w"]:
    """1 where the frame shows the canvas, a rim left out."""
    corners = image_corners(frame_size[0] - 2 * INSET, frame_size[1] - 2 * INSET) + INSET
    return _fill(np.zeros(size, np.uint8), transform_points(matrix, corners)[None], 1)


def _mask_boxes(
    boxes: Float[Array, "N 4"], matrix: Float[Array, "3 3"], size: tuple[int, int]
) -> UInt8[Array, "H W"]:
    """0 inside the grown boxes, as they lie on the canvas; 1 elsewhere."""
    centre, half = (boxes[:, :2] + boxes[:, 2:]) / 2, (boxes[:, 2:] - boxes[:, :2]) / 2 * GROW
    grown = np.concatenate([centre - half, centre + half], axis=1)
    return _fill(np.ones(size, np.uint8), transform_boxes(matrix, grown), 0)


def _fill(
    mask: UInt8[Array, "h w"], polygons: Float[Array, "n 4 2"], value: int
) -> UInt8[Array, "h w"]:
    """Draw convex polygons of corner-origin points, to 1/16 px."""
    for polygon in np.rint((polygons - 0.5).clip(-30000, 30000) * 16).astype(np.int32):
        cv2.fillConvexPoly(mask, polygon, value, shift=4)
    return mask


def _band(number: int, bands: int, height: int) -> slice:
    """Rows of a stripe; it begins on an even row, where chroma does."""
    first, last = (2 * (height * i // (2 * bands)) for i in (number, number + 1))
    return slice(first, height if number == bands - 1 else last)


def _block_means(plane: _Plane) -> Float32[Array, "h w *c"]:
    size = (max(plane.weight.shape[1] // BLOCK, 1), max(plane.weight.shape[0] // BLOCK, 1))
    total = cv2.resize(plane.total, size, interpolation=cv2.INTER_AREA)
    weight = cv2.resize(plane.weight.astype(np.float32), size, interpolation=cv2.INTER_AREA)
    weight = weight.reshape(weight.shape + (1,) * (total.ndim - 2))
    return np.asarray(np.where(weight > 0, total / np.maximum(weight, 1e-6), np.nan), np.float32)


def _change(before: Float32[Array, "h w *c"], after: Float32[Array, "h w *c"]) -> float:
    moved = np.abs(after - before)
    known = moved[np.isfinite(moved)]
    return float(np.quantile(known, 0.999)) if len(known) else np.nan


def _finish(
    planes: tuple[_Plane, ...],
    frame: Frame,
    size: tuple[int, int],
    change: float,
    gains: Float[Array, "n"],
) -> Background:
    means = []
    for plane in planes:
        bare = plane.weight == 0
        np.copyto(plane.total, plane.spare, where=bare.reshape(bare.shape + (1,) * (plane.total.ndim - 2)))
        weight = np.where(bare, plane.spare_weight, plane.weight).astype(np.float32)
        plane.total[:] /= np.maximum(weight, 1).reshape(weight.shape + (1,) * (plane.total.ndim - 2))
        means.append(plane.total)
    if len(means) == 3:
        image = image_from_planes(*means, frame.colour)
    else:
        image = np.rint(means[0]).clip(0, 255).astype(np.uint8)
    coverage, spare = planes[0].weight, planes[0].spare_weight
    image[(coverage == 0) & (spare == 0)] = 0
    contested = (coverage == 0) & (spare > 0)
    return Background(image, coverage, contested, len(gains), change, gains)


def _watch_traffic(
    frames: Iterable[Registered],
    place: Float[Array, "3 3"],
    size: tuple[int, int],
    tolerance: float,
) -> tuple[Traffic, float]:
    """Look for traffic in small frames, until more of them no longer change the ground."""
    shrink = -(-max(size) // SMALL)
    small = (-(-size[0] // shrink), -(-size[1] // shrink))
    to_small = np.diag([small[1] / size[1], small[0] / size[0], 1.0])
    level = np.zeros((size[0] // GRID, size[1] // GRID), np.float32)
    stack, seen, before, change, gain = [], [], None, np.nan, 1.0
    traffic = None
    for frame, reference_from_frame in frames:
        matrix = place @ reference_from_frame
        gain = _gain(frame, matrix, level, gain)
        pixels, small_from_frame = _shrink(frame, shrink, gain)
        step = to_small @ matrix @ np.linalg.inv(small_from_frame)
        stack.append(_warp(pixels, to_opencv(step), small[::-1]))
        seen.append(_footprint(pixels.shape, step, small).astype(bool))
        traffic = None
        if len(stack) >= FIRST_CHECK and len(stack).bit_count() == 1:
            traffic = find_traffic(np.stack(stack), np.stack(seen))
            ground = traffic.background.astype(np.float32)
            ground = np.asarray(cv2.blur(ground, (2, 2)), np.float32)
            change = np.nan if before is None else _change(before, ground)
            before = ground
            if change <= tolerance:
                break
    if len(stack) < 4:
        raise BackgroundError(
            f"{len(stack)} registered frames; at least 4 are needed to tell traffic from ground: "
            "register more frames, or average them as they are"
        )
    return traffic or find_traffic(np.stack(stack), np.stack(seen)), change


def _shrink(
    frame: Frame, factor: int, gain: float
) -> tuple[UInt8[Array, "h w 3"], Float[Array, "3 3"]]:
    """The frame as RGB (near enough for comparisons) at 1/factor of its size; small_from_frame."""
    height, width = frame.grey.shape
    size = (-(-width // factor), -(-height // factor))
    if frame.planes is None:
        pixels = cv2.resize(frame.image, size, interpolation=cv2.INTER_AREA)
    else:
        parts = [cv2.resize(p, size, interpolation=cv2.INTER_AREA) for p in frame.planes]
        pixels = cv2.cvtColor(cv2.merge(parts), cv2.COLOR_YUV2RGB)
    pixels = cv2.convertScaleAbs(pixels, alpha=gain, beta=_black(frame) * (1 - gain))
    return np.asarray(pixels, np.uint8), np.diag([size[0] / width, size[1] / height, 1.0])
