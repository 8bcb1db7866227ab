"""Check that sizes, speeds, accelerations and headings are plausible for the agents' types."""

import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from geoaim.base.errors import TracksError, warn
from geoaim.base.geometry import wrap_angle
from geoaim.base.world import FOOT_M, describe_crs_problem, describe_misplacement, lonlat_from_world
from geoaim.tracks.formats.motion import derive_motion, derive_speeds, estimate_velocity
from geoaim.tracks.tracks import Tracks

# By type: greatest length and width in metres, and speed in m/s.
LIMITS = {
    "car": (10.0, 4.0, 80.0),
    "van": (12.0, 4.0, 60.0),
    "truck": (40.0, 5.0, 50.0),
    "bus": (40.0, 5.0, 50.0),
    "motorcycle": (5.0, 2.5, 80.0),
    "cyclist": (5.0, 2.5, 30.0),
    "pedestrian": (3.0, 3.0, 15.0),
}
OTHER_LIMITS = (100.0, 20.0, 100.0)
MAX_ACCELERATION = 25.0  # m/s2; brakes and tyres reach 12, noise of positions the rest
LONG_TYPES = ("car", "van", "truck", "bus", "motorcycle", "cyclist")  # longer than wide
HALF_WINDOW_S = 0.25  # half the time over which positions are differenced
MIN_MOVING_SPEED = 1.0  # m/s; slower motion has too noisy a direction
MAX_HEADING_ERROR = np.radians(60.0)
MAX_SPEED_ERROR = (2.0, 0.5)  # m/s, and share of the greater of stated and measured speed
MAX_SPEED_SHARE = 0.2  # by which an agent's speeds may differ from its motion
MOST_TURNED = 0.25  # share of agents that head elsewhere than they move: so many do not reverse
MOST = 0.5  # share of the agents whose columns contradict their motion, so that none are used
NOISE = 0.05  # share of states that may be wrong without a warning
MIN_EXTENT_M = 0.1  # two agents need more room; degrees of a junction span less
NEAR_DEGREES = 1.0  # from the origin, in which one agent that stands is taken to have degrees
NEARLY_ALL = 0.9  # share with which a file is refused
MIRRORED, TURNED = 0.9, 0.7  # resultants of angles: over one and under the other, axes are swapped


@dataclass(frozen=True, eq=False)
class _Check:
    """One property of agents or of their states: where it was checked and where it is wrong."""

    problem: str
    wrong: Bool[Array, "N *T"]
    checked: Bool[Array, "N *T"]
    tolerance: float = 0.0  # share that may be wrong by noise

    @property
    def unit(self) -> str:
        return "agents" if self.wrong.ndim == 1 else "states"


def check_plausibility(path: str | os.PathLike[str], tracks: Tracks) -> None:
    """Warn of implausible sizes, speeds, headings and accelerations; raise if most are.

    Tracks that state uncertainties are estimates of `track_video`, whose units are right: single
    ones of them may be odd, and only nearly all are refused.
    """
    found = []
    for check in (*_check_sizes(tracks), *_check_motion(tracks)):
        share = check.wrong.sum() / max(check.checked.sum(), 1)
        if share <= check.tolerance:
            continue
        agents = check.wrong.reshape(len(tracks.ids), -1).any(axis=1).sum()
        text = f"{agents} of {len(tracks.ids)} agents {check.problem}"
        if share >= NEARLY_ALL:
            raise TracksError(
                f"{Path(path)}: {text}: {100 * share:.0f} % of the {check.unit} that were checked"
            )
        found.append(text)
    if found and tracks.uncertainty is None:
        warn(f"{Path(path)}: {'; '.join(found)}. They are kept as they are")


def check_place(path: str | os.PathLike[str], tracks: Tracks) -> None:
    """Refuse positions outside the area of their CRS, where it has no metres, and degrees.

    Raises:
        TracksError: such positions.
    """
    crs, origin, positions = tracks.world.crs, tracks.world.origin, tracks.get_rows("states")[:, :2]
    if crs is None:
        return
    middle = np.median(positions, axis=0)  # of which one outlier says nothing
    east, north = (middle + origin).tolist()
    problem = describe_misplacement(crs, middle[None], origin)
    if not problem and np.ptp(positions, axis=0).max() < MIN_EXTENT_M:
        off = middle - lonlat_from_world(tracks.world, np.zeros((1, 2)))[0]
        if len(tracks.ids) > 1 or np.abs(off).max() < NEAR_DEGREES:
            x, y = middle.tolist()
            problem = (
                f"all agents are at {x:g}, {y:g} m: are they degrees, and not metres of {crs}?"
            )
    if problem := problem or describe_crs_problem(crs, (east, north)):
        raise TracksError(f"{Path(path)}: {problem}")


