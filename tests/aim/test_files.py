import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rasterio
import rasterio.shutil
from hypothesis import given
from hypothesis import strategies as st
from rasterio.enums import ColorInterp

from geoaim.aim.aim import AIM
from geoaim.aim.files import read_aim, write_aim
from geoaim.aim.rectification import rectify
from geoaim.base.errors import AimError, GeoaimWarning
from geoaim.base.geometry import transform_points
from geoaim.base.world import World
from tests.aim.test_aim import TURNED, UTM, make_aim
from tests.aim.test_rectification import OBLIQUE, painted_aim

json_values = st.recursive(
    st.none() | st.booleans() | st.integers(-(2**53), 2**53) | st.floats() | st.text(max_size=20),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=9), inner),
    max_leaves=8,
)


def assert_same(first: AIM, second: AIM) -> None:
    for name in ("image", "world_from_image", "coverage", "contested"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    assert first.world == second.world
    assert first.report == second.report


@given(
    size=st.tuples(st.integers(1, 70), st.integers(1, 70)),
    turn=st.floats(-3.1, 3.1),
    pixel=st.floats(1e-3, 5.0),
    shift=st.tuples(st.floats(-1e4, 1e4), st.floats(-1e4, 1e4)),
    world=st.sampled_from(
        [UTM, World(None), World(None, (3.0, -4.0)), World("EPSG:5186", (2e5, 5.5e5))]
    ),
    report=st.dictionaries(st.text(max_size=9), json_values, max_size=4),
    seed=st.integers(0, 99),
)
def test_a_written_aim_is_read_back_exactly(
    tmp_path, size, turn, pixel, shift, world, report, seed
):
    cos, sin = pixel * np.cos(turn), pixel * np.sin(turn)
    place = np.array([[cos, sin, shift[0]], [sin, -cos, shift[1]], [0.0, 0.0, 1.0]])
    aim = make_aim(*size, place=place, world=world, seed=seed, report=report)
    write_aim(aim, tmp_path / "aim.tif")
    assert_same(read_aim(tmp_path / "aim.tif"), aim)


def test_an_image_with_pixels_of_one_metre_is_read_back(tmp_path):
    aim = make_aim(place=np.eye(3), world=World(None))
    write_aim(aim, tmp_path / "aim.tif")
    assert_same(read_aim(tmp_path / "aim.tif"), aim)


def test_rasterio_puts_a_pixel_centre_where_the_aim_does(tmp_path):
    aim = make_aim()
    write_aim(aim, tmp_path / "aim.tif")
    row, column = 31, 7
    world = transform_points(aim.world_from_image, np.array([[column + 0.5, row + 0.5]]))[0]
    with rasterio.open(tmp_path / "aim.tif") as dataset:
        assert dataset.crs.to_epsg() == 32633
        np.testing.assert_allclose(dataset.xy(row, column), world + UTM.origin, atol=1e-6)
        np.testing.assert_array_equal(
            dataset.read([1, 2, 3])[:, row, column], aim.image[row, column]
        )


def test_file_is_a_tiled_lossless_cog_that_shows_colours_and_transparency(tmp_path):
    aim = make_aim(700, 1100)
    aim.coverage[:50] = 0
    write_aim(aim, tmp_path / "aim.tif")
    with rasterio.open(tmp_path / "aim.tif") as dataset:
        assert dataset.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
        assert dataset.tags(ns="IMAGE_STRUCTURE")["COMPRESSION"] == "DEFLATE"
        assert dataset.tags(ns="IMAGE_STRUCTURE")["PREDICTOR"] == "2"
        assert dataset.profile["tiled"]
        assert dataset.overviews(1) == [2, 4]
        assert dataset.colorinterp == (ColorInterp.red, ColorInterp.green, ColorInterp.blue)
        assert not dataset.subdatasets  # QGIS would ask which one is meant
        np.testing.assert_array_equal(dataset.dataset_mask() > 0, aim.coverage > 0)


def test_coverage_and_contested_are_a_second_geotiff_that_the_first_names(tmp_path):
    path, aim = tmp_path / "a b,ü.tif", make_aim(700, 1100)
    write_aim(aim, path)
    with (
        rasterio.open(path) as dataset,
        rasterio.open(f"{dataset.tags()['GEOAIM_DOUBT']}{path}") as doubt,
    ):
        assert (doubt.crs, doubt.transform) == (dataset.crs, dataset.transform)
        assert doubt.descriptions == ("coverage", "contested")
        np.testing.assert_array_equal(doubt.read(1), aim.coverage)
        np.testing.assert_array_equal(doubt.read(2) > 0, aim.contested)


def test_the_default_picture_of_rio_tiler_shows_colours_and_mask(tmp_path):
    rio_tiler = pytest.importorskip("rio_tiler.io", reason="pip install rio-tiler")
    aim = make_aim(300, 400)
    aim.coverage[:], aim.coverage[:50] = 3, 0
    write_aim(aim, tmp_path / "aim.tif")
    with rio_tiler.Reader(tmp_path / "aim.tif") as reader:
        picture = reader.preview()
        assert reader.info().nodata_type == "Mask"
    np.testing.assert_array_equal(np.moveaxis(picture.data, 0, -1), aim.image)
    np.testing.assert_array_equal(picture.mask > 0, aim.coverage > 0)
    assert picture.render(img_format="PNG").startswith(b"\x89PNG")


def test_report_can_be_read_by_any_program_from_the_tags(tmp_path):
    report = {"rmse_m": np.float64(0.04), "absent": np.nan, "names": ("A", "ß"), "n": np.arange(2)}
    write_aim(make_aim(report=report), tmp_path / "aim.tif")
    with rasterio.open(tmp_path / "aim.tif") as dataset:
        found = json.loads(dataset.tags()["GEOAIM_REPORT"])
    assert found == {"rmse_m": 0.04, "absent": None, "names": ["A", "ß"], "n": [0, 1]}


def test_long_report_stays_inside_the_file(tmp_path):
    report = {"reasons": ["too few inliers & a cut"] * 20_000}
    write_aim(make_aim(report=report), tmp_path / "aim.tif")
    assert read_aim(tmp_path / "aim.tif").report == report
    assert [path.name for path in tmp_path.iterdir()] == ["aim.tif"]


def test_world_without_crs_is_written_without_one(tmp_path):
    write_aim(make_aim(world=World(None)), tmp_path / "aim.tif")
    with rasterio.open(tmp_path / "aim.tif") as dataset:
        assert dataset.crs is None
        np.testing.assert_allclose(np.array(dataset.transform).reshape(3, 3), TURNED)


def test_oblique_aim_is_rectified_when_written(tmp_path):
    aim = painted_aim(200, 300, OBLIQUE)
    write_aim(aim, tmp_path / "aim.tif")
    found = read_aim(tmp_path / "aim.tif")
    assert_same(found, rectify(aim))
    assert found.is_affine


def test_resolution_of_the_file_can_be_chosen(tmp_path):
    write_aim(rectify(painted_aim(200, 300, TURNED), 0.2), tmp_path / "aim.tif")
    with rasterio.open(tmp_path / "aim.tif") as dataset:
        assert dataset.res == (0.2, 0.2)


def test_an_orthophoto_is_refused_and_described(tmp_path):
    path = tmp_path / "ortho.tif"
    profile = {"driver": "GTiff", "height": 8, "width": 8, "count": 3, "dtype": "uint16"}
    place = rasterio.Affine(0.5, 0, 4e5, 0, -0.5, 5e6)
    with rasterio.open(path, "w", **profile, crs="EPSG:32633", transform=place):
        pass
    with pytest.raises(AimError, match=r"3 band\(s\) of uint16, CRS EPSG:32633, and no GEOAIM tag"):
        read_aim(path)


def test_a_file_that_is_not_a_raster_is_refused(tmp_path):
    (tmp_path / "aim.tif").write_text("not a picture")
    with pytest.raises(AimError, match="not a readable GeoTIFF"):
        read_aim(tmp_path / "aim.tif")


def test_truncated_file_is_refused(tmp_path):
    write_aim(make_aim(600, 600), tmp_path / "aim.tif")
    whole = (tmp_path / "aim.tif").read_bytes()
    (tmp_path / "aim.tif").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(AimError, match="is damaged"):
        read_aim(tmp_path / "aim.tif")


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"nowhere\.tif"):
        read_aim(tmp_path / "nowhere.tif")


