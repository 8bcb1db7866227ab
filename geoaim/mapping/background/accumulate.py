"""A canvas in the reference's pixels: warp frames onto it, and sum them plane by plane."""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8, UInt16
from numpy import ndarray as Array

from geoaim.geometry import image_corners, to_opencv, transform_points, translation
from geoaim.mapping.video.frames import Frame, image_from_planes

INSET = 0.5  # px: a frame shows what lies between the centres of its outermost pixels
SAMPLES = 120  # points along the longest side where exposure is compared
FEWEST = 50  # points below which exposure is not compared
FULL = 65_535  # frames that a pixel can count
STEADY = 0.002  # a gain this close to 1 changes nothing by half a grey level


@dataclass(frozen=True, eq=False)
class Plane:
    """Sums over one plane of the canvas, at 1/scale of its size; written to in place.

    Attributes:
        scale: 2 for the chroma of a video, else 1.
        neutral: the value that a change of exposure leaves as it is.
        total: (h, w, c) sums of what may be averaged.
        weight: (h, w) how many frames are in them.
        spare: (h, w, c) sums of masked pixels, as long as no frame has shown them clean.
        spare_weight: (h, w) how many frames are in these.
        softness: sums over the frames of the warps' softness along x and y, and their number.
    """

    scale: int
    neutral: float
    total: Float32[Array, "h w c"]
    weight: UInt16[Array, "h w"]
    spare: Float32[Array, "h w c"]
    spare_weight: UInt16[Array, "h w"]
    softness: Float[Array, "3"]


@dataclass(frozen=True, eq=False)
class Exposure:
    """Grey levels above black at the points of a grid, 0 where none was seen; filled in place."""

    spacing: int
    level: Float32[Array, "h w"]


