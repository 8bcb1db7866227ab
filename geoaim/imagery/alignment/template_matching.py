"""Template matching between images of one ground by different sensors on different days.

Brightness changes with sensor, season and sun; the direction of edges does not. Each pixel gets two
orientation channels, cos and sin of the doubled angle of its gradient (Granlund 1978; Kass and
Witkin 1987), so that an edge from dark to bright equals one from bright to dark. Windows of these
channels are compared by normalised cross-correlation; orientation correlation (Fitch et al. 2002)
does so with single angles. Shadows move with the sun: pixels darker than the local mean are raised
to it beforehand, since shadows are darker than their surroundings, and paint, kerbs and roofs are
not.
"""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8
from numpy import ndarray as Array

from geoaim.aim.aim import AIM
from geoaim.base.errors import AlignmentError
from geoaim.base.geometry import to_opencv
from geoaim.base.grid import Grid, make_north_up_grid
from geoaim.imagery.alignment.result import Prior

SHADOW_RADIUS_M = 10.0  # radius of the local mean, to which darker pixels are raised
GRADIENT_SIGMA_PX = 0.7  # standard deviation of the Gaussian filter before the gradient
EROSION_PX = 5  # side of the square of valid pixels that a gradient needs around it
MIN_WINDOW_VALID_SHARE = 0.6  # smallest share of valid pixels in a window
# tolerance of the ratio of a grid's pixel size to an image's, whose resolution is rounded
STEP_TOLERANCE = 1e-6
MIN_CURVATURE = 1e-4  # a correlation peak that is flatter has no position


class WindowShifts(NamedTuple):
    """Where windows of one image were found in another."""

    centers: Float[Array, "M 2"]  # centres of the windows, pixels of the grid
    # shifts to where the windows were found, pixels; NaN where the peak has no position
    shifts: Float[Array, "M 2"]
    information: Float[Array, "M 2 2"]  # sharpness of the peaks: low along a straight edge


class GreyImage(NamedTuple):
    """Grey values of an image, low-pass filtered for sampling at one resolution."""

    grey: Float32[Array, "H W"]  # brightness
    valid: UInt8[Array, "H W"]  # 255 where the image shows ground
    image_from_world: Float[Array, "3 3"]  # metres to pixels


def reduce_to_grey(aim: AIM, resolution: float) -> GreyImage:
    """Convert an AIM to grey, for sampling every `resolution` metres without aliasing."""
    grey: Array = cv2.cvtColor(aim.image, cv2.COLOR_RGB2GRAY)
    valid: Array = np.where(aim.coverage > 0, np.uint8(255), np.uint8(0))
    matrix, step = aim.grid.grid_from_world, resolution / aim.resolution
    reduction = int(step + STEP_TOLERANCE)
    if reduction >= 2:  # means of whole pixels first
        height, width = grey.shape
        size = round(width / reduction), round(height / reduction)
        grey, valid = (cv2.resize(x, size, interpolation=cv2.INTER_AREA) for x in (grey, valid))
        matrix = np.diag([size[0] / width, size[1] / height, 1.0]) @ matrix
        step /= reduction
    return GreyImage(smooth_for_step(grey.astype(np.float32), step), valid, matrix)


def smooth_for_step(image: Array, step: float) -> Array:
    """Smooth an image against aliasing on a grid whose pixels are `step` times as large."""
    if step <= 1:
        return image
    return cv2.GaussianBlur(image, (0, 0), 0.45 * np.sqrt(step**2 - 1) + 1e-3)


def resample_grey(
    image: GreyImage, stated_from_true: Float[Array, "3 3"], grid: Grid
) -> tuple[Float32[Array, "H W"], Bool[Array, "H W"]]:
    """Resample a misplaced image to a grid as if its position had been corrected."""
    matrix = to_opencv(image.image_from_world @ stated_from_true @ grid.world_from_grid)
    size = grid.shape[::-1]
    flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
    replicate = cv2.BORDER_REPLICATE
    grey = cv2.warpPerspective(image.grey, matrix, size, flags=flags, borderMode=replicate)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    valid = cv2.warpPerspective(image.valid, matrix, size, flags=flags)
    return grey.astype(np.float32), valid > 252


