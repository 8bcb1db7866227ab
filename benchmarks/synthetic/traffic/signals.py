"""Fixed-time traffic lights: which of them are green together, and their state at any time."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int8
from numpy import ndarray as Array

from benchmarks.synthetic.roads.layouts import STREET_KINDS
from benchmarks.synthetic.roads.plan import Roads
from geoaim.tracks.lights import GREEN, RED, YELLOW

YELLOW_S, ALL_RED_S = 3.0, 2.0  # duration of yellow and of red for all after each phase
CLEARING_SPEED = 1.2  # m/s of pedestrians for whom a crossing must be cleared
MIN_WALK_S = 5.0  # shortest green for pedestrians


@dataclass(frozen=True)
class Signals:
    """Traffic lights with a fixed cycle."""

    names: tuple[str, ...]  # "east", "east left", ... for vehicles, "walk north" for pedestrians
    cycle: float  # seconds; 0: there are no lights
    # start and end of each light's green within the cycle, seconds
    green: tuple[tuple[float, float], ...]
    yellow: tuple[float, ...]  # seconds of each light's yellow after green
    phase: float = 0.0  # position in the cycle at time 0, seconds


@dataclass(frozen=True)
class _Phase:
    """Lights that are green together for a duration (seconds)."""

    duration: float
    vehicles: tuple[str, ...]
    pedestrians: tuple[str, ...] = ()


def make_signals(roads: Roads, generator: np.random.Generator) -> Signals:
    """Draw a cycle of the lights of a place at random; it has no names if there are no lights."""
    if not roads.layout.signalised:
        return Signals((), 0.0, (), ())
    main, side = generator.uniform(24, 32), generator.uniform(16, 20)
    if roads.layout.kind in STREET_KINDS:
        walk = 10.0 + _measure_marked_crossing(roads, "east") / CLEARING_SPEED
        phases = [_Phase(main + 8, ("east", "west")), _Phase(walk - YELLOW_S, (), ("east",))]
        return _make_cycle(phases, roads)
    phases = [
        _Phase(main, ("east", "west"), ("north", "south")),
        _Phase(side, ("north", "south"), ("east", "west")),
    ]
    if "L" in roads.layout.approaches[0].turns:  # turns of the east approach
        phases.append(_Phase(generator.uniform(7, 10), ("east left", "west left")))
    return _make_cycle(phases, roads)


def compute_light_states(signals: Signals, times: Float[Array, "T"]) -> Int8[Array, "T G"]:
    """Compute the state of each light at times (s): (T, G) `GREEN`, `YELLOW` or `RED`."""
    if not signals.names:
        return np.zeros((len(times), 0), np.int8)
    start, end = np.array(signals.green).T
    elapsed = (np.asarray(times)[:, None] + signals.phase - start) % signals.cycle
    duration = end - start
    is_yellow = (elapsed >= duration) & (elapsed < duration + signals.yellow)
    return np.select([elapsed < duration, is_yellow], [GREEN, YELLOW], RED).astype(np.int8)


def _make_cycle(phases: list[_Phase], roads: Roads) -> Signals:
    """Concatenate phases, each followed by yellow and by red for all."""
    start = 0.0
    names: list[str] = []
    green, yellow = [], []
    for phase in phases:
        end = start + phase.duration
        for name in phase.vehicles:
            names.append(name)
            green.append((start, end))
            yellow.append(YELLOW_S)
        for name in phase.pedestrians:
            clearing = _measure_marked_crossing(roads, name) / CLEARING_SPEED
            names.append(f"walk {name}")
            walk_end = end + YELLOW_S + ALL_RED_S - clearing
            green.append((start, max(walk_end, start + MIN_WALK_S)))
            yellow.append(0.0)
        start += phase.duration + YELLOW_S + ALL_RED_S
    return Signals(tuple(names), start, tuple(green), tuple(yellow))


def _measure_marked_crossing(roads: Roads, name: str) -> float:
    """Metres of the marked crossing of an approach; 0 where there is none."""
    ends = next((c.ends for c in roads.crossings if c.name == name and c.marked), np.zeros((2, 2)))
    return float(np.hypot(*(ends[1] - ends[0])))
