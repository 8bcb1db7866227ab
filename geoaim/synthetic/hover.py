"""How a hovering camera moves: slow drift, yaw, zoom and tilt, vibration, and exposure."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.geometry import translation


@dataclass(frozen=True)
class Hover:
    """Motion and image quality of a hovering camera.

    Attributes:
        count: number of frames.
        frame_rate: frames per second.
        drift: mean distance of the image centre from where frame 0 saw it, frame pixels.
        yaw: standard deviation of the camera's heading, radians.
        zoom: standard deviation of the scale, relative.
        perspective: standard deviation of the corners' shift by tilt, frame pixels.
        vibration: standard deviation of the shift from frame to frame, frame pixels.
        blur: standard deviation of the lens blur, frame pixels.
        noise: standard deviation of the sensor noise, grey levels.
        exposure: standard deviation of the gain over the clip; frame 0 has gain 1.
    """

    count: int = 120
    frame_rate: float = 30.0
    drift: float = 28.0
    yaw: float = 0.006
    zoom: float = 0.004
    perspective: float = 1.5
    vibration: float = 0.4
    blur: float = 0.6
    noise: float = 2.0
    exposure: float = 0.03


def simulate_poses(
    hover: Hover, height: int, width: int, generator: np.random.Generator
) -> tuple[Float[Array, "T 3 3"], Float[Array, "T"]]:
    """Simulate the camera's motion and exposure over a clip; frame 0 is a pose like any other.

    Args:
        hover: size of the motion.
        height: rows of a frame.
        width: columns of a frame.
        generator: source of randomness.

    Returns:
        nominal_from_frame: (T, 3, 3) frame pixels to those of a camera that does not move.
        gains: (T,) exposure relative to frame 0.
    """
    times = np.arange(hover.count) / hover.frame_rate
    slow = np.stack([_make_slow_noise(times, generator) for _ in range(7)])
    path = slow[:2] - slow[:2, :1]
    length = np.hypot(*path).mean()
    path = path * (hover.drift / length if length > 0 else 0.0)
    path += hover.vibration * generator.standard_normal(path.shape)
    radius = np.hypot(height, width) / 2
    centre, back = translation(width / 2, height / 2), translation(-width / 2, -height / 2)
    poses = np.empty((hover.count, 3, 3))
    for i in range(hover.count):
        angle, size = hover.yaw * slow[2, i], 1 + hover.zoom * slow[3, i]
        cosine, sine = size * np.cos(angle), size * np.sin(angle)
        rotation = np.array([[cosine, sine, path[0, i]], [-sine, cosine, path[1, i]], [0, 0, 1]])
        tilt = np.eye(3)
        tilt[2, :2] = hover.perspective * slow[4:6, i] / radius**2
        poses[i] = centre @ rotation @ tilt @ back
    return poses, 1 + hover.exposure * (slow[6] - slow[6, 0])


def _make_slow_noise(times: Float[Array, "T"], generator: np.random.Generator) -> Float[Array, "T"]:
    """Sum sinusoids with periods of 2.5 to 25 s, the longer the stronger; unit variance."""
    frequencies = 0.04 * 10 ** generator.uniform(0, 1, 8)
    phases = generator.uniform(0, 2 * np.pi, 8)
    weights = frequencies[0] / frequencies
    waves = np.sin(2 * np.pi * frequencies * times[:, None] + phases)
    return np.asarray(waves @ weights / np.sqrt((weights**2).sum() / 2))
