import json
from dataclasses import replace

import numpy as np
import pytest
import rasterio

from geoaim.aim.aim import AIM
from geoaim.aim.files import read_aim, write_aim
from geoaim.aim.position import MOVED, describe_covariance, read_position_covariance, state_position
from geoaim.aim.rectification import change_aim_world, rectify
from geoaim.aim.texture_files import read_texture
from geoaim.base.errors import GeoaimWarning
from geoaim.base.geometry import make_similarity, translation
from geoaim.base.world import World
from geoaim.mapping.texture import export_texture

COVARIANCE = np.array([[0.04, 0.01], [0.01, 9.0]])
WORLD = World("EPSG:32632", (500_000.0, 5_000_000.0))


@pytest.fixture
def aim():
    image = np.random.default_rng(0).integers(0, 255, (40, 60, 3), np.uint8)
    matrix = np.array([[0.5, 0.0, 10.0], [0.0, -0.5, 30.0], [0.0, 0.0, 1.0]])
    made = AIM.from_image(image, matrix, WORLD, "a test")
    return replace(made, report={"position": state_position("aim", COVARIANCE)})


def _holds(aim):
    return aim.report["position"]["source"] != MOVED


@pytest.mark.parametrize(
    "move",
    [
        translation(0.1, 0.0),
        translation(5.0, 0.0),  # ten whole pixels
        make_similarity(np.zeros(2), 0.01, 1.0),
        make_similarity(np.zeros(2), 0.0, 1.01),
    ],
)
def test_map_that_is_moved_in_python_says_so(aim, move):
    moved = replace(aim, world_from_image=move @ aim.world_from_image)
    assert not _holds(moved)
    assert read_position_covariance(moved.report) is None
    assert moved.report["before_moving"]["position"]["covariance_m2"] == COVARIANCE.tolist()
    assert moved.summarize()["position"].startswith("moved since")
    assert "m at azimuth" not in str(moved.summarize())


def test_map_in_another_world_is_moved(aim):
    assert not _holds(replace(aim, world=World(WORLD.crs, (500_001.0, 5_000_000.0))))
    assert not _holds(replace(aim, world=World("EPSG:32633", WORLD.origin)))


def test_report_is_bound_again_after_a_move(aim):
    moved = replace(aim, world_from_image=translation(1, 0) @ aim.world_from_image)
    again = replace(moved, world_from_image=translation(1, 0) @ moved.world_from_image)
    assert again.report["before_moving"] == moved.report["before_moving"]


def test_file_whose_transform_is_edited_says_so(aim, tmp_path):
    path = tmp_path / "a.tif"
    write_aim(aim, path)
    assert _holds(read_aim(path))
    with rasterio.open(path, "r+", IGNORE_COG_LAYOUT_BREAK="YES") as file:
        file.transform = file.transform * rasterio.Affine.translation(4, 0)
    assert not _holds(read_aim(path))


def test_map_that_is_cropped_or_resampled_keeps_its_claim(aim, tmp_path):
    path, cropped = tmp_path / "a.tif", tmp_path / "b.tif"
    write_aim(aim, path)
    with rasterio.open(path) as file:
        window = rasterio.windows.Window(7, 5, 30, 20)
        profile = {**file.profile, "width": 30, "height": 20}
        profile["transform"] = file.window_transform(window)
        with rasterio.open(cropped, "w", **profile) as part:
            part.write(file.read(window=window))
            part.descriptions = file.descriptions
            part.update_tags(**file.tags())
    with pytest.warns(GeoaimWarning, match="written anew by another program"):
        assert _holds(read_aim(cropped))
    turned = replace(
        aim, world_from_image=aim.world_from_image @ make_similarity(np.zeros(2), 1, 1)
    )
    turned = replace(turned, report={"position": state_position("aim", COVARIANCE)})
    for other in (rectify(aim, 0.3), rectify(turned)):
        assert _holds(other)
        assert not _holds(replace(other, world=World(WORLD.crs, (500_001.0, 5_000_000.0))))


def test_map_that_is_expressed_in_another_world_keeps_its_claim(aim):
    world = World("EPSG:32633", (20_000.0, 5_020_000.0))
    moved = change_aim_world(aim, world)
    assert _holds(moved)
    back = change_aim_world(moved, WORLD)
    np.testing.assert_allclose(back.corners, aim.corners, atol=1e-4)


def test_texture_carries_the_position_and_says_if_it_was_moved(aim, tmp_path):
    export_texture(aim, tmp_path)
    found = read_texture(tmp_path)
    np.testing.assert_allclose(read_position_covariance(found.report), COVARIANCE)
    frame = json.loads((tmp_path / "texture.json").read_text())
    frame["corners"] = (np.array(frame["corners"]) + np.array([2.0, 0.0])).tolist()
    (tmp_path / "texture.json").write_text(json.dumps(frame))
    assert not _holds(read_texture(tmp_path))


def test_region_is_described_by_azimuths_from_north():
    along = np.array([np.sin(np.radians(142)), np.cos(np.radians(142))])
    across = np.array([along[1], -along[0]])
    covariance = 36.0 * np.outer(along, along) + 0.04 * np.outer(across, across)
    assert describe_covariance(covariance) == "±0.49 m at azimuth 52°, ±15 m at 142°"
    assert describe_covariance(None) == "unknown"
