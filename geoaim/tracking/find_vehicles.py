"""Vehicles without boxes: the network's own, in frames and in what differs from the map."""

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Int, Shaped, UInt8
from numpy import ndarray as Array

from geoaim.aim.aim import AIM
from geoaim.base.errors import TracksError
from geoaim.base.geometry import to_opencv
from geoaim.base.grid import Grid
from geoaim.base.progress import Progress, no_progress, notebook_progress
from geoaim.detection.detect import DOUBTFUL
from geoaim.detection.network import RESOLUTION, Peaks, find_peaks, join_peaks, read_calibration
from geoaim.detection.vehicles import resample
from geoaim.mapping.video.detections import DetectedBoxes
from geoaim.mapping.video.video import Video, VideoSource, open_video
from geoaim.tracking.association import Tracklets
from geoaim.tracking.frame_poses import FramePoses, locate_frames
from geoaim.tracking.ground_detections import GroundDetections, select_detections
from geoaim.tracking.shadows import DARK, DarkBoxes, find_dark_boxes, find_shadows
from geoaim.tracks.formats.shared import MAX_CAR_LENGTH_M

# frames per second that are searched: of videos with real cars as many vehicles are followed as by
# twice as many, and fewer by two thirds of it
RATE = 4.0
LOWEST = -2.0  # log odds; of vehicles of validation videos 98 % (Songdo) and 93 % (Minsk) are above
# log odds of a vehicle in a frame: the network's, less `STILL`, since what is mistaken once is
# mistaken in all frames, more `MOVED` for each e-fold by which the difference from the map exceeds
# `USUAL` times what is typical of the frame. Chosen on videos of two stills of Songdo and of Minsk
# with their real cars
STILL, MOVED, USUAL = 1.0, 3.0, 2.0
EVEN = 110.0  # grey level on which the network is shown what differs; 70 and 160 do as well
MAX_SHARED = 0.1  # of a box that lies in a better one; more is its shadow or a piece of it
MIN_PROBABILITY = 0.3  # of a box that may belong to a track
MIN_CERTAINTY = 0.5  # mean probability of a track; 0 counts for the frames without its box
MAX_POSE_SIGMA_M = 0.45  # a quarter of a car's width; rims of what stands then differ as cars do
MIDDLE_SIGMA_M = 0.2  # of a coordinate of a box's middle, that lasts
# where the inside of a box is compared, in shares of its sides
WITHIN = np.stack(np.meshgrid(np.linspace(-0.4, 0.4, 7), np.linspace(-0.35, 0.35, 4)), -1)
WITHIN = WITHIN.reshape(-1, 2)


def find_vehicles(
    video: VideoSource, aim: AIM, *, progress: Progress = notebook_progress
) -> list[DetectedBoxes | None]:
    """Find the vehicles of a video without boxes: those that move, wait, and are parked.

    A small network finds what looks like a vehicle in four frames a second. Where such a frame
    differs from the map, something came, left or moves, which makes a vehicle of it more probable.
    The network also looks at the difference alone, in which a dark car on dark ground stands out.

    Args:
        video: what `open_video` opens.
        aim: an AIM of the same ground, best one that was built of this video.
        progress: called with the stage, the frames done and the frames in all.

    Returns:
        Turned boxes of each frame, with probabilities, for `track_video`; None for a frame that
        could not be registered or was not searched.

    Raises:
        RegistrationError: the frames cannot be registered to the AIM.
        TracksError: a pixel shows too much ground.
    """
    opened = open_video(video)
    return search_frames(opened, aim, locate_frames(opened, aim, None, progress), progress)


def search_frames(
    video: Video, aim: AIM, poses: FramePoses, progress: Progress = no_progress
) -> list[DetectedBoxes | None]:
    """Search the vehicles of a video whose frames are located; see `find_vehicles`."""
    matrices = dict(zip(poses.registration.index.tolist(), poses.world_from_frame, strict=True))
    chosen = [
        index
        for index in list(matrices)[:: max(1, round(video.rate / RATE))]
        if np.isfinite(matrices[index]).all()
    ]
    size = video.height, video.width
    resolution = Grid(size, matrices[chosen[0]], aim.world).resolution
    _check(poses, resolution)
    ground, wanted = _Ground.of(aim), set(chosen)
    found: dict[int, _Found] = {}
    for frame in video.read_all():
        if frame.index in wanted:
            image = resample(frame.image, resolution)
            shrink = np.array(image.shape[1::-1]) / size[::-1]
            image_from_world = np.diag([*shrink, 1.0]) @ np.linalg.inv(matrices[frame.index])
            change, excess = ground.compare(image, image_from_world)
            seen = find_peaks(image, LOWEST)
            peaks = join_peaks([seen, find_peaks(change, LOWEST)])
            inside = _sample_inside(peaks)
            odds = _weigh(peaks, inside, excess, len(seen.logits))
            peaks, odds = _pick_peaks(peaks, odds)
            is_dark = _find_dark(_sample_inside(peaks), image, change)
            beside = find_dark_boxes(peaks, is_dark, np.linalg.inv(image_from_world))
            found[frame.index] = _Found(peaks, odds, shrink, beside)
            progress("find vehicles", len(found), len(chosen))
    shadows = find_shadows([own.dark for own in found.values()])
    boxes = {
        index: _choose(own, np.delete(np.arange(len(own.odds)), shadow))
        for (index, own), shadow in zip(found.items(), shadows, strict=True)
    }
    return [boxes.get(index) for index in matrices]


