import warnings

import cv2
import numpy as np
import pytest
import rasterio
import rasterio.shutil
from rasterio.enums import ColorInterp

from geoaim.base.errors import ImageryError
from geoaim.imagery.mosaic import read_imagery
from tests.imagery.painted_ground import HERE, WORLD, constant, flat, place_around, write


def test_one_band_is_grey(tmp_path):
    aim = read_imagery(flat(tmp_path, constant(77)), world=WORLD)
    assert (aim.image == 77).all()


def test_fourth_band_that_is_not_alpha_is_ignored(tmp_path):
    path = flat(tmp_path, constant(10, 20, 30, 0), photometric="rgb", alpha="no")
    with rasterio.open(path) as dataset:
        assert dataset.colorinterp[3] != ColorInterp.alpha
    aim = read_imagery(path, world=WORLD)
    assert (aim.image == [10, 20, 30]).all()
    assert aim.coverage.all()


def test_bands_are_chosen_by_colour_interpretation_or_number(tmp_path):
    path = flat(tmp_path, constant(10, 20, 30, 40))
    with rasterio.open(path, "r+") as dataset:
        dataset.colorinterp = [
            ColorInterp.blue,
            ColorInterp.green,
            ColorInterp.red,
            ColorInterp.undefined,
        ]
    assert (read_imagery(path, world=WORLD).image == [30, 20, 10]).all()
    assert (read_imagery(path, world=WORLD, bands=[4, 3, 2]).image == [40, 30, 20]).all()
    assert (read_imagery(path, world=WORLD, bands=[2]).image == 20).all()
    with pytest.raises(ImageryError, match=r"has 4 band\(s\), and bands \[5\] were wanted"):
        read_imagery(path, world=WORLD, bands=[5])
    with pytest.raises(ValueError, match="one for grey or three"):
        read_imagery(path, world=WORLD, bands=[1, 2])


def test_bands_are_chosen_by_their_names(tmp_path):
    path = flat(tmp_path, constant(10, 20, 30, 40), alpha="no")
    with rasterio.open(path, "r+") as dataset:
        dataset.descriptions = ("Blue", "Green", "Red", "NIR")
    assert (read_imagery(path, world=WORLD).image == [30, 20, 10]).all()


@pytest.mark.parametrize("dtype", ["uint8", "uint16"])
def test_white_that_is_0_is_white(tmp_path, dtype):
    ramp = np.tile(np.arange(20, 120, dtype=dtype), (1, 80, 1))
    path = flat(tmp_path, ramp, photometric="miniswhite")
    row = read_imagery(path, world=WORLD).image[40, :, 0].astype(int)
    assert row[5] > row[-5] + 80


def test_black_that_jpeg_blurs_beside_nodata_shows_nothing(tmp_path):
    bands = np.random.default_rng(0).integers(90, 160, (3, 256, 256), dtype=np.uint8)
    bands[:, :40] = 0
    path = flat(tmp_path, bands, nodata=255, compress="JPEG", photometric="YCBCR", tiled=True)
    with pytest.warns(UserWarning, match="17% of the image is plain white or black"):
        aim = read_imagery(path, world=WORLD)
    assert not aim.coverage[:40].any()
    assert aim.coverage[50:].all()


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_the_least_number_as_nodata_is_no_overflow(tmp_path, dtype):
    bands = np.random.default_rng(0).uniform(0, 1, (1, 80, 80)).astype(dtype)
    least = float(np.finfo(dtype).min)
    bands[:, :20] = least
    path = flat(tmp_path, bands, nodata=least)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        aim = read_imagery(path, world=WORLD)
    assert not aim.coverage[:18].any()
    assert aim.coverage[22:].all()


