"""Choose the ground where the votes of `traffic_removal` are in doubt, and mark what stays so.

Pixels in doubt are filled in from their rim (Telea 2004), and the frame is taken that differs least
from this guess over a window. The guess itself is never shown. (Colombari and Fusiello 2010 grow a
background from its known part in a similar way, patch by patch.)

What is wrong afterwards are mostly pieces of vehicles beside pieces of ground that no frame shows
together, and vehicles that left for good.
"""

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Int, UInt8
from numpy import ndarray as Array

from geoaim.mapping.background.stacks import (
    Image,
    Masks,
    Stack,
    average_at,
    average_stack,
    find_alike,
    find_pixels,
    measure_difference,
)

GROWTH_PX = 4  # of the pixels in doubt, whose rim shows half a vehicle
WINDOW_PX = 21  # about a vehicle's width: in which a frame is compared with the guess
LARGEST_DIFFERENCE = 2  # of a pixel, in thresholds: a mark on the ground or a vehicle
MIN_REPEATS = 2  # frames that must look alike: a single one may show a passing vehicle's roof
MAX_COST = 0.5  # share of the largest difference up to which a single frame is taken
INPAINTING_PX = 5  # radius of the fill
SEAM_WINDOW = np.ones((7, 7), np.uint8)  # that some frame must show as the background does
OUTLINE_WINDOW = np.ones((9, 9), np.uint8)  # in which no traffic may be where an outline is judged
SQUARE = np.ones((3, 3), np.uint8)


def continue_ground(
    stack: Stack, seen: Masks, background: Image, doubtful: Bool[Array, "h w"], threshold: float
) -> tuple[Image, Bool[Array, "h w"]]:
    """Replace the background where it is in doubt by the frames that continue its surroundings.

    Args:
        stack: (K, h, w, 3) frames.
        seen: (K, h, w) what they show of the image.
        background: (h, w, 3) the background.
        doubtful: (h, w) where it is in doubt.
        threshold: difference above which two pixels differ, grey levels.

    Returns:
        (h, w, 3) the background, and (h, w) where it is still in doubt and was left as it is.
    """
    if not doubtful.any():
        return background, doubtful
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (1 + 2 * GROWTH_PX, 1 + 2 * GROWTH_PX))
    unknown = np.asarray(cv2.dilate(doubtful.view(np.uint8), disc), np.uint8)
    guess = np.asarray(cv2.inpaint(background, unknown, INPAINTING_PX, cv2.INPAINT_TELEA), np.uint8)
    largest = round(LARGEST_DIFFERENCE * threshold)
    chosen, cost = _choose_frames(stack, seen, guess, unknown, largest)
    pixels = find_pixels(unknown)
    where = tuple(pixels)
    alike = find_alike(stack, pixels, chosen[where], threshold) & seen[:, where[0], where[1]]
    known = (alike.sum(0) >= MIN_REPEATS) | (cost[where] < MAX_COST * largest)
    continued, left = background.copy(), np.zeros(unknown.shape, bool)
    mean = average_at(stack, pixels, alike, background[where])
    continued[where] = np.where(known[:, None], mean, background[where])
    left[where] = ~known
    return continued, left


def _choose_frames(
    stack: Stack, seen: Masks, guess: Image, unknown: UInt8[Array, "h w"], largest: int
) -> tuple[Image, Float32[Array, "h w"]]:
    """The frame of each unknown pixel that differs least from the guess over a window about it.

    Differences are cut at `largest`, so that a mark on the ground is no worse than a vehicle. Also
    returns their mean over the window.
    """
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
    area = cv2.boxFilter(unknown, cv2.CV_32F, (WINDOW_PX, WINDOW_PX), normalize=False)
    return chosen, least / np.maximum(area, 1)


def find_seams(
    stack: Stack, seen: Masks, background: Image, threshold: float
) -> Bool[Array, "h w"]:
    """Find where the background joins parts that no frame shows together.

    Args:
        stack: (K, h, w, 3) frames.
        seen: (K, h, w) what they show of the image.
        background: (h, w, 3) the background.
        threshold: difference above which two pixels differ, grey levels.

    Returns:
        (h, w) pixels about which no frame shows 7 x 7 pixels as the background does.
    """
    shown = np.zeros(background.shape[:2], np.uint8)
    never_seen = ~seen.any(0)
    for frame, visible in zip(stack, seen, strict=True):
        alike = (measure_difference(frame, background) <= threshold) & visible | never_seen
        closed = cv2.morphologyEx(alike.view(np.uint8), cv2.MORPH_CLOSE, SQUARE)
        cv2.max(shown, cv2.erode(closed, SEAM_WINDOW), shown)
    return shown == 0


def remove_outlines(
    stack: Stack, seen: Masks, masks: Masks, background: Image, threshold: float
) -> Image:
    """Replace thin outlines of traffic in a background, which no segmentation finds.

    The traffic beside them is masked. Frames in which nothing is masked nearby show the ground.

    Args:
        stack: (K, h, w, 3) frames.
        seen: (K, h, w) what they show of the image.
        masks: (K, h, w) traffic in the frames.
        background: (h, w, 3) the background.
        threshold: difference above which two pixels differ, grey levels.

    Returns:
        (h, w, 3) the background without lines that differ from the mean of these frames.
    """
    clear = np.empty_like(masks)
    for mask, visible, free in zip(masks, seen, clear, strict=True):
        free[:] = visible & (cv2.dilate(mask.view(np.uint8), OUTLINE_WINDOW) == 0)
    mean = average_stack(stack, clear, background)
    differs = (measure_difference(mean, background) > threshold).view(np.uint8)
    thin = differs - cv2.morphologyEx(differs, cv2.MORPH_OPEN, SQUARE)
    return np.where(((thin > 0) & (clear.sum(0) >= MIN_REPEATS))[..., None], mean, background)


def find_beyond(masks: Masks, seen: Masks, order: Int[Array, "K"]) -> Masks:
    """Find where frames lie before the first or after the last one that shows the background.

    What stands and leaves does not return, but the ground does after each vehicle that passes.

    Args:
        masks: (K, h, w) where frames show something else.
        seen: (K, h, w) what they show of the image.
        order: (K,) the indices of the frames in order of time.

    Returns:
        (K, h, w) whether a frame shows something else, and so do all before it or all after it.
    """
    beyond = np.zeros_like(masks)
    for indices in (order, order[::-1]):
        so_far = np.ones(masks.shape[1:], bool)
        for index in indices:
            so_far &= masks[index] | ~seen[index]
            if not so_far.any():
                break
            beyond[index] |= so_far & masks[index]
    return beyond
