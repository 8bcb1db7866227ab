"""Image statistics that are compared between real and rendered images, and those images."""

from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from benchmarks.data import read_image
from benchmarks.realism.motion import Statistics
from benchmarks.synthetic import Sample, draw_place, tracks_of
from benchmarks.synthetic.compositing import compute_image_poses, draw_agents, paste

RESOLUTION = 0.1  # m/px at which images are compared
OCTAVES = 2.0 ** np.arange(-7, 0)  # cycles a pixel
WINDOW = 256  # px, side of the squares whose spectra are measured


def sample_statistics(image: UInt8[Array, "H W 3"]) -> Statistics:
    """Sample image statistics that differ between rendered and real images.

    Args:
        image: (H, W, 3) RGB of `RESOLUTION` metres per pixel.

    Returns:
        A 1-D sample for each name:

        - "grey level" and "colourfulness" (distance from grey in Lab): at the same 40,000 pixels,
          or all of a smaller image.
        - "gradient": grey levels per pixel at 40,000 pixels, drawn anew with replacement.
        - "edge direction": up to 20,000 of the strongest 5 % of edges, radians in [-pi/4, pi/4)
          from the commonest direction.
        - "spectrum": amplitude of each octave in half-overlapping windows of 256 px; empty for
          smaller images.
    """
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float64)
    right, down = grey[1:-1, 2:] - grey[1:-1, :-2], grey[2:, 1:-1] - grey[:-2, 1:-1]
    lab = cv2.cvtColor(image, cv2.COLOR_RGB2LAB).astype(np.float64)
    subset = np.random.default_rng(0).choice(grey.size, min(grey.size, 40_000), replace=False)
    magnitude = np.hypot(right, down) / 2
    return {
        "gradient": np.random.default_rng(0).choice(magnitude.ravel(), 40_000),
        "grey level": grey.ravel()[subset],
        "colourfulness": np.hypot(lab[..., 1] - 128, lab[..., 2] - 128).ravel()[subset],
        "edge direction": _measure_edge_directions(right, down, magnitude),
        "spectrum": _measure_spectrum(grey).ravel(),
    }


def _measure_edge_directions(right: Array, down: Array, magnitude: Array) -> Float[Array, "_"]:
    """Directions of strong edges relative to the commonest one, radians in [-pi/4, pi/4)."""
    strong = magnitude > np.percentile(magnitude, 95)
    angle = np.arctan2(down[strong], right[strong]) % (np.pi / 2)
    counts, edges = np.histogram(angle, 90, (0, np.pi / 2))
    top = edges[np.argmax(counts)]
    relative = (angle - top + np.pi / 4) % (np.pi / 2) - np.pi / 4
    return np.random.default_rng(0).choice(relative, min(len(relative), 20_000), replace=False)


def _measure_spectrum(grey: Float[Array, "H W"]) -> Float[Array, "n k"]:
    """Measure the mean amplitude of each octave in windowed squares."""
    window = np.outer(np.hanning(WINDOW), np.hanning(WINDOW))
    radius = np.hypot(np.fft.fftfreq(WINDOW)[:, None], np.fft.fftfreq(WINDOW))
    bands = [(radius >= low) & (radius < 2 * low) for low in OCTAVES[:-1]]
    rows = []
    for top in range(0, grey.shape[0] - WINDOW + 1, WINDOW // 2):
        for left in range(0, grey.shape[1] - WINDOW + 1, WINDOW // 2):
            square = grey[top : top + WINDOW, left : left + WINDOW]
            power = np.abs(np.fft.fft2((square - square.mean()) * window)) ** 2
            rows.append([np.sqrt(power[band].mean() / (window**2).sum()) for band in bands])
    return np.array(rows)


def draw_sample(sample: Sample) -> UInt8[Array, "H W 3"]:
    """Draw a synthetic place with the agents of its last step, at `RESOLUTION`."""
    still = draw_place(sample.place)
    tracks = tracks_of(sample)
    agents = draw_agents(tracks, 0.05, np.random.default_rng(1))
    paste(still, agents, compute_image_poses(sample.place, tracks, 0.05)[-1])
    return _resize(still, 0.05)


def _resize(image: UInt8[Array, "H W 3"], resolution: float) -> UInt8[Array, "_ _ 3"]:
    scale = resolution / RESOLUTION
    return np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))


def read_real_images(folder: Path) -> dict[str, UInt8[Array, "_ _ 3"]]:
    """Read drone stills of four junctions from the folder of real data, at `RESOLUTION`."""
    street = str(next((folder / "hover/minsk_street").glob("*.jpg")).relative_to(folder))
    sources = {
        "songdo 3": ("hover/songdo_stills/00003.jpg", 0.04),
        "songdo 972": ("hover/songdo_stills/00972.jpg", 0.04),
        "minsk junction": ("hover/minsk_junction/DJI_0005-0018.jpg", 0.05),
        "minsk street": (street, 0.05),
    }
    return {
        name: _resize(read_image(folder / path), metres) for name, (path, metres) in sources.items()
    }
