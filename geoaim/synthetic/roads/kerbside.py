"""Cars parked at the kerbs of a street, by turns on either side, and the ways round them.

They stand on the carriageway and never move: a picture from above shows them, a map of lanes and
tracks of traffic do not.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.synthetic.roads.arms import Arm, half_width, lane_in, lane_out, on_arm
from geoaim.synthetic.roads.curves import Line, even, headings
from geoaim.synthetic.roads.lanes import FAR, Lane
from geoaim.synthetic.roads.layouts import Layout

PITCH = (5.4, 6.4)  # m from one parked car to the next
CARS = 4  # at most in a row
END = 110.0  # m from the middle, beyond the page
TURNS = 0.8  # chance that the next row is on the other side
GAP = 8.0  # m at most between rows beyond what ways between them need
INSIDE = 1.15  # m from the kerb to the middle of a parked car
ASIDE = 1.2  # m that vehicles keep further off than the middle of their lane
RAMP = 14.0  # m on which they come to be there, and back
CLEAR = 2.0  # m before and behind a row in which they still are


@dataclass(frozen=True)
class Row:
    """Cars that are parked one behind the other.

    Attributes:
        arm: the arm that they stand on.
        side: 1 for the side of traffic towards the middle, -1 for the other.
        start: metres along the arm to the row's start.
        pitch: metres from one to the next.
        cars: how many.
    """

    arm: str
    side: int
    start: float
    pitch: float
    cars: int

    @property
    def end(self) -> float:
        """Metres along the arm to the row's end."""
        return self.start + self.cars * self.pitch


def make_rows(layout: Layout, generator: np.random.Generator) -> tuple[Row, ...]:
    """Rows along both arms of a street, so far apart that nobody has to wait for oncoming traffic.

    The way round a row ends where the one round the next of the other side begins, and between rows
    of one side vehicles come back to their lane.
    """
    rows = []
    for arm in layout.arms:
        at = arm.mouth + RAMP + CLEAR + generator.uniform(0, GAP)
        side = 1 if generator.uniform() < 0.5 else -1
        while at < END:
            cars, pitch = int(generator.integers(1, CARS + 1)), generator.uniform(*PITCH)
            rows.append(Row(arm.name, side, at, pitch, cars))
            turns = generator.uniform() < TURNS
            way = RAMP if turns else 2 * RAMP
            at = rows[-1].end + 2 * CLEAR + way + generator.uniform(0, GAP)
            side = -side if turns else side
    return tuple(rows)


def parked(row: Row, arm: Arm) -> tuple[Line, Float[Array, "n"]]:
    """Middles of a row's cars, and their headings (radians)."""
    along = row.start + row.pitch * (np.arange(2 * row.cars + 1) / 2)
    across = np.full_like(along, row.side * (half_width(arm) - INSIDE))
    line = on_arm(arm, np.stack([along, across], axis=1))
    return line[1::2], headings(line)[1::2]


def driven(lane: Lane, arms: Sequence[Arm], rows: Sequence[Row]) -> Line:
    """Where vehicles drive in a lane: in its middle, and further off past parked cars."""
    name, way, rank = lane.name.split()[:3]
    side = {"in": 1, "out": -1}.get(way, 0)
    here = [row for row in rows if (row.arm, row.side) == (name, side)]
    if not here:
        return lane.centre
    arm = next(arm for arm in arms if arm.name == name)
    along = np.linspace(arm.mouth, FAR, int(2 * (FAR - arm.mouth)))
    middle = lane_in(arm, int(rank)) if way == "in" else lane_out(arm, int(rank))
    line = on_arm(arm, np.stack([along, middle - side * ASIDE * _share(along, here)], axis=1))
    return even(line[::-side])


def _share(along: Float[Array, "n"], rows: Sequence[Row]) -> Float[Array, "n"]:
    """How far vehicles are on their way round the rows of their side, 0 to 1."""
    share = np.zeros_like(along)
    for row in rows:
        away = np.maximum(row.start - CLEAR - along, along - row.end - CLEAR)
        near = 1 - np.clip(away / RAMP, 0, 1)
        share = np.maximum(share, (1 - np.cos(np.pi * near)) / 2)
    return share
