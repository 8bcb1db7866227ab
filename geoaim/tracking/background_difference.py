"""What differs from the background: gain, noise of each cell, standing vehicles, and shadows."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Int, UInt8
from numpy import ndarray as Array
from scipy import ndimage

from geoaim.base.errors import TracksError

NOISE_FACTOR = 2.5  # standard deviations of a cell's noise that are no difference
MIN_DIFFERENCE = 9.0  # grey levels
GAIN_STEP = 101  # every which cell is compared for the gain
LEVELS = (1, 2, 3, 4, 6, 8, 10, 13)  # grey levels at which the differences of a cell are counted
MANY = 2.0  # times the typical difference; such a cell may be of what stands
UNIT = 64  # of a difference as large as the tolerance
MIN_STANDING = 0.2  # share of the frames in which a cell looks different, but alike
STANDING_SCATTER = 10.0  # grey levels within which it looks alike
MIN_STANDING_M2 = 1.5
MAX_EDGE = 100.0  # Sobel; of a step of 25 grey levels
BOUNDARY_GAIN = 0.95  # the ground's boundary has less contrast than a vehicle's, by this factor
SHADOW_RATIOS = (0.3, 0.93)  # of brightness in shadow and beside it
SHADOW_TINT = 0.09  # differences of the colours' ratios in a shadow
CLEAR = 1.5  # times the tolerance, of differences that tell how dark shadows are
MIN_SHADOW_SHARE = 0.05  # of what differs; less is no shadow
SHADOW_MARGIN = 0.1  # by which the ratio in a shadow may be lower than in most of them
SHADOW_REACH_M, GLASS_REACH_M = 4.5, 1.5  # of a shadow from its vehicle; of glass between its parts
MAX_VEHICLE_M2 = 60.0  # with its shadow
MIN_SUN, MIN_SUN_VEHICLES = 0.4, 20  # agreement of the directions of shadows, and how many
SMOOTHING = 0.7  # cells; standard deviation of the blur of frames and map
BLACK = 8.0  # grey levels that are added before ratios are taken


@dataclass(frozen=True, eq=False)
class Ground:
    """The ground without traffic on a grid, and what is known of its noise and shadows."""

    image: UInt8[Array, "H W 3"]
    covered: Bool[Array, "H W"]
    tolerance: UInt8[Array, "H W"]  # grey levels from which on a cell differs
    shadow: float  # ratio of brightness in vehicles' shadows; 1: they cast none
    # from a vehicle's outline to its shadow's, cells; zero where that is not known
    sun: Float[Array, "2"]
    resolution: float  # metres per cell


def match_gain(
    frame: UInt8[Array, "H W 3"], image: UInt8[Array, "H W 3"], known: Bool[Array, "H W"]
) -> UInt8[Array, "H W 3"]:
    """Bring a frame to the ground's exposure, by a gain and an offset for each channel."""
    rows = GAIN_STEP * np.flatnonzero(known.ravel()[::GAIN_STEP])
    if not len(rows):
        return frame
    one, other = (picture.reshape(-1, 3)[rows].astype(np.float32) for picture in (frame, image))
    table = np.empty((256, 1, 3), np.uint8)
    for channel in range(3):
        x, y = one[:, channel], other[:, channel]
        gain, offset = 1.0, float(np.median(y - x))
        for _ in range(4):
            misfit = np.abs(gain * x + offset - y)
            near = misfit <= 2.5 * max(float(np.median(misfit)), 1.0)
            spread = float(x[near].var())
            mean = float(x[near].mean()), float(y[near].mean())
            if spread > 4.0:
                gain = float(((x[near] - mean[0]) * (y[near] - mean[1])).mean()) / spread
                gain = min(max(gain, 0.5), 2.0)
            offset = mean[1] - gain * mean[0]
        table[:, 0, channel] = np.rint(gain * np.arange(256) + offset).clip(0, 255)
    return np.asarray(cv2.LUT(frame, table), np.uint8)


def _subtract(
    frame: UInt8[Array, "H W 3"], ground: UInt8[Array, "H W 3"], known: Bool[Array, "H W"]
) -> UInt8[Array, "H W"]:
    """The largest difference of a channel, 0 where it is not known."""
    red, green, blue = cv2.split(cv2.absdiff(frame, ground))
    return np.asarray(cv2.max(cv2.max(red, green), blue) * known, np.uint8)


