import numpy as np
import pytest

from geoaim.base.errors import GeoaimWarning
from geoaim.imagery.collars import find_collars, hide_collars
from geoaim.imagery.mosaic import read_imagery
from tests.imagery.alignment.alignment_pairs import as_aim


@pytest.fixture
def picture():
    """Ground inside a turned square, white around it; a white roof and a dark pond inside."""
    image = np.random.default_rng(0).integers(60, 190, (300, 400, 3), np.uint8)
    rows, columns = np.indices(image.shape[:2])
    outside = np.abs(rows - 150) + np.abs(columns - 200) > 210
    image[outside] = 255
    image[140:170, 190:220] = 255
    image[100:115, 180:200] = 0
    return image, outside


@pytest.mark.parametrize("white", [255, 252])
def test_white_at_the_edge_is_a_collar_and_a_roof_is_not(picture, white):
    image, outside = picture
    image = np.minimum(image, white).astype(np.uint8)
    found = find_collars(image, np.ones(outside.shape, bool))
    assert found[outside].all()
    assert found.sum() < 1.2 * outside.sum()
    assert not found[130:180, 180:230].any()


def test_collar_around_uncovered_ground_is_found(picture):
    image, outside = picture
    covered = np.ones(outside.shape, bool)
    covered[:10] = False
    assert find_collars(image, covered)[outside & covered].mean() > 0.99


def test_picture_without_a_collar_stays(picture):
    image, outside = picture
    image = np.where(outside[..., None], np.uint8(200), image)
    assert not find_collars(image, np.ones(outside.shape, bool)).any()
    white = as_aim(np.full((50, 60, 3), 255, np.uint8), np.diag([1.0, -1.0, 1.0]))
    assert hide_collars(white, "white.png").coverage.all()


def test_collar_of_a_file_without_nodata_shows_nothing(picture, tmp_path):
    import rasterio

    image, outside = picture
    path = tmp_path / "a.tif"
    profile = {"driver": "GTiff", "height": 300, "width": 400, "count": 3, "dtype": "uint8"}
    place = {"crs": "EPSG:32632", "transform": rasterio.Affine(0.5, 0, 5e5, 0, -0.5, 5e6)}
    with rasterio.open(path, "w", **profile, **place) as file:
        file.write(np.moveaxis(image, -1, 0))
    with pytest.warns(GeoaimWarning, match="of the image is plain white or black at its edge"):
        aim = read_imagery(path)
    assert (aim.coverage > 0).mean() == pytest.approx((~outside).mean(), abs=0.05)
    assert (read_imagery(path, nodata="none").coverage > 0).all()
    with rasterio.open(path, "r+") as file:
        file.nodata = 255
    roof = read_imagery(path).coverage[140:170, 190:220]
    assert not roof.any()  # the file says so
