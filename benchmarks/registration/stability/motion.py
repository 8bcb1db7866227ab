"""The camera's motion over a clip, as parameters that each generator applies to its own camera."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from benchmarks.registration.stability.kinds import Disturbance

REFERENCE_WIDTH = 960  # px, of the frames to which the lengths in `Disturbance` refer
PERIODS = {"parking": 26.0, "panels": 40.0, "tiles": 14.0}  # px


@dataclass(frozen=True)
class CameraMotion:
    """The camera's motion; frame 0 is the plain view."""

    shift: Float[Array, "T 2"]  # px of the frame by which the camera moves over the ground
    angle: Float[Array, " T"]  # radians
    scale: Float[Array, " T"]  # magnification
    tilt: Float[Array, "T 2"]  # displacement of the corners by tilts about the two axes, px


def draw_motion(
    disturbance: Disturbance, count: int, width: int, generator: np.random.Generator
) -> CameraMotion:
    """Draw a slow drift with shake, and the rotation, scale, shift and tilt of the disturbance.

    Args:
        disturbance: the disturbance.
        count: number of frames.
        width: width of the frames, px.
        generator: source of randomness.

    Returns:
        The motion.
    """
    if disturbance.is_still:
        none = np.zeros(count)
        return CameraMotion(np.zeros((count, 2)), none, none + 1, np.zeros((count, 2)))
    unit = width / REFERENCE_WIDTH
    time = np.arange(count) / (count - 1)
    reached = np.minimum(3 * time, 1) if not disturbance.is_abrupt else (time > 1 / 3).astype(float)
    heading = generator.uniform(0, 2 * np.pi)
    direction = np.array([np.cos(heading), np.sin(heading)])
    slow = _draw_slow(time, generator)
    path = disturbance.drift * unit * (0.8 * time[:, None] * direction + 0.25 * slow[:, :2])
    path += disturbance.shake * unit * generator.standard_normal((count, 2))
    side = generator.choice([-1.0, 1.0])
    path += disturbance.shift * width * reached[:, None] * [side, 0.15 * generator.uniform(-1, 1)]
    if disturbance.pattern:  # the camera moves along the pattern
        period = PERIODS[disturbance.pattern] * unit
        path[:, 0] += disturbance.pattern_step * period * np.arange(count) * side
    calm = disturbance.drift / 12 * unit
    tilting = generator.uniform(0, 2 * np.pi)
    lean = disturbance.tilt * unit * np.array([np.cos(tilting), np.sin(tilting)])
    return CameraMotion(
        path - path[0],
        np.deg2rad(disturbance.rotation) * reached * side + 0.004 * slow[:, 2],
        disturbance.scale**reached * (1 + 0.003 * slow[:, 3]),
        reached[:, None] * lean + 0.6 * calm * slow[:, 4:6],
    )


def _draw_slow(time: Float[Array, " T"], generator: np.random.Generator) -> Float[Array, "T 6"]:
    """Sums of slow sinusoids that start at zero, of about unit size."""
    phase = generator.uniform(0, 2 * np.pi, (3, 6))
    frequency = generator.uniform(0.2, 1.3, (3, 6))
    waves = np.sin(2 * np.pi * frequency * time[:, None, None] + phase).sum(1) / 1.5
    return waves - waves[0]
