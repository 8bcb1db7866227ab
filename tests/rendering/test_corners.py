"""Grounds of textures and of images with known corners."""

import json
import math
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image

import geoaim
from geoaim.aim.aim import AIM
from geoaim.aim.texture_files import ORIENTATION_TAG, fit_corners
from geoaim.base.errors import AimError, GeoaimError
from geoaim.base.world import World
from geoaim.mapping.texture import export_texture
from geoaim.rendering import (
    View,
    ground_from_corners,
    prefilter_ground,
    read_ground,
    render,
    render_coverage,
)
from geoaim.rendering.corners import make_ground_from_aim
from geoaim.rendering.ground import world_from_pixels

TURNED = np.array([[3.0, 100.0], [203.0, 120.0], [193.0, 20.0], [-7.0, 0.0]])
QUADRILATERAL = np.array([[3.0, 100.0], [213.0, 90.0], [233.0, -20.0], [-12.0, 3.0]])
PLACE = np.array([[0.25, 0.05, -9.5], [0.05, -0.25, 11.5], [0.0, 0.0, 1.0]])
BLOCKED = """
import sys
class Blocker:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("cv2", "rasterio"):
            raise ImportError(name)
sys.meta_path.insert(0, Blocker())
"""
READ = """
from geoaim.rendering import read_ground
print(*read_ground(sys.argv[1]).image.shape)
"""
PREDICT = """
import geoaim, torch
from geoaim.rendering import View, prefilter_ground, render, read_ground
aim = geoaim.read_texture(sys.argv[1])
scene = geoaim.make_scene(aim, geoaim.read_tracks(sys.argv[2]))
model = geoaim.prediction.read_pretrained("vehicle")
noise = torch.Generator().manual_seed(0)
futures = geoaim.prediction.predict(model, scene, samples=2, start=90, generator=noise)
ground = prefilter_ground(read_ground(sys.argv[1]), 0.5)
picture = render(View(64, 64, 0.5), scene.poses[9, 90][None], ground)
torch.save((futures.states, picture), sys.argv[3])
"""


def make_aim(side=80):
    v, u = np.mgrid[:side, :side]
    image = np.stack([u * 3 % 256, v * 5 % 256, (u + v) % 256], axis=-1).astype(np.uint8)
    coverage = np.where(np.hypot(u - side / 2, v - side / 2) < side * 0.6, 2, 0).astype(np.uint16)
    world = World("EPSG:32633", (5e5, 5.4e6))
    return AIM(image, PLACE, world, coverage, np.zeros((side, side), bool))


def test_views_of_a_texture_are_those_of_the_map(tmp_path):
    aim = make_aim()
    export_texture(aim, tmp_path)
    view, cameras = View(40, 40, 0.3), torch.tensor([[0.0, 0.0, 0.4], [-5.0, 8.0, 2.0]])
    one, two = (
        render(view, cameras, g) for g in (make_ground_from_aim(aim), read_ground(tmp_path))
    )
    assert (one - two).abs().max() * 255 < 1
    again = geoaim.read_texture(tmp_path)
    np.testing.assert_allclose(again.corners, aim.corners, atol=1e-9)
    np.testing.assert_array_equal(again.coverage > 0, aim.coverage > 0)
    assert again.world == aim.world


@pytest.mark.slow
def test_a_cluster_without_rasterio_and_opencv_predicts_the_same(tmp_path):
    aim = geoaim.build_aim("samples/hover.mp4", "samples/gcps.csv")
    geoaim.write_aim(aim, tmp_path / "aim.tif")
    folder, tracks = tmp_path / "texture", os.path.abspath("samples/tracks.csv")
    export_texture(geoaim.read_aim(tmp_path / "aim.tif"), folder)
    command = [sys.executable, "-c", BLOCKED + PREDICT, folder, tracks, tmp_path / "a.pt"]
    subprocess.run(command, check=True, cwd=tmp_path, env={**os.environ, "PYTHONPATH": os.getcwd()})
    futures, picture = torch.load(tmp_path / "a.pt")
    scene = geoaim.make_scene(geoaim.read_aim(tmp_path / "aim.tif"), geoaim.read_tracks(tracks))
    model = geoaim.prediction.read_pretrained("vehicle")
    noise = torch.Generator().manual_seed(0)
    expected = geoaim.prediction.predict(model, scene, samples=2, start=90, generator=noise).states
    assert torch.equal(futures.isnan(), expected.isnan())
    assert (futures - expected)[..., :2].nan_to_num().abs().max() < 0.01
    ground = prefilter_ground(scene.ground, 0.5)
    own = render(View(64, 64, 0.5), scene.poses[9, 90][None], ground)
    assert (own - picture).abs().max() * 255 < 1


