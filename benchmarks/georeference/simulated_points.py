"""Simulated cameras, and control points picked on their images with errors.

Two simulators that share no code alternate: the nine terms of the method's own model, and a pinhole
camera with tilt, pixel aspect and two lens terms (OpenCV).
"""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy import ndarray as Array

from geoaim.base.geometry import image_corners, make_similarity, transform_points
from geoaim.mapping.georeference.control_points import ControlPoints
from geoaim.mapping.georeference.transform_models import (
    Points,
    compose_world_from_image,
    half_diagonal,
    undistort_points,
)

HEIGHT, WIDTH = 1080, 1920
# stretch and shear, perspective, lens of a usual camera that looks down
TERM_SIGMA = np.array([0.01, 0.01, 0.05, 0.05, 0.005])
LAYOUTS = (  # boxes of the points, shares of the sides: left, top, right, bottom
    (0.06, 0.06, 0.94, 0.94),
    (0.06, 0.06, 0.35, 0.94),
    (0.42, 0.35, 0.67, 0.65),
)
NOISE_PX = (0.5, 5.0)
NOISES = ("normal", "heavy tails", "one wrong")
HEAVY_DOF = 3  # degrees of freedom of Student's t
WRONG_PX = (10.0, 1000.0)  # error of the wrong point
# a function that maps pixels to the ground (metres), and metres per pixel
Camera = tuple[Callable[[Points], Points], float]


@dataclass(frozen=True, eq=False)
class PointSet:
    """Control points of one image."""

    points: ControlPoints  # the points as picked
    corners: Points  # (4, 2) places of the image's corners, metres
    resolution: float  # metres per pixel


def sample_terms_camera(generator: np.random.Generator) -> Camera:
    """Draw a camera of the method's own nine terms, of 0, 1 or 3 times `TERM_SIGMA`."""
    terms = np.zeros(9)
    terms[4:] = generator.choice([0.0, 1.0, 3.0]) * TERM_SIGMA * generator.normal(size=5)
    unit = 0.05 * half_diagonal(HEIGHT, WIDTH)
    plane = make_similarity(np.zeros(2), generator.uniform(0.0, 2.0 * np.pi), unit)
    matrix = compose_world_from_image(plane, terms, (HEIGHT, WIDTH))

    def transform(pixels: Points) -> Points:
        return transform_points(matrix, undistort_points(pixels, float(terms[8]), HEIGHT, WIDTH))

    return transform, 0.05


def sample_pinhole_camera(generator: np.random.Generator) -> Camera:
    """Draw a pinhole camera: tilt (sigma 3 degrees; 5 to 20 for a fifth), lens and pixel aspect."""
    tilt = abs(generator.normal()) * 3.0
    if generator.random() < 0.2:
        tilt = generator.uniform(5.0, 20.0)
    lens = generator.normal(size=2) * [0.01, 0.003]
    return make_pinhole_camera(tilt, lens, 1.0 + 0.005 * generator.normal(), generator)


def make_pinhole_camera(
    tilt: float, lens: Array, aspect: float, generator: np.random.Generator
) -> Camera:
    """Make a pinhole camera of random focal length, height, heading and direction of tilt.

    Args:
        tilt: angle between the optical axis and the vertical, degrees.
        lens: radial distortion, OpenCV's k1 and k2.
        aspect: focal length in pixel heights over that in pixel widths.
        generator: source of randomness.

    Returns:
        The transform of pixels to metres on the ground, and the metres per pixel without tilt.
    """
    focal = WIDTH / 2.0 / np.tan(np.radians(generator.uniform(25.0, 42.0)))
    distortion = np.array([*lens, 0.0, 0.0])
    matrix = np.array([[focal, 0, WIDTH / 2], [0, focal * aspect, HEIGHT / 2], [0, 0, 1.0]])
    azimuth, yaw = generator.uniform(0.0, 2.0 * np.pi, 2)
    axis = np.radians(tilt) * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    turned = cv2.Rodrigues(np.array([0.0, 0.0, yaw]))[0] @ np.diag([1.0, -1.0, -1.0])
    rotation = turned @ cv2.Rodrigues(axis)[0]
    height = generator.uniform(40.0, 150.0)

    def transform(pixels: Points) -> Points:
        rays = cv2.undistortPoints(pixels.reshape(-1, 1, 2), matrix, distortion)[:, 0]
        rays = np.column_stack([rays, np.ones(len(rays))]) @ rotation.T
        return rays[:, :2] * (height / -rays[:, 2:])

    return transform, height / focal


CAMERAS = (sample_terms_camera, sample_pinhole_camera)


def draw_sets(noise: str, count: int, trials: int, seed: int) -> list[PointSet]:
    """Draw sets of control points from both cameras in turn, in all layouts.

    Args:
        noise: one of NOISES, of an unknown size in NOISE_PX.
        count: number of points.
        trials: number of sets.
        seed: random seed.

    Returns:
        The sets.
    """
    generator = np.random.default_rng([seed, count, NOISES.index(noise)])
    sets = []
    for trial in range(trials):
        camera = CAMERAS[trial % len(CAMERAS)](generator)
        layout = LAYOUTS[generator.integers(len(LAYOUTS))]
        sigma = np.exp(generator.uniform(*np.log(NOISE_PX)))
        sets.append(pick_points(camera, layout, noise, (count, float(sigma)), generator))
    return sets


def pick_points(
    camera: Camera,
    layout: tuple[float, ...],
    noise: str,
    size: tuple[int, float],
    generator: np.random.Generator,
) -> PointSet:
    """Pick control points on an image.

    Args:
        camera: the camera.
        layout: one of LAYOUTS.
        noise: one of NOISES.
        size: number of points, and standard deviation of the noise in pixels.
        generator: source of randomness.

    Returns:
        The points with their truth.
    """
    transform, resolution = camera
    count, sigma = size
    box = np.reshape(layout, (2, 2)) * [WIDTH, HEIGHT]
    pixels = generator.uniform(box[0], box[1], size=(count, 2))
    coordinates = transform(pixels)
    if noise == "one wrong":
        angle, far = generator.uniform(0.0, 2.0 * np.pi), generator.uniform(*np.log10(WRONG_PX))
        coordinates[0] += 10.0**far * resolution * np.array([np.cos(angle), np.sin(angle)])
    errors = generator.normal(size=pixels.shape)
    if noise == "heavy tails":
        errors /= np.sqrt(generator.chisquare(HEAVY_DOF, (count, 1)) / HEAVY_DOF)
    names = tuple(f"p{i}" for i in range(count))
    picked = (pixels + sigma * errors).clip(0.0, (WIDTH, HEIGHT))
    points = ControlPoints(picked, coordinates, None, names, (None,) * count)
    return PointSet(points, transform(image_corners(HEIGHT, WIDTH)), resolution)
