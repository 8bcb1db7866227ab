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
5. Steps 2 to 4 are repeated with the new background.
6. Where hardly any frame shows the ground, or a single frame still votes against it, the frame is
   taken that continues the ground around best. A last segmentation, dilated, is the traffic,
   with single values that differ where most frames do not: regions miss cars of a few pixels.
   What is in doubt and its rim are filled in first (Telea 2004), and the frame is taken that
   differs least from this guess over a window; the guess itself is never shown. (Colombari and
   Fusiello 2010 grow a background from its known part in a similar way, patch by patch.)
7. The ground is contested where no frame continues the ground around, where no frame shows the
   7 x 7 pixels around as the background does, and where the background is seen at a single time, of
   less than 80 % of the frames that see it, and the mean vote of the others is not clear (-0.5).
   What is wrong afterwards are mostly pieces of vehicles beside pieces of ground that no frame
   shows together, and vehicles that left for good.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Int, Int32, UInt8, UInt16
from numpy import ndarray as Array

Stack = UInt8[Array, "K h w 3"]  # small frames
Image = UInt8[Array, "h w 3"]
Masks = Bool[Array, "K h w"]
Pixels = Int[Array, "2 m"]  # rows and columns
Votes = list[tuple[Int[Array, "_"], Float32[Array, "_"]]]  # of each frame: flat pixels, votes

MIN_FRAMES = 4  # with fewer frames, a majority may be chance
# of the background; where queues stood, 15.6 grey levels, 16.2 with one and 15.5 with three
UPDATES = 2
MIN_THRESHOLD = 8  # grey levels; smaller differences come from compression
THRESHOLD_SIGMAS = 3.0  # standard deviations of the noise that a difference must exceed
BORDER_WINDOW_PX = 32  # about a vehicle's length: window in which the steps of a border are summed
BORDER_CELL_PX = 4  # side of the cells in which the steps are summed first
REGION_WEIGHT_PX = 48.0  # length of border that the mean over the whole region counts for
MIN_SUPPORT = 0.06  # share of the frames, at least 2, that must show a state of the ground
MAX_VOTE = 0.1  # of a frame against the background; above it the ground is chosen again
MIN_CLEAR_MEAN = -0.5  # mean vote for a background that is seen at a single time
MAX_SINGLE_SHARE = 0.8  # of the frames that see the pixel; more leave no doubt
# of intensities, for relative steps; the 32 keeps noise in dark parts small
LOGARITHMS = np.log(np.arange(32, 288, dtype=np.float32))
SQUARE = np.ones((3, 3), np.uint8)
DISC = np.array([[0, 1, 1, 1, 0], *[[1] * 5] * 3, [0, 1, 1, 1, 0]], np.uint8)
GROWTH_PX = 4  # of the pixels in doubt, whose rim shows half a vehicle
WINDOW_PX = 21  # about a vehicle's width: in which a frame is compared with the guess
LARGEST_DIFFERENCE = 2  # of a pixel, in thresholds: a mark on the ground or a vehicle
MIN_REPEATS = 2  # frames that must look alike: a single one may show a passing vehicle's roof
INPAINTING_PX = 5  # radius of the fill
SEAM_WINDOW = np.ones((7, 7), np.uint8)  # that some frame must show as the background does


@dataclass(frozen=True)
class Traffic:
    """Traffic, moving or standing, in K registered frames."""

    # (K, h, w) pixels that do not show the ground in this frame, and one pixel of what it does not
    # cover beside them
    masks: Masks
    contested: Bool[Array, "h w"]  # pixels where the frames do not decide what the ground is
    background: Image  # (h, w, 3) the ground, in the frames' colours


