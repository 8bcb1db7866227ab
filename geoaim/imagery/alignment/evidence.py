"""Placement of a mosaic: where evidence and its own place say it lies, as a whole or in parts."""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.aim.aim import AIM
from geoaim.aim.position import (
    describe_covariance,
    measure_azimuth,
    read_position_covariance,
    state_position,
)
from geoaim.base.errors import AlignmentError, TracksError, warn
from geoaim.base.geometry import transform_points
from geoaim.imagery.alignment.by_image import align_image
from geoaim.imagery.alignment.by_tracks import align_tracks
from geoaim.imagery.alignment.parts import Labels, Part, align_parts, compose_parts, try_alignment
from geoaim.imagery.alignment.result import ImageryAlignment, Prior
from geoaim.imagery.alignment.segmentation import find_parts
from geoaim.imagery.alignment.weighing import forget_undetermined_direction, weigh_alignment
from geoaim.imagery.mosaic import Mosaic
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
        """List no parts: tracks place imagery as a whole."""
        if labels is not None and len(labels.names) > 1 and whole is not None:
            warn(
                f"tracks place the {len(labels.names)} files of the imagery as one; whether they "
                "are displaced against each other only an AIM of the place (--aim) tells"
            )
        return []


Evidence = AimEvidence | TracksEvidence


def list_evidence(aim: AIM | None, tracks: Tracks | None, prior: Prior) -> list[Evidence]:
    """List what is given, the strongest first."""
    evidence: list[Evidence] = []
    if aim is not None:
        evidence.append(AimEvidence(aim, prior))
    if tracks is not None:
        evidence.append(TracksEvidence(tracks, prior))
    return evidence


MAX_PARTS = 16  # a mosaic of more files is taken as one source


class PlacedPart(NamedTuple):
    """A part, how it is moved in the end, and how well its place in the world is then known."""

    part: Part
    moved: ImageryAlignment
    covariance: Float[Array, "2 2"]


def place_mosaic(mosaic: Mosaic, evidence: Evidence) -> AIM:
    """Move a mosaic, or each of its parts, to where evidence and its own place say it lies."""
    parts = align_mosaic(mosaic, evidence)
    placed = [weigh_part(part, evidence, mosaic.aim) for part in parts]
    if len(placed) == 1:
        imagery = apply_alignment(mosaic.aim, placed[0].moved)
    else:
        moved = [part._replace(alignment=alignment) for part, alignment, _ in placed]
        imagery = compose_parts(mosaic.aim, moved)
        _warn_of_parts(parts, evidence.name)
    _warn_of_undetermined(parts[0].alignment, evidence.name)
    report = {name: value for name, value in mosaic.aim.report.items() if name != "place"}
    report["alignment"] = {evidence.name: report_parts(placed)}
    report["position"] = report_position(placed, evidence)
    return replace(imagery, report=report)


def apply_alignment(imagery: AIM, alignment: ImageryAlignment) -> AIM:
    """Move imagery to where an alignment places it; its pixels stay as they are."""
    return replace(imagery, world_from_image=alignment.true_from_stated @ imagery.world_from_image)


def align_mosaic(mosaic: Mosaic, evidence: Evidence) -> list[Part]:
    """Align a mosaic: one part if one place suits all of it, else a place for each part."""
    imagery = mosaic.aim
    whole, error = try_alignment(evidence.align, imagery)
    labels = None
    if mosaic.labels is not None and len(np.unique(mosaic.labels)) <= MAX_PARTS:
        labels = Labels(mosaic.labels, mosaic.names)
    if parts := evidence.align_parts(imagery, labels, whole):
        return parts
    if whole is None:
        raise error or AlignmentError("the imagery cannot be aligned")
    return [Part("all", imagery.coverage > 0, whole)]


def weigh_part(part: Part, evidence: Evidence, imagery: AIM) -> PlacedPart:
    """Weigh the alignment of a part against its own place, where the evidence states its own."""
    alignment, reference = part.alignment, evidence.covariance
    own = read_position_covariance(imagery.report)
    if reference is None and (own is None or not isinstance(evidence, TracksEvidence)):
        return PlacedPart(part, alignment, alignment.covariance)
    if reference is None:
        reference = forget_undetermined_direction(alignment).covariance - alignment.covariance
    if own is None:
        own = np.eye(2) * (evidence.prior.max_shift / 2) ** 2
    return PlacedPart(part, *weigh_alignment(alignment, own, reference))


