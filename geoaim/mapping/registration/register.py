"""Registration: the transform of each frame to one reference frame, or why there is none.

All frames are registered to the same reference, each search starting from the frame before, so that
errors do not accumulate. Where the view leaves the reference another keyframe is made; its
uncertainty is added to that of the frames that are registered to it. `frame_registration.py`
registers a single frame, and decides whether it is rejected.
"""

import os
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from geoaim.base.displays import Display
from geoaim.base.errors import RegistrationError
from geoaim.base.files import atomic_write
from geoaim.base.geometry import image_corners, transform_points
from geoaim.base.progress import Progress, notebook_progress
from geoaim.mapping.registration.features import Features, detect_features, match_features
from geoaim.mapping.registration.frame_registration import (
    MIN_INLIERS,
    MIN_OVERLAP,
    FrameRegistration,
    Keyframe,
    compute_overlap,
    make_keyframe,
    mask_detections,
    register_frame,
    select_keyframe,
)
from geoaim.mapping.registration.hover import find_hovers
from geoaim.mapping.registration.motion_models import Model, ModelChoice, PointMatches, choose_model
from geoaim.mapping.registration.patches import PatchAlignment
from geoaim.mapping.registration.rest import (
    EVIDENCE_FRAMES,
    may_stand,
    register_at_rest,
    stands_still,
)
from geoaim.mapping.registration.sequence import check_ground, find_jumps
from geoaim.mapping.video.detections import Detections, DetectionSource, read_detections
from geoaim.mapping.video.frames import Frame
from geoaim.mapping.video.video import Video, VideoSource, open_video

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes

COMPARE_EVERY = 10  # frames, after which a placement is compared with others again
COMPARE_SHIFT_SHARE = 1 / 240  # shift, in image widths, after which it is compared sooner
PROBE_FRAMES = 5  # number of frames from which the reference and the model are chosen
HOVER_FRAMES = 64  # among which hovers are searched where the probes show other views
PROBE_FEATURES = 800  # features of each probe that are matched between probes
TIME_TOLERANCE_S = 1e-3  # two frames are not nearer
MIN_OF_USUAL = 0.75  # of the median uncertainty of a video's frames, which none states less than
MIN_LINKED_SHARE = 0.5  # of the probes that must match the reference, unless it is the first frame

Row = tuple[int, float, FrameRegistration]  # index, time (s) and registration of a frame


@dataclass(frozen=True, eq=False)
class Reference:
    """The frame to which all others are registered."""

    keyframe: Keyframe  # its image and patches
    index: int  # its number in the video
    time: float  # seconds
    model: Model  # motion model of the registration
    choice: ModelChoice | None  # how the model was chosen; None when it was given
    height: int  # height of the frames, pixels
    width: int  # width of the frames, pixels


@dataclass(frozen=True, eq=False, repr=False)
class Registration(Display):
    """The transform of each frame to the reference."""

    is_map: ClassVar[bool] = False  # it is drawn in pixels of the reference
    reference_from_frame: Float[Array, "T 3 3"]  # transforms in pixels; NaN where `valid` is False
    index: Int[Array, " T"]  # number of each frame in the video
    time: Float[Array, " T"]  # seconds
    reason: tuple[str, ...]  # why each frame is rejected; empty if it is not
    quality: Float[Array, " T"]  # median correlation of the patches with the frame, 0 to 1
    inlier_share: Float[Array, " T"]  # share of inliers among the patches in view
    uncertainty: Float[Array, " T"]  # standard deviation over the image, root mean square, pixels
    reference: Reference  # the frame to which the others are registered

    @property
    def valid(self) -> Bool[Array, " T"]:
        """(T,) whether each registration can be trusted."""
        return np.array([not reason for reason in self.reason], bool)

    def to_dataframe(self) -> "pd.DataFrame":
        """Make a table with a row for each frame, and the matrix in nine columns, m00 to m22."""
        import pandas as pd

        names = ["index", "time", "valid", "reason", "quality", "inlier_share", "uncertainty"]
        table = pd.DataFrame({name: getattr(self, name) for name in names})
        table[[f"m{row}{column}" for row in range(3) for column in range(3)]] = (
            self.reference_from_frame.reshape(-1, 9)
        )
        return table

    def summarize(self) -> dict[str, str]:
        """Summarize the motion model, the reference, the valid frames and their uncertainty."""
        reference, valid = self.reference, self.valid
        lines = {
            "motion model": reference.model,
            "reference": f"frame {reference.index}, {reference.time:.2f} s",
            "registered frames": f"{valid.sum()} of {len(valid)}",
        }
        if valid.any():
            lines["uncertainty"] = f"{np.median(self.uncertainty[valid]):.3f} px (1 sigma, median)"
        return lines | {
            f"rejected: {reason}": str(count)
            for reason, count in count_reasons(self.reason).items()
        }

    def _draw(self, axes: "Axes") -> None:
        from geoaim.base.map_axes import draw_drift

        middle = np.array([[self.reference.width / 2, self.reference.height / 2]])
        moved = transform_points(self.reference_from_frame[self.valid], middle)[:, 0] - middle
        draw_drift(axes, self.time[self.valid], moved, "reference")