def learn_ground(
    image: UInt8[Array, "H W 3"],
    covered: Bool[Array, "H W"],
    frames: list[tuple[UInt8[Array, "H W 3"], Bool[Array, "H W"]]],
    resolution: float,
) -> Ground:
    """Learn the ground from a map and frames on a grid.

    Args:
        image: the map without traffic, of this video.
        covered: which cells it covers.
        frames: some 30 frames, and which cells they cover.
        resolution: metres per cell.

    Returns:
        The ground: the map, but where something stood in it that left, what was under it.

    Raises:
        TracksError: the map does not look like the frames.
    """
    stack = [
        cv2.GaussianBlur(match_gain(frame, image, seen & covered), (3, 3), SMOOTHING)
        for frame, seen in frames
    ]
    known = [seen & covered for _, seen in frames]
    image = np.asarray(cv2.GaussianBlur(image, (3, 3), SMOOTHING), np.uint8)
    differences = [_subtract(frame, image, k) for frame, k in zip(stack, known, strict=True)]
    counts = [sum((d <= level).view(np.uint8) for d in differences) for level in LEVELS]
    median = np.full(covered.shape, LEVELS[-1], np.uint8)
    for level, count in zip(LEVELS[::-1], counts[::-1], strict=True):
        median[count > len(frames) / 2] = level
    typical = float(np.median(median[covered])) if covered.any() else LEVELS[-1]
    if typical >= LEVELS[-1]:
        raise TracksError(
            f"frames differ from the map by {typical:.0f} grey levels or more nearly everywhere; "
            "vehicles are found without a detector on a map of the same video: build it with "
            "geoaim build, or give boxes (--detections)"
        )
    lasting = (median > MANY * typical).view(np.uint8)
    broad = np.asarray(cv2.morphologyEx(lasting, cv2.MORPH_OPEN, np.ones((5, 5)))) > 0
    median[broad] = _measure_scatter(stack, np.flatnonzero(broad))
    dilated = cv2.dilate(median, np.ones((3, 3)))
    median = np.asarray(cv2.GaussianBlur(dilated, (5, 5), 1.0), np.uint8)
    tolerance = np.asarray(MIN_DIFFERENCE + NOISE_FACTOR * 1.4826 * median, np.uint8)
    image = _uncover_ground(image, stack, differences, tolerance, resolution)
    ground = Ground(image, covered, tolerance, 1.0, np.zeros(2), resolution)
    ground = replace(ground, shadow=_find_shadow_ratio(ground, stack, differences))
    if ground.shadow == 1.0:
        return ground
    return replace(ground, sun=_find_sun(ground, stack, differences))


def _measure_scatter(
    stack: list[UInt8[Array, "H W 3"]], cells: Int[Array, " n"]
) -> UInt8[Array, " n"]:
    """Measure how cells scatter in time, in grey levels: little under what stands."""
    values = np.stack([frame.reshape(-1, 3)[cells] for frame in stack])
    middle = np.median(values, axis=0).astype(np.uint8)
    off = np.maximum(values, middle) - np.minimum(values, middle)
    return np.median(off.max(axis=2), axis=0).clip(LEVELS[0], LEVELS[-1]).astype(np.uint8)


def _uncover_ground(
    ground: UInt8[Array, "H W 3"],
    stack: list[UInt8[Array, "H W 3"]],
    differences: list[UInt8[Array, "H W"]],
    tolerance: UInt8[Array, "H W"],
    resolution: float,
) -> UInt8[Array, "H W 3"]:
    """Replace what stood in the map, and left, by what was seen under it."""
    # cells that look different for long, or as they do at the start, or at the end
    differs = [d > tolerance for d in differences]
    share = sum(one.view(np.uint8) for one in differs)
    for end in (None, 0, -1):
        if end is None:
            cells = np.flatnonzero(share > MIN_STANDING * len(stack))
        else:
            cells = np.flatnonzero(differs[end] & (share > 1))
        if not len(cells):
            continue
        values = np.stack([frame.reshape(-1, 3)[cells] for frame in stack]).astype(np.float32)
        used = np.stack([one.reshape(-1)[cells] for one in differs])
        if end is not None:
            used &= np.abs(values - values[end]).max(axis=2) < STANDING_SCATTER
        values[~used] = np.nan
        middle = np.nanmedian(values, axis=0)
        scatter = np.nanmedian(np.abs(values - middle).max(axis=2), axis=0)
        alike = (scatter < STANDING_SCATTER) & (used.sum(axis=0) > 1)
        ground = _fill(ground, cells[alike], middle[alike], resolution)
    return ground


