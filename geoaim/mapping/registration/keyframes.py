"""Keyframes: frames that others are laid on, and how one frame is laid on them.

A frame is looked for where the last one was, by the patches of a keyframe at full size. Only
when a check fails, coarse patches widen the search, and only when they fail, ORB features.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from geoaim.geometry import transform_points
from geoaim.mapping.registration.features import Features, detect, match
from geoaim.mapping.registration.motion_models import Model
from geoaim.mapping.registration.patches import (
    SIDE,
    Alignment,
    Template,
    align,
    corner_uncertainty,
    make_template,
    reduce,
)
from geoaim.mapping.video.detections import Detections, mask_boxes
from geoaim.mapping.video.frames import Frame

COARSE_WIDTH = 480  # px of the level that widens the search
LEAST_PATCHES = 16  # in agreement, of about 300
LEAST_SHARE = 0.2  # of the patches in view, below which a frame is refused
SURE_SHARE = 0.5  # above which no wider search is tried
LARGEST_UNCERTAINTY = 1.0  # px at the corners
OVERLAP = 0.55  # share of a keyframe's patches in view below which another is made


@dataclass(frozen=True, eq=False)
class FrameRegistration:
    """One frame on the reference.

    Attributes:
        matrix: (3, 3) reference_from_frame in pixels; NaN when invalid.
        reason: why it is invalid; empty when it is valid.
        quality: median correlation of the patches with the frame, 0 to 1.
        inlier_share: patches in agreement, of those in view.
        uncertainty: standard deviation of the image corners' places, pixels.
    """

    matrix: Float[Array, "3 3"]
    reason: str
    quality: float
    inlier_share: float
    uncertainty: float

    @property
    def valid(self) -> bool:
        """Whether the frame can be trusted."""
        return not self.reason


@dataclass(frozen=True, eq=False)
class Keyframe:
    """A frame that others are laid on: itself, or the reference."""

    coarse: Template
    fine: Template
    features: Features
    reference_from_keyframe: Float[Array, "3 3"]
    uncertainty: float


def place(
    grey: UInt8[Array, "H W"],
    keyframes: list[Keyframe],
    keyframe: Keyframe,
    prior: Float[Array, "3 3"],
    model: Model,
) -> tuple[FrameRegistration, Alignment | None]:
    """Search near the prior, then wider, then everywhere; the first that can be trusted."""
    best: tuple[FrameRegistration, Alignment | None] = (_refusal("no patch in view"), None)

    def attempt(home: Keyframe, start: Float[Array, "3 3"], *, coarse: bool) -> bool:
        """Keep the better of this and the best so far; whether to look no further."""
        nonlocal best
        if coarse:
            small = reduce(grey, round(1 / home.coarse.scale))
            rough = align(home.coarse, small, start, model, iterations=10)
            if rough is None:
                return False
            start = rough.matrix
        alignment = align(home.fine, grey, start, model)
        placement = _judge(home, alignment, model)
        if (placement.valid, placement.inlier_share) >= (best[0].valid, best[0].inlier_share):
            best = placement, alignment
        return placement.valid and placement.inlier_share > SURE_SHARE

    near = np.linalg.inv(keyframe.reference_from_keyframe) @ prior
    if attempt(keyframe, near, coarse=False) or attempt(keyframe, near, coarse=True):
        return best
    found = detect(grey)
    for home in dict.fromkeys([keyframe, *keyframes]):
        start = match(home.features, found, model, size=grey.shape)
        if start is not None and attempt(home, start, coarse=True):
            return best
    return best


def _judge(keyframe: Keyframe, alignment: Alignment | None, model: Model) -> FrameRegistration:
    """Whether an alignment can be trusted, and where it lays the frame."""
    if alignment is None:
        return _refusal("no overlap with the reference, or nothing in common")
    seen, agreeing = int(alignment.seen.sum()), int(alignment.agree.sum())
    share = agreeing / max(seen, 1)
    quality = float(np.median(alignment.correlation[alignment.seen]))
    uncertainty = corner_uncertainty(keyframe.fine, alignment.motion)
    total = float(np.hypot(uncertainty, keyframe.uncertainty))
    reason = ""
    if seen < LEAST_PATCHES:
        reason = f"too little overlap: {seen} patches in view, {LEAST_PATCHES} needed"
    elif agreeing < LEAST_PATCHES or share < LEAST_SHARE:
        reason = f"too few inliers: {agreeing} of {seen} patches agree"
    elif not alignment.converged:
        reason = "the alignment did not settle"
    elif not uncertainty <= LARGEST_UNCERTAINTY:
        reason = f"badly spread inliers: corners uncertain by {uncertainty:.1f} px"
    matrix = keyframe.reference_from_keyframe @ alignment.matrix
    matrix = np.full((3, 3), np.nan) if reason else matrix / matrix[2, 2]
    return FrameRegistration(matrix, reason, quality, share, total)


def _refusal(reason: str) -> FrameRegistration:
    return FrameRegistration(np.full((3, 3), np.nan), reason, 0.0, 0.0, np.inf)


def make_keyframe(
    frame: Frame,
    features: Features,
    detections: Detections | None,
    reference_from_keyframe: Float[Array, "3 3"],
    uncertainty: float,
) -> Keyframe:
    """Prepare a frame for others to be laid on it."""
    exclude = excluded(frame, detections)
    height, width = frame.grey.shape
    factor = max(min(round(width / COARSE_WIDTH), height // (4 * SIDE)), 1)
    return Keyframe(
        make_template(frame.grey, factor=factor, exclude=exclude),
        make_template(frame.grey, exclude=exclude),
        features,
        reference_from_keyframe,
        uncertainty,
    )


def keyframe_in_view(
    keyframes: list[Keyframe], prior: Float[Array, "3 3"], shape: tuple[int, int]
) -> Keyframe:
    """The earliest keyframe of which enough is in view from the prior, else the best of all."""
    shares = [share_in_view(keyframe, prior, shape) for keyframe in keyframes]
    enough = [
        keyframe for keyframe, share in zip(keyframes, shares, strict=True) if share > OVERLAP
    ]
    return enough[0] if enough else keyframes[int(np.argmax(shares))]


def share_in_view(
    keyframe: Keyframe, reference_from_frame: Float[Array, "3 3"], shape: tuple[int, int]
) -> float:
    """Share of a keyframe's patches that lie inside a frame."""
    frame_from_keyframe = np.linalg.inv(reference_from_frame) @ keyframe.reference_from_keyframe
    points = transform_points(frame_from_keyframe, keyframe.fine.points)
    return float(((points > 0) & (points < np.array(shape[::-1]))).all(1).mean())


def excluded(frame: Frame, detections: Detections | None) -> Bool[Array, "H W"] | None:
    """Pixels of a frame that its detections say are vehicles."""
    found = detections(frame) if detections else None
    return None if found is None else mask_boxes(found, frame.grey.shape)
