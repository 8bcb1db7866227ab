"""Six kinds of place: how their arms lie, and what controls the traffic."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from geoaim.geometry import wrap_angle
from geoaim.synthetic.roads.arms import Arm, half_width

Kind = Literal["junction", "t", "roundabout", "street", "park", "campus"]
KINDS: tuple[Kind, ...] = get_args(Kind)  # a new one goes last: seeds of imagery count them
# where nothing that leads anywhere is missing from a map of lanes but pavements and a car park
PLAIN: tuple[Kind, ...] = ("junction", "t", "roundabout", "street")
STRETCHES: tuple[Kind, ...] = ("street", "park")  # of one road

CROSSING = 4.0  # m, how long a stripe of a crossing is
CYCLES = 2.4  # m between a crossing and the stop line, for a strip on which cycles cross
SETBACK = 1.0  # m from the crossing or strip to the stop line
WINDING = (0.006, 0.011)  # 1/m, bends of private roads
RING_LANE = 5.4  # m, width of the lane of a roundabout
AROUND = 0.8 * np.pi  # arms further apart than this make one straight road, with no corner


@dataclass(frozen=True)
class Layout:
    """The arms of a place and how they meet.

    Attributes:
        kind: one of `KINDS`.
        arms: counter-clockwise.
        corner: radius of the kerbs where two arms meet, metres.
        ring: radius of the middle of a roundabout's lane, metres; 0: there is none.
        signalised: whether lights control it.
        informal: across which arms people walk where there is no crossing, and where along it.
        private: arms that lead through private ground, which maps of lanes leave out.
    """

    kind: Kind
    arms: tuple[Arm, ...]
    corner: float
    ring: float = 0.0
    signalised: bool = False
    informal: tuple[tuple[str, float], ...] = ()
    private: tuple[str, ...] = ()


def lay_out(kind: Kind, generator: np.random.Generator) -> Layout:
    """The arms of a place of some kind; what the kind leaves open is drawn.

    Raises:
        ValueError: there is no such kind.
    """
    makers: dict[str, Callable[[np.random.Generator], Layout]] = {
        "junction": _junction,
        "t": _t,
        "roundabout": _roundabout,
        "street": _street,
        "park": _park,
        "campus": _campus,
    }
    if kind not in makers:
        raise ValueError(f"kind {kind!r} is not one of {', '.join(KINDS)}")
    return makers[kind](generator)


def _junction(generator: np.random.Generator) -> Layout:
    """Two roads that cross at lights; the main one has two lanes each way, or three and two."""
    tilt, lean = generator.uniform(-0.05, 0.05), generator.uniform(-0.18, 0.18)
    main, side = generator.uniform(-0.0022, 0.0022), generator.uniform(-0.003, 0.003)
    lane = round(generator.uniform(3.1, 3.4), 2)
    inner = generator.choice(["pocket", "shared"])
    turns = ("L", "S", "SR") if inner == "pocket" else ("LS", "SR")
    minor = ("L", "SR") if generator.uniform() < 0.7 else ("LSR",)
    main_arm = Arm("east", tilt, main, turns, 2, lane)
    side_arm = Arm("north", np.pi / 2 + lean, side, minor, 1, lane, speed=11.1)
    arms = [
        main_arm,
        side_arm,
        replace(main_arm, name="west", angle=tilt + np.pi, bend=-main),
        replace(side_arm, name="south", angle=lean - np.pi / 2, bend=-side),
    ]
    corner = generator.uniform(6.5, 9.0)
    arms = [_meeting(arm, arms, corner, cycles=CYCLES) for arm in arms]
    return Layout("junction", tuple(arms), corner, signalised=True, informal=(("south", 40.0),))


def _t(generator: np.random.Generator) -> Layout:
    """A side road that gives way to a main road."""
    tilt, lean = generator.uniform(-0.06, 0.06), generator.uniform(-0.2, 0.2)
    main, side = generator.uniform(-0.003, 0.003), generator.uniform(-0.004, 0.004)
    lane = round(generator.uniform(3.0, 3.4), 2)
    arms = [
        Arm("east", tilt, main, ("LS",), 1, lane),
        Arm("west", tilt + np.pi, -main, ("SR",), 1, lane),
        Arm("south", lean - np.pi / 2, side, ("LR",), 1, lane, speed=8.3),
    ]
    corner = generator.uniform(6.0, 8.0)
    arms = [_meeting(arm, arms, corner, cycles=0.0) for arm in arms]
    keep = "east" if generator.uniform() < 0.5 else "west"
    arms = [
        _without_line(arm, crossing=arm.name == keep) if i < 2 else arm
        for i, arm in enumerate(arms)
    ]
    bare = "west" if keep == "east" else "east"
    return Layout("t", tuple(arms), corner, informal=((bare, 26.0),))


def _roundabout(generator: np.random.Generator) -> Layout:
    """Three or four arms on a ring of one lane."""
    ring = generator.uniform(13.5, 16.5)
    tilt, median = generator.uniform(-0.12, 0.12), 2.6
    spots = [("east", 0.0), ("north", np.pi / 2), ("west", np.pi), ("south", -np.pi / 2)]
    if generator.uniform() < 0.35:
        spots.pop(1 if generator.uniform() < 0.5 else 3)
    outside = ring + RING_LANE / 2
    arms = []
    for name, angle in spots:
        turn = tilt + angle + generator.uniform(-0.12, 0.12)
        arm = Arm(name, turn, generator.uniform(-0.003, 0.003), ("LSR",), 1, 3.3, median)
        mouth = outside + 9.0
        arms.append(replace(arm, mouth=mouth, crossing=mouth + 0.5, stop=outside + 1.0, speed=11.1))
    return Layout("roundabout", tuple(arms), corner=10.0, ring=ring, informal=(("east", 58.0),))


def _street(generator: np.random.Generator) -> Layout:
    """A stretch of one road, with a crossing at lights in its middle."""
    tilt, bend = generator.uniform(-0.08, 0.08), generator.uniform(-0.004, 0.004)
    lanes = int(generator.integers(1, 3))
    line = CROSSING / 2 + 1.5 * SETBACK
    arm = Arm("east", tilt, bend, ("S",) * lanes, lanes, 3.3, mouth=6.0, stop=line)
    arms = (
        replace(arm, crossing=-CROSSING / 2),
        replace(arm, name="west", angle=tilt + np.pi, bend=-bend),
    )
    return Layout("street", arms, corner=6.0, signalised=True, informal=(("east", 45.0),))


def _park(generator: np.random.Generator) -> Layout:
    """A street through a park."""
    return replace(_street(generator), kind="park")


def _campus(generator: np.random.Generator) -> Layout:
    """A T at the gate of private ground: one arm of the main road winds on there."""
    layout = _t(generator)
    bend = generator.uniform(*WINDING) * (1 if generator.uniform() < 0.5 else -1)
    east, *others = layout.arms
    arms = (replace(east, bend=bend), *others)
    return replace(layout, kind="campus", arms=arms, private=(east.name,))


def corner_along(arm: Arm, other: Arm) -> float:
    """Metres along an arm to where its kerb would meet the other's, were there no round corner."""
    between = _between(arm, other)
    if other.name == arm.name or between > AROUND:
        return 0.0
    near, far = half_width(arm), half_width(other)
    return float((far + near * np.cos(between)) / np.sin(between))


def _between(arm: Arm, other: Arm) -> float:
    return float(abs(wrap_angle(np.asarray(other.angle - arm.angle))))


def _meeting(arm: Arm, arms: list[Arm], corner: float, *, cycles: float) -> Arm:
    """The arm with its mouth, crossing and stop line where the corners leave room for them."""
    mouth = edge = 0.0
    for other in arms:
        at = corner_along(arm, other)
        if at > 0:
            mouth = max(mouth, at + corner / np.tan(_between(arm, other) / 2))
            edge = max(edge, at)
    crossing = edge + 0.55 * corner
    stop = crossing + CROSSING + cycles + SETBACK
    return replace(arm, mouth=mouth, crossing=crossing, stop=stop)


def _without_line(arm: Arm, *, crossing: bool) -> Arm:
    """A main road's arm: nobody stops there, but people may cross."""
    return replace(arm, stop=np.nan, crossing=arm.mouth + 1.0 if crossing else np.nan)
