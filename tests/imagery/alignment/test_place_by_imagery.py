"""A map is placed by imagery of another day: the sample's ground, made rougher and brighter."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from typer.testing import CliRunner

import geoaim
from geoaim.aim.aim import AIM
from geoaim.base.errors import AlignmentError
from geoaim.base.geometry import image_corners, make_similarity, transform_points, translation
from geoaim.base.progress import no_progress
from geoaim.base.world import World, lonlat_from_world
from geoaim.cli import app
from geoaim.imagery.alignment import place_by_imagery as placing
from geoaim.imagery.alignment.place_by_imagery import place_by_imagery

SAMPLES = Path(__file__).parents[3] / "samples"


@pytest.fixture(scope="module")
def aim():
    truth = np.load(SAMPLES / "truth.npz")
    image = np.asarray(cv2.imread(str(SAMPLES / "background.jpg")), np.uint8)[..., ::-1].copy()
    matrix = truth["world_from_frame"][0]
    world = World(str(truth["crs"]), tuple(truth["origin"].tolist()))
    return AIM.from_image(image, matrix / matrix[2, 2], world, "sample")


@pytest.fixture(scope="module")
def ortho(aim):
    generator = np.random.default_rng(1)
    image = 255 * (aim.image / 255.0) ** 0.7 + generator.normal(0, 6, aim.image.shape)
    other = replace(aim, image=image.clip(0, 255).astype(np.uint8))
    return geoaim.rectify(other, 0.25)


def measure_corners(placed, aim):
    corners = image_corners(*aim.coverage.shape)
    offset = transform_points(placed.world_from_image, corners) - transform_points(
        aim.world_from_image, corners
    )
    return np.hypot(*offset.T)


def test_a_map_by_telemetry_is_placed(aim, ortho):
    middle = aim.corners.mean(axis=0)
    wrong = translation(9.0, -7.0) @ make_similarity(middle, np.radians(12.0), 1.08)
    rough = replace(aim, world_from_image=wrong @ aim.world_from_image)
    placed = place_by_imagery(rough, ortho, accuracy=0.3, progress=no_progress)
    assert measure_corners(placed, aim).max() < 0.3
    assert placed.report["placed_by_imagery"]["control_points"] >= 8
    position = placed.report["position"]
    assert position["relative_to"] == "imagery"
    stated = np.array(position["covariance_m2"]) - position["relative_covariance_m2"]
    np.testing.assert_allclose(stated, 0.09 * np.eye(2), atol=1e-9)


@pytest.mark.slow
def test_a_tilted_map_is_placed_to_its_corners(aim, ortho):
    height, width = aim.coverage.shape
    lean = np.eye(3)
    lean[2, :2] = 0.06 / width, -0.04 / height
    seen = np.asarray(cv2.warpPerspective(aim.image, lean, (width, height)), np.uint8)
    true = aim.world_from_image @ np.linalg.inv(lean)
    tilted = replace(aim, image=seen, world_from_image=true / true[2, 2])
    rough = replace(tilted, world_from_image=translation(9.0, -7.0) @ aim.world_from_image)
    placed = place_by_imagery(rough, ortho, progress=no_progress)
    assert measure_corners(placed, tilted).max() < 0.3


@pytest.mark.slow
def test_a_local_map_is_placed_near_a_position_in_any_direction(aim, ortho):
    turned = make_similarity(np.zeros(2), np.radians(137.0), 0.9)
    rough = replace(aim, world=World(None), world_from_image=turned @ aim.world_from_image)
    middle = aim.corners.mean(axis=0) + np.array([10.0, 8.0])
    longitude, latitude = lonlat_from_world(aim.world, middle[None])[0]
    placed = place_by_imagery(rough, ortho, near=(latitude, longitude), progress=no_progress)
    corners = placed.corners
    lonlat = lonlat_from_world(placed.world, corners)
    expected = lonlat_from_world(aim.world, aim.corners)
    metres = (lonlat - expected) * [111e3 * np.cos(np.radians(latitude)), 111e3]
    assert np.hypot(*metres.T).max() < 0.3


def test_corners_that_may_be_off_are_named_where_they_show_ground(aim, ortho, monkeypatch):
    monkeypatch.setattr(placing, "MAX_CORNER_PX", 0.0)
    coverage = aim.coverage.copy()
    coverage[:, -1] = 0
    with pytest.warns(UserWarning, match="corners of the map") as caught:
        placing.place_by_imagery(replace(aim, coverage=coverage), ortho, progress=no_progress)
    [text] = [str(one.message) for one in caught if "corners" in str(one.message)]
    assert "top left" in text
    assert "bottom left" in text
    assert "right" not in text


def state_world(aim, imagery, **options):
    placed = place_by_imagery(aim, imagery, progress=no_progress, **options)
    return placed.report["position"], geoaim.AIM.summarize(placed)


def test_a_place_is_as_sure_as_the_imagery(aim, ortho, tmp_path):
    geoaim.write_aim(replace(ortho, report={}), tmp_path / "ortho.tif")
    position, lines = state_world(aim, tmp_path / "ortho.tif")
    assert position["reference"] == "ortho.tif"
    assert lines["relative to ortho.tif (95 %)"].startswith("±0.")
    assert lines["in the world (95 %)"].startswith("±6.1")  # 2.45 times 2.5 m
    assert "supposing 2.5 m" in lines["in the world (95 %)"]
    _, lines = state_world(aim, tmp_path / "ortho.tif", accuracy=0.0)
    assert "taking the imagery as right" in lines["in the world (95 %)"]
    _, lines = state_world(aim, tmp_path / "ortho.tif", accuracy=1.0)
    assert lines["in the world (95 %)"].startswith("±2.4")
    assert "supposing" not in lines["in the world (95 %)"]


def test_web_tiles_are_less_sure_than_an_orthophoto(ortho):
    tiled = {"imagery": [{"name": "host", "zoom": 19}]}
    covariance, supposed = placing._choose_covariance(replace(ortho, report=tiled), None)
    np.testing.assert_allclose(covariance, 4.8**2 * np.eye(2))
    assert supposed == {"supposed_accuracy_m": 4.8}
    stated = {"position": {"source": "control points", "covariance_m2": [[0.01, 0], [0, 0.04]]}}
    covariance, supposed = placing._choose_covariance(replace(ortho, report=stated), None)
    np.testing.assert_allclose(covariance, np.diag([0.01, 0.04]))
    assert supposed == {}


def test_other_ground_is_refused(aim, ortho):
    generator = np.random.default_rng(2)
    noise = cv2.GaussianBlur(generator.uniform(0, 255, ortho.image.shape), (0, 0), 2)
    other = replace(ortho, image=noise.astype(np.uint8))
    with pytest.raises(AlignmentError):
        place_by_imagery(aim, other, progress=no_progress)


def test_a_local_map_needs_a_position(aim, ortho):
    with pytest.raises(ValueError, match="--near"):
        place_by_imagery(replace(aim, world=World(None)), ortho, progress=no_progress)


def test_options_that_contradict_are_refused(tmp_path):
    command = ["build", str(SAMPLES / "hover.mp4"), "-o", str(tmp_path / "map.tif")]
    for options, text in (
        (["--near", "50,36"], "need --imagery"),
        (["--imagery", "a.tif", "--near", "50"], "latitude,longitude"),
        (["--imagery", "a.tif", "--points", str(SAMPLES / "gcps.csv")], "give one"),
    ):
        result = CliRunner().invoke(app, [*command, *options])
        assert result.exit_code == 1
        assert text in " ".join(result.output.split())
