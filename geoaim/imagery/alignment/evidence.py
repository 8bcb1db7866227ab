"""What tells where imagery lies: an AIM of the same place, or tracks of vehicles."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.aim.aim import AIM
from geoaim.aim.position import read_position_covariance
from geoaim.base.errors import TracksError, warn
from geoaim.imagery.alignment.by_image import align_image
from geoaim.imagery.alignment.by_tracks import align_tracks
from geoaim.imagery.alignment.parts import Labels, Part, align_parts
from geoaim.imagery.alignment.prior import Prior
from geoaim.imagery.alignment.result import ImageryAlignment
from geoaim.imagery.alignment.segmentation import find_parts
from geoaim.imagery.alignment.tracks_parts import align_parts_to_tracks
from geoaim.tracks.tracks import Tracks

# more of the windows must agree with one place; else parts are looked for that have another one
MAX_AGREEING_SHARE = 0.8
WARN_DISPLACED = 0.5  # a warning says that parts are displaced, if they are so more probably


@dataclass(frozen=True, eq=False)
class AimEvidence:
    """An AIM of the same place, to which imagery is aligned."""

    source: AIM
    prior: Prior
    name: str = "aim"

    @property
    def covariance(self) -> Float[Array, "2 2"] | None:
        """Covariance of the AIM's own place, square metres; None where it states none."""
        return read_position_covariance(self.source.report)

    @property
    def bounds(self) -> Float[Array, "2 2"]:
        """Least and greatest x and y of the AIM."""
        return np.stack([self.source.corners.min(axis=0), self.source.corners.max(axis=0)])

    def align(self, imagery: AIM) -> ImageryAlignment:
        """Align imagery by the AIM, as `align_image`."""
        return align_image(imagery, self.source, prior=self.prior)

    def align_parts(
        self, imagery: AIM, labels: Labels | None, whole: ImageryAlignment | None
    ) -> list[Part]:
        """Align files, or else parts of one, that lie elsewhere than the imagery as a whole."""
        max_shift = self.prior.max_shift
        if labels is not None:
            parts = align_parts(imagery, labels, self.align, whole, max_shift)
            if parts:
                return parts
        if whole is not None:
            evidence = whole.evidence
            if evidence["windows_agreeing"] > MAX_AGREEING_SHARE * evidence["windows"]:
                return []
        found = find_parts(imagery, self.source, self.prior)
        return [] if found is None else align_parts(imagery, found, self.align, whole, max_shift)


@dataclass(frozen=True, eq=False)
class TracksEvidence:
    """Tracks of vehicles, under which imagery is moved."""

    source: Tracks
    prior: Prior
    name: str = "tracks"
    covariance = None  # tracks do not state how well their place in the world is known

    @property
    def bounds(self) -> Float[Array, "2 2"]:
        """Least and greatest x and y of the tracks.

        Raises:
            TracksError: no agent is present.
        """
        points = self.source.states[self.source.present][:, :2]
        if not len(points):
            raise TracksError("no agent is present in the tracks at any time; give others, or none")
        return np.stack([points.min(axis=0), points.max(axis=0)])

    def align(self, imagery: AIM) -> ImageryAlignment:
        """Align imagery by the tracks, as `align_tracks`."""
        return align_tracks(imagery, self.source, prior=self.prior)

    def align_parts(
        self, imagery: AIM, labels: Labels | None, whole: ImageryAlignment | None
    ) -> list[Part]:
        """Align files each for itself, or widen what is stated, as the tracks support it."""
        if whole is None:
            return []
        places = align_parts_to_tracks(imagery, labels, self.source, whole, self.prior)
        if len(places.parts) == 1 and places.displaced > WARN_DISPLACED:
            warn(
                f"with a probability of {places.displaced:.0%} parts of the imagery are displaced "
                "against each other, as in a mosaic, and the tracks do not tell how far: the "
                "stated uncertainty is that of such parts. An AIM (--aim) places each for itself"
            )
        return places.parts


Evidence = AimEvidence | TracksEvidence


def list_evidence(aim: AIM | None, tracks: Tracks | None, prior: Prior) -> list[Evidence]:
    """List what is given, the strongest first."""
    evidence: list[Evidence] = []
    if aim is not None:
        evidence.append(AimEvidence(aim, prior))
    if tracks is not None:
        evidence.append(TracksEvidence(tracks, prior))
    return evidence
