import cv2
import numpy as np
import pytest
import rasterio
import rasterio.shutil
from rasterio.enums import ColorInterp
from rasterio.transform import Affine, from_origin

from geoaim.imagery import resampling
from geoaim.imagery.mosaic import read_imagery
from geoaim.imagery.rasters import open_raster
from tests.imagery.painted_ground import (
    BOX,
    HERE,
    WORLD,
    constant,
    flat,
    misplaced,
    ortho,
    painted,
    place_around,
    write,
)

FEET = "+proj=utm +zone=33 +datum=WGS84 +units=us-ft +no_defs"
CRSES = ["EPSG:32633", "EPSG:32634", "EPSG:4326", "EPSG:3857", "EPSG:31256", "EPSG:3416"]


@pytest.mark.parametrize("crs", CRSES)
@pytest.mark.parametrize("ratio", [0.4, 1.0, 1.5, 2.7, 7.3])
def test_pixels_show_their_own_place(tmp_path, crs, ratio):
    pixel, shape = 0.4 / max(ratio, 1.0), (300, 300)
    wave = 12.0 * max(ratio * pixel, pixel)
    place = place_around(crs, pixel, shape)
    path = write(tmp_path / "a.tif", painted(crs, place, shape, wave), crs, place)
    reach = (0.2 if ratio < 1 else 0.4) * 300 * pixel
    corners = np.array([[-reach, -reach], [reach, reach]])
    aim = read_imagery(path, world=WORLD, corners=corners, resolution=ratio * pixel)
    assert aim.coverage.all()
    assert misplaced(aim, wave) < 0.02


def test_a_coarse_file_is_opened_once_for_all_of_its_blocks(tmp_path, monkeypatch):
    opened = []

    def count(path, options):
        opened.append(path)
        return open_raster(path, options)

    monkeypatch.setattr(resampling, "open_raster", count)
    place = np.array([[0.004, 0, 15.5], [0, -0.004, 48.7], [0, 0, 1]])
    path = write(tmp_path / "a.tif", constant(1, 2, 3, side=200), "EPSG:4326", place)
    read_imagery(path)  # of over 100 blocks: degrees are no affine map of metres
    assert len(opened) == 1


@pytest.mark.parametrize("crs", ["EPSG:25833", "EPSG:3035", FEET])
def test_further_crs_show_their_own_place(tmp_path, crs):
    place = place_around(crs, 0.4, (300, 300))
    path = write(tmp_path / "a.tif", painted(crs, place, (300, 300), 12.0), crs, place)
    aim = read_imagery(path, world=WORLD, corners=BOX / 2, resolution=0.4)
    assert aim.coverage.all()
    assert misplaced(aim, 12.0) < 0.02


@pytest.mark.parametrize("turn", [0.3, -1.2, 3.0])
def test_rotated_raster_is_rotated_back(tmp_path, turn):
    place = place_around("EPSG:32633", 0.25, (250, 200), turn)
    bands = painted("EPSG:32633", place, (250, 200), 8.0)
    path = write(tmp_path / "a.tif", bands, "EPSG:32633", place)
    assert misplaced(read_imagery(path, world=WORLD, resolution=0.3), 8.0) < 0.02


@pytest.mark.parametrize("resolution", [0.23, 0.5, 0.7, 1.9])
@pytest.mark.parametrize("kind", ["alpha", "grey alpha", "nodata", "mask"])
def test_holes_stay_holes_and_do_not_darken_their_rims(tmp_path, kind, resolution):
    hole = np.zeros((80, 80), bool)
    hole[:, 50:] = True
    hole[20:28, 20:28] = True
    bands = constant(*{"alpha": (200, 150, 100, 255), "grey alpha": (180, 255)}.get(kind, (180,)))
    bands[:, hole] = 0
    path = flat(tmp_path, bands, nodata=0 if kind == "nodata" else None)
    with rasterio.open(path, "r+") as dataset:
        if "alpha" in kind:
            dataset.colorinterp = [*dataset.colorinterp[:-1], ColorInterp.alpha]
        if kind == "mask":
            dataset.write_mask(~hole)
    aim = read_imagery(path, world=WORLD, corners=BOX / 10, resolution=resolution)
    size = aim.coverage.shape[::-1]
    truth = cv2.resize((~hole[32:48, 28:52]).astype(np.float32), size, interpolation=cv2.INTER_AREA)
    assert (aim.coverage[truth > 0.99] == 1).mean() > 0.97
    seen = read_imagery(path, world=WORLD, resolution=resolution)
    colours = [200, 150, 100] if kind == "alpha" else [180] * 3
    assert np.abs(seen.image[seen.coverage > 0].astype(int) - colours).max() <= 1
    assert seen.coverage.sum() * resolution**2 == pytest.approx(
        (~hole).sum() / 4, rel=0.05 if resolution < 1 else 0.12
    )


def test_palette_is_expanded_and_its_transparency_kept(tmp_path):
    bands = constant(1)
    bands[0, :, 40:] = 2
    bands[0, 40:] = 3
    path = flat(tmp_path, bands, photometric="palette")
    with rasterio.open(path, "r+") as dataset:
        dataset.write_colormap(1, {1: (250, 10, 20, 255), 2: (0, 200, 9, 255), 3: (7, 7, 7, 255)})
    aim = read_imagery(path, world=WORLD)
    assert (aim.image[:40, :40] == [250, 10, 20]).all()
    assert (aim.image[:40, 40:] == [0, 200, 9]).all()
    assert (aim.image[40:] == 7).all()


