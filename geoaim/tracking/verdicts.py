"""How far the map of a video, its scale and its tracks can be used, by what is known of them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from geoaim.aim.aim import AIM
from geoaim.tracking.association import MAX_GAP_S
from geoaim.tracking.box_checks import find_askew
from geoaim.tracking.find_vehicles import MAX_POSE_SIGMA_M
from geoaim.tracking.noise import SLOW_DT
from geoaim.tracking.pipeline import MAX_UNUSED
from geoaim.tracking.scale import PEOPLE, measure_scale_error
from geoaim.tracks.tracks import Tracks

# share of tracks that the network expects to be right: 0.90 to 0.97 on videos of four places with
# vehicles, at 0.05 m a pixel; 0.76 at 0.4 m, where hedges and shadows are among them; 0.74 to 0.81
# of people alone, of empty ground, and by night
MIN_CERTAINTY = 0.85

Grade = Literal["good", "doubtful", "unusable"]


@dataclass(frozen=True)
class Verdict:
    """How far a part of a result can be used.

    Attributes:
        grade: good; doubtful: look before you use it; unusable: it is not what it should be.
        by: what tells it.
    """

    grade: Grade
    by: tuple[str, ...]

    def __str__(self) -> str:
        """The grade, and what tells it."""
        return f"{self.grade}: {'; '.join(self.by)}"


def measure_registration(aim: AIM) -> float | None:
    """Measure how surely frames lie on the map, metres (1 sigma); None: the report does not say."""
    registration = aim.report.get("registration")
    if registration is None:
        return None
    return float(registration["uncertainty_px"] * aim.resolution)


def measure_observed(tracks: Tracks) -> float:
    """Measure the share of the states that are known from the past alone."""
    observed = tracks.get_rows("observed")
    return 1.0 if observed is None else float(np.isfinite(observed).all(axis=1).mean())


def judge_map(aim: AIM, warnings: Sequence[str]) -> Verdict:
    """Judge a map by how its frames lie on each other, and by what the build warned of."""
    sigma = measure_registration(aim)
    if sigma is not None and sigma > MAX_POSE_SIGMA_M:
        text = f"its frames lie on each other to {sigma:.2g} m only, up to {MAX_POSE_SIGMA_M} m"
        return Verdict("unusable", (f"{text} what stands is told from what moves", *warnings))
    by = "no warning" if sigma is None else f"frames lie on each other to {sigma:.2g} m (1 sigma)"
    return Verdict("doubtful", tuple(warnings)) if warnings else Verdict("good", (by,))


def judge_scale(aim: AIM, tracks: Tracks | None) -> Verdict:
    """Judge a map's scale by what it comes from, and by the sizes of what was tracked on it."""
    error = None if tracks is None else measure_scale_error(tracks, aim)
    if error is not None:
        return Verdict("unusable", (f"most tracks are {1 / error:.2g} times as large as cars",))
    georeference = aim.report.get("georeference", {})
    if by_vehicles := georeference.get("scale_by_vehicles"):
        if tracks is not None and (text := find_askew(tracks)):
            return Verdict("unusable", (f"{text}: {PEOPLE}",))
        number, sigma = by_vehicles["vehicles"], by_vehicles["sigma"]
        return Verdict("doubtful", (f"it is that of {number} vehicles, to {sigma:.0%} (1 sigma)",))
    if georeference.get("given_scale"):
        return Verdict("good", ("it is given; nothing in the frames checks it",))
    if georeference.get("approximate", False):
        return Verdict("doubtful", ("it is that of the telemetry",))
    return Verdict("good", ("it is that of control points or imagery",))


def judge_tracks(
    interval: float, unused: float, certainty: float | None, warnings: Sequence[str]
) -> Verdict:
    """Judge tracks by the seconds between frames, the share of unused boxes, and warnings.

    `certainty` is the share of tracks that are expected to be right; None: boxes were given.
    """
    text = f"frames are {interval:.2g} s apart"
    if interval > MAX_GAP_S and certainty is not None:
        lost = f"what is not seen for {MAX_GAP_S} s is lost, so that tracks join what is not one"
        return Verdict("unusable", (f"{text}: {lost}", *warnings))
    doubts = list(warnings)
    if interval > SLOW_DT:
        doubts.append(f"{text}: agents that turn or brake between them may be mistaken")
    if unused > MAX_UNUSED:
        doubts.append(f"{unused:.0%} of the boxes are in no track")
    by = f"{1 - unused:.0%} of the boxes are in tracks"
    if certainty is not None:
        by = f"{certainty:.0%} of the tracks are expected to be of vehicles"
        if certainty < MIN_CERTAINTY:
            doubts.append(f"only {by}: the network is unsure in this light, at this scale")
    return Verdict("doubtful", tuple(doubts)) if doubts else Verdict("good", (by,))
