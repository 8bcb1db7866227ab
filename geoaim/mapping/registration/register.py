"""Registration: where each frame lies on the reference, or why that cannot be said.

Frames are laid on one reference, each starting from the last, so there is no drift. Another
keyframe is made where the view leaves it, and its uncertainty is passed on to the frames that
are laid on it.
"""

import os
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from geoaim.errors import RegistrationError
from geoaim.files import atomic_write
from geoaim.geometry import image_corners, transform_points
from geoaim.mapping.registration.features import Features, detect, match
from geoaim.mapping.registration.keyframes import (
    LEAST_PATCHES,
    OVERLAP,
    FrameRegistration,
    Keyframe,
    excluded,
    keyframe_in_view,
    make_keyframe,
    place,
    share_in_view,
)
from geoaim.mapping.registration.motion_models import Match, Model, ModelChoice, choose_model
from geoaim.mapping.video.detections import Detections, read_detections
from geoaim.mapping.video.frames import Frame
from geoaim.mapping.video.video import Video, VideoSource, open_video
from geoaim.progress import Progress, no_progress

PROBES = 5  # frames that choose the reference and the model


@dataclass(frozen=True, eq=False)
class Reference:
    """The frame that all others are laid on, and the motion model that they need."""

    keyframe: Keyframe
    index: int
    time: float
    model: Model
    choice: ModelChoice | None
    height: int
    width: int


@dataclass(frozen=True, eq=False)
class Registration:
    """Where each frame lies on the reference.

    Attributes:
        reference_from_frame: (T, 3, 3) pixels to pixels; NaN where `valid` is False.
        index: (T,) number of each frame in the video.
        time: (T,) seconds.
        reason: why a frame is invalid, else empty.
        quality: (T,) median correlation of the patches, 0 to 1.
        inlier_share: (T,) share of the patches in agreement.
        uncertainty: (T,) pixels, one standard deviation at the corners.
        reference: the frame that the others are laid on.
    """

    reference_from_frame: Float[Array, "T 3 3"]
    index: Int[Array, " T"]
    time: Float[Array, " T"]
    reason: tuple[str, ...]
    quality: Float[Array, " T"]
    inlier_share: Float[Array, " T"]
    uncertainty: Float[Array, " T"]
    reference: Reference

    @property
    def valid(self) -> Bool[Array, " T"]:
        """(T,) frames that can be trusted."""
        return np.array([not reason for reason in self.reason], bool)

    def to_frame(self) -> pd.DataFrame:
        """A row a frame; the matrix in nine columns, m00 to m22."""
        table = pd.DataFrame(
            {
                "index": self.index,
                "time": self.time,
                "valid": self.valid,
                "reason": list(self.reason),
                "quality": self.quality,
                "inlier_share": self.inlier_share,
                "uncertainty": self.uncertainty,
            }
        )
        names = [f"m{row}{column}" for row in range(3) for column in range(3)]
        table[names] = self.reference_from_frame.reshape(-1, 9)
        return table


def register(
    video: VideoSource,
    *,
    detections: Detections | str | Path | None = None,
    model: Model | None = None,
    reference_time: float | None = None,
    progress: Progress = no_progress,
) -> Registration:
    """Lay every frame of a video on one reference frame.

    Args:
        video: what `open_video` takes.
        detections: vehicles to leave out: a folder of YOLO text files, or a function of a frame,
            as `read_detections` makes it.
        model: the motion model; chosen by the data when None.
        reference_time: seconds; the reference is chosen by the data when None.
        progress: called with the stage, the frames done and the frames in all (None: unknown).

    Raises:
        RegistrationError: no frame can serve as the reference, or none can be laid on it.
    """
    video = open_video(video)
    detections = read_detections(detections) if isinstance(detections, str | Path) else detections
    reference = choose_reference(video, detections=detections, model=model, time=reference_time)
    rows = []
    for frame, placement in register_frames(video, reference, detections=detections):
        rows.append((frame.index, frame.time, placement))
        progress("register", len(rows), video.frame_count)
    return _refuse_jumps(collect(rows, reference))


def write_registration(registration: Registration, path: str | os.PathLike[str]) -> None:
    """Write `registration.to_frame()` as .csv or .parquet, by the name's ending.

    Raises:
        ValueError: the name ends otherwise.
    """
    path = Path(path)
    if path.suffix.lower() not in (".csv", ".parquet"):
        raise ValueError(f"{path}: the name must end in .csv or .parquet")
    table = registration.to_frame()
    with atomic_write(path) as part:
        if path.suffix.lower() == ".csv":
            table.to_csv(part, index=False)
        else:
            table.to_parquet(part, index=False)


def tally(reasons: Iterable[str]) -> dict[str, int]:
    """How many frames each kind of reason refuses, the commonest first; figures are left out.

    >>> tally(["", "too few inliers: 3 of 90", "too few inliers: 5 of 80"])
    {'too few inliers': 2}
    """
    kinds = Counter(reason.split(":")[0] for reason in reasons if reason)
    return dict(kinds.most_common())


