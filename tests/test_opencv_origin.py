"""OpenCV has its origin at the first pixel's centre: no function may be half a pixel off by that.

Each function that warps, remaps or matches features with OpenCV is given an image whose pixels hold
their own coordinates, or a known transform, and the mean error of the result is measured.
"""

import cv2
import numpy as np
import pytest

from benchmarks.synthetic import exact
from geoaim.aim.aim import AIM
from geoaim.aim.rectification import rectify
from geoaim.base.geometry import image_corners, make_similarity, transform_points, translation
from geoaim.base.grid import Grid
from geoaim.base.world import World
from geoaim.imagery.alignment import by_tracks
from geoaim.imagery.alignment.template_matching import reduce_to_grey, resample_grey
from geoaim.mapping import pipeline
from geoaim.mapping.background.exposure import estimate_gain, start_exposure
from geoaim.mapping.background.running_mean import Background, average_frames
from geoaim.mapping.background.traffic_search import _shrink_frame
from geoaim.mapping.box_evidence import view_map
from geoaim.mapping.georeference.transform_models import distort_points
from geoaim.mapping.registration.features import detect_features, match_features
from geoaim.mapping.registration.patches import align_patches, make_template, shrink_image
from geoaim.mapping.video.frames import Frame
from geoaim.web.picking.snap import snap_to_corner
from tests.conftest import textured

SHIFTED = np.array([[2.0, 0.1, 3.3], [-0.1, 2.0, -4.6], [0, 0, 1.0]])  # twice as large, and turned
OBLIQUE = np.array([[2.0, 0, 3.3], [0, 2.0, -4.6], [2e-4, 1e-4, 1.0]])
MAX_BIAS_PX = 0.1  # half a pixel left out shows as 0.25 px or more here


def coordinates(height: int, width: int) -> np.ndarray:
    """Corner-origin coordinates (u, v) of the pixel centres: (H, W, 2)."""
    return np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=-1)


def ramp(height: int = 100, width: int = 120) -> np.ndarray:
    """An image whose red is twice u and whose green is twice v, at each pixel's centre."""
    image = np.full((height, width, 3), 100, np.uint8)
    image[..., :2] = 2 * coordinates(height, width)
    return image


def bias(image: np.ndarray, expected: np.ndarray, source: tuple[int, ...] = (100, 120)) -> float:
    """Mean difference in pixels between a resampled ramp and the source coordinates expected."""
    margin = 5  # px; beyond it nothing is repeated or left out
    inner = ((expected > margin) & (expected < np.array(source[1::-1]) - margin)).all(axis=-1)
    assert inner.sum() > 500
    return float(np.abs((image[..., :2] / 2 - expected)[inner].mean(axis=0)).max())


@pytest.mark.parametrize("image_from_frame", [SHIFTED, OBLIQUE])
def test_average_lies_where_the_transforms_say(image_from_frame):
    frames = [(Frame(0, 0.0, None, ramp()), image_from_frame)]
    image = average_frames(frames, size=(200, 240)).image
    expected = transform_points(np.linalg.inv(image_from_frame), coordinates(200, 240))
    assert bias(image, expected) < MAX_BIAS_PX


def test_exposure_is_compared_at_the_same_places():
    u = coordinates(100, 120)[..., 0]
    large, small = (30 + u).astype(np.uint8), (30 + 2 * u[:50, :60]).astype(np.uint8)
    exposure = start_exposure((100, 120))
    estimate_gain(exposure, Frame(0, 0.0, None, large), np.eye(3))
    gain = estimate_gain(exposure, Frame(1, 1.0, None, small), np.diag([2.0, 2.0, 1.0]))
    assert abs(gain - 1) < 0.004


@pytest.mark.parametrize("factor", [2, 3])
def test_shrunk_frame_lies_where_its_transform_says(factor):
    small, small_from_frame = _shrink_frame(Frame(0, 0.0, None, ramp()), factor, 1.0)
    places = coordinates(*small.shape[:2])
    assert bias(small, transform_points(np.linalg.inv(small_from_frame), places)) < MAX_BIAS_PX


def test_background_without_distortion_follows_the_lens():
    none = np.zeros((100, 120), bool)
    background = Background(ramp(), none.astype(np.uint16), none, 1, np.ones(1))
    image = pipeline.remove_distortion(background, -0.1).image
    places = coordinates(100, 120).reshape(-1, 2)
    expected = distort_points(places, -0.1, 100, 120).reshape(100, 120, 2)
    assert bias(image, expected) < MAX_BIAS_PX


@pytest.fixture(scope="module")
def aim() -> AIM:
    coverage = np.ones((100, 120), np.uint16)
    place = make_similarity(np.array([30.0, -20.0]), 0.1, 1.0) @ np.diag([0.5, -0.5, 1.0])
    return AIM(ramp(), place, World(None), coverage, np.zeros((100, 120), bool))


@pytest.mark.parametrize("resolution", [0.2, 0.5, 1.7])
def test_rectified_pixels_lie_where_the_grid_says(aim, resolution):
    image = rectify(aim, resolution)
    places = transform_points(image.world_from_image, coordinates(*image.coverage.shape))
    expected = transform_points(np.linalg.inv(aim.world_from_image), places)
    assert bias(image.image, expected) < MAX_BIAS_PX


@pytest.mark.parametrize("frame_from_aim", [SHIFTED, OBLIQUE])
def test_view_of_an_aim_lies_where_its_transform_says(frame_from_aim):
    aim_from_frame, covered = np.linalg.inv(frame_from_aim), np.ones((100, 120), bool)
    view, _ = view_map(ramp(), covered, aim_from_frame, (200, 240))
    expected = transform_points(aim_from_frame, coordinates(200, 240))
    assert bias(view, expected) < MAX_BIAS_PX