def crop(path: Path, out: Path, **changes) -> None:
    """What a GIS program does to a file when it exports a part of it."""
    with rasterio.open(path) as source:
        window = rasterio.windows.Window(10, 5, 20, 16)
        profile = source.profile | {"height": 16, "width": 20, "driver": "GTiff"}
        profile |= {"transform": source.window_transform(window), **changes}
        for key in ("blockxsize", "blockysize", "tiled"):
            profile.pop(key)
        bands = list(range(1, profile["count"] + 1))
        with rasterio.open(out, "w", **profile) as target:
            target.write(source.read(bands, window=window))
            target.descriptions = source.descriptions[: len(bands)]
            target.update_tags(**source.tags())


def test_a_cropped_file_keeps_its_position(tmp_path):
    aim = make_aim()
    write_aim(aim, tmp_path / "aim.tif")
    crop(tmp_path / "aim.tif", tmp_path / "part.tif")
    with pytest.warns(GeoaimWarning, match="as if every pixel were of one frame and sure"):
        part = read_aim(tmp_path / "part.tif")
    np.testing.assert_array_equal(part.image, aim.image[5:21, 10:30])
    assert not part.contested.any()
    corner = transform_points(aim.world_from_image, np.array([[10.0, 5.0]]))
    np.testing.assert_allclose(part.corners[:1], corner, atol=1e-6)