def collect(
    rows: Iterable[tuple[int, float, FrameRegistration]], reference: Reference
) -> Registration:
    """Gather (index, time, placement) of frames into a table.

    Raises:
        RegistrationError: no frame is valid.
    """
    index, time, placements = zip(*rows, strict=True)
    reasons = tuple(placement.reason for placement in placements)
    if all(reasons):
        common = next(iter(tally(reasons)))
        raise RegistrationError(
            f"none of {len(reasons)} frames could be laid on the frame at {reference.time:.2f} s "
            f"(most often: {common}); pass another reference_time, or check that the camera hovers"
        )

    def column(name: str) -> Array:
        return np.array([getattr(placement, name) for placement in placements])

    return Registration(
        column("matrix"),
        np.array(index),
        np.array(time, float),
        reasons,
        column("quality"),
        column("inlier_share"),
        column("uncertainty"),
        reference,
    )


def choose_reference(
    video: Video,
    *,
    detections: Detections | None = None,
    model: Model | None = None,
    time: float | None = None,
) -> Reference:
    """Take the frame on which most of a few sampled frames can be laid, and the least model.

    Where the view moves on, so that no frame sees what all others see, it is the first frame.
    """
    probes = list(video.sample(PROBES))
    if time is not None:
        probes = [*video.frames_at([time]), *probes]
    rivals = probes if time is None else probes[:1]
    found = [detect(probe.grey, exclude=excluded(probe, detections)) for probe in rivals]
    best = _best_connected(found, (video.height, video.width))
    probe = probes[best]
    keyframe = make_keyframe(probe, found[best], detections, np.eye(3), 0.0)
    if len(keyframe.fine.points) < LEAST_PATCHES:
        raise RegistrationError(
            f"the frame at {probe.time:.2f} s has {len(keyframe.fine.points)} patches with enough "
            f"texture, {LEAST_PATCHES} are needed; pass the reference_time of a sharper frame"
        )
    reference = Reference(
        keyframe, probe.index, probe.time, model or "homography", None, video.height, video.width
    )
    return reference if model else _choose_model(reference, probes)


def register_frames(
    frames: Iterable[Frame], reference: Reference, *, detections: Detections | None = None
) -> Iterator[tuple[Frame, FrameRegistration]]:
    """Lay frames on the reference, one after another, each starting from the last."""
    keyframes = [reference.keyframe]
    prior = np.eye(3)
    for frame in frames:
        keyframe = keyframe_in_view(keyframes, prior, frame.grey.shape)
        placement, _ = place(frame.grey, keyframes, keyframe, prior, reference.model)
        yield frame, placement
        if placement.valid:
            prior = placement.matrix
            nearest = keyframe_in_view(keyframes, prior, frame.grey.shape)
            if share_in_view(nearest, prior, frame.grey.shape) < OVERLAP:
                features = detect(frame.grey, exclude=excluded(frame, detections))
                new = make_keyframe(frame, features, detections, prior, placement.uncertainty)
                if len(new.fine.points) >= LEAST_PATCHES:
                    keyframes.append(new)


def _best_connected(found: list[Features], size: tuple[int, int]) -> int:
    """The probe on which most others can be laid; the first when it cannot hold them all."""
    count = len(found)
    links = np.zeros((count, count))
    strongest = [Features(f.points[:800], f.descriptors[:800]) for f in found]
    for one in range(count):
        for other in range(one):
            pair = strongest[one], strongest[other]
            matrix = match(*pair, "homography", size=size)
            links[one, other] = links[other, one] = matrix is not None
    degree = links.sum(0)
    middle = np.argsort(np.abs(np.arange(count) - (count - 1) / 2), kind="stable")
    best = int(middle[np.argmax(degree[middle])])
    return best if degree[best] >= 0.5 * (count - 1) else 0


def _choose_model(reference: Reference, probes: list[Frame]) -> Reference:
    """The least model that the probes need; the homography when no probe can be laid."""
    home, matches = reference.keyframe, []
    for probe in probes:
        if probe.index == reference.index:
            continue
        placement, alignment = place(probe.grey, [home], home, np.eye(3), "homography")
        if placement.valid and alignment is not None:
            points = home.fine.points[alignment.fitted]
            # What was measured: reference point + residual lies where the frame's point lies.
            measured = points + alignment.motion.residuals
            source = transform_points(np.linalg.inv(placement.matrix), points)
            weight = alignment.motion.weights[:, None, None]
            matches.append(Match(source, measured, weight * np.eye(2)))
    if not matches:
        return reference
    choice = choose_model(matches, size=(reference.height, reference.width))
    return replace(reference, model=choice.model, choice=choice)


def _refuse_jumps(registration: Registration) -> Registration:
    """Mark frames invalid that lie apart from both neighbours while these agree.

    The limit follows the sequence's own jitter.
    """
    height, width = registration.reference.height, registration.reference.width
    where = np.flatnonzero(registration.valid)
    if len(where) < 5:
        return registration
    corners = transform_points(
        registration.reference_from_frame[where], image_corners(height, width)
    )
    between = (corners[:-2] + corners[2:]) / 2
    apart = np.abs(corners[1:-1] - between).max((1, 2))
    span = np.abs(corners[2:] - corners[:-2]).max((1, 2))
    limit = max(10 * float(np.median(apart)), 0.01 * width)
    jumps = where[1:-1][(apart > limit) & (apart > 3 * span)]
    reason, matrix = list(registration.reason), registration.reference_from_frame.copy()
    for jump in jumps:
        reason[jump] = "inconsistent with its neighbours in time"
        matrix[jump] = np.nan
    return replace(registration, reason=tuple(reason), reference_from_frame=matrix)
