"""Boxes and tracks that cannot be: doubled boxes, sizes on the map, and speeds."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Int
from numpy import ndarray as Array

from geoaim.base.errors import TracksError, warn
from geoaim.mapping.box_evidence import MIN_BOXES
from geoaim.mapping.video.detections import DetectedBoxes
from geoaim.tracking.association import MAX_GAP_S
from geoaim.tracking.ground_detections import GroundDetections
from geoaim.tracks.agent_types import TYPICAL_SIZES, select_group
from geoaim.tracks.formats.plausibility import check_plausibility
from geoaim.tracks.tracks import Tracks

MAX_IOU = 0.6  # of the boxes of two agents; those that overlap more are of one
MAX_CONTAINED = 0.9  # share of a box in another one of its class: a part of it, cut by a slice
# of the middles of an agent's boxes, in their sides and in pixels: the noise of small boxes decides
# how they overlap, but larger ones that are further apart are neighbours
MAX_OFFSET, MAX_OFFSET_PX = 0.5, 8.0
MIN_PART = 0.25  # of the area of the other one; a smaller one may be an agent beside it
USUAL_TYPES = ("car", "cyclist", "motorcycle")  # of alike sizes; by other names of classes, cars
USUAL_SIZES = (0.7, 1.8)  # of the square root of boxes' areas, over what is typical of their type
POSSIBLE_SIZES = (0.35, 3.5)  # beyond which boxes are refused
MIN_REFUSED = 0.1  # share of the boxes; those of a rarer type may be false ones
EXTENTS_M = (0.15, 30.0)  # of agents of unknown type
MAX_CHECKED = 3000  # frames whose states are checked
MIN_AGENTS = 3  # that tell a wrong scale, or are odd
# length over width of what can be a vehicle: an articulated bus has 7.2
MAX_SLENDER = 8.0
# share of vehicles that move that lie across their paths or askew: 0 to 0.04 of 16 videos of
# vehicles without boxes, 12 with real ones, at most 0.02 of hard boxes; 0.79 to 1 of four of
# people who had been taken for cars, 0.18 to 0.33 of four of turned boxes read as upright ones
MAX_ASKEW = 0.1
# share of agents that stand and come or go: 0 to 0.27 of 14 videos without boxes, 12 of them with
# real cars, at most 0.07 of hard boxes but for 0.49 where false ones stay for 0.6 s; 0.93 and 0.99
# of two shows of stills
MAX_APPEARING = 0.5
HELP = (
    "are the boxes of pictures of another size (--size), of another form (--form), of other "
    "frames (--rate), are classes named otherwise (--classes), or is the map's scale wrong?"
)


def drop_doubled_boxes(
    frames: Sequence[DetectedBoxes | None],
) -> tuple[list[DetectedBoxes | None], int, int]:
    """Drop boxes that lie on another one of any class, and those that are a part of one.

    Of two, that with the greater score stays; without scores the larger one. Gives the others of
    each frame, how many were doubled, and how many had no area or values missing.
    """
    cleaned: list[DetectedBoxes | None] = []
    doubled = empty = 0
    for boxes in frames:
        if boxes is None or not len(boxes.boxes):
            cleaned.append(boxes)
            continue
        ends = np.asarray(boxes.boxes, np.float64)
        sides = ends[:, 2:] - ends[:, :2]
        usable = np.isfinite(ends).all(axis=1) & ((sides > 0).all(axis=1) | ~sides.any())
        kept = np.flatnonzero(usable)
        kept = kept[_find_single(boxes, kept)]
        empty += int((~usable).sum())
        doubled += int(usable.sum()) - len(kept)
        cleaned.append(boxes if len(kept) == len(ends) else _select(boxes, kept))
    return cleaned, doubled, empty


def _select(boxes: DetectedBoxes, kept: Int[Array, " n"]) -> DetectedBoxes:
    return DetectedBoxes(
        boxes.boxes[kept],
        None if boxes.corners is None else boxes.corners[kept],
        None if boxes.scores is None else boxes.scores[kept],
        tuple(boxes.types[row] for row in kept) if boxes.types else (),
        None if boxes.at_border is None else boxes.at_border[kept],
    )


def _find_single(boxes: DetectedBoxes, rows: Int[Array, " n"]) -> Int[Array, " m"]:
    """Find which of these boxes lie on no better one."""
    ends = np.asarray(boxes.boxes, np.float64)[rows]
    low = np.maximum(ends[:, None, :2], ends[None, :, :2])
    shared = (np.minimum(ends[:, None, 2:], ends[None, :, 2:]) - low).clip(0).prod(axis=2)
    np.fill_diagonal(shared, 0)
    if not shared.any():
        return np.arange(len(rows))
    area = (ends[:, 2:] - ends[:, :2]).prod(axis=1)
    types = boxes.get_types()[rows]
    least = np.minimum(area[:, None], area)
    alike = least > MIN_PART * np.maximum(area[:, None], area)
    part = (shared > MAX_CONTAINED * least) & alike
    part &= types[:, None] == types[None, :]
    middle, sides = (ends[:, :2] + ends[:, 2:]) / 2, ends[:, 2:] - ends[:, :2]
    offset = np.abs(middle[:, None] - middle[None])
    reach = np.minimum(MAX_OFFSET * np.minimum(sides[:, None], sides[None]), MAX_OFFSET_PX)
    close = (offset < reach).all(axis=2) & alike
    over = (shared > MAX_IOU * (area[:, None] + area - shared)) | part | close
    np.fill_diagonal(over, False)
    if not over.any():
        return np.arange(len(rows))
    scores = np.nan_to_num(boxes.get_scores()[rows])
    kept: list[int] = []
    for row in np.lexsort((-area, -scores)).tolist():
        if not over[row, kept].any():
            kept.append(row)
    return np.sort(np.array(kept, int))


def check_sizes(detections: GroundDetections) -> None:
    """Check sizes of boxes on the map by their types.

    Raises:
        TracksError: they cannot be sizes of such agents.
    """
    whole = ~detections.cut.any(axis=(1, 2)) & (detections.extent.min(axis=1) > 0)
    for kind in np.unique(detections.types[whole].astype(str)).tolist():
        extent = detections.extent[whole & (detections.types == kind)]
        if len(extent) < MIN_BOXES:
            continue
        middle = np.median(extent, axis=0)
        text = f"boxes of {kind or 'agents'} are {middle[0]:.2g} x {middle[1]:.2g} m on the map"
        if kind in TYPICAL_SIZES:
            usual = float(np.sqrt(np.prod(TYPICAL_SIZES[kind])))
            ratio = float(np.median(np.sqrt(extent.prod(axis=1)))) / usual
            if not POSSIBLE_SIZES[0] < ratio < POSSIBLE_SIZES[1]:
                if len(extent) > MIN_REFUSED * whole.sum():
                    raise TracksError(f"{text}, which cannot be: {HELP}")
                warn(f"{text}, which cannot be; they are few, and may be false or of another type")
            elif not USUAL_SIZES[0] < ratio < USUAL_SIZES[1] and kind in USUAL_TYPES:
                warn(f"{text}, which is unusual: {HELP}")
        elif not EXTENTS_M[0] < middle.max() < EXTENTS_M[1]:
            raise TracksError(f"{text}, which cannot be: {HELP}")


def check_tracks(tracks: Tracks) -> None:
    """Check speeds, accelerations and sizes of tracks, as those of files are checked.

    Raises:
        TracksError: nearly all are implausible.
    """
    count = min(len(tracks.times), MAX_CHECKED)
    present = tracks.present[:, :count]
    agents = np.flatnonzero(present.any(axis=1))
    first = np.nonzero(tracks.present)[1] < count
    part = Tracks.from_rows(
        present[agents],
        {"states": tracks.get_rows("states")[first]},
        times=tracks.times[:count],
        # longer side first: what stands askew in upright boxes is no slip of whoever made them
        sizes=np.sort(tracks.sizes[agents], axis=1)[:, ::-1],
        types=tuple(tracks.types[agent] for agent in agents),
        ids=tuple(tracks.ids[agent] for agent in agents),
        world=tracks.world,
    )
    try:
        check_plausibility("the tracks", part)
    except TracksError as error:
        raise TracksError(f"{error}; {HELP}") from error


def find_askew(tracks: Tracks) -> str:
    """Find whether many vehicles that move can be none: they lie across their paths, or askew.

    Vehicles move along their longer side. Sizes are fitted to boxes by the direction of motion, so
    that what moves across is wider than long, and what moves askew has no width. So do people who
    are taken for cars, as which they look at some scale, where they walk as fast as cars drive
    (1.3 m/s becomes 7 m/s), and boxes that are turned and were taken for upright ones. Says how
    many; "" where all but a few can be vehicles.
    """
    moved = _find_movers(tracks) & select_group(tracks.types, "vehicle")
    slender = tracks.sizes[moved, 0] / tracks.sizes[moved, 1]
    odd, count = int(((slender < 1) | (slender > MAX_SLENDER)).sum()), int(moved.sum())
    if odd < MIN_AGENTS or odd <= MAX_ASKEW * count:
        return ""
    return f"{odd} of {count} vehicles that move lie across their paths or askew, as none does"


def check_standing(tracks: Tracks) -> None:
    """Warn where most agents stand all the time that they are there, but are not there always.

    What stands neither comes nor goes: cuts, a show of stills, or false boxes do.
    """
    present, times = tracks.present, tracks.times
    late = times[present.argmax(axis=1)] > times[0] + MAX_GAP_S
    early = times[len(times) - 1 - present[:, ::-1].argmax(axis=1)] < times[-1] - MAX_GAP_S
    odd, count = int(((late | early) & ~_find_movers(tracks)).sum()), len(present)
    if odd >= MIN_AGENTS and odd > MAX_APPEARING * count:
        warn(
            f"{odd} of {count} agents stand, and come or go nevertheless: has the video cuts, is "
            "it a show of stills, or are boxes false?"
        )


def _find_movers(tracks: Tracks) -> Bool[Array, " N"]:
    """Find which agents moved on by more than their size."""
    places, stop = tracks.get_rows("states")[:, :2], np.cumsum(tracks.present.sum(axis=1))
    way = places[stop - 1] - places[np.concatenate([[0], stop[:-1]])]
    return np.asarray(np.hypot(*way.T) > tracks.sizes.max(axis=1))
