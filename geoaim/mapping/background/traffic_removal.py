"""Find which pixels of registered frames show traffic, without detections; its thresholds.

A mean, a median or a mixture model takes a vehicle that stands for most of the clip for ground.
But an object has an outline, and the bare ground has none. Where a frame and the background differ
over a region, the one with the stronger intensity steps across the region's border shows the
object. (Surveillance tells abandoned from removed objects in this way: SanMiguel and Martinez
2008.) The algorithm:

1. The first background is the median of the frames; their noise about it gives the threshold.
2. In each frame, segment the regions that differ from the background.
3. Each frame votes at the pixels of its regions, by the steps across their border in the
   background, b, and in the frame, f: (b - f) / (b + f), from -1 to 1. A positive vote says that
   the frame shows the ground and the background an object. Steps near the pixel count, and the
   mean over the whole region.
4. At each pixel, the frame with the highest vote is the candidate. The background is replaced
   where the votes of the frames that look like it have a positive sum and they are at least two
   and 6 % of all: behind a queue that has left, others follow, and the ground is seen now and
   then only. Frames unlike both do not count: a third vehicle is evidence for neither. The
   background is then the mean of the frames that look like it.
5. Steps 2 to 4 are repeated three times. A last segmentation, dilated, is the traffic.
6. The ground is contested where hardly any frame shows it, or where a single frame still votes
   against it: passing traffic never does.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Int, UInt8
from numpy import ndarray as Array

Stack = UInt8[Array, "K h w 3"]  # small frames
Image = UInt8[Array, "h w 3"]
Masks = Bool[Array, "K h w"]
Pixels = Int[Array, "2 m"]  # rows and columns

MIN_FRAMES = 4  # with fewer, no majority differs from chance
UPDATES = 3  # of the background; more do not change it
MIN_THRESHOLD = 8  # grey levels; smaller differences come from compression
THRESHOLD_SIGMAS = 3.0  # standard deviations of the noise that a difference must exceed
BORDER_WINDOW_PX = 32  # about a vehicle's length: window in which the steps of a border are summed
BORDER_CELL_PX = 4  # in which they are first collected
REGION_WEIGHT_PX = 48.0  # length of border that the mean over the whole region counts for
MIN_SUPPORT = 0.06  # share of the frames, at least 2, that must show a state of the ground
MAX_VOTE = 0.1  # of a frame against the final background; above it the ground is contested
SQUARE = np.ones((3, 3), np.uint8)
DISC = np.array([[0, 1, 1, 1, 0], *[[1] * 5] * 3, [0, 1, 1, 1, 0]], np.uint8)


@dataclass(frozen=True)
class Traffic:
    """Traffic, moving or standing, in K registered frames."""

    masks: Masks  # (K, h, w) pixels that do not show the ground in this frame
    contested: Bool[Array, "h w"]  # pixels where the frames do not decide what the ground is
    background: Image  # (h, w, 3) the ground, in the frames' colours


def find_traffic(stack: Stack, seen: Masks) -> Traffic:
    """Separate traffic from ground in small registered frames, about 1000 px wide.

    `stack` has K frames (h, w, 3) warped to one image, at one exposure, in any colour space and
    order; it is modified in place where `seen`, whether a frame covers a pixel, is False.
    """
    background = _compute_median(stack, seen)
    noise = _estimate_noise(stack, seen, background)
    threshold = max(MIN_THRESHOLD, THRESHOLD_SIGMAS * noise)
    for _ in range(UPDATES):
        # the votes are not kept under a name, as they take as much memory as the frames
        background = _update_background(
            stack, background, _vote_by_frames(stack, seen, background, threshold)[0], threshold
        )
    votes, masks = _vote_by_frames(stack, seen, background, threshold)
    for visible, mask in zip(seen, masks, strict=True):
        mask[:] = visible & cv2.dilate(mask.view(np.uint8), DISC).view(bool)
    ground = _average_selected(stack, seen & ~masks, background)
    return Traffic(masks, _find_contested(votes, masks, seen), ground)


def _estimate_noise(stack: Stack, seen: Masks, background: Image) -> float:
    """Robust standard deviation of every fourth frame about the background; their median."""
    medians = [
        np.median(_max_difference(frame, background)[::4, ::4][visible[::4, ::4]])
        for frame, visible in zip(stack[::4], seen[::4], strict=True)
        if visible[::4, ::4].any()
    ]
    return 1.4826 * float(np.median(medians)) if medians else 0.0


def _compute_median(stack: Stack, seen: Masks) -> Image:
    """Median over the frames that see a pixel, by bisection: 8 counts instead of a sort."""
    kind = np.uint8 if len(stack) < 256 else np.uint16
    half = np.maximum(seen.sum(0, dtype=np.uint16), 1)[..., None] / np.float32(2)
    stack[~seen] = 0  # never counts as bright
    low = np.zeros(stack.shape[1:], np.uint8)
    for bit in (128, 64, 32, 16, 8, 4, 2, 1):
        middle = low | np.uint8(bit)
        count = np.zeros(low.shape, kind)
        for frame in stack:
            count += frame >= middle
        low = np.where(count >= half, middle, low)
    return low


def _max_difference(one: Image, other: Image) -> UInt8[Array, "h w"]:
    """Largest absolute difference of the three channels."""
    first, second, third = cv2.split(cv2.absdiff(one, other))
    return np.asarray(cv2.max(cv2.max(first, second), third), np.uint8)


def _segment_foreground(frame: Image, background: Image, threshold: float) -> UInt8[Array, "h w"]:
    """1 in regions that differ, with holes filled: a car's roof may look like asphalt."""
    # OpenCV takes 1.6 ms for 960 x 540 pixels, scikit-image and SciPy 58 ms with equal result
    differs = (_max_difference(frame, background) > threshold).view(np.uint8)
    solid = cv2.morphologyEx(differs, cv2.MORPH_OPEN, SQUARE)
    solid = cv2.morphologyEx(solid, cv2.MORPH_CLOSE, DISC)
    outlines, _ = cv2.findContours(solid, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return np.asarray(cv2.drawContours(solid, outlines, -1, 1, -1), np.uint8)


def _vote_by_frames(
    stack: Stack, seen: Masks, background: Image, threshold: float
) -> tuple[Float32[Array, "K h w"], Masks]:
    """Votes of all frames (step 3), and the regions in which they differ from the background.

    Pixels that a frame does not see are set to the background.
    """
    votes, regions = np.zeros(seen.shape, np.float32), np.empty(seen.shape, bool)

    def vote(k: int) -> None:
        cv2.copyTo(background, (~seen[k]).view(np.uint8), stack[k])
        foreground = _segment_foreground(stack[k], background, threshold)
        regions[k] = foreground.view(bool)
        _vote_by_borders(stack[k], background, foreground, votes[k])

    with ThreadPoolExecutor(cv2.getNumThreads()) as pool:
        list(pool.map(vote, range(len(stack))))
    return votes, regions


def _vote_by_borders(
    frame: Image, background: Image, foreground: UInt8[Array, "h w"], votes: Float32[Array, "h w"]
) -> None:
    """Fill in the votes of one frame (step 3), which are 0 outside its foreground."""
    # steps nearby separate a vehicle from a false region that touches it, the mean is less noisy
    border = _find_pixels(foreground - cv2.erode(foreground, SQUARE, borderValue=1))
    sides = _find_sides(border, foreground)
    of_background, of_frame = (_measure_steps(image, sides) for image in (background, frame))
    count, labels = cv2.connectedComponents(foreground, connectivity=4)
    region = labels[tuple(border)]
    length = np.maximum(np.bincount(region, minlength=count), 1)
    pixels = _find_pixels(foreground)
    label = labels[tuple(pixels)]
    difference, total = (
        _sum_nearby(border, steps, foreground.shape)[tuple(pixels // BORDER_CELL_PX)]
        + (REGION_WEIGHT_PX * np.bincount(region, steps, count) / length).astype(np.float32)[label]
        for steps in (of_background - of_frame, of_background + of_frame)
    )
    votes[tuple(pixels)] = difference / np.maximum(total, 1e-3)


def _find_pixels(mask: UInt8[Array, "h w"]) -> Pixels:
    """Rows and columns of the pixels that are set; OpenCV takes a third of NumPy's time."""
    points = cv2.findNonZero(mask)
    return np.empty((2, 0), np.int32) if points is None else points.reshape(-1, 2)[:, ::-1].T


def _find_sides(border: Pixels, foreground: UInt8[Array, "h w"]) -> list[Pixels]:
    """Rows and columns 1.5 px inside and outside of a border, by the smoothed gradient."""
    smooth = cv2.GaussianBlur(foreground * np.uint8(255), (0, 0), 1.5)
    gradient = [cv2.Sobel(smooth, cv2.CV_16S, *d)[tuple(border)] for d in ((0, 1), (1, 0))]
    normal = np.stack(gradient).astype(np.float32) * np.float32(1.5) / (np.hypot(*gradient) + 1e-6)
    limit = np.array(foreground.shape)[:, None] - 1
    return [np.rint(border + sign * normal).clip(0, limit).astype(np.intp) for sign in (1, -1)]


def _measure_steps(image: Image, sides: list[Pixels]) -> Float32[Array, "m"]:
    """Absolute differences across the border, summed over channels: only edges along it count."""
    inner, outer = (image[tuple(side)].astype(np.float32) for side in sides)
    return np.asarray(np.abs(inner - outer).sum(-1), np.float32)


def _sum_nearby(
    border: Pixels, steps: Float32[Array, "m"], shape: tuple[int, ...]
) -> Float32[Array, "r c"]:
    """Sums of the border's steps in a window about each cell of a grid."""
    height, width = -(-shape[0] // BORDER_CELL_PX), -(-shape[1] // BORDER_CELL_PX)
    rows, columns = border // BORDER_CELL_PX
    sums = np.bincount(rows * width + columns, steps, height * width).reshape(height, width)
    side = BORDER_WINDOW_PX // BORDER_CELL_PX
    near = cv2.boxFilter(sums.astype(np.float32), cv2.CV_32F, (side, side), normalize=False)
    return np.asarray(near, np.float32)


def _update_background(
    stack: Stack, background: Image, votes: Float32[Array, "K h w"], threshold: float
) -> Image:
    """Replace background pixels where weighted votes and support agree (step 4)."""
    highest = np.zeros(background.shape[:2], np.float32)
    updated = background.copy()
    for frame, vote in zip(stack, votes, strict=True):
        higher = (vote > highest).view(np.uint8)
        cv2.copyTo(vote, higher, highest)
        cv2.copyTo(frame, higher, updated)
    # elsewhere no frame votes for another background
    pixels = tuple(_find_pixels((highest > 0).view(np.uint8)))
    candidate = updated[pixels].astype(np.int16)
    weighted = np.zeros(len(candidate), np.float32)
    support = np.zeros(len(candidate), np.uint16)
    for frame, vote in zip(stack, votes, strict=True):
        alike = np.abs(frame[pixels] - candidate).max(-1) <= threshold
        support += alike
        weighted += vote[pixels] * alike
    kept = (weighted <= 0) | (support < max(MIN_SUPPORT * len(stack), 2))
    updated[pixels[0][kept], pixels[1][kept]] = background[pixels][kept]
    alike = np.stack([_max_difference(frame, updated) <= threshold for frame in stack])
    return _average_selected(stack, alike, updated)


def _average_selected(stack: Stack, selected: Masks, default: Image) -> Image:
    """Mean over the selected frames of each pixel; the default where none is selected."""
    total = np.zeros(default.shape, np.float32)
    for frame, mask in zip(stack, selected, strict=True):
        cv2.accumulate(frame, total, mask.view(np.uint8))
    count = selected.sum(0)[..., None]
    mean = np.rint(total / np.maximum(count, 1)).astype(np.uint8)
    return np.where(count > 0, mean, default)


def _find_contested(
    votes: Float32[Array, "K h w"], masks: Masks, seen: Masks
) -> Bool[Array, "h w"]:
    """Pixels of which hardly any frame shows the ground, or where one shows less of an object."""
    views = seen.sum(0)
    clear = views - masks.sum(0)
    few = (clear < np.maximum(MIN_SUPPORT * views, 2)) & (views > 0)
    doubtful = few | (votes.max(0) > MAX_VOTE)
    return np.asarray(cv2.dilate(doubtful.view(np.uint8), SQUARE).view(bool))
