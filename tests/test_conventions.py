"""One assertion for each row of the conventions in docs/conventions.md that applies so far."""

import ast
import inspect
import re
from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio

import geoaim
from geoaim.aim.aim import AIM
from geoaim.aim.files import write_aim
from geoaim.aim.rectification import rectify
from geoaim.base import errors
from geoaim.base.geometry import from_opencv, image_corners, to_opencv, transform_points
from geoaim.base.world import World

SOURCES = sorted(Path(geoaim.__file__).parent.rglob("*.py"))
PLACE = np.array([[0.5, 0.0, 10.0], [0.0, -0.5, 40.0], [0.0, 0.0, 1.0]])


def make_aim() -> AIM:
    image = np.random.default_rng(0).integers(0, 256, (40, 60, 3), dtype=np.uint8)
    world = World("EPSG:32633", (5e5, 5.4e6))
    return AIM(image, PLACE, world, np.ones((40, 60), np.uint16), np.zeros((40, 60), bool))


def functions(path: Path) -> list[ast.FunctionDef]:
    tree = ast.parse(path.read_text())
    return [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]


def arguments(function: ast.FunctionDef) -> list[ast.arg]:
    found = function.args
    return [*found.posonlyargs, *found.args, *found.kwonlyargs]


def test_corner_frame_goes_round_from_the_top_left():
    assert make_aim().corners.tolist() == [[10, 40], [40, 40], [40, 20], [10, 20]]


def test_world_is_metres_from_the_origin_x_east_y_north(tmp_path):
    write_aim(make_aim(), tmp_path / "aim.tif")
    with rasterio.open(tmp_path / "aim.tif") as dataset:
        west, south, east, north = dataset.bounds
    assert (west, east) == (500_010, 500_040)
    assert (south, north) == (5_400_020, 5_400_040)


def test_image_axes_are_u_right_v_down():
    image = rectify(make_aim()).image
    np.testing.assert_array_equal(image, make_aim().image)  # a row down is a step south


def test_pixel_centre_is_half_a_pixel_from_its_corner_as_in_rasterio(tmp_path):
    aim = make_aim()
    write_aim(aim, tmp_path / "aim.tif")
    row, column = 3, 7
    ours = transform_points(PLACE, np.array([[column + 0.5, row + 0.5]]))[0] + aim.world.origin
    with rasterio.open(tmp_path / "aim.tif") as dataset:
        np.testing.assert_allclose(dataset.xy(row, column), ours)


def test_resizing_is_a_pure_scale():
    image = cv2.GaussianBlur(np.random.default_rng(0).random((40, 60)), (0, 0), 3)
    resized = cv2.resize(image, (120, 80), interpolation=cv2.INTER_LINEAR)
    scale = to_opencv(np.diag([2.0, 2.0, 1.0]))
    warped = cv2.warpPerspective(image, scale, (120, 80), flags=cv2.INTER_LINEAR)
    np.testing.assert_allclose(warped[2:-2, 2:-2], resized[2:-2, 2:-2], atol=2e-3)


def test_opencv_has_its_origin_at_the_centre_of_the_first_pixel():
    scale = np.diag([2.0, 2.0, 1.0])
    first_centre = np.array([[0.5, 0.5]])
    theirs = transform_points(to_opencv(scale), first_centre - 0.5)
    np.testing.assert_allclose(theirs, transform_points(scale, first_centre) - 0.5)
    np.testing.assert_array_equal(from_opencv(to_opencv(scale)), scale)


def test_chains_of_transforms_cancel():
    world_from_image, image_from_frame = PLACE, np.diag([0.5, 0.5, 1.0])
    world_from_frame = world_from_image @ image_from_frame
    points = np.array([[4.0, 6.0]])
    image_points = transform_points(image_from_frame, points)
    np.testing.assert_allclose(
        transform_points(world_from_frame, points), transform_points(world_from_image, image_points)
    )


def test_transforms_are_named_destination_first():
    backwards = re.compile(r"\b(frame|reference|image|world)_to_(frame|reference|image|world)\b")
    assert [path.name for path in SOURCES if backwards.search(path.read_text())] == []


def test_points_are_rows_whose_last_axis_has_two_entries():
    assert transform_points(np.eye(3), np.zeros((5, 2))).shape == (5, 2)
    shift = np.array([[1.0, 0, 3], [0, 1.0, 4], [0, 0, 1.0]])  # acts on column vectors
    np.testing.assert_array_equal(transform_points(shift, np.zeros((1, 2))), [[3.0, 4.0]])


def test_height_comes_before_width():
    assert image_corners(20, 30).max(axis=0).tolist() == [30, 20]
    for path in SOURCES:
        for function in functions(path):
            names = [argument.arg for argument in arguments(function)]
            if {"height", "width"} <= set(names):
                assert names.index("height") < names.index("width"), f"{path}: {function.name}"


def test_images_are_rgb_in_files_too(tmp_path):
    aim = make_aim()
    write_aim(aim, tmp_path / "aim.tif")
    with rasterio.open(tmp_path / "aim.tif") as dataset:
        assert [colour.name for colour in dataset.colorinterp[:3]] == ["red", "green", "blue"]
        np.testing.assert_array_equal(dataset.read(1), aim.image[..., 0])


@pytest.mark.usefixtures("unchecked")
def test_images_are_uint8_and_geography_is_float64():
    aim = make_aim()
    with pytest.raises(ValueError, match="uint8"):
        AIM(aim.image / 255.0, PLACE, aim.world, aim.coverage, aim.contested)
    with pytest.raises(ValueError, match="float64"):
        AIM(aim.image, PLACE.astype(np.float32), aim.world, aim.coverage, aim.contested)


def test_what_does_not_exist_is_nan():
    assert np.isnan(transform_points(np.full((3, 3), np.nan), np.zeros((2, 2)))).all()


def test_far_from_the_origin_of_the_crs_points_keep_a_tenth_of_a_millimetre():
    step = transform_points(np.eye(3), np.array([[500_000.0001, 5_400_000.0001]]))
    assert np.abs(step - [[500_000, 5_400_000]]).max() > 5e-5
    assert transform_points(np.eye(3, dtype=np.float32), np.zeros((1, 2))).dtype == np.float64


def test_randomness_comes_through_an_argument_named_generator():
    for path in SOURCES:
        text = path.read_text()
        assert "cv2.setRNGSeed" not in text, path  # ruff refuses numpy's own
        for function in functions(path):
            for argument in arguments(function):
                kind = ast.unparse(argument.annotation) if argument.annotation else ""
                if "Generator" in kind and "random" in kind:
                    assert argument.arg == "generator", f"{path}: {function.name}"


def test_every_error_about_data_is_a_geoaim_error():
    kinds = [kind for _, kind in inspect.getmembers(errors, inspect.isclass)]
    assert len(kinds) > 5
    for kind in kinds:
        assert issubclass(kind, errors.GeoaimError | errors.GeoaimWarning)
        assert kind.__dict__["__doc__"]