@pytest.mark.parametrize("dtype", ["uint16", "int16", "float32", "float64"])
def test_deep_values_are_stretched_jointly_over_bands(tmp_path, dtype):
    ramp = np.linspace(300, 1300, 80 * 80).reshape(80, 80)
    path = flat(tmp_path, np.stack([ramp, ramp / 2, ramp]).astype(dtype))
    aim = read_imagery(path, world=WORLD)
    low, high = aim.report["imagery"][0]["stretch"]
    assert (low, high) == pytest.approx(np.percentile([ramp, ramp / 2, ramp], [1, 99]), rel=0.01)
    wanted = np.clip((ramp - low) / (high - low) * 255, 0, 255)
    assert np.abs(aim.image[..., 0] - wanted).max() <= 1
    wanted = np.clip((ramp / 2 - low) / (high - low) * 255, 0, 255)
    assert np.abs(aim.image[..., 1] - wanted).max() <= 1


def test_values_that_are_not_finite_are_holes(tmp_path):
    bands = np.linspace(0, 1, 6400, dtype=np.float32).reshape(1, 80, 80)
    bands[0, 10:20, 30:50] = np.nan
    bands[0, 60, 60] = np.inf
    aim = read_imagery(flat(tmp_path, bands), world=WORLD)
    assert (aim.coverage == 0).sum() == 201
    assert (aim.coverage[10:20, 30:50] == 0).all()


def test_deep_constant_has_a_colour(tmp_path):
    aim = read_imagery(flat(tmp_path, constant(500, dtype="uint16")), world=WORLD)
    assert len(np.unique(aim.image)) == 1
    mostly = constant(0, dtype="uint16")
    mostly[0, :3, :3] = 9
    image = read_imagery(flat(tmp_path, mostly, "b.tif"), world=WORLD).image
    assert image[0, 0, 0] == 255
    assert image[-1, -1, 0] == 0


def test_alpha_of_16_bits_is_understood(tmp_path):
    bands = constant(1000, 2000, 3000, 65535, dtype="uint16")
    bands[0, :40] = 500
    bands[3, :, :40] = 0
    path = flat(tmp_path, bands, photometric="rgb", alpha="yes")
    aim = read_imagery(path, world=WORLD)
    assert not aim.coverage[:, :40].any()
    assert aim.coverage[:, 40:].all()
    assert aim.report["imagery"][0]["stretch"] == [500.0, 3000.0]


WIDE = (1024, 1024), 15.0


@pytest.fixture
def read_pixels(monkeypatch):
    """The numbers of pixels in the windows that are read from rasters from now on."""
    counts, read = [], resampling._read

    def note(raster, window, *rest):
        counts.append(window.width * window.height)
        return read(raster, window, *rest)

    monkeypatch.setattr(resampling, "_read", note)
    return counts


def test_huge_raster_is_cut_without_reading_it(tmp_path, read_pixels):
    side = 60_000
    place = np.array(from_origin(*(HERE - [side / 20, -side / 20]), 0.1, 0.1)).reshape(3, 3)
    path = tmp_path / "a.tif"
    profile = {"driver": "GTiff", "height": side, "width": side, "count": 3, "dtype": "uint8"}
    options = {"tiled": True, "SPARSE_OK": "TRUE", "compress": "deflate", "BIGTIFF": "YES"}
    transform = Affine(*place[:2].flat)
    with rasterio.open(
        path, "w", **profile, **options, crs="EPSG:32633", transform=transform
    ) as dataset:
        middle = painted("EPSG:32633", place @ [[1, 0, 29488], [0, 1, 29488], [0, 0, 1]], *WIDE)
        dataset.write(middle, window=rasterio.windows.Window(29488, 29488, 1024, 1024))
    aim = read_imagery(path, world=WORLD, corners=BOX / 2)
    assert misplaced(aim, 15.0) < 0.02
    assert 0 < sum(read_pixels) < 2 * aim.coverage.size  # the raster has 5000 times as many


def test_coarse_images_are_read_from_overviews(tmp_path):
    path = flat(tmp_path, constant(10, 20, 30, side=256))
    with rasterio.open(path, "r+") as dataset:
        dataset.build_overviews([8], rasterio.enums.Resampling.nearest)
        dataset.write(constant(70, 70, 70, side=256))  # the overviews keep the old colours
    assert read_imagery(path, world=WORLD).image[128, 128].tolist() == [70, 70, 70]
    assert read_imagery(path, world=WORLD, resolution=8.0).image[8, 8].tolist() == [10, 20, 30]


def test_more_is_not_read_than_the_image_needs(tmp_path, monkeypatch):
    read = []

    def noted(source, *rest):
        read.append(source.size)
        return convolve(source, *rest)

    convolve = resampling._convolve
    monkeypatch.setattr(resampling, "_convolve", noted)
    aim = read_imagery(ortho(tmp_path / "a.tif", pixel=0.1, side=700), world=WORLD, resolution=1.3)
    assert max(read) < 4 * 4 * aim.coverage.size
