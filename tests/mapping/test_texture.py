import json
import os
from contextlib import suppress
from dataclasses import replace

import cv2
import numpy as np
import pytest
import rasterio

from geoaim.aim.aim import AIM
from geoaim.aim.rectification import rectify
from geoaim.aim.texture_files import read_texture
from geoaim.base.errors import AimError
from geoaim.base.files import keep_files_of_others
from geoaim.base.world import World
from geoaim.mapping.texture import export_texture

PLACE = np.array([[0.05, 0.01, 3.7], [0.01, -0.05, 21.3], [0.0, 0.0, 1.0]])
OBLIQUE = np.array([[0.05, 0.01, 3.7], [0.01, -0.05, 21.3], [2e-4, 4e-4, 1.0]])
FILES = {"texture.png", "texture.json", "texture.pgw", "texture.png.aux.xml"}


def make_aim(place: np.ndarray) -> AIM:
    generator = np.random.default_rng(0)
    coverage = generator.integers(0, 3, (40, 60), dtype=np.uint16)
    image = generator.integers(0, 256, (40, 60, 3), dtype=np.uint8)
    world = World("EPSG:32633", (5e5, 5.4e6))
    return AIM(image, place, world, coverage, np.zeros((40, 60), bool))


def read(folder) -> tuple[np.ndarray, dict]:
    frame = json.loads((folder / "texture.json").read_text())
    bgra = cv2.imread(str(folder / frame["image"]), cv2.IMREAD_UNCHANGED)
    return cv2.cvtColor(bgra, cv2.COLOR_BGRA2RGBA), frame


def test_texture_holds_the_image_and_where_its_corners_lie(tmp_path):
    aim = make_aim(PLACE)
    export_texture(aim, tmp_path / "new" / "folder")
    picture, frame = read(tmp_path / "new" / "folder")
    np.testing.assert_array_equal(picture[..., :3], aim.image)
    np.testing.assert_array_equal(picture[..., 3], np.where(aim.coverage > 0, 255, 0))
    np.testing.assert_array_equal(frame["corners"], aim.corners)
    assert frame["corner_order"] == ["top-left", "top-right", "bottom-right", "bottom-left"]
    assert (frame["height"], frame["width"]) == (40, 60)
    assert frame["world"] == {"crs": "EPSG:32633", "origin": [5e5, 5.4e6]}


def test_gis_programs_place_the_picture(tmp_path):
    aim = make_aim(PLACE)
    export_texture(aim, tmp_path)
    expected = [0.05, 0.01, 5e5 + 3.7, 0.01, -0.05, 5.4e6 + 21.3]
    with rasterio.open(tmp_path / "texture.png") as dataset:
        np.testing.assert_allclose(list(dataset.transform)[:6], expected, rtol=1e-12)
        assert dataset.crs.to_epsg() == 32633
    export_texture(replace(aim, world=World(None)), tmp_path)
    with rasterio.open(tmp_path / "texture.png") as dataset:
        assert dataset.crs is None
        np.testing.assert_allclose(list(dataset.transform)[:6], PLACE[:2].ravel())


def test_pixel_sides_times_their_number_are_the_sides_of_the_corner_frame(tmp_path):
    export_texture(make_aim(PLACE), tmp_path)
    frame = read(tmp_path)[1]
    corners = np.array(frame["corners"])
    across, down = np.linalg.norm(corners[[1, 3]] - corners[0], axis=1)
    assert frame["pixel_width"] * frame["width"] == pytest.approx(across)
    assert frame["pixel_height"] * frame["height"] == pytest.approx(down)


def test_oblique_aim_becomes_a_north_up_texture(tmp_path):
    aim = make_aim(OBLIQUE)
    export_texture(aim, tmp_path)
    picture, frame = read(tmp_path)
    rectified = rectify(aim)
    np.testing.assert_array_equal(picture[..., :3], rectified.image)
    np.testing.assert_array_equal(frame["corners"], rectified.corners)
    (left, top), (right, _), (_, bottom), _ = frame["corners"]
    assert frame["corners"] == [[left, top], [right, top], [right, bottom], [left, bottom]]


def test_resolution_of_the_texture_can_be_chosen(tmp_path):
    export_texture(make_aim(PLACE), tmp_path, resolution=0.2)
    frame = read(tmp_path)[1]
    assert (frame["pixel_height"], frame["pixel_width"]) == (0.2, 0.2)


def test_failed_export_leaves_the_old_files_and_no_litter(tmp_path, monkeypatch):
    export_texture(make_aim(PLACE), tmp_path)
    old = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert set(old) == FILES

    def fail(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("geoaim.mapping.texture.json.dumps", fail)
    with pytest.raises(KeyboardInterrupt):
        export_texture(make_aim(OBLIQUE), tmp_path, resolution=0.1)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == old


@pytest.mark.parametrize("kept", range(7))
def test_a_kill_at_any_step_leaves_a_whole_texture(tmp_path, monkeypatch, kept):
    export_texture(make_aim(PLACE), tmp_path)
    old = read_texture(tmp_path)
    replaced, move = [], os.replace

    def stop(source, target):
        if len(replaced) == kept:
            raise KeyboardInterrupt
        replaced.append(target)
        move(source, target)

    monkeypatch.setattr("geoaim.base.files.os.replace", stop)
    with suppress(KeyboardInterrupt):
        export_texture(make_aim(OBLIQUE), tmp_path, resolution=0.1)
    assert len(replaced) == min(kept, 6)
    found = read_texture(tmp_path)
    assert np.array_equal(found.image, old.image) == (kept < 2)
    if kept == 6:
        assert {path.name for path in tmp_path.iterdir()} == FILES


def test_a_picture_that_would_start_another_program_is_refused(tmp_path):
    export_texture(make_aim(PLACE), tmp_path)
    document = json.loads((tmp_path / "texture.json").read_text())
    for key in ("image_sha256", "checksum"):
        document.pop(key)
    (tmp_path / "texture.json").write_text(json.dumps(document))
    (tmp_path / "texture.png").write_bytes(b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 8 8\n")
    with pytest.raises(AimError, match=r"texture\.png"):
        read_texture(tmp_path)


def test_a_picture_that_claims_far_more_pixels_than_its_size_is_refused(tmp_path, monkeypatch):
    blank = np.zeros((1200, 1200, 3), np.uint8)
    export_texture(AIM.from_image(blank, PLACE, World(None), "test"), tmp_path)
    read_texture(tmp_path)
    monkeypatch.setenv("GEOAIM_MAX_GB", "0.01")
    with pytest.raises(AimError, match="claims 1200 x 1200 pixels"):
        read_texture(tmp_path)


def test_a_texture_that_another_program_wrote_meanwhile_is_kept(tmp_path):
    with keep_files_of_others():
        export_texture(make_aim(PLACE), tmp_path)
        export_texture(make_aim(PLACE), tmp_path)
    with keep_files_of_others():
        with keep_files_of_others():
            export_texture(make_aim(OBLIQUE), tmp_path)
        theirs = read_texture(tmp_path)
        with pytest.raises(FileExistsError, match=r"texture\.json was written by another program"):
            export_texture(make_aim(PLACE), tmp_path)
    np.testing.assert_array_equal(read_texture(tmp_path).image, theirs.image)
