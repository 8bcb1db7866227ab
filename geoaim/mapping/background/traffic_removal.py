"""Find which pixels of registered frames show traffic, without detections; its thresholds.

A mean, a median or a mixture model mistakes a vehicle that stands for most of the clip for ground.
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
   then only. One frame with a vote above 0.1 is enough before the first or after the last frame
   that shows the background: what stands and leaves does not return, but the ground does.
   Frames unlike both do not count: a third vehicle is evidence for neither. The background is
   then the mean of the frames that look like it.
5. Steps 2 to 4 are repeated three times, and thin outlines are removed, which step 2 misses.
6. Where hardly any frame shows the ground, or a single frame still votes against it, the frame is
   taken that continues the ground around best (`contested_ground`). A last segmentation, dilated,
   is the traffic.
7. The ground is contested where no frame continues the ground around, and where no frame shows the
   7 x 7 pixels around as the background does. What stands does not return, but the ground is seen
   again and again. So it is contested as well where the background is not seen before or after
   some time, of which a frame does not clearly vote for it (-0.05), unless it is seen at more than
   four separate times; and where it is seen at a single one, of less than 80 % of the frames that
   see it, and the mean vote of the others is not clear (-0.5).
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Int, UInt8, UInt16
from numpy import ndarray as Array

from geoaim.mapping.background.contested_ground import (
    continue_ground,
    find_beyond,
    find_seams,
    remove_outlines,
)
from geoaim.mapping.background.outlying_values import mask_outliers
from geoaim.mapping.background.stacks import (
    Image,
    Masks,
    Pixels,
    Stack,
    average_at,
    average_stack,
    compute_median,
    estimate_noise,
    find_alike,
    find_pixels,
    measure_difference,
)

MIN_FRAMES = 4  # with fewer frames, a majority may be chance
UPDATES = 3  # how often the background is updated; more updates do not change it
MIN_THRESHOLD = 8  # grey levels; smaller differences come from compression
THRESHOLD_SIGMAS = 3.0  # standard deviations of the noise that a difference must exceed
BORDER_WINDOW_PX = 32  # about a vehicle's length: window in which the steps of a border are summed
BORDER_CELL_PX = 4  # side of the cells in which the steps are summed first
REGION_WEIGHT_PX = 48.0  # length of border that the mean over the whole region counts for
MIN_SUPPORT = 0.06  # share of the frames, at least 2, that must show a state of the ground
MAX_VOTE = 0.1  # of a frame against the background; above it the ground is chosen again
MIN_CLEAR_VOTE = -0.05  # of a frame for the background, beyond those that show it
MIN_CLEAR_MEAN = -0.5  # mean vote for a background that is seen at a single time
MAX_SINGLE_SHARE = 0.8  # of the frames that see the pixel; more leave no doubt
MAX_DOUBTFUL_TIMES = 4  # separate times at which a background is seen that changes leave in doubt
# of intensities, for relative steps; the 32 keeps noise in dark parts small
LOGARITHMS = np.log(np.arange(32, 288, dtype=np.float32))
SQUARE = np.ones((3, 3), np.uint8)
DISC = np.array([[0, 1, 1, 1, 0], *[[1] * 5] * 3, [0, 1, 1, 1, 0]], np.uint8)


@dataclass(frozen=True)
class Traffic:
    """Traffic, moving or standing, in K registered frames."""

    # (K, h, w) pixels that do not show the ground in this frame, and one pixel of what it does not
    # cover beside them
    masks: Masks
    contested: Bool[Array, "h w"]  # pixels where the frames do not decide what the ground is
    background: Image  # (h, w, 3) the ground, in the frames' colours


def find_traffic(stack: Stack, seen: Masks, order: Int[Array, "K"] | None = None) -> Traffic:
    """Separate traffic from ground in small registered frames, about 1000 px wide.

    Args:
        stack: (K, h, w, 3) frames warped to one image, at one exposure. They are modified in place
            where `seen` is False.
        seen: (K, h, w) whether a frame covers a pixel.
        order: (K,) the indices of the frames in order of time; None: they are in this order.

    Returns:
        The traffic.
    """
    order = np.arange(len(stack)) if order is None else order
    background = compute_median(stack, seen)
    threshold = max(MIN_THRESHOLD, THRESHOLD_SIGMAS * estimate_noise(stack, seen, background))
    for _ in range(UPDATES):
        masks = _segment_frames(stack, seen, background, threshold)
        beyond = find_beyond(masks, seen, order)
        # the votes are not kept under a name, as they take as much memory as the frames
        background = _update_background(
            stack, background, _vote_by_frames(stack, masks, background), beyond, threshold
        )
    masks = _segment_frames(stack, seen, background, threshold)
    background = remove_outlines(stack, seen, masks, background, threshold)
    highest, mean = _summarise_votes(_vote_by_frames(stack, masks, background))
    doubtful = highest > MAX_VOTE
    doubtful |= _find_rarely_clear(_dilate(masks, seen), seen)
    background, contested = continue_ground(
        stack, seen, background, _dilate_square(doubtful), threshold
    )
    masks = _segment_frames(stack, seen, background, threshold)
    clear = seen & ~masks
    times = _count_times(clear, order)
    changes = _mark_doubtful_changes(stack, masks, background, find_beyond(masks, seen, order))
    contested |= changes & (times <= MAX_DOUBTFUL_TIMES)
    is_single = (times <= 1) & (clear.sum(0) < MAX_SINGLE_SHARE * seen.sum(0))
    contested |= is_single & (mean > MIN_CLEAR_MEAN)
    contested |= find_seams(stack, seen, background, threshold)
    masks = _dilate(masks, seen)
    mask_outliers(stack, seen & ~contested, masks, background, threshold)
    ground = average_stack(stack, seen & ~masks, background)
    for visible, mask in zip(seen, masks, strict=True):  # small pixels lie half outside of a box
        mask |= _dilate_square(mask) & ~visible
    return Traffic(masks, contested, ground)


def _summarise_votes(
    votes: Float32[Array, "K h w"],
) -> tuple[Float32[Array, "h w"], Float32[Array, "h w"]]:
    """The highest vote at each pixel, and the mean of those cast: -1, a clear one, without any."""
    number = np.count_nonzero(votes, axis=0)
    mean = votes.sum(0) / np.maximum(number, 1).astype(np.float32)
    return votes.max(0), np.where(number > 0, mean, np.float32(-1))


def _count_times(clear: Masks, order: Int[Array, "K"]) -> UInt16[Array, "h w"]:
    """Count at how many separate times the frames show the background.

    Args:
        clear: (K, h, w) whether a frame shows the background.
        order: (K,) the indices of the frames in order of time.

    Returns:
        (h, w) the number of sequences of frames that show it without interruption.
    """
    times, before = np.zeros(clear.shape[1:], np.uint16), np.zeros(clear.shape[1:], bool)
    for index in order:
        times += clear[index] & ~before
        before = clear[index]
    return times


def _mark_doubtful_changes(
    stack: Stack, masks: Masks, background: Image, beyond: Masks
) -> Bool[Array, "h w"]:
    """Mark where a background that came or left for good may have been a vehicle (step 7)."""
    doubtful = np.zeros(background.shape[:2], bool)
    for k in np.flatnonzero(beyond.any((1, 2))):  # mostly the first and the last frames
        votes = np.zeros(doubtful.shape, np.float32)
        _vote_by_borders(stack[k], background, masks[k].view(np.uint8), votes)
        doubtful |= (votes > MIN_CLEAR_VOTE) & beyond[k]
    return doubtful


def _dilate(masks: Masks, seen: Masks) -> Masks:
    """Dilate masks in place, where frames see the image; they are returned."""
    for visible, mask in zip(seen, masks, strict=True):
        mask[:] = visible & cv2.dilate(mask.view(np.uint8), DISC).view(bool)
    return masks


def _segment_foreground(frame: Image, background: Image, threshold: float) -> UInt8[Array, "h w"]:
    """1 in regions that differ, with holes filled: a car's roof may look like asphalt."""
    # OpenCV takes 1.6 ms for 960 x 540 pixels, scikit-image and SciPy 58 ms with equal result
    differs = (measure_difference(frame, background) > threshold).view(np.uint8)
    solid = cv2.morphologyEx(differs, cv2.MORPH_OPEN, SQUARE)
    solid = cv2.morphologyEx(solid, cv2.MORPH_CLOSE, DISC)
    outlines, _ = cv2.findContours(solid, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return np.asarray(cv2.drawContours(solid, outlines, -1, 1, -1), np.uint8)


def _segment_frames(stack: Stack, seen: Masks, background: Image, threshold: float) -> Masks:
    """Regions in which the frames differ from the background (step 2).

    Pixels that a frame does not see are set to the background.
    """
    regions = np.empty(seen.shape, bool)

    def segment(k: int) -> None:
        cv2.copyTo(background, (~seen[k]).view(np.uint8), stack[k])
        regions[k] = _segment_foreground(stack[k], background, threshold).view(bool)

    with ThreadPoolExecutor(cv2.getNumThreads()) as pool:
        list(pool.map(segment, range(len(stack))))
    return regions


def _vote_by_frames(stack: Stack, regions: Masks, background: Image) -> Float32[Array, "K h w"]:
    """Votes of all frames in their regions (step 3)."""
    votes = np.zeros(regions.shape, np.float32)

    def vote(k: int) -> None:
        _vote_by_borders(stack[k], background, regions[k].view(np.uint8), votes[k])

    with ThreadPoolExecutor(cv2.getNumThreads()) as pool:
        list(pool.map(vote, range(len(stack))))
    return votes


def _vote_by_borders(
    frame: Image, background: Image, foreground: UInt8[Array, "h w"], votes: Float32[Array, "h w"]
) -> None:
    """Fill in the votes of one frame (step 3), which are 0 outside its foreground."""
    # steps nearby separate a vehicle from a false region that touches it, the mean is less noisy
    border = find_pixels(foreground - cv2.erode(foreground, SQUARE, borderValue=1))
    sides = _find_sides(border, foreground)
    of_background, of_frame = (_measure_steps(image, sides) for image in (background, frame))
    count, labels = cv2.connectedComponents(foreground, connectivity=4)
    region = labels[tuple(border)]
    length = np.maximum(np.bincount(region, minlength=count), 1)
    pixels = find_pixels(foreground)
    label = labels[tuple(pixels)]
    difference, total = (
        _sum_nearby(border, steps, foreground.shape)[tuple(pixels // BORDER_CELL_PX)]
        + (REGION_WEIGHT_PX * np.bincount(region, steps, count) / length).astype(np.float32)[label]
        for steps in (of_background - of_frame, of_background + of_frame)
    )
    votes[tuple(pixels)] = difference / np.maximum(total, 1e-3)


def _find_sides(border: Pixels, foreground: UInt8[Array, "h w"]) -> list[Pixels]:
    """Rows and columns 1.5 px inside and outside of a border, by the smoothed gradient."""
    smooth = cv2.GaussianBlur(foreground * np.uint8(255), (0, 0), 1.5)
    gradient = [cv2.Sobel(smooth, cv2.CV_16S, *d)[tuple(border)] for d in ((0, 1), (1, 0))]
    normal = np.stack(gradient).astype(np.float32) * np.float32(1.5) / (np.hypot(*gradient) + 1e-6)
    limit = np.array(foreground.shape)[:, None] - 1
    return [np.rint(border + sign * normal).clip(0, limit).astype(np.intp) for sign in (1, -1)]


def _measure_steps(image: Image, sides: list[Pixels]) -> Float32[Array, "m"]:
    """Relative differences across the border, summed over channels: only edges along it count."""
    # relative to the brightness: a dark car on dark asphalt weighs as much as white paint
    inner, outer = (LOGARITHMS[image[tuple(side)]] for side in sides)
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
    stack: Stack, background: Image, votes: Float32[Array, "K h w"], beyond: Masks, threshold: float
) -> Image:
    """Replace background pixels where weighted votes and support agree (step 4)."""
    highest, left = np.zeros((2, *background.shape[:2]), np.float32)
    updated = background.copy()
    for frame, vote, after in zip(stack, votes, beyond, strict=True):
        higher = (vote > highest).view(np.uint8)
        cv2.copyTo(vote, higher, highest)
        cv2.copyTo(frame, higher, updated)
        cv2.copyTo(vote * after, higher, left)
    # elsewhere no frame votes for another background
    pixels = find_pixels((highest > 0).view(np.uint8))
    where = tuple(pixels)
    alike = find_alike(stack, pixels, updated[where], threshold)
    weighted = np.zeros(pixels.shape[1], np.float32)
    for vote, same in zip(votes, alike, strict=True):
        weighted += vote[where] * same
    lasting = (alike.sum(0) >= max(MIN_SUPPORT * len(stack), 2)) | (left[where] > MAX_VOTE)
    replaced = (weighted > 0) & lasting
    mean = average_at(stack, pixels, alike, background[where])
    updated[where] = np.where(replaced[:, None], mean, background[where])
    return updated


def _find_rarely_clear(masks: Masks, seen: Masks) -> Bool[Array, "h w"]:
    """Pixels of which hardly any frame shows the ground."""
    views = seen.sum(0)
    clear = views - masks.sum(0)
    return np.asarray((clear < np.maximum(MIN_SUPPORT * views, 2)) & (views > 0))


def _dilate_square(mask: Bool[Array, "h w"]) -> Bool[Array, "h w"]:
    return np.asarray(cv2.dilate(mask.view(np.uint8), SQUARE).view(bool))