def empty_planes(frame: Frame, size: tuple[int, int]) -> tuple[Plane, ...]:
    """Sums for the Y, U and V planes of a video, or for the RGB of anything else."""
    kinds = [(1, 0.0, 3)]
    if frame.planes is not None:
        kinds = [(1, _black(frame), 1), (2, 128.0, 1), (2, 128.0, 1)]
    planes = []
    for scale, neutral, channels in kinds:
        shape = (-(-size[0] // scale), -(-size[1] // scale))
        sums = [np.zeros((*shape, channels), np.float32) for _ in range(2)]
        weights = [np.zeros(shape, np.uint16) for _ in range(2)]
        sums_and_weights = sums[0], weights[0], sums[1], weights[1]
        planes.append(Plane(scale, neutral, *sums_and_weights, np.zeros(3)))
    return tuple(planes)


def add_frame(
    planes: tuple[Plane, ...],
    frame: Frame,
    canvas_from_frame: Float[Array, "3 3"],
    mask: UInt8[Array, "H W"] | None,
    gain: float,
    rows: slice,
) -> None:
    """Warp a frame onto some rows of the canvas and add it; where the mask is 0, to the spare."""
    shift = translation(0, -rows.start)
    size = rows.stop - rows.start, planes[0].weight.shape[1]
    reached = footprint(frame.grey.shape, shift @ canvas_from_frame, size)
    for plane, pixels in zip(planes, frame.planes or (frame.image,), strict=True):
        every = slice(None, None, plane.scale)
        part = slice(rows.start // plane.scale, -(-rows.stop // plane.scale))
        scale = np.diag([plane.scale, plane.scale, 1.0])
        matrix = np.linalg.inv(scale) @ shift @ canvas_from_frame @ scale
        warped = expose(warp(pixels, matrix, plane.weight[part].shape), gain, plane.neutral)
        plane.softness[:] += [*softness(matrix, plane.weight[part].shape), 1.0]
        shown = reached[every, every].copy()
        clean = shown if mask is None else shown * mask[rows][every, every]
        clean = clean * (plane.weight[part] < FULL)
        cv2.accumulate(warped, plane.total[part], clean)
        plane.weight[part] += clean
        if mask is not None:
            hidden = shown * (plane.weight[part] == 0)
            cv2.accumulate(warped, plane.spare[part], hidden)
            plane.spare_weight[part] += hidden


def mean_image(planes: tuple[Plane, ...], frame: Frame) -> UInt8[Array, "H W 3"]:
    """RGB of the means, of the spare ones where there are no others; overwrites the sums.

    Args:
        planes: as filled by `add_frame`.
        frame: any of the frames, for the meaning of its planes.
    """
    for plane in planes:
        bare = plane.weight == 0
        np.copyto(plane.total, plane.spare, where=bare[..., None])
        count = np.where(bare, plane.spare_weight, plane.weight)
        np.divide(
            plane.total, np.maximum(count, 1)[..., None], out=plane.total, casting="same_kind"
        )
        blank = count == 0
        plane.total[blank] = plane.neutral
        sharp = sharpen(plane.total, plane.softness[:2] / plane.softness[2])
        if blank.any():  # beside what nothing is known of, the mean stays as it is
            rim = cv2.dilate(blank.view(np.uint8), np.ones((5, 5), np.uint8)).view(bool)
            sharp[rim] = plane.total[rim]
        plane.total[:] = sharp
    if frame.encoding is not None and len(planes) == 3:
        y, u, v = (plane.total[..., 0] for plane in planes)
        image = image_from_planes(y, u, v, frame.encoding)
    else:
        image = np.rint(planes[0].total).clip(0, 255).astype(np.uint8)
    image[(planes[0].weight == 0) & (planes[0].spare_weight == 0)] = 0
    return image


def first_exposure(size: tuple[int, int]) -> Exposure:
    """Nothing seen yet, on a canvas of (height, width) pixels."""
    spacing = max(max(size) // SAMPLES, 1)
    return Exposure(spacing, np.zeros((size[0] // spacing, size[1] // spacing), np.float32))


def compare_exposure(
    exposure: Exposure, frame: Frame, canvas_from_frame: Float[Array, "3 3"], last: float
) -> float:
    """Factor that brings a frame to the exposure of those before it: the commonest ratio of greys.

    One factor for all colours: a real drone's step in exposure was 0.983, 0.984 and 0.986 in
    red, green and blue. Points that no frame has shown before are learnt from this one.

    Args:
        exposure: grey levels first seen; filled in place.
        frame: the frame.
        canvas_from_frame: where it lies.
        last: the answer where too few points are known to compare.
    """
    shrink = np.diag([1 / exposure.spacing, 1 / exposure.spacing, 1.0])
    matrix, size = to_opencv(shrink @ canvas_from_frame), exposure.level.shape[::-1]
    at = cv2.warpPerspective(frame.grey, matrix, size, flags=cv2.INTER_NEAREST)
    black = _black(frame)
    usable = (at > black + 20) & (at < 225)
    grey = at.astype(np.float32) - np.float32(black)
    common = usable & (exposure.level > 0)
    gain = last
    if np.count_nonzero(common) >= FEWEST:
        gain = _commonest_ratio(np.log(exposure.level[common] / grey[common]))
    np.copyto(exposure.level, grey * np.float32(gain), where=usable & (exposure.level == 0))
    return gain


def _commonest_ratio(logarithms: Float32[Array, "n"]) -> float:
    """Where ratios crowd: a bus that fills most of the view does not move it, but the median."""
    bins = np.clip(logarithms * 50 + 175, 0, 350).astype(np.intp)
    centre = (float(np.bincount(bins).argmax()) - 174.5) / 50
    for _ in range(3):
        near = np.abs(logarithms - centre) < 0.05
        centre = float(np.median(logarithms[near])) if near.any() else centre
    return float(np.exp(centre))


def expose(pixels: UInt8[Array, "H W *c"], gain: float, neutral: float) -> UInt8[Array, "H W *c"]:
    """Multiply the distance from the neutral value."""
    if abs(gain - 1) < STEADY:
        return pixels
    return np.asarray(cv2.convertScaleAbs(pixels, alpha=gain, beta=neutral * (1 - gain)), np.uint8)


def shrink_frame(
    frame: Frame, factor: int, gain: float
) -> tuple[UInt8[Array, "h w 3"], Float[Array, "3 3"]]:
    """RGB, near enough for comparisons, at 1/factor of the frame's size; small_from_frame."""
    height, width = frame.grey.shape
    size = (-(-width // factor), -(-height // factor))
    if frame.planes is None:
        pixels = expose(cv2.resize(frame.image, size, interpolation=cv2.INTER_AREA), gain, 0.0)
    else:
        parts = [cv2.resize(p, size, interpolation=cv2.INTER_AREA) for p in frame.planes]
        pixels = cv2.cvtColor(cv2.merge(parts), cv2.COLOR_YUV2RGB)
        pixels = expose(pixels, gain, _black(frame))
    return pixels, np.diag([size[0] / width, size[1] / height, 1.0])


def warp(
    pixels: UInt8[Array, "H W *c"], matrix: Float[Array, "3 3"], size: tuple[int, int]
) -> UInt8[Array, "h w *c"]:
    """Warp to (height, width) by a transform of corner-origin pixels.

    Linear: a third of the cubic's time, and OpenCV's cubic kernel (a = -0.75) shifts smooth
    texture by up to 0.047 px. What a mean of linear warps loses, `sharpen` gives back.
    """
    matrix = to_opencv(matrix)
    matrix = matrix / matrix[2, 2]
    if np.abs(matrix[2, :2]).max() < 1e-12:  # affine is faster
        warped = cv2.warpAffine(
            pixels, matrix[:2], size[::-1], flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
    else:
        warped = cv2.warpPerspective(
            pixels, matrix, size[::-1], flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )
    return np.asarray(warped, np.uint8)


def softness(matrix: Float[Array, "3 3"], size: tuple[int, int]) -> Float[Array, "2"]:
    """How much a linear warp blurs on average along x and y: d (1 - d) at the sub-pixel phase d.

    That is the second moment of the interpolation's two weights about the point, px squared:
    0 where pixels fall on pixels, 1/6 where the phases are spread evenly.
    """
    steps = [(np.arange(16) + 0.5) * extent / 16 // 1 + 0.5 for extent in size[::-1]]
    points = np.stack(np.meshgrid(*steps), axis=-1).reshape(-1, 2)
    phase = (transform_points(np.linalg.inv(matrix), points) - 0.5) % 1.0
    return np.asarray((phase * (1 - phase)).mean(axis=0))


def sharpen(pixels: Float32[Array, "h w c"], soft: Float[Array, "2"]) -> Float32[Array, "h w c"]:
    """Undo the blur of many linear warps, whose `softness` is given.

    Over even phases their mean passes (sin(w/2) / (w/2))^2 of a wave of w radians a pixel. The
    inverse is 1 + w^2/12 + w^4/240 + ..., and 1 + s/12 + s^2/90 with s = 2 - 2 cos w, which five
    weights can do, agrees with it to that order.
    """
    line = np.array([0.0, -1.0, 2.0, -1.0, 0.0])
    again = np.convolve([-1.0, 2.0, -1.0], [-1.0, 2.0, -1.0])
    along_x, along_y = (np.eye(5)[2] + 6 * v * (line / 12 + again / 90) for v in soft)
    sharp = cv2.sepFilter2D(pixels, -1, along_x, along_y, borderType=cv2.BORDER_REPLICATE)
    return np.asarray(sharp, np.float32).reshape(pixels.shape)


def footprint(
    frame_size: tuple[int, ...], canvas_from_frame: Float[Array, "3 3"], size: tuple[int, int]
) -> UInt8[Array, "h w"]:
    """1 where a frame shows the canvas, its rim left out; else 0."""
    corners = image_corners(frame_size[0] - 2 * INSET, frame_size[1] - 2 * INSET) + INSET
    polygon = transform_points(canvas_from_frame, corners)
    return fill_polygons(np.zeros(size, np.uint8), polygon[None], 1)


def fill_polygons(
    mask: UInt8[Array, "h w"], polygons: Float[Array, "n m 2"], value: int
) -> UInt8[Array, "h w"]:
    """Draw convex polygons of corner-origin points, to 1/16 px, in place."""
    for polygon in np.rint((polygons - 0.5).clip(-30000, 30000) * 16).astype(np.int32):
        cv2.fillConvexPoly(mask, polygon, [value], shift=4)
    return mask


def enlarge(mask: Bool[Array, "h w"], size: tuple[int, int]) -> UInt8[Array, "H W"]:
    """1 where a small mask is true, at full size."""
    large = cv2.resize(mask.view(np.uint8), size[::-1], interpolation=cv2.INTER_NEAREST)
    return np.asarray(large, np.uint8)


def _black(frame: Frame) -> float:
    """The grey level that stands for no light."""
    return 0.0 if frame.encoding is None or frame.encoding.full_range else 16.0