def _check(poses: FramePoses, resolution: float) -> None:
    """Check that a frame shows vehicles, and lies on the map more exactly than one is wide."""
    if resolution > DOUBTFUL:
        raise TracksError(
            f"a pixel shows {resolution:.2g} m of ground; vehicles are found without boxes up to "
            f"{DOUBTFUL} m: give boxes (--detections), or check the scale"
        )
    sigma = float(np.median(poses.registration.uncertainty[poses.registration.valid])) * resolution
    if sigma > MAX_POSE_SIGMA_M:
        raise TracksError(
            f"the frames are registered to {sigma:.2g} m only; up to {MAX_POSE_SIGMA_M} m, "
            "vehicles are told from what stands: give boxes (--detections) or hover"
        )


@dataclass(frozen=True, eq=False)
class _Found:
    """What may be vehicles in a frame."""

    peaks: Peaks
    odds: Float[Array, " N"]
    shrink: Float[Array, "2"]  # pixels of the frame to those of the peaks
    dark: DarkBoxes  # those that may be shadows


@dataclass(frozen=True, eq=False)
class _Ground:
    """The map, as fine as the network sees."""

    image: UInt8[Array, "h w 3"]
    covered: UInt8[Array, "h w"]
    world_from_image: Float[Array, "3 3"]

    @classmethod
    def of(cls, aim: AIM) -> "_Ground":
        image = resample(aim.image, aim.resolution)
        size = image.shape[1::-1]
        covered = (aim.coverage > 0).view(np.uint8)
        grow = np.array(aim.image.shape[1::-1]) / size
        return cls(
            image,
            np.asarray(cv2.resize(covered, size, interpolation=cv2.INTER_NEAREST), np.uint8),
            aim.world_from_image @ np.diag([*grow, 1.0]),
        )

    def compare(
        self, frame: UInt8[Array, "H W 3"], frame_from_world: Float[Array, "3 3"]
    ) -> tuple[UInt8[Array, "H W 3"], Float32[Array, "H W"]]:
        """Compare a frame with the map.

        Returns:
            The difference on an even ground, and its size over what is typical; 0 where unknown.
        """
        matrix, size = to_opencv(frame_from_world @ self.world_from_image), frame.shape[1::-1]
        view = cv2.warpPerspective(self.image, matrix, size, flags=cv2.INTER_LINEAR)
        known = cv2.warpPerspective(self.covered, matrix, size, flags=cv2.INTER_NEAREST) > 0
        change = cv2.subtract(frame, view, dtype=cv2.CV_16S)
        seen = known[::4, ::4]  # which medians need no more than
        usual = np.median(change[::4, ::4][seen], axis=0) if seen.any() else np.zeros(3)
        even = (change + (EVEN - usual).astype(np.int16)).clip(0, 255).astype(np.uint8)
        even[~known] = EVEN
        parts = cv2.split(cv2.LUT(even, np.abs(np.arange(256) - EVEN).astype(np.uint8)))
        largest = cv2.max(cv2.max(parts[0], parts[1]), parts[2])
        typical = 1 + (float(np.median(largest[::4, ::4][seen])) if seen.any() else 0.0)
        return even, known * (1 + largest.astype(np.float32)) / typical


def _pick_peaks(peaks: Peaks, odds: Float[Array, " N"]) -> tuple[Peaks, Float[Array, " n"]]:
    """Pick the probable peaks, with their log odds."""
    likely = np.flatnonzero(odds > np.log(MIN_PROBABILITY / (1 - MIN_PROBABILITY)))
    return peaks.pick(likely), odds[likely]


def _find_dark(
    inside: Float[Array, "N n 2"], image: UInt8[Array, "H W 3"], change: UInt8[Array, "H W 3"]
) -> Bool[Array, " N"]:
    """Find which boxes are dark beside the map, by points inside them."""
    grey, differs = (_read_inside(part, inside).mean(axis=2) for part in (image, change))
    return np.asarray(np.median(grey - DARK * (grey - differs + EVEN), axis=1) < 0)