def register(
    video: VideoSource,
    *,
    detections: DetectionSource | None = None,
    model: Model | None = None,
    reference_time: float | None = None,
    progress: Progress = notebook_progress,
) -> Registration:
    """Register every frame of a video to one reference frame.

    Args:
        video: what `open_video` opens.
        detections: vehicles to leave out, as `read_detections` reads them.
        model: the motion model; None chooses the simplest that the frames need. "rest" is that of
            a camera that stands still, on a mast or a tripod.
        reference_time: seconds; 0 for the first frame; None chooses the reference by the data.
        progress: called with the stage, the frames done and the frames in all (None: unknown).

    Returns:
        The registration of each frame, in order; rejected frames have a reason.

    Raises:
        VideoError: the video cannot be opened.
        RegistrationError: no frame can serve as the reference, or none can be registered to it.
    """
    video = open_video(video)
    detections = None if detections is None else read_detections(detections, video=video)
    reference = choose_reference(video, detections=detections, model=model, time=reference_time)
    rows = []
    for frame, registration in register_frames(video, reference, detections=detections):
        rows.append((frame.index, frame.time, registration))
        progress("register", len(rows), video.frame_count)
    return _reject_jumps(collect_registration(rows, reference))


def write_registration(registration: Registration, path: str | os.PathLike[str]) -> None:
    """Write `registration.to_dataframe()` as .csv or .parquet; ValueError for another suffix."""
    path = Path(path)
    if path.suffix.lower() not in (".csv", ".parquet"):
        raise ValueError(f"{path}: the name must end in .csv or .parquet")
    table = registration.to_dataframe()
    with atomic_write(path) as part:
        if path.suffix.lower() == ".csv":
            table.to_csv(part, index=False)
        else:
            table.to_parquet(part, index=False)


def count_reasons(reasons: Iterable[str]) -> dict[str, int]:
    """Count the frames rejected for each reason, the commonest first, without figures in reasons.

    >>> count_reasons(["", "too few inliers: 3 of 90", "too few inliers: 5 of 80"])
    {'too few inliers': 2}
    """
    kinds = Counter(reason.split(":")[0] for reason in reasons if reason)
    return dict(kinds.most_common())


def collect_registration(rows: Iterable[Row], reference: Reference) -> Registration:
    """Collect the registrations of one or more single frames."""
    index, time, frames = zip(*rows, strict=True)
    check_ground(frames, (reference.height, reference.width))
    reasons = tuple(frame.reason for frame in frames)
    if all(reasons):
        common = next(iter(count_reasons(reasons)))
        raise RegistrationError(
            f"none of {len(reasons)} frames could be registered to the frame at "
            f"{reference.time:.2f} s (most often: {common}); pass another reference_time, or check "
            "that the camera hovers"
        )
    names = ("reference_from_frame", "quality", "inlier_share")
    uncertainty = np.array([frame.uncertainty for frame in frames])
    usual = float(np.median(uncertainty[[not reason for reason in reasons]]))
    return Registration(
        index=np.array(index),
        time=np.array(time, float),
        reason=reasons,
        # what misleads the others may mislead a frame that does not show it
        uncertainty=np.maximum(uncertainty, MIN_OF_USUAL * usual),
        reference=reference,
        **{name: np.array([getattr(frame, name) for frame in frames]) for name in names},
    )