@pytest.mark.parametrize("corners", [TURNED, QUADRILATERAL])
def test_transform_of_corners_is_exact(corners):
    matrix = fit_corners(corners, 70, 110)
    pixels = np.array([[0, 0, 1], [110, 0, 1], [110, 70, 1], [0, 70, 1]]) @ matrix.T
    np.testing.assert_allclose(pixels[:, :2] / pixels[:, 2:], corners, atol=1e-9)


def test_ground_of_a_parallelogram_has_exact_corners():
    ground = ground_from_corners(torch.rand(3, 70, 110).double(), torch.tensor(TURNED))
    pixels = torch.tensor([[0.0, 0], [110, 0], [110, 70], [0, 70]]) + 1  # beyond the border
    found = world_from_pixels(ground.image_from_world[0], pixels)
    np.testing.assert_allclose(found, TURNED, atol=1e-6)


def test_marks_on_an_image_in_perspective_lie_where_the_homography_leads():
    """The centre of gravity of a smooth blob, of which the place is known, in a rendered view."""
    matrix = fit_corners(QUADRILATERAL, 140, 220)
    v, u = np.mgrid[:140, :220] + 0.5
    points = np.stack([u, v, np.ones_like(u)]).T @ matrix.T
    x, y = (points[..., :2] / points[..., 2:]).T
    for place in ((40.0, 50.0), (150.0, 40.0)):
        blob = np.exp(-((x - place[0]) ** 2 + (y - place[1]) ** 2) / (2 * 6.0**2))
        dark = torch.zeros(1).double()
        ground = ground_from_corners(
            torch.tensor(blob)[None], torch.tensor(QUADRILATERAL), outside=dark
        )
        view = View(160, 160, 0.5)
        camera = torch.tensor([[*place, np.pi / 2]]).double()
        picture = render(view, camera, ground)[0, 0].numpy()
        rows, columns = (np.mgrid[:160, :160] + 0.5 - 80) * 0.5
        right, down = (picture * columns).sum(), (picture * rows).sum()
        assert np.hypot(right, down) / picture.sum() < 0.01  # of pixels of about a metre


@pytest.mark.parametrize("autocast", [False, True])
def test_places_on_an_image_in_perspective_are_exact(autocast):
    """Each pixel's colour is its place by the homography, and the views show their own places."""
    matrix = fit_corners(QUADRILATERAL, 420, 660)
    v, u = np.mgrid[:420, :660] + 0.5
    points = np.stack([u, v, np.ones_like(u)]).T @ matrix.T
    image = torch.tensor((points[..., :2] / points[..., 2:]).T) - 110
    with torch.autocast("cpu", torch.bfloat16, enabled=autocast):
        ground = ground_from_corners(image, torch.tensor(QUADRILATERAL))
    ground = replace(ground, finest=math.inf)  # a ramp does not alias
    camera = torch.tensor([[110.0, 40.0, np.pi / 2]]).double()
    picture = render(View(61, 61, 1.0), camera, ground)[0].numpy() + 110
    rows, columns = np.mgrid[-30:31, -30:31]
    np.testing.assert_allclose(picture, np.stack([110 + columns, 40 - rows]), atol=1e-6)


def test_a_diagonal_strip_keeps_its_resolution():
    """Corners rounded to centimetres are no parallelogram."""
    along, across = np.array([700.0, 700.0]), np.array([3.5, -3.5])
    corners = np.array([[0.01, 0.0], along, along + across, across])
    ground = ground_from_corners(torch.rand(1, 10, 2000).double(), torch.tensor(corners))
    resolution = 1 / torch.linalg.det(ground.image_from_world[0, :, :2]).abs().sqrt()
    assert float(resolution) == pytest.approx(0.495, rel=0.01)


def test_textures_of_integers_are_refused(unchecked):
    for corners in (TURNED, QUADRILATERAL):
        with pytest.raises(ValueError, match=r"a texture of torch\.uint8"):
            ground_from_corners(torch.zeros(1, 4, 4, dtype=torch.uint8), torch.tensor(corners))


