"""What tells where imagery lies: an AIM of the same place, or tracks of vehicles."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from scipy.special import chdtrc

from geoaim.aim.aim import AIM
from geoaim.aim.position import read_position_covariance
from geoaim.base.errors import TracksError, warn
from geoaim.imagery.alignment.by_image import align_image
from geoaim.imagery.alignment.by_tracks import align_tracks
from geoaim.imagery.alignment.parts import MAX_CHANCE, Labels, try_alignment
from geoaim.imagery.alignment.prior import Prior
from geoaim.imagery.alignment.result import ImageryAlignment
from geoaim.imagery.alignment.segmentation import find_parts
from geoaim.imagery.alignment.weighing import forget_undetermined
from geoaim.tracks.tracks import Tracks

# more of the windows must agree with one place; else parts are looked for that have another one
MAX_AGREEING_SHARE = 0.8


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

    def find_parts(self, imagery: AIM, whole: ImageryAlignment | None) -> Labels | None:
        """Find parts that lie elsewhere than the imagery as a whole; None where it needs none."""
        if whole is not None:
            evidence = whole.evidence
            if evidence["windows_agreeing"] > MAX_AGREEING_SHARE * evidence["windows"]:
                return None
        return find_parts(imagery, self.source, self.prior)


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

    def find_parts(self, imagery: AIM, whole: ImageryAlignment | None) -> Labels | None:
        """Find no parts: tracks only tell where halves of the imagery disagree (`widen`)."""
        return None

    def widen(self, imagery: AIM, whole: ImageryAlignment) -> ImageryAlignment:
        """Add the difference of two halves to the covariance, where chance does not explain it."""
        moved = replace(imagery, world_from_image=whole.true_from_stated @ imagery.world_from_image)
        points = np.nan_to_num(self.source.states[..., :2])
        middle = np.median(points[self.source.present], axis=0)
        covariance = whole.covariance
        for axis, names in ((0, "western and eastern"), (1, "southern and northern")):
            low = points[..., axis] < middle[axis]
            halves = [self._align_half(moved, half) for half in (low, ~low)]
            apart = _compare_halves(halves, whole.evidence["rotation_sigma_degrees"])
            if apart is not None:
                east, north = np.abs(apart)
                warn(
                    f"the {names} half of the tracks place the imagery {east:.1f} m (east) and "
                    f"{north:.1f} m (north) apart, more than chance explains: it may be a mosaic "
                    "whose parts are displaced. Its uncertainty is widened by that; an AIM (--aim) "
                    "would place the parts each for itself"
                )
                covariance = covariance + np.outer(apart, apart)
        return replace(whole, covariance=covariance)

    def _align_half(self, imagery: AIM, half: Bool[Array, "N T"]) -> ImageryAlignment | None:
        """Align imagery, but not turn it, by half of the tracks."""
        present = self.source.present & half
        states = np.where(present[..., None], self.source.states, np.nan)
        tracks = replace(self.source, present=present, states=states, observed=None)
        prior = replace(self.prior, max_rotation=0.0)
        return try_alignment(lambda x: align_tracks(x, tracks, prior=prior), imagery)[0]


Evidence = AimEvidence | TracksEvidence


def list_evidence(aim: AIM | None, tracks: Tracks | None, prior: Prior) -> list[Evidence]:
    """List what is given, the strongest first.

    Args:
        aim: an AIM of the same place, if any.
        tracks: tracks of vehicles in the same world, if any.
        prior: how far off the imagery may be.

    Returns:
        None, one or both.
    """
    evidence: list[Evidence] = []
    if aim is not None:
        evidence.append(AimEvidence(aim, prior))
    if tracks is not None:
        evidence.append(TracksEvidence(tracks, prior))
    return evidence


def _compare_halves(
    halves: Sequence[ImageryAlignment | None], rotation_sigma_degrees: float
) -> Float[Array, "2"] | None:
    """The difference of two shifts, where neither chance nor an unknown rotation explains it."""
    one, other = halves
    if one is None or other is None:
        return None
    apart = one.shift - other.shift
    turned = np.radians(rotation_sigma_degrees) * np.linalg.norm(one.center - other.center)
    covariance = sum(forget_undetermined(half).covariance for half in (one, other))
    squares = float(apart @ np.linalg.inv(covariance + np.eye(2) * turned**2) @ apart)
    return apart if chdtrc(2, squares) < MAX_CHANCE else None