def find_traffic(stack: Stack, seen: Masks, order: Int[Array, "K"] | None = None) -> Traffic:
    """Separate traffic from ground in small registered frames, about 1000 px wide."""
    order = np.arange(len(stack)) if order is None else order
    background = compute_median(stack, seen)
    threshold = max(MIN_THRESHOLD, THRESHOLD_SIGMAS * estimate_noise(stack, seen, background))
    for _ in range(UPDATES):
        masks = _segment_frames(_compare_frames(stack, seen, background, threshold))
        beyond = find_beyond(masks, seen, order)
        votes = _vote_by_frames(stack, masks, background)
        background = _update_background(stack, seen, background, votes, beyond, threshold)
    masks = _segment_frames(_compare_frames(stack, seen, background, threshold))
    votes = _vote_by_frames(stack, masks, background)
    highest, mean = _summarise_votes(votes, masks.shape[1:])
    doubtful = highest > MAX_VOTE
    doubtful |= _find_rarely_clear(_dilate(masks, seen), seen)
    background, contested = continue_ground(
        stack, seen, background, _dilate_square(doubtful), threshold
    )
    differs = _compare_frames(stack, seen, background, threshold)
    masks = _segment_frames(differs)
    clear = seen & ~masks
    is_single = _count_times(clear, order) <= 1
    is_single &= count_frames(clear) < MAX_SINGLE_SHARE * count_frames(seen)
    contested |= is_single & (mean > MIN_CLEAR_MEAN)
    contested |= find_seams(differs, seen)
    masks = _dilate(masks, seen)
    # what a segmentation misses: a car of a few pixels, its windows, the rim of a shadow
    differs &= ~contested & (count_frames(differs) < count_frames(seen) / 2)
    for visible, mask, small in zip(seen, masks, differs, strict=True):
        mask |= _dilate_square(small) & visible
        mask |= _dilate_square(mask) & ~visible  # small pixels lie half outside of a box
    return Traffic(masks, contested, background)


def _summarise_votes(
    votes: Votes, shape: tuple[int, ...]
) -> tuple[Float32[Array, "h w"], Float32[Array, "h w"]]:
    """The highest vote at each pixel, and the mean of those cast: -1, a clear one, without any."""
    highest, total, number = np.zeros((3, shape[0] * shape[1]), np.float32)
    for where, vote in votes:
        highest[where] = np.maximum(highest[where], vote)
        total[where] += vote
        number[where] += 1
    mean = np.where(number > 0, total / np.maximum(number, 1), np.float32(-1))
    return highest.reshape(shape), mean.reshape(shape)


def count_frames(masks: Masks) -> Int32[Array, "h w"]:
    """Count in how many frames each pixel is set."""
    kind = np.uint8 if len(masks) < 256 else np.uint16  # NumPy's own sums take ten times as long
    return np.add.reduce(masks.view(np.uint8), axis=0, dtype=kind).astype(np.int32)


def _count_times(clear: Masks, order: Int[Array, "K"]) -> UInt16[Array, "h w"]:
    """Count at how many separate times the frames show the background."""
    times, before = np.zeros(clear.shape[1:], np.uint16), np.zeros(clear.shape[1:], bool)
    for index in order:
        times += clear[index] & ~before
        before = clear[index]
    return times


def _dilate(masks: Masks, seen: Masks) -> Masks:
    """Dilate masks in place, where frames see the image; they are returned."""
    for visible, mask in zip(seen, masks, strict=True):
        mask[:] = visible & cv2.dilate(mask.view(np.uint8), DISC).view(bool)
    return masks