def _fill(
    ground: UInt8[Array, "H W 3"],
    cells: Int[Array, " n"],
    values: Float32[Array, "n 3"],
    resolution: float,
) -> UInt8[Array, "H W 3"]:
    """Give cells other values, where groups of them have boundaries with less contrast then."""
    other, mask = ground.copy(), np.zeros(ground.shape[:2], np.uint8)
    other.reshape(-1, 3)[cells] = np.rint(values)
    mask.reshape(-1)[cells] = 1
    mask = np.asarray(cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((3, 3))), np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask)
    ring = cv2.dilate(mask, np.ones((3, 3))) - cv2.erode(mask, np.ones((3, 3)))
    around = np.where(ring > 0, ndimage.grey_dilation(labels, size=(3, 3)), 0)
    number = np.arange(count)
    edges = [ndimage.mean(_measure_edges(picture), around, number) for picture in (ground, other)]
    better = edges[1] < BOUNDARY_GAIN * edges[0]
    better &= stats[:, cv2.CC_STAT_AREA] * resolution**2 > MIN_STANDING_M2
    better[0] = False
    return np.where(better[labels][..., None], other, ground)


def _measure_edges(image: UInt8[Array, "H W 3"]) -> Float32[Array, "H W"]:
    """Measure the strength of edges; of strong ones it counts that they are there."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    edges = np.hypot(cv2.Sobel(grey, cv2.CV_32F, 1, 0), cv2.Sobel(grey, cv2.CV_32F, 0, 1))
    return np.minimum(edges, MAX_EDGE)


def _compute_ratio(
    frame: UInt8[Array, "n 3"], ground: UInt8[Array, "n 3"]
) -> tuple[Float32[Array, "n"], Float32[Array, "n"]]:
    """Compute how bright a frame is relative to the ground, and how colours differ in that."""
    ratio = (frame + np.float32(BLACK)) / (ground + np.float32(BLACK))
    mean = ratio.mean(axis=-1)
    return mean, np.abs(ratio - mean[..., None]).max(axis=-1)


def _find_shadow_ratio(
    ground: Ground, stack: list[UInt8[Array, "H W 3"]], differences: list[UInt8[Array, "H W"]]
) -> float:
    """Find how dark shadows of vehicles are: the mode of the ratios of neutral dark cells."""
    chosen = [
        _compute_ratio(frame[where], ground.image[where])
        for frame, where in (
            (frame, difference > CLEAR * ground.tolerance.astype(np.float32))
            for frame, difference in zip(stack, differences, strict=True)
        )
    ]
    ratio, tint = (np.concatenate(part) for part in zip(*chosen, strict=True))
    neutral = ratio[(tint < SHADOW_TINT) & (ratio > SHADOW_RATIOS[0]) & (ratio < SHADOW_RATIOS[1])]
    if len(neutral) < MIN_SHADOW_SHARE * len(ratio) or len(neutral) < 100:
        return 1.0
    counts, edges = np.histogram(neutral, bins=31, range=SHADOW_RATIOS)
    smooth = ndimage.gaussian_filter1d(counts.astype(float), 1.0)
    return float(edges[smooth.argmax()] + (edges[1] - edges[0]) / 2)


def _find_sun(
    ground: Ground, stack: list[UInt8[Array, "H W 3"]], differences: list[UInt8[Array, "H W"]]
) -> Float[Array, "2"]:
    """Find how far shadows fall: from lit to dark cells of what differs, over all vehicles."""
    offsets, groups = [np.empty((0, 2))], []
    for frame, difference in zip(stack, differences, strict=True):
        mask = (difference > ground.tolerance).view(np.uint8)
        count, labels, stats, _ = cv2.connectedComponentsWithStats(
            cv2.morphologyEx(mask, cv2.MORPH_CLOSE, np.ones((3, 3)))
        )
        area = stats[:, cv2.CC_STAT_AREA] * ground.resolution**2
        rows, columns = np.nonzero(mask)
        ratio, tint = _compute_ratio(frame[rows, columns], ground.image[rows, columns])
        dark = (ratio < SHADOW_RATIOS[1]) & (tint < SHADOW_TINT)
        own = labels[rows, columns]
        places = np.column_stack([columns, rows]).astype(float)
        sums = []
        for kind in (~dark, dark):
            weight = np.bincount(own[kind], minlength=count)
            place = [np.bincount(own[kind], places[kind, k], count) for k in (0, 1)]
            sums.append((weight, np.stack(place, axis=1) / np.maximum(weight, 1)[:, None]))
        (lit, here), (shade, there) = sums
        both = np.minimum(lit, shade) > 0.2 * (lit + shade)
        both &= (area > MIN_STANDING_M2) & (area < MAX_VEHICLE_M2) & (np.arange(count) > 0)
        offsets.append((there - here)[both])
        chosen = both[own]
        groups.append((count, own[chosen], places[chosen], dark[chosen]))
    offset = np.concatenate(offsets)
    total = (offset / np.maximum(np.hypot(*offset.T), 1e-9)[:, None]).sum(axis=0)
    agreement = float(np.hypot(*total))
    if len(offset) < MIN_SUN_VEHICLES or agreement < MIN_SUN * len(offset):
        return np.zeros(2)
    direction = total / agreement
    return direction * max(1.0, _measure_shadows(groups, direction))


def _measure_shadows(
    groups: list[tuple[int, Int[Array, "_"], Float[Array, "_ 2"], Bool[Array, "_"]]],
    direction: Float[Array, "2"],
) -> float:
    """Measure how far shadows reach beyond the lit parts of their vehicles, cells; the median."""
    beyond = []
    for count, own, places, dark in groups:
        ends = np.full((2, count), -np.inf)
        for row, kind in enumerate((dark, ~dark)):
            np.maximum.at(ends[row], own[kind], places[kind] @ direction)
        known = np.isfinite(ends).all(axis=0)
        beyond += (ends[0][known] - ends[1][known]).tolist()
    return float(np.median(beyond))


def _sweep(mask: UInt8[Array, "H W"], step: Float[Array, "2"], reach: float) -> UInt8[Array, "H W"]:
    """Extend a mask in a direction, by up to `reach` cells."""
    swept, done = mask, 0.0
    while done < reach:
        length = min(max(done, 1.0), reach - done)
        right, down = np.rint(step * length).astype(int).tolist()
        columns, rows = (
            (
                slice(max(shift, 0), count + min(shift, 0)),
                slice(max(-shift, 0), count - max(shift, 0)),
            )
            for shift, count in ((right, mask.shape[1]), (down, mask.shape[0]))
        )
        moved = swept.copy()
        moved[rows[0], columns[0]] |= swept[rows[1], columns[1]]
        swept, done = moved, done + length
    return swept


def find_foreground(
    ground: Ground, frame: UInt8[Array, "H W 3"], seen: Bool[Array, "H W"]
) -> tuple[UInt8[Array, "H W"], UInt8[Array, "H W"]]:
    """Find what differs from the ground in a frame.

    Args:
        ground: the ground.
        frame: on its grid.
        seen: which cells it covers.

    Returns:
        The difference, `UNIT` for one of the tolerance, and which cells may be shadow (1).
    """
    known = seen & ground.covered
    matched = cv2.GaussianBlur(match_gain(frame, ground.image, known), (3, 3), SMOOTHING)
    difference = _subtract(matched, ground.image, known)
    strength = np.asarray(cv2.divide(difference, ground.tolerance, scale=UNIT), np.uint8)
    shaded = np.zeros(known.shape, np.uint8)
    if ground.shadow == 1.0:
        return strength, shaded
    cells = np.flatnonzero(strength > UNIT // 2)
    ratio, tint = _compute_ratio(matched.reshape(-1, 3)[cells], ground.image.reshape(-1, 3)[cells])
    dark = (ratio < SHADOW_RATIOS[1]) & (tint < SHADOW_TINT)
    shaded.reshape(-1)[cells] = dark & (ratio > ground.shadow - SHADOW_MARGIN)
    if ground.sun.any():
        lit, either = np.zeros_like(shaded), np.zeros_like(shaded)
        lit.reshape(-1)[cells] = ~dark & (strength.reshape(-1)[cells] > UNIT)
        either.reshape(-1)[cells] = dark
        sun = ground.sun / np.hypot(*ground.sun)
        cast = _sweep(lit, sun, SHADOW_REACH_M / ground.resolution)
        ahead = _sweep(lit, -sun, GLASS_REACH_M / ground.resolution)
        # dark between lit parts is glass; dark on one side only is a shadow
        shaded = np.where(either & cast, 1 - ahead, shaded & (1 - (cast & ahead))).astype(np.uint8)
    return strength, shaded