def derive_contradicted_motion(path: str | os.PathLike[str], tracks: Tracks) -> Tracks:
    """Replace headings and speeds by those of the positions where most agents' contradict them.

    Raises TracksError where positions are a mirror image of headings, as if x and y were swapped.
    """
    velocity = np.nan_to_num(estimate_velocity(tracks, HALF_WINDOW_S, HALF_WINDOW_S))
    measured, stated, off = _measure_motion(tracks, velocity)
    moving = measured > MIN_MOVING_SPEED
    judged = moving.any(axis=1)
    if not judged.any():
        return tracks
    totals = [np.where(moving, speed, 0.0).sum(axis=1)[judged] for speed in (stated, measured)]
    ratio = totals[0] / totals[1]
    turned = (off & moving).sum(axis=1)[judged] > moving.sum(axis=1)[judged] / 2
    wrong = np.abs(ratio - 1) > MAX_SPEED_SHARE
    wrong_headings, wrong_speeds = turned.mean() > MOST_TURNED, wrong.mean() > MOST
    if not (wrong_headings or wrong_speeds):
        return tracks
    if wrong_headings and _detect_mirroring(velocity[moving], tracks.states[moving, 2]):
        raise TracksError(
            f"{Path(path)}: {turned.sum()} agents do not move where they head: positions are a "
            "mirror image of the headings. Are x and y swapped, or does y count downwards?"
        )
    names, found = "Headings and speeds are", f"{turned.sum()} agents do not move where they head"
    if not wrong_headings:
        names = "Speeds are"
        found = f"speeds are {np.median(ratio):.2f} times those of the positions and times"
        if abs(np.median(ratio) - FOOT_M) < 0.005:  # as that is shown
            found += " (are x and y in feet?)"
    warn(
        f"{Path(path)}: {found}. {names} taken from the positions; to keep the file's, use its "
        "reader in geoaim.tracks.formats"
    )
    derive = derive_motion if wrong_headings else derive_speeds
    return derive(tracks, half_window=HALF_WINDOW_S)


def _detect_mirroring(velocity: Float[Array, "n 2"], heading: Float[Array, "n"]) -> bool:
    """Whether headings turn one way where the motion turns the other."""
    direction = np.arctan2(velocity[:, 1], velocity[:, 0])
    sums, differences = (abs(np.exp(1j * (direction + sign * heading)).mean()) for sign in (1, -1))
    return bool(sums > MIRRORED and differences < TURNED)


def _check_sizes(tracks: Tracks) -> list[_Check]:
    limits = _list_limits(tracks)
    checked = np.ones(len(tracks.ids), bool)
    length, width = tracks.sizes.T
    is_long = np.isin(tracks.types, LONG_TYPES)
    wide = is_long & (width > length)
    too_large = ((length > limits[:, 0]) | (width > limits[:, 1])) & ~wide
    return [
        _Check("are larger than their type can be (are they in metres?)", too_large, checked),
        _Check("are wider than long (are length and width swapped?)", wide, is_long, NOISE),
    ]


def _check_motion(tracks: Tracks) -> list[_Check]:
    max_speed = _list_limits(tracks)[:, 2, None]
    velocity = estimate_velocity(tracks, HALF_WINDOW_S, HALF_WINDOW_S)
    known = np.isfinite(velocity[..., 0])
    velocity = np.nan_to_num(velocity)
    measured, stated, off = _measure_motion(tracks, velocity)
    highest = np.maximum(measured, stated)
    active = tracks.present & (highest > MIN_MOVING_SPEED)
    slack, share = MAX_SPEED_ERROR
    wrong_speed = np.abs(measured - stated) > np.maximum(slack, share * highest)
    moving = known & (np.minimum(measured, stated) > MIN_MOVING_SPEED)
    acceleration = _measure_acceleration(tracks, velocity)
    return [
        _Check(
            "are faster than their type can be (is the speed in m/s?)", highest > max_speed, active
        ),
        _Check(
            "have a speed other than that of their motion (is the speed in m/s?)",
            wrong_speed & known,
            active & known,
            NOISE,
        ),
        _Check(
            "do not move where they head (are x and y swapped, or headings turned? To derive "
            "headings from positions, use a reader of geoaim.tracks.formats and its derive_motion)",
            off & moving,
            moving,
            NOISE,
        ),
        _Check(
            f"accelerate by more than {MAX_ACCELERATION:g} m/s2 (do positions jump?)",
            known & (acceleration > MAX_ACCELERATION),
            known,
            NOISE,
        ),
    ]


def _measure_motion(
    tracks: Tracks, velocity: Float[Array, "N T 2"]
) -> tuple[Float[Array, "N T"], Float[Array, "N T"], Bool[Array, "N T"]]:
    """Speeds by positions and as stated, and where agents do not move where they head."""
    signed = np.nan_to_num(tracks.states[..., 3])
    direction = np.arctan2(velocity[..., 1], velocity[..., 0]) + np.pi * (signed < 0)
    off = np.abs(wrap_angle(direction - np.nan_to_num(tracks.states[..., 2])))
    return np.hypot(*velocity.T).T, np.abs(signed), off > MAX_HEADING_ERROR


def _measure_acceleration(tracks: Tracks, velocity: Float[Array, "N T 2"]) -> Float[Array, "N T"]:
    """Acceleration in m/s2 by differences of velocities; 0 where it is not known."""
    states = np.where(tracks.present[..., None], tracks.states, np.nan)
    states[tracks.present, :2] = velocity[tracks.present]
    moving = replace(tracks, states=states)
    change = np.nan_to_num(estimate_velocity(moving, HALF_WINDOW_S, HALF_WINDOW_S))
    return np.hypot(change[..., 0], change[..., 1])


def _list_limits(tracks: Tracks) -> Float[Array, "N 3"]:
    return np.array([LIMITS.get(name, OTHER_LIMITS) for name in tracks.types]).reshape(-1, 3)