def choose_reference(
    video: Video,
    *,
    detections: Detections | None = None,
    model: Model | None = None,
    time: float | None = None,
    probes: Sequence[Frame] = (),
    prefer_first: bool = False,
) -> Reference:
    """Choose the reference and the motion model by a few frames spread over the video.

    A camera that stands still is recognised first; any frame then serves. Else the reference is the
    middle one if all others can be registered to it, or the middle of the longest hover of a
    flight, or the one that matches most others, or the first one when none overlaps with others.
    """
    if model == "rest" and time is None:
        time = video.start  # any frame serves
    is_given = time is not None and model is not None
    read = list(probes) or ([] if is_given else list(video.sample(PROBE_FRAMES)))
    probes = _spread(read, PROBE_FRAMES)
    if time is None:
        frame = probes[0 if prefer_first else len(probes) // 2]
    else:
        known = (one for one in read if abs(one.time - time) < TIME_TOLERANCE_S)
        frame = next(known, None) or next(iter(video.frames_at([time])))
    reference = _make_reference(frame, detections, model)
    others = [probe for probe in probes if probe.index != frame.index]
    if model is None and may_stand(others, reference.keyframe):
        evidence = read if len(read) >= EVIDENCE_FRAMES else list(video.sample(EVIDENCE_FRAMES))
        if stands_still(_spread(evidence, EVIDENCE_FRAMES)):
            return replace(reference, model="rest")
    placed = [] if is_given else _register_probes(reference, probes)
    if time is None and not all(result.valid for result, _ in placed):
        many = read if len(read) > PROBE_FRAMES else video.sample(HOVER_FRAMES)
        best, probes = _find_best_frame(video, many, probes, detections)
        reference = _make_reference(best, detections, model)
        placed = _register_probes(reference, probes)
    patches = len(reference.keyframe.fine.points)
    if patches < MIN_INLIERS:
        raise RegistrationError(
            f"the frame at {reference.time:.2f} s has {patches} patches with enough texture, "
            f"{MIN_INLIERS} are needed; pass the reference_time of a sharper frame"
        )
    return reference if model else _choose_model(reference, placed)


def _find_best_frame(
    video: Video, many: Iterable[Frame], probes: list[Frame], detections: Detections | None
) -> tuple[Frame, list[Frame]]:
    """Find the middle of the longest hover, else the probe that matches most; and its probes."""
    if hovers := find_hovers(many):
        start, end = max(hovers, key=np.ptp)
        best = next(iter(video.frames_at([(start + end) / 2])))
        return best, list(video.frames_at(np.linspace(start, end, PROBE_FRAMES)))
    features = [
        detect_features(probe.grey, exclude=mask_detections(probe, detections)) for probe in probes
    ]
    return probes[_choose_best_connected(features, (video.height, video.width))], probes


def _spread(frames: Sequence[Frame], count: int) -> list[Frame]:
    """Take up to a number of frames, spread over all."""
    chosen = np.linspace(0, len(frames) - 1, min(count, len(frames))).round().astype(int)
    return [frames[i] for i in chosen]


def register_frames(
    frames: Iterable[Frame], reference: Reference, *, detections: Detections | None = None
) -> Iterator[tuple[Frame, FrameRegistration]]:
    """Register frames to the reference one after another, each starting from the one before.

    Args:
        frames: frames in order of time.
        reference: the reference, near which the first frame is searched.
        detections: vehicles to leave out.

    Yields:
        Each frame with its registration, or the reason why it is rejected.
    """
    if reference.model == "rest":
        yield from register_at_rest(frames, reference.keyframe)
        return
    keyframes = [reference.keyframe]
    prior = compared = np.eye(3)
    since = COMPARE_EVERY  # frames since a placement was compared with others
    for frame in frames:
        size = frame.grey.shape
        keyframe = select_keyframe(keyframes, prior, size)
        compare = (
            since >= COMPARE_EVERY or _measure_shift(prior, compared, size) > COMPARE_SHIFT_SHARE
        )
        registration, _ = register_frame(
            frame.grey, keyframes, keyframe, prior, reference.model, compare=compare
        )
        yield frame, registration
        since += 1
        if not registration.valid:
            since = COMPARE_EVERY
            continue
        if compare and frame.index != reference.index:
            compared = registration.reference_from_frame
            since = 1
        prior = registration.reference_from_frame
        if compute_overlap(select_keyframe(keyframes, prior, size), prior, size) < MIN_OVERLAP:
            hidden = mask_detections(frame, detections)
            new = make_keyframe(frame.grey, hidden, prior, registration.uncertainty)
            if len(new.fine.points) >= MIN_INLIERS:
                keyframes.append(new)


def _measure_shift(
    one: Float[Array, "3 3"], other: Float[Array, "3 3"], size: tuple[int, int]
) -> float:
    """Largest displacement of a corner between two transforms, as a share of the width."""
    corners = image_corners(*size)
    shift = transform_points(one, corners) - transform_points(other, corners)
    return float(np.abs(shift).max()) / size[1]


def _choose_best_connected(features: list[Features], size: tuple[int, int]) -> int:
    """Index of the probe that matches most others, or 0 when none matches half of them."""
    count = len(features)
    links = np.zeros((count, count))
    strongest = [
        Features(one.points[:PROBE_FEATURES], one.descriptors[:PROBE_FEATURES]) for one in features
    ]
    for one in range(count):
        for other in range(one):
            matrix = match_features(strongest[one], strongest[other], "homography", size=size)
            links[one, other] = links[other, one] = matrix is not None
    degree = links.sum(0)
    from_middle = np.argsort(np.abs(np.arange(count) - (count - 1) / 2), kind="stable")
    best = int(from_middle[np.argmax(degree[from_middle])])
    return best if degree[best] >= MIN_LINKED_SHARE * (count - 1) else 0


def _make_reference(frame: Frame, detections: Detections | None, model: Model | None) -> Reference:
    """Make a frame the reference; a model that is yet to be chosen is the homography."""
    keyframe = make_keyframe(frame.grey, mask_detections(frame, detections), np.eye(3), 0.0)
    size = frame.grey.shape
    return Reference(keyframe, frame.index, frame.time, model or "homography", None, *size)


def _register_probes(
    reference: Reference, probes: list[Frame]
) -> list[tuple[FrameRegistration, PatchAlignment | None]]:
    """Register all other probes, the nearest in time first, each starting from its neighbour."""
    keyframe = reference.keyframe
    placed, priors = [], {reference.time: np.eye(3)}
    for probe in sorted(probes, key=lambda probe: abs(probe.time - reference.time)):
        if probe.index == reference.index:
            continue
        prior = priors[min(priors, key=lambda time: abs(time - probe.time))]
        result = register_frame(probe.grey, [keyframe], keyframe, prior, "homography")
        placed.append(result)
        if result[0].valid:
            priors[probe.time] = result[0].reference_from_frame
    return placed


def _choose_model(
    reference: Reference, placed: list[tuple[FrameRegistration, PatchAlignment | None]]
) -> Reference:
    """Choose the simplest model that the probes need; the homography when none is registered."""
    keyframe, matches = reference.keyframe, []
    for registration, alignment in placed:
        if registration.valid and alignment is not None:
            points = keyframe.fine.points[alignment.fitted]
            # measured: the reference point plus its residual corresponds to the frame's point
            measured = points + alignment.motion.residuals
            source = transform_points(np.linalg.inv(registration.reference_from_frame), points)
            weight = alignment.motion.weights[:, None, None]
            matches.append(PointMatches(source, measured, weight * np.eye(2)))
    if not matches:
        return reference
    choice = choose_model(matches, size=(reference.height, reference.width))
    return replace(reference, model=choice.model, choice=choice)


def _reject_jumps(registration: Registration) -> Registration:
    """Reject frames that lie far from both neighbours while these agree."""
    valid = np.flatnonzero(registration.valid)
    size = registration.reference.height, registration.reference.width
    reason, matrix = list(registration.reason), registration.reference_from_frame.copy()
    for jump in valid[find_jumps(matrix[valid], size)]:
        reason[jump] = "inconsistent with its neighbours in time"
        matrix[jump] = np.nan
    return replace(registration, reason=tuple(reason), reference_from_frame=matrix)
