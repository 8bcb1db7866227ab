"""Traffic lights: which of them are green together, and their state at any time."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int8
from numpy import ndarray as Array

from geoaim.lights import GREEN, RED, YELLOW
from geoaim.synthetic.roads.layouts import STREET_KINDS
from geoaim.synthetic.roads.plan import Roads

AMBER, CLEAR = 3.0, 2.0  # s of yellow, and of red for all
STRIDE = 1.2  # m/s of those on foot for whom a crossing must be cleared


@dataclass(frozen=True)
class Signals:
    """Lights that repeat.

    Attributes:
        names: "east", "east left", ... for vehicles, "walk north" for those on foot.
        cycle: seconds until all repeats; 0: there are no lights.
        green: for each light, start and end of its green within the cycle, seconds.
        amber: for each light, seconds of yellow after green.
        phase: seconds of the cycle that are over at time 0.
    """

    names: tuple[str, ...]
    cycle: float
    green: tuple[tuple[float, float], ...]
    amber: tuple[float, ...]
    phase: float = 0.0


def plan_signals(roads: Roads, generator: np.random.Generator) -> Signals:
    """Lights of a place: the main road, its protected left turns, the side road, and walkers."""
    if not roads.layout.signalised:
        return Signals((), 0.0, (), ())
    long, short = generator.uniform(24, 32), generator.uniform(16, 20)
    if roads.layout.kind in STREET_KINDS:
        walk = 10.0 + _length(roads, "east") / STRIDE
        return _cycle([(long + 8, ("east", "west"), ()), (walk - AMBER, (), ("east",))], roads)
    main = [approach for approach in roads.layout.approaches if approach.name in ("east", "west")]
    phases: list[_Phase] = [(long, ("east", "west"), ("north", "south"))]
    phases.append((short, ("north", "south"), ("east", "west")))
    if "L" in main[0].turns:
        phases.append((generator.uniform(7, 10), ("east left", "west left"), ()))
    return _cycle(phases, roads)


def lights_at(signals: Signals, times: Float[Array, "T"]) -> Int8[Array, "T G"]:
    """The state of each light at each time: `GREEN`, `YELLOW` or `RED`."""
    if not signals.names:
        return np.zeros((len(times), 0), np.int8)
    start, end = np.array(signals.green).T
    since = (np.asarray(times)[:, None] + signals.phase - start) % signals.cycle
    lasting = end - start
    state = np.where(since < lasting, GREEN, RED)
    return np.where((state == RED) & (since < lasting + signals.amber), YELLOW, state).astype(
        np.int8
    )


_Phase = tuple[float, tuple[str, ...], tuple[str, ...]]  # green seconds, vehicles, walkers


def _cycle(phases: list[_Phase], roads: Roads) -> Signals:
    """Phases one after the other, each with yellow and red for all behind it."""
    at = 0.0
    names: list[str] = []
    green, amber = [], []
    for lasting, vehicles, walkers in phases:
        for name in vehicles:
            names.append(name)
            green.append((at, at + lasting))
            amber.append(AMBER)
        for name in walkers:
            cleared = at + lasting + AMBER + CLEAR - _length(roads, name) / STRIDE
            names.append(f"walk {name}")
            green.append((at, max(cleared, at + 5.0)))
            amber.append(0.0)
        at += lasting + AMBER + CLEAR
    return Signals(tuple(names), at, tuple(green), tuple(amber))


def _length(roads: Roads, name: str) -> float:
    """Metres of the marked crossing of an approach; 0 where there is none."""
    found = [c for c in roads.crossings if c.name == name and c.marked]
    return float(np.hypot(*(found[0].ends[1] - found[0].ends[0]))) if found else 0.0