def _warn_of_parts(parts: list[Part], name: str) -> None:
    """Say that parts of the imagery lie at different places, and which could not be aligned."""
    listed = ", ".join(
        "{} {:+.2f} m east {:+.2f} m north".format(part.name, *part.alignment.shift)
        for part in parts
    )
    message = f"by the {name} the parts of the imagery are displaced each for itself: {listed}"
    if rest := [part.name for part in parts if not part.placed]:
        message += f"; {', '.join(rest)} cannot be aligned, and is as unsure as such parts differ"
    warn(message)


def _warn_of_undetermined(alignment: ImageryAlignment, name: str) -> None:
    direction = alignment.undetermined_direction
    if direction is None:
        return
    azimuth = measure_azimuth(np.array([np.cos(direction), np.sin(direction)]))
    region = describe_covariance(alignment.covariance)
    warn(
        f"along azimuth {azimuth:.0f}° the {name} hardly tell the place, as nothing "
        f"changes along straight roads: the imagery is {region}, "
        "and in this direction it stays where its georeference says; only the stated prior "
        "(--max-shift) limits how far it may be off there"
    )


MAX_RESIDUALS = 400  # windows whose residuals are in the report


def report_alignment(alignment: ImageryAlignment) -> dict[str, Any]:
    """Describe an alignment for the report of an AIM, in metres and degrees."""
    matrix, direction = alignment.true_from_stated, alignment.undetermined_direction
    east = np.array([[0.0, 0.0], [1.0, 0.0]]) + alignment.center
    start, end = transform_points(matrix, east)
    return {
        "model": alignment.model,
        "shift_m": alignment.shift,
        "rotation_degrees": float(np.degrees(np.arctan2(*(end - start)[::-1]))),
        "scale": float(np.linalg.norm(end - start)),
        "uncertainty_m": alignment.uncertainty,
        "covariance_m2": alignment.covariance,
        "undetermined_degrees": None if direction is None else float(np.degrees(direction)),
        "true_from_stated": matrix,
        **alignment.evidence,
    }


def report_position(placed: list[PlacedPart], evidence: Evidence) -> dict[str, Any]:
    """The entry "position" of the report, for the part that is known least."""
    worst = max(placed, key=lambda one: np.trace(one.covariance))
    relative = max((one.part.alignment.covariance for one in placed), key=np.trace)
    entry = state_position(
        evidence.name, worst.covariance, relative_to=evidence.name, relative=relative
    )
    assumed = [] if evidence.covariance is not None else [evidence.name]
    if isinstance(evidence, AimEvidence):
        assumed += evidence.source.report.get("position", {}).get("assumes", [])
    offset = worst.part.alignment.shift - worst.moved.shift
    return entry | {"assumes": assumed, "offset_from_reference_m": offset}


def report_parts(placed: list[PlacedPart]) -> dict[str, Any]:
    """The alignment of the largest part, and of each part where there are several."""
    report = report_alignment(placed[0].part.alignment)
    report["true_from_stated"] = placed[0].moved.true_from_stated
    rows = [(number, one.part.alignment) for number, one in enumerate(placed)]
    windows = [
        np.column_stack([np.full(len(alignment.windows), number), alignment.windows])
        for number, alignment in rows
        if alignment.windows is not None
    ]
    if windows:
        residuals = np.concatenate(windows)
        report["residuals"] = residuals[:: len(residuals) // MAX_RESIDUALS + 1].round(3)
    if len(placed) > 1:
        total = sum(one.part.mask.sum() for one in placed)
        report["parts"] = [
            {
                **report_alignment(one.part.alignment),
                "name": one.part.name,
                "aligned": one.part.placed,
                "share": float(one.part.mask.sum() / total),
                "world_covariance_m2": one.covariance,
                "true_from_stated": one.moved.true_from_stated,
            }
            for one in placed
        ]
    return report