def grid_over(aim: AIM, resolution: float) -> tuple[Grid, np.ndarray]:
    """A grid over an AIM, and where its pixels' centres lie in the AIM's image."""
    low, high = aim.corners.min(axis=0), aim.corners.max(axis=0)
    world_from_grid = translation(low[0], high[1]) @ np.diag([resolution, -resolution, 1.0])
    shape = tuple(np.ceil((high - low)[::-1] / resolution).astype(int).tolist())
    places = transform_points(world_from_grid, coordinates(*shape))
    expected = transform_points(np.linalg.inv(aim.world_from_image), places)
    return Grid(shape, world_from_grid, aim.world), expected


@pytest.mark.parametrize("resolution", [0.2, 0.7, 1.3])
def test_grey_of_a_grid_lies_where_the_grid_says(aim, resolution):
    grid, expected = grid_over(aim, resolution)
    grey, _ = resample_grey(reduce_to_grey(aim, resolution), np.eye(3), grid)
    red, green = (grey - 0.114 * 100) / 2, 0.299 * expected[..., 0] + 0.587 * expected[..., 1]
    inner = ((expected > 5) & (expected < [115, 95])).all(axis=-1)
    assert abs((red - green)[inner].mean()) < MAX_BIAS_PX


@pytest.mark.parametrize("resolution", [0.2, 0.7])
def test_colours_of_surfaces_lie_where_the_grid_says(aim, resolution, monkeypatch):
    seen = []
    original = by_tracks._classify
    monkeypatch.setattr(
        by_tracks, "_classify", lambda image, *rest: seen.append(image) or original(image, *rest)
    )
    grid, expected = grid_over(aim, resolution)
    by_tracks._classify_ground(aim, grid)
    assert bias(seen[0], expected) < MAX_BIAS_PX


def pattern(places: np.ndarray) -> np.ndarray:
    """Smooth texture at any places: waves of many directions and lengths."""
    generator = np.random.default_rng(0)
    angle, length, phase = generator.uniform([0, 9, 0], [np.pi, 60, 2 * np.pi], (60, 3)).T
    wave = np.stack([np.cos(angle), np.sin(angle)]) * 2 * np.pi / length
    return (128 + 9 * np.cos(places @ wave + phase).sum(axis=-1)).clip(0, 255).astype(np.uint8)


@pytest.mark.parametrize("factor", [1, 2])
def test_patches_find_a_known_transform_without_bias(factor):
    truth = translation(7.3, -4.6) @ make_similarity(np.array([200.0, 200.0]), 2.9, 1.04)
    reference = pattern(coordinates(400, 400))
    frame = pattern(transform_points(truth, coordinates(400, 400)))
    template = make_template(reference, factor=factor)
    prior = translation(0.8, -0.7) @ truth
    alignment = align_patches(template, shrink_image(frame, factor), prior, "similarity")
    corners = image_corners(400, 400)
    error = transform_points(alignment.matrix, corners) - transform_points(truth, corners)
    assert np.abs(error).max() < MAX_BIAS_PX


@pytest.mark.parametrize("width", [800, 1920])
def test_features_of_a_turned_image_match_without_bias(width):
    """Half a turn doubles a bias; ORB's levels of rounded sizes alone leave 0.4 px of the level."""
    grey = textured(np.random.default_rng(3), 400, width)[..., 1].copy()
    one, two = detect_features(grey), detect_features(np.ascontiguousarray(grey[::-1, ::-1]))
    matrix = match_features(one, two, "similarity", size=grey.shape)
    middle = np.array([[width / 2, 200.0]])
    assert np.abs(transform_points(matrix, middle) - middle).max() < 0.6 * width / 960


@pytest.mark.parametrize("size", [(50, 60), (64, 77), (200, 240), (170, 300)])
def test_reproducible_resizing_is_a_pure_scale(size):
    image = exact.resize(ramp(), size)
    assert bias(image, coordinates(*size) * [120 / size[1], 100 / size[0]]) < MAX_BIAS_PX


@pytest.mark.parametrize("source_from_image", [np.linalg.inv(SHIFTED), np.linalg.inv(OBLIQUE)])
def test_reproducible_warp_lies_where_its_transform_says(source_from_image):
    image = exact.warp(exact.pack(ramp()), source_from_image, 200, 240)
    assert bias(image, transform_points(source_from_image, coordinates(200, 240))) < MAX_BIAS_PX


RESIZED_BY = ("INTER_AREA", "INTER_LINEAR", "INTER_LINEAR_EXACT", "INTER_CUBIC", "INTER_LANCZOS4")


@pytest.mark.parametrize("name", RESIZED_BY)
@pytest.mark.parametrize("size", [(60, 50), (300, 250)])
def test_opencv_resizes_by_a_pure_scale(name, size):
    image = cv2.resize(ramp(), size, interpolation=getattr(cv2, name))
    assert bias(image, coordinates(*size[::-1]) * [120 / size[0], 100 / size[1]]) < MAX_BIAS_PX


def test_a_click_moves_to_the_corner_of_drawn_squares():
    image = np.full((100, 120), 100, np.uint8)
    image[40:, 70:] = image[:40, :70] = 180
    corner = snap_to_corner(image, (73.0, 38.0))
    assert np.abs(np.subtract(corner, (70, 40))).max() < MAX_BIAS_PX