def compute_orientation(
    grey: Float32[Array, "H W"], valid: Bool[Array, "H W"], resolution: float
) -> Float32[Array, "H W 2"]:
    """Compute the orientation channels of an image.

    With the gradient (x, y) of strength s = |(x, y)| and its median m, they are
    (x² - y², 2xy) / (s (s + m)): cos and sin of the doubled angle times a weight s / (s + m).
    """
    smooth = cv2.GaussianBlur(grey, (0, 0), GRADIENT_SIGMA_PX)
    side = 2 * round(SHADOW_RADIUS_M / resolution) + 1
    bright = np.maximum(smooth, cv2.blur(grey, (side, side)))
    x, y = (cv2.Sobel(bright, cv2.CV_32F, *axis, ksize=3) for axis in ((1, 0), (0, 1)))
    strength = cv2.magnitude(x, y) + np.float32(1e-6)
    square = np.ones((EROSION_PX, EROSION_PX), np.uint8)
    inner = cv2.erode(valid.astype(np.uint8), square, borderValue=0) > 0
    sample = strength[::3, ::3][inner[::3, ::3]]
    median = np.float32(np.median(sample) if len(sample) else 1.0)
    weight = inner / ((strength + median) * strength)
    return cv2.merge([(x * x - y * y) * weight, 2 * x * y * weight])


def find_edges(channels: Float32[Array, "H W 2"]) -> Bool[Array, "H W"]:
    """Mark pixels with any edge, however weak, in channels of `compute_orientation`."""
    return (channels[..., 0] != 0) | (channels[..., 1] != 0)


def match_windows(
    reference: Float32[Array, "H W 2"],
    image: Float32[Array, "H W 2"],
    *,
    side: int,
    search: int,
    stride: int,
) -> WindowShifts:
    """Find windows of a reference in an image, each within a few pixels of its own place."""
    height, width = reference.shape[:2]
    both = np.asarray(find_edges(reference) & find_edges(image), np.float32)
    share = cv2.blur(both, (side, side), anchor=(0, 0), borderType=cv2.BORDER_CONSTANT)
    padded = np.pad(image, ((search, search), (search, search), (0, 0)))
    reach = side + 2 * search
    corners = [
        (top, left)
        for top in range(0, height - side + 1, stride)
        for left in range(0, width - side + 1, stride)
        if share[top, left] >= MIN_WINDOW_VALID_SHARE
    ]
    scores = [
        cv2.matchTemplate(
            padded[top : top + reach, left : left + reach],
            reference[top : top + side, left : left + side],
            cv2.TM_CCORR_NORMED,
        )
        for top, left in corners
    ]
    centers = np.array(corners, np.float64).reshape(-1, 2)[:, ::-1] + side / 2
    stacked = np.array(scores, np.float64).reshape(-1, 2 * search + 1, 2 * search + 1)
    peaks, information = _locate_peaks(stacked)
    return WindowShifts(centers, peaks - search, information)


def _locate_peaks(
    scores: Float[Array, "M h w"],
) -> tuple[Float[Array, "M 2"], Float[Array, "M 2 2"]]:
    """Positions of the highest scores, NaN at the border or on a ridge, and their information."""
    count, height, width = scores.shape
    highest = scores.reshape(count, height * width).argmax(axis=1)
    rows, columns = np.unravel_index(highest, (height, width))
    valid = (rows > 0) & (rows < height - 1) & (columns > 0) & (columns < width - 1)
    around = np.arange(-1, 2)
    near = scores[
        np.arange(count)[:, None, None],
        np.clip(rows, 1, height - 2)[:, None, None] + around[:, None],
        np.clip(columns, 1, width - 2)[:, None, None] + around,
    ]
    gradient, hessian = _differentiate(near)
    valid &= np.linalg.eigvalsh(hessian)[:, 1] < -MIN_CURVATURE
    safe = np.where(valid[:, None, None], hessian, -np.eye(2))
    offset = -np.linalg.solve(safe, gradient[..., None])[..., 0]
    valid &= np.abs(offset).max(axis=1) <= 1
    peaks = np.stack([columns, rows], axis=1) + offset
    information = -safe / (1 - np.minimum(near[:, 1, 1], 0.95))[:, None, None]
    return np.where(valid[:, None], peaks, np.nan), information