def test_beyond_the_quadrilateral_nothing_is_covered():
    image, corners = torch.ones(1, 70, 110).double(), torch.tensor(QUADRILATERAL)
    ground = ground_from_corners(image, corners)
    view, camera = View(300, 300, 1.0), torch.tensor([[110.0, 40.0, np.pi / 2]]).double()
    area = render_coverage(view, camera, ground).sum()
    x, y = QUADRILATERAL.T
    expected = abs((x * np.roll(y, -1) - y * np.roll(x, -1)).sum()) / 2
    assert area == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize(
    ("corners", "message"),
    [
        (TURNED[[0, 2, 1, 3]], "convex quadrilateral"),
        (TURNED * [1, np.nan], "convex quadrilateral"),
        (TURNED * [0, 1], "convex quadrilateral"),
    ],
)
def test_corners_in_a_wrong_order_are_refused(corners, message):
    with pytest.raises(AimError, match=message):
        ground_from_corners(torch.zeros(1, 4, 4).double(), torch.tensor(corners))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"version": 2}, "version 2 of the corner frame"),
        ({"width": 79}, "by the corners and 79 pixels 0.2582 m"),
        ({"width": 79, "pixel_width": 0.2582}, "80 x 80 pixels, and texture.json states 79 x 80"),
        ({"pixel_height": 0.5}, "pixel_height is 0.5 m, and by the corners"),
        ({"corners": [[0, 0], [20, 0], [20, 20], [0, 20]]}, "as in a mirror"),
        ({"image": "../texture.png"}, "the name of a file beside"),
        ({"corners": [[0, 0]] * 3}, "corners have shape"),
        ({"colour": "red"}, "the unknown key colour"),
        ({"corner_order": ["bottom-left"] * 4}, "corner_order is"),
        ({"world": {"crs": "EPSG:1", "origin": [0, 0]}}, "EPSG:1"),
    ],
)
def test_damaged_textures_are_refused_by_name(tmp_path, change, message):
    export_texture(make_aim(), tmp_path)
    frame = json.loads((tmp_path / "texture.json").read_text())
    (tmp_path / "texture.json").write_text(json.dumps({**frame, **change}))
    with pytest.raises(GeoaimError, match=message) as error:
        geoaim.read_texture(tmp_path)
    assert "texture" in str(error.value)


@pytest.mark.slow
def test_a_texture_in_perspective_is_read_without_opencv(tmp_path):
    export_texture(make_aim(), tmp_path)
    frame = json.loads((tmp_path / "texture.json").read_text())
    frame["corners"][2][0] += 0.01
    (tmp_path / "texture.json").write_text(json.dumps(frame))
    command = [sys.executable, "-c", BLOCKED + READ, tmp_path]
    result = subprocess.run(command, check=True, capture_output=True, text=True)
    assert result.stdout.split()[0] == "3"


@pytest.mark.parametrize("name", ["texture.json", "texture.png"])
def test_a_flipped_bit_of_a_texture_is_found(tmp_path, name):
    export_texture(make_aim(), tmp_path)
    intact = (tmp_path / name).read_bytes()
    generator = np.random.default_rng(0)
    for place in generator.choice(len(intact), 60, replace=False):
        damaged = bytearray(intact)
        damaged[place] ^= 1 << generator.integers(8)
        (tmp_path / name).write_bytes(damaged)
        with pytest.raises(GeoaimError) as error:
            geoaim.read_texture(tmp_path)
        assert "\n" not in str(error.value)


def test_a_picture_that_was_exchanged_is_found(tmp_path):
    for folder, side in (("one", 80), ("other", 81)):
        export_texture(make_aim(side), tmp_path / folder)
    (tmp_path / "other/texture.png").replace(tmp_path / "one/texture.png")
    with pytest.raises(AimError, match=r"not the picture that texture\.json was written with"):
        geoaim.read_texture(tmp_path / "one")


def test_a_texture_without_checksums_is_read(tmp_path):
    export_texture(make_aim(), tmp_path)
    frame = json.loads((tmp_path / "texture.json").read_text())
    for key in ("checksum", "image_sha256"):
        del frame[key]
    (tmp_path / "texture.json").write_text(json.dumps(frame))
    assert geoaim.read_texture(tmp_path).image.shape == (80, 80, 3)


@pytest.mark.parametrize("key", ["version", "image", "pixel_width", "corners", "world"])
def test_a_corner_frame_that_lacks_a_key_is_refused(tmp_path, key):
    export_texture(make_aim(), tmp_path)
    frame = json.loads((tmp_path / "texture.json").read_text())
    del frame[key]
    (tmp_path / "texture.json").write_text(json.dumps(frame))
    with pytest.raises(AimError, match=f"the corner frame lacks {key}; docs/schemas"):
        geoaim.read_texture(tmp_path)


def save_turned(path):
    exif = Image.Exif()
    exif[ORIENTATION_TAG] = 6
    Image.open(path).save(path, exif=exif)


def save_deep(path):
    Image.fromarray(np.full((80, 80), 40_000, np.uint16)).save(path)


@pytest.mark.parametrize(("save", "message"), [(save_turned, "EXIF"), (save_deep, "8 bits")])
def test_pictures_that_would_be_misread_are_refused(tmp_path, save, message):
    export_texture(make_aim(), tmp_path)
    frame = json.loads((tmp_path / "texture.json").read_text())
    del frame["image_sha256"]
    (tmp_path / "texture.json").write_text(json.dumps(frame))
    save(tmp_path / "texture.png")
    with pytest.raises(AimError, match=message):
        geoaim.read_texture(tmp_path)


def test_large_textures_are_read(tmp_path, monkeypatch):
    """Pillow refuses images of over twice `MAX_IMAGE_PIXELS`; here that is made small."""
    export_texture(make_aim(), tmp_path)
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 80 * 80 // 3)
    assert geoaim.read_texture(tmp_path).image.shape == (80, 80, 3)
    assert Image.MAX_IMAGE_PIXELS == 80 * 80 // 3