def _weigh(
    peaks: Peaks, inside: Float[Array, "N n 2"], excess: Float32[Array, "H W"], in_frame: int
) -> Float[Array, " N"]:
    """Weigh peaks, the first of which are of the frame itself, and say their log odds."""
    moved = np.log(np.maximum(_read_inside(excess, inside).mean(axis=1) / USUAL, 1))
    slope, offset = read_calibration()
    prior = np.where(np.arange(len(moved)) < in_frame, MOVED * moved - STILL, 0.0)
    return np.asarray(slope * peaks.logits + offset + prior)


def _sample_inside(peaks: Peaks) -> Float[Array, "N n 2"]:
    """Sample points inside boxes."""
    corners = peaks.get_corners()
    along, across = (corners[:, k, None] - corners[:, 0, None] for k in (1, 3))
    return peaks.centres[:, None] + WITHIN[:, :1] * along + WITHIN[:, 1:] * across


def _read_inside(picture: Shaped[Array, "H W *c"], inside: Float[Array, "N n 2"]) -> Any:
    """Read the pixels of a picture at points."""
    last = np.array(picture.shape[1::-1]) - 1
    columns, rows = np.moveaxis(inside.clip(0, last).astype(int), 2, 0)
    return picture[rows, columns]


def _choose(found: _Found, rows: Int[Array, " n"]) -> DetectedBoxes:
    """Choose the best boxes of each place among some, in pixels of the frame."""
    peaks, odds = found.peaks.pick(rows), found.odds[rows]
    corners = peaks.get_corners()
    kept = _find_single(corners, _sample_inside(peaks), odds)
    is_long = peaks.lengths[kept] * RESOLUTION > MAX_CAR_LENGTH_M
    bounds = np.concatenate([corners.min(axis=1), corners.max(axis=1)], axis=1)
    return DetectedBoxes(
        bounds[kept] / np.tile(found.shrink, 2),
        corners[kept] / found.shrink,
        1 / (1 + np.exp(-odds[kept])),
        tuple(np.where(is_long, "truck", "car").tolist()),
    )


def _find_single(
    corners: Float[Array, "N 4 2"], inside: Float[Array, "N n 2"], odds: Float[Array, " N"]
) -> Int[Array, " M"]:
    """Find which boxes lie on no better one, by points inside them."""
    sides = corners[:, [1, 3]] - corners[:, :1]
    single: list[int] = []
    for row in np.argsort(-odds).tolist():
        offsets = inside[row] - corners[single, :1]
        shares = offsets @ sides[single].swapaxes(1, 2) / (sides[single] ** 2).sum(2)[:, None]
        within = ((shares > 0) & (shares < 1)).all(axis=2).mean(axis=1)
        if within.max(initial=0) <= MAX_SHARED:
            single.append(row)
    return np.sort(np.array(single, int))


def keep_certain(
    detections: GroundDetections, tracklets: Tracklets
) -> tuple[GroundDetections, Tracklets]:
    """Keep tracks that are more probably right than wrong, and say how far off boxes may lie.

    Args:
        detections: of `find_vehicles`, each with a probability.
        tracklets: their tracks.

    Returns:
        Their detections, with lasting errors, and the tracks.

    Raises:
        TracksError: none is.
    """
    certain = measure_certainty(detections, tracklets) > MIN_CERTAINTY
    if not certain.any():
        raise TracksError(
            f"{len(certain)} things are followed that may be vehicles, none of them more probably "
            "than not; give boxes (--detections), or check the scale"
        )
    member = np.flatnonzero(tracklets.track >= 0)
    rows = member[certain[tracklets.track[member]]]
    number = np.cumsum(certain) - 1
    chosen = select_detections(detections, rows)
    return replace(chosen, roof_sigma=chosen.roof_sigma + MIDDLE_SIGMA_M), Tracklets(
        number[tracklets.track[rows]], tracklets.confirmed[certain], tracklets.sigma[rows]
    )


def measure_certainty(detections: GroundDetections, tracklets: Tracklets) -> Float[Array, " N"]:
    """Measure the mean probability of each track; 0 counts for the frames without its box."""
    count, member = len(tracklets.confirmed), tracklets.track >= 0
    track, step = tracklets.track[member], detections.step[member]
    first, last, total = np.full(count, step.max(initial=0)), np.zeros(count, int), np.zeros(count)
    np.minimum.at(first, track, step)
    np.maximum.at(last, track, step)
    np.add.at(total, track, detections.score[member])
    return np.asarray(total / (last - first + 1))