def _differentiate(
    near: Float[Array, "M 3 3"],
) -> tuple[Float[Array, "M 2"], Float[Array, "M 2 2"]]:
    """Gradient and Hessian in the middle of 3 x 3 values, by central differences."""
    top = near[:, 1, 1]
    gradient = np.stack([near[:, 1, 2] - near[:, 1, 0], near[:, 2, 1] - near[:, 0, 1]], axis=1) / 2
    mixed = (near[:, 2, 2] - near[:, 2, 0] - near[:, 0, 2] + near[:, 0, 0]) / 4
    across = near[:, 1, 0] + near[:, 1, 2] - 2 * top
    down = near[:, 0, 1] + near[:, 2, 1] - 2 * top
    return gradient, np.stack([across, mixed, mixed, down], axis=1).reshape(-1, 2, 2)


WINDOW_PX = 64  # side of a window
COARSEST_PX = 128  # longer side of the coarsest grid, at most about
MIN_COARSEST_PX = 32  # shorter side of the coarsest grid
FINEST_STEP = 0.8  # pixels of the coarser image for one of the finest grid
MAX_WINDOWS = 300  # approximate number of windows on one grid


class Level(NamedTuple):
    """A grid of the pyramid."""

    grid: Grid  # the grid in the world
    reference: Float32[Array, "H W 2"]  # orientation channels of the AIM on the grid
    image: GreyImage  # the imagery, smoothed for the grid

    @property
    def side(self) -> int:
        """Pixels of a window: half as many where few would fit."""
        return WINDOW_PX if min(self.grid.shape) >= 4 * WINDOW_PX else WINDOW_PX // 2

    @property
    def stride(self) -> int:
        """Pixels between windows, so that at most about `MAX_WINDOWS` lie on valid ground."""
        valid = np.count_nonzero(find_edges(self.reference))
        return max(int(np.sqrt(valid / MAX_WINDOWS)), self.side // 4)

    @property
    def overlap(self) -> float:
        """How many windows cover a pixel, at least one."""
        return max((self.side / self.stride) ** 2, 1.0)


def build_pyramid(imagery: AIM, aim: AIM, prior: Prior) -> list[Level]:
    """Build grids over the ground that both may share, from coarse to fine."""
    low = np.maximum(aim.corners.min(axis=0), imagery.corners.min(axis=0) - prior.max_shift)
    high = np.minimum(aim.corners.max(axis=0), imagery.corners.max(axis=0) + prior.max_shift)
    finest = FINEST_STEP * max(imagery.resolution, aim.resolution)
    shorter, longer = np.sort(high - low) / finest
    if shorter < 2 * WINDOW_PX:
        raise AlignmentError(
            f"the imagery lies {_describe_bounds(imagery)}, the AIM {_describe_bounds(aim)}; with "
            f"{prior.max_shift:g} m to search, both must share {2 * WINDOW_PX * finest:.0f} m each "
            "way or more"
        )
    halvings = min(
        np.ceil(np.log2(longer / COARSEST_PX)), np.floor(np.log2(shorter / MIN_COARSEST_PX))
    )
    corners = np.stack([low, high])
    levels = []
    for halving in range(max(int(halvings), 1), -1, -1):
        grid = make_north_up_grid(corners, finest * 2**halving, aim.world)
        grey, valid = resample_grey(reduce_to_grey(aim, grid.resolution), np.eye(3), grid)
        reference = compute_orientation(grey, valid, grid.resolution)
        levels.append(Level(grid, reference, reduce_to_grey(imagery, grid.resolution)))
    return levels


def _describe_bounds(aim: AIM) -> str:
    (left, low), (right, high) = aim.corners.min(axis=0), aim.corners.max(axis=0)
    return f"from ({left:.0f}, {low:.0f}) to ({right:.0f}, {high:.0f}) m"