def test_image_with_a_world_file_needs_a_crs(tmp_path):
    image = np.random.default_rng(0).integers(0, 256, (40, 60, 3), dtype=np.uint8)
    for name, world_file in (("a.png", "a.pgw"), ("b.png", "b.wld"), ("c.jpg", "c.jgw")):
        cv2.imwrite(str(tmp_path / name), image[..., ::-1])
        # a world file gives the first pixel's centre
        text = f"0.5\n0\n0\n-0.5\n{HERE[0] + 0.25}\n{HERE[1] - 0.25}\n"
        (tmp_path / world_file).write_text(text)
        with pytest.raises(ImageryError, match=r"names no coordinate.* crs='EPSG:"):
            read_imagery(tmp_path / name)
        aim = read_imagery(tmp_path / name, world=WORLD, crs="EPSG:32633")
        np.testing.assert_allclose(aim.corners[0], [0, 0], atol=1e-6)
        if name.endswith("png"):
            np.testing.assert_array_equal(aim.image, image)


@pytest.mark.parametrize(
    ("crs", "transform", "message"),
    [
        ("EPSG:32633", (0.2, 5.34e6, -0.2, 6e5), "outside the area .* are x and y swapped"),
        ("EPSG:32633", (0.66, 6e5 / 0.3048, -0.66, 5.34e6 / 0.3048), "are they feet"),
        ("EPSG:32633", (3e-6, 16.3, -2e-6, 48.2), "all of it lies within .* are they degrees"),
        ("EPSG:4326", (0.2, 6e5, -0.2, 5.34e6), "is the CRS the right one"),
    ],
)
def test_a_raster_outside_the_area_of_its_crs_is_refused(tmp_path, crs, transform, message):
    step, left, down, top = transform
    place = np.array([[step, 0, left], [0, down, top], [0, 0, 1]])
    path = write(tmp_path / "a.tif", constant(1, 2, 3), crs, place)
    with pytest.raises(ImageryError, match=message):
        read_imagery(path)


def test_a_crs_of_a_site_by_itself_counts_as_none(tmp_path):
    site = 'LOCAL_CS["site",UNIT["metre",1]]'
    path = write(tmp_path / "a.tif", constant(1, 2, 3), site, place_around("EPSG:32633", 1, (9, 9)))
    with pytest.raises(ImageryError, match="names no coordinate reference system"):
        read_imagery(path)
    assert read_imagery(path, crs="EPSG:32633").world.crs == "EPSG:32633"


def test_truncated_jpeg_is_refused(tmp_path):
    image = np.random.default_rng(0).integers(0, 256, (200, 200, 3), dtype=np.uint8)
    whole = cv2.imencode(".jpg", image)[1].tobytes()
    (tmp_path / "a.jpg").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "a.jgw").write_text("0.5\n0\n0\n-0.5\n600000\n5340000\n")
    with pytest.raises(ImageryError, match=r"a\.jpg cannot be read"):
        read_imagery(tmp_path / "a.jpg", crs="EPSG:32633")


def test_truncated_geotiff_is_refused(tmp_path):
    path = flat(tmp_path, np.random.default_rng(0).integers(1, 255, (3, 300, 300), dtype=np.uint8))
    path.write_bytes(path.read_bytes()[:50_000])
    with pytest.raises(ImageryError, match=r"a\.tif cannot be read"):
        read_imagery(path, world=WORLD)


def test_image_without_a_place_is_refused(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((8, 8, 3), np.uint8))
    with pytest.raises(ImageryError, match=r"no transform.* put a world file .*beside it"):
        read_imagery(tmp_path / "a.png", crs="EPSG:32633")


@pytest.mark.usefixtures("unchecked")
def test_images_that_are_decoded_in_one_huge_piece_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("geoaim.imagery.rasters.MAX_BLOCK_PIXELS", 1000)
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((40, 40, 3), np.uint8))
    with pytest.raises(ImageryError, match="40 x 40 pixels in one piece"):
        read_imagery(tmp_path / "a.png")
    path = flat(tmp_path, constant(9), tiled=True, blockxsize=16, blockysize=16)
    assert read_imagery(path, world=WORLD).coverage.all()
