"""Lanes of a place: along its arms, through its middle, around its ring."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.synthetic.roads.arms import Arm, lane_in, lane_out, on_arm, turn_between
from geoaim.synthetic.roads.curves import Line, arc, even, headings, joint, parallel
from geoaim.synthetic.roads.layouts import RING_LANE, Layout

FAR = 150.0  # m from the middle to where lanes begin and end, out of sight
MERGE = 0.62  # radians on the ring from an arm to where its lanes join and leave


@dataclass(frozen=True)
class Lane:
    """A lane in the direction of its traffic.

    Attributes:
        name: "east in 0", "east 0 to north 0", "north out 0", "ring past east", ...
        centre: its middle, a point each half metre, plan metres.
        width: (start, end) metres.
        speed: limit, m/s.
        turn: L, S or R through the middle; "" elsewhere.
    """

    name: str
    centre: Line
    width: tuple[float, float]
    speed: float = 13.9
    turn: str = ""


def sides(lane: Lane) -> tuple[Line, Line]:
    """The left and the right edge of a lane."""
    share = np.linspace(0, 1, len(lane.centre))
    half = 0.5 * (lane.width[0] + (lane.width[1] - lane.width[0]) * share)
    return parallel(lane.centre, half), parallel(lane.centre, -half)


@dataclass(frozen=True)
class Passage:
    """A way through the place: the lanes that follow each other, from one arm to another.

    Attributes:
        come: the arm that it comes in on.
        go: the arm that it leaves on.
        lanes: names in the order of travel.
        turn: L, S or R.
    """

    come: str
    go: str
    lanes: tuple[str, ...]
    turn: str


def make_lanes(layout: Layout) -> tuple[tuple[Lane, ...], tuple[Passage, ...]]:
    """All lanes of a layout, and all ways through it."""
    lanes = [lane for arm in layout.arms for lane in _arm_lanes(arm)]
    known = {lane.name: lane for lane in lanes}
    if layout.ring:
        links, passages = _ring_lanes(layout, known)
    else:
        links, passages = _connectors(layout, known)
    return (*lanes, *links), tuple(passages)


def _arm_lanes(arm: Arm) -> list[Lane]:
    """The lanes of an arm outside of its mouth."""
    lanes = []
    for rank in range(len(arm.turns)):
        inwards = on_arm(arm, np.array([[s, lane_in(arm, rank)] for s in _along(arm)[::-1]]))
        lanes.append(Lane(f"{arm.name} in {rank}", even(inwards), (arm.lane,) * 2, arm.speed))
    for rank in range(arm.lanes_out):
        outwards = on_arm(arm, np.array([[s, lane_out(arm, rank)] for s in _along(arm)]))
        lanes.append(Lane(f"{arm.name} out {rank}", even(outwards), (arm.lane,) * 2, arm.speed))
    return lanes


def _along(arm: Arm) -> Float[Array, "L"]:
    return np.linspace(arm.mouth, FAR, int(2 * (FAR - arm.mouth)))


def _connectors(layout: Layout, known: dict[str, Lane]) -> tuple[list[Lane], list[Passage]]:
    """A lane through the middle for each turn that a lane serves."""
    links, passages = [], []
    for come in layout.arms:
        for rank, served in enumerate(come.turns):
            for go in layout.arms:
                turn = turn_between(come, go)
                if go is come or turn not in served:
                    continue
                exit_rank = _exit_rank(come, go, rank, turn)
                start, end = f"{come.name} in {rank}", f"{go.name} out {exit_rank}"
                name = f"{come.name} {rank} to {go.name} {exit_rank}"
                line = _join(known[start].centre, known[end].centre)
                width = (come.lane, go.lane)
                links.append(Lane(name, line, width, min(come.speed, go.speed), turn))
                passages.append(Passage(come.name, go.name, (start, name, end), turn))
    return links, passages


def _exit_rank(come: Arm, go: Arm, rank: int, turn: str) -> int:
    """Left turns take the inner lane, right turns the outer one, others the lane opposite."""
    if turn == "L":
        return 0
    if turn == "R":
        return go.lanes_out - 1
    return int(np.clip(rank - (len(come.turns) - go.lanes_out), 0, go.lanes_out - 1))


def _join(before: Line, after: Line) -> Line:
    """A gentle line from the end of one lane to the start of another."""
    return joint(before[-1], headings(before)[-1], after[0], headings(after)[0])


def _ring_lanes(layout: Layout, known: dict[str, Lane]) -> tuple[list[Lane], list[Passage]]:
    """The ring in pieces, and for each arm the way onto it and off it."""
    middle, radius, arms = np.zeros(2), layout.ring, layout.arms
    links = []
    for arm, after in zip(arms, [*arms[1:], arms[0]], strict=True):
        on, off = arm.angle + MERGE, arm.angle - MERGE
        start, end = known[f"{arm.name} in 0"].centre, known[f"{arm.name} out 0"].centre
        spot, leave = arc(middle, radius, on, on + 0.1), arc(middle, radius, off - 0.1, off)
        entry = joint(start[-1], headings(start)[-1], spot[0], on + np.pi / 2, end_bend=1 / radius)
        away = joint(leave[-1], off + np.pi / 2, end[0], headings(end)[0], start_bend=1 / radius)
        gap = (after.angle - MERGE - on) % (2 * np.pi)
        widths = (arm.lane, RING_LANE), (RING_LANE, arm.lane), (RING_LANE, RING_LANE)
        links += [
            Lane(f"{arm.name} onto ring", entry, widths[0], 8.3),
            Lane(f"{arm.name} off ring", away, widths[1], 8.3),
            Lane(f"ring past {arm.name}", arc(middle, radius, off, on), widths[2], 8.3),
            Lane(f"ring after {arm.name}", arc(middle, radius, on, on + gap), widths[2], 8.3),
        ]
    return links, _ring_passages(arms)


def _ring_passages(arms: tuple[Arm, ...]) -> list[Passage]:
    passages = []
    for i, come in enumerate(arms):
        lanes = [f"{come.name} in 0", f"{come.name} onto ring"]
        for step in range(1, len(arms)):
            go = arms[(i + step) % len(arms)]
            lanes.append(f"ring after {arms[(i + step - 1) % len(arms)].name}")
            way = (*lanes, f"{go.name} off ring", f"{go.name} out 0")
            passages.append(Passage(come.name, go.name, way, turn_between(come, go)))
            lanes.append(f"ring past {go.name}")
    return passages
