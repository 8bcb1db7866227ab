"""Paths of agents with exact states, and the boxes that a detector draws about them."""

import numpy as np

from benchmarks.tracking.cases import DetectorErrors, detect_boxes, project_boxes
from geoaim.base.world import World
from geoaim.tracks.tracks import Tracks

RATE, RESOLUTION, SIZE = 25.0, 0.05, (1200, 1600)
# the frame is north up, its lower left corner at the origin
WORLD_FROM_FRAME = np.array([[RESOLUTION, 0, 0], [0, -RESOLUTION, SIZE[0] * RESOLUTION], [0, 0, 1]])
CAR, ERRORS = (4.6, 1.9), DetectorErrors()


def make_truth(*agents, kinds=None, sizes=None) -> Tracks:
    """Tracks of agents, each (T, 4) states at 25 Hz."""
    states = np.stack(agents)
    kinds = kinds or ("car",) * len(agents)
    return Tracks(
        times=np.arange(states.shape[1]) / RATE,
        states=states,
        present=np.isfinite(states[..., 0]),
        sizes=np.array(sizes or [CAR] * len(agents), float),
        types=tuple(kinds),
        ids=tuple(str(n) for n in range(len(agents))),
        world=World(None),
    )


def drive_straight(x, y, heading, speed, steps=100):
    """States of an agent that drives straight on."""
    distance = speed * np.arange(steps) / RATE
    ones = np.ones(steps)
    return np.column_stack(
        [
            x + distance * np.cos(heading),
            y + distance * np.sin(heading),
            heading * ones,
            speed * ones,
        ]
    )


def turn_left(x, y, speed, radius, steps=100, rear=0.3 * CAR[0]):
    """States of a car whose rear axle drives on a circle, heading east at first."""
    turned = speed * np.arange(steps) / RATE / radius
    axle = np.column_stack([x + radius * np.sin(turned), y + radius * (1 - np.cos(turned))])
    middle = axle + rear * np.column_stack([np.cos(turned), np.sin(turned)])
    along = speed * np.ones(steps)  # the middle's speed along the heading is that of the axle
    return np.column_stack([middle, turned, along])


def detect(truth, errors=ERRORS, seed=0):
    """Boxes of a detector, and the transform of each frame."""
    matrices = np.broadcast_to(WORLD_FROM_FRAME, (len(truth.times), 3, 3))
    boxes, visible = project_boxes(truth, np.linalg.inv(matrices), SIZE)
    generator = np.random.default_rng(seed)
    return detect_boxes(boxes, visible, truth.types, errors, SIZE, generator), matrices