@pytest.mark.parametrize(
    "options",
    [
        {"driver": "COG", "compress": "deflate", "predictor": "yes"},
        {"driver": "COG", "compress": "deflate", "predictor": "yes", "level": 9},
        {"driver": "COG", "compress": "zstd"},
        {"driver": "GTiff"},
    ],
)
def test_a_copy_of_a_gis_program_is_read(tmp_path, options):
    aim = make_aim(700, 600)
    write_aim(aim, tmp_path / "aim.tif")
    rasterio.shutil.copy(tmp_path / "aim.tif", tmp_path / "copy.tif", **options)
    with pytest.warns(GeoaimWarning, match="written anew by another program"):
        found = read_aim(tmp_path / "copy.tif")
    seen = (aim.coverage > 0).astype(np.uint16)
    assert_same(found, replace(aim, coverage=seen, contested=np.zeros_like(aim.contested)))


def test_reprojected_file_is_refused(tmp_path):
    write_aim(make_aim(), tmp_path / "aim.tif")
    crop(tmp_path / "aim.tif", tmp_path / "part.tif", crs="EPSG:32634")
    with pytest.raises(AimError, match="reprojected"):
        read_aim(tmp_path / "part.tif")


def test_file_that_lost_a_colour_is_refused(tmp_path):
    write_aim(make_aim(), tmp_path / "aim.tif")
    crop(tmp_path / "aim.tif", tmp_path / "part.tif", count=2)
    with pytest.raises(AimError, match="lost bands"):
        read_aim(tmp_path / "part.tif")


def test_file_of_a_later_format_is_refused(tmp_path):
    write_aim(make_aim(), tmp_path / "aim.tif")
    with rasterio.open(tmp_path / "aim.tif", "r+", IGNORE_COG_LAYOUT_BREAK="YES") as dataset:
        frame = json.loads(dataset.tags()["GEOAIM"])
        dataset.update_tags(GEOAIM=json.dumps(frame | {"format": 4}))
    with pytest.raises(AimError, match="format 4"):
        read_aim(tmp_path / "aim.tif")


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError, AimError])
def test_a_failed_write_leaves_the_old_file_and_no_temporary_files(tmp_path, monkeypatch, error):
    write_aim(make_aim(), tmp_path / "aim.tif")
    old = (tmp_path / "aim.tif").read_bytes()

    def fail(*_):
        raise error

    monkeypatch.setattr("geoaim.aim.files._write_bands", fail)
    with pytest.raises(AimError if error is OSError else error):
        write_aim(make_aim(seed=1), tmp_path / "aim.tif")
    assert (tmp_path / "aim.tif").read_bytes() == old
    assert [path.name for path in tmp_path.iterdir()] == ["aim.tif"]


FULL_DISK = """
import resource, signal, sys
sys.path[:0] = {path!r}
from tests.aim.test_aim import make_aim
from geoaim.aim.files import write_aim
aim = make_aim(600, 600)
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000))
write_aim(aim, {out!r})
"""


@pytest.mark.slow
def test_full_disk_is_an_error_and_leaves_no_file(tmp_path):
    pytest.importorskip("resource", reason="needs POSIX limits to stand for a full disk")
    script = FULL_DISK.format(path=[str(Path(__file__).parents[2])], out=str(tmp_path / "aim.tif"))
    found = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert "AimError" in found.stderr
    assert "could not be written" in found.stderr
    assert list(tmp_path.iterdir()) == []