def _segment_foreground(differs: Bool[Array, "h w"]) -> UInt8[Array, "h w"]:
    """1 in regions that differ, with holes filled: a car's roof may look like asphalt."""
    # OpenCV takes 1.6 ms for 960 x 540 pixels, scikit-image and SciPy 58 ms with equal result
    solid = cv2.morphologyEx(differs.view(np.uint8), cv2.MORPH_OPEN, SQUARE)
    solid = cv2.morphologyEx(solid, cv2.MORPH_CLOSE, DISC)
    outlines, _ = cv2.findContours(solid, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    return np.asarray(cv2.drawContours(solid, outlines, -1, 1, -1), np.uint8)


def _compare_frames(stack: Stack, seen: Masks, background: Image, threshold: float) -> Masks:
    """Where frames differ from the background, to which they are set where they see nothing."""
    differs = np.empty(seen.shape, bool)
    for frame, visible, result in zip(stack, seen, differs, strict=True):
        cv2.copyTo(background, (~visible).view(np.uint8), frame)
        result[:] = measure_difference(frame, background) > threshold
    return differs


def _segment_frames(differs: Masks) -> Masks:
    """Regions in which frames differ from the background (step 2)."""
    with ThreadPoolExecutor(cv2.getNumThreads()) as pool:
        return np.stack(list(pool.map(_segment_foreground, differs))).view(bool)


def _vote_by_frames(stack: Stack, regions: Masks, background: Image) -> Votes:
    """Votes of all frames in their regions (step 3)."""
    sides = (np.arange(side, dtype=np.int32) for side in regions.shape[1:])
    rows, columns = (places // BORDER_CELL_PX for places in sides)
    cells = (rows[:, None] * (columns[-1] + 1) + columns).ravel()

    def vote(pair: tuple[Image, Bool[Array, "h w"]]) -> tuple[Array, Array]:
        return _vote_by_borders(pair[0], background, pair[1].view(np.uint8), cells)

    with ThreadPoolExecutor(cv2.getNumThreads()) as pool:
        return list(pool.map(vote, zip(stack, regions, strict=True)))


def _vote_by_borders(
    frame: Image, background: Image, foreground: UInt8[Array, "h w"], cells: Int[Array, " p"]
) -> tuple[Int[Array, " m"], Float32[Array, " m"]]:
    """The flat pixels of one frame's foreground, and the votes there (step 3)."""
    # steps nearby separate a vehicle from a false region that touches it, the mean is less noisy
    border = find_pixels(foreground - cv2.erode(foreground, SQUARE, borderValue=1))
    sides = _find_sides(border, foreground)
    of_background, of_frame = (_measure_steps(image, sides) for image in (background, frame))
    count, labels = cv2.connectedComponents(foreground, connectivity=4)
    region = labels[tuple(border)]
    length = np.maximum(np.bincount(region, minlength=count), 1)
    where = np.flatnonzero(foreground)
    label, cell = labels.ravel()[where], cells[where]
    difference, total = (
        _sum_nearby(border, steps, foreground.shape).ravel()[cell]
        + (REGION_WEIGHT_PX * np.bincount(region, steps, count) / length).astype(np.float32)[label]
        for steps in (of_background - of_frame, of_background + of_frame)
    )
    return where, difference / np.maximum(total, np.float32(1e-3))


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
    stack: Stack, seen: Masks, background: Image, votes: Votes, beyond: Masks, threshold: float
) -> Image:
    """Replace background pixels where weighted votes and support agree (step 4)."""
    highest, left, weighted = np.zeros((3, background.size // 3), np.float32)
    updated = background.copy()
    for frame, (where, vote), after in zip(stack, votes, beyond, strict=True):
        higher = vote > highest[where]
        chosen, value = where[higher], vote[higher]
        highest[chosen] = value
        updated.reshape(-1, 3)[chosen] = frame.reshape(-1, 3)[chosen]
        left[chosen] = value * after.ravel()[chosen]
    # elsewhere no frame votes for another background
    voted = highest.reshape(updated.shape[:2]) > 0
    alike = find_alike(stack, seen, updated, threshold)
    for (where, vote), same in zip(votes, alike, strict=True):
        weighted[where] += vote * same.ravel()[where]
    weighted, left = (values.reshape(voted.shape) for values in (weighted, left))
    lasting = (count_frames(alike) >= max(MIN_SUPPORT * len(stack), 2)) | (left > MAX_VOTE)
    replaced = voted & (weighted > 0) & lasting
    return average_frames_at(stack, alike, replaced, background)


def _find_rarely_clear(masks: Masks, seen: Masks) -> Bool[Array, "h w"]:
    """Pixels of which hardly any frame shows the ground."""
    views = count_frames(seen)
    clear = views - count_frames(masks)
    return np.asarray((clear < np.maximum(MIN_SUPPORT * views, 2)) & (views > 0))


def _dilate_square(mask: Bool[Array, "h w"]) -> Bool[Array, "h w"]:
    return np.asarray(cv2.dilate(mask.view(np.uint8), SQUARE).view(bool))


def continue_ground(
    stack: Stack, seen: Masks, background: Image, doubtful: Bool[Array, "h w"], threshold: float
) -> tuple[Image, Bool[Array, "h w"]]:
    """Replace the background where it is in doubt by the frames that continue its surroundings."""
    if not doubtful.any():
        return background, doubtful
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (1 + 2 * GROWTH_PX, 1 + 2 * GROWTH_PX))
    unknown = np.asarray(cv2.dilate(doubtful.view(np.uint8), disc), np.uint8)
    guess = np.asarray(cv2.inpaint(background, unknown, INPAINTING_PX, cv2.INPAINT_TELEA), np.uint8)
    largest = round(LARGEST_DIFFERENCE * threshold)
    chosen = _choose_frames(stack, seen, guess, unknown, largest)
    alike = find_alike(stack, seen, chosen, threshold)
    known = count_frames(alike) >= MIN_REPEATS
    inside = unknown.view(bool)
    return average_frames_at(stack, alike, inside & known, background), inside & ~known


def _choose_frames(
    stack: Stack, seen: Masks, guess: Image, unknown: UInt8[Array, "h w"], largest: int
) -> Image:
    """The frame of each unknown pixel that differs least from the guess over a window about it."""
    least = np.full(unknown.shape, np.inf, np.float32)
    chosen = guess.copy()
    for frame, visible in zip(stack, seen, strict=True):
        difference = measure_difference(frame, guess)
        difference[~visible] = largest
        inside = np.minimum(difference, np.uint8(largest)) * unknown
        cost = cv2.boxFilter(inside, cv2.CV_32F, (WINDOW_PX, WINDOW_PX), normalize=False)
        lower = ((cost < least) & visible).view(np.uint8) & unknown
        cv2.copyTo(cost, lower, least)
        cv2.copyTo(frame, lower, chosen)
    return chosen


def find_seams(differs: Masks, seen: Masks) -> Bool[Array, "h w"]:
    """Find pixels about which no frame shows 7 x 7 pixels as the background does."""
    shown = np.zeros(seen.shape[1:], np.uint8)
    never_seen = ~seen.any(0)
    for different, visible in zip(differs, seen, strict=True):
        alike = ~different & visible | never_seen
        closed = cv2.morphologyEx(alike.view(np.uint8), cv2.MORPH_CLOSE, SQUARE)
        cv2.max(shown, cv2.erode(closed, SEAM_WINDOW), shown)
    return shown == 0


def find_beyond(masks: Masks, seen: Masks, order: Int[Array, "K"]) -> Masks:
    """Find where frames lie before the first or after the last one that shows the background."""
    beyond = np.zeros_like(masks)
    for indices in (order, order[::-1]):
        so_far = np.ones(masks.shape[1:], bool)
        for index in indices:
            so_far &= masks[index] | ~seen[index]
            if not so_far.any():
                break
            beyond[index] |= so_far & masks[index]
    return beyond


def compute_median(stack: UInt8[Array, "K h w c"], seen: Masks) -> UInt8[Array, "h w c"]:
    """Median over the frames that see a pixel, by bisection: 8 counts instead of a sort.

    `stack` becomes 0 in place where a frame does not see a pixel.
    """
    kind = np.uint8 if len(stack) < 256 else np.uint16
    half = np.maximum(count_frames(seen), 1)[..., None] / np.float32(2)
    stack[~seen] = 0  # never counts as bright
    low = np.zeros(stack.shape[1:], np.uint8)
    for bit in (128, 64, 32, 16, 8, 4, 2, 1):
        middle = low | np.uint8(bit)
        count = np.zeros(low.shape, kind)
        for frame in stack:
            count += (frame >= middle).view(np.uint8)
        low = np.where(count >= half, middle, low)
    return low


def estimate_noise(stack: Stack, seen: Masks, background: Image) -> float:
    """Robust standard deviation of frames about the background: the median over every fourth one.

    In grey levels; 0 where no frame shows anything.
    """
    medians = [
        np.median(measure_difference(frame, background)[::4, ::4][visible[::4, ::4]])
        for frame, visible in zip(stack[::4], seen[::4], strict=True)
        if visible[::4, ::4].any()
    ]
    return 1.4826 * float(np.median(medians)) if medians else 0.0


def measure_difference(one: Image, other: Image) -> UInt8[Array, "h w"]:
    """Largest absolute difference of the three channels."""
    first, second, third = cv2.split(cv2.absdiff(one, other))
    return np.asarray(cv2.max(cv2.max(first, second), third), np.uint8)


def find_pixels(mask: UInt8[Array, "h w"]) -> Pixels:
    """Rows and columns of the pixels that are set; OpenCV takes a third of NumPy's time."""
    points = cv2.findNonZero(mask)
    return np.empty((2, 0), np.int32) if points is None else points.reshape(-1, 2)[:, ::-1].T


def find_alike(stack: Stack, seen: Masks, image: Image, threshold: float) -> Masks:
    """Find where frames that see the image have nearly its colours."""
    alike = np.empty(seen.shape, bool)
    for frame, visible, same in zip(stack, seen, alike, strict=True):
        np.less_equal(measure_difference(frame, image), threshold, out=same)
        same &= visible
    return alike


def average_frames_at(
    stack: Stack, selected: Masks, where: Bool[Array, "h w"], default: Image
) -> Image:
    """Average the selected frames at some pixels; elsewhere, and without any, the default stays."""
    total = np.zeros(default.shape, np.float32)
    for frame, chosen in zip(stack, selected, strict=True):
        cv2.accumulate(frame, total, chosen.view(np.uint8))
    count = count_frames(selected)
    mean = default.copy()
    inside = where & (count > 0)
    mean[inside] = np.rint(total[inside] / count[inside][:, None])
    return mean
