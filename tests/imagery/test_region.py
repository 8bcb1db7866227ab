import numpy as np
import pytest
from rasterio.transform import from_origin

from geoaim.base.errors import GeoaimWarning, ImageryError
from geoaim.base.world import choose_world, lonlat_from_world
from geoaim.imagery.mosaic import read_imagery
from tests.imagery.painted_ground import BOX, WORLD, constant, misplaced, ortho, write


def test_whole_imagery_lies_in_the_utm_world_around_it(tmp_path):
    path = ortho(tmp_path / "a.tif", "EPSG:4326")
    aim = read_imagery(path)
    assert aim.world == choose_world(lonlat_from_world(WORLD, np.zeros((1, 2))))
    assert aim.report["resolution_m"] == pytest.approx(0.5, rel=1e-3)
    assert aim.coverage.mean() > 0.95
    assert misplaced(aim, 15.0) < 0.02


def test_huge_extent_needs_a_region(tmp_path):
    place = np.array(from_origin(0, 60, 0.1, 0.1)).reshape(3, 3)
    path = write(tmp_path / "a.tif", constant(9, side=100), "EPSG:4326", place)
    with pytest.raises(ImageryError, match="10 by 10 degrees"):
        read_imagery(path)


def test_source_that_lies_elsewhere_is_left_out_with_a_warning(tmp_path):
    near, far = ortho(tmp_path / "near.tif"), tmp_path / "far.tif"
    write(far, constant(9), "EPSG:32635", np.array([[1.0, 0, 6e5], [0, -1, 0], [0, 0, 1]]))
    with pytest.warns(GeoaimWarning, match=r"far\.tif covers longitude 27\.89.* is needed in lon"):
        aim = read_imagery([far, near], world=WORLD, corners=BOX)
    assert aim.coverage.all()
    with pytest.raises(ImageryError, match=r"far\.tif covers longitude 27\.89.* is needed in lon"):
        read_imagery(far, world=WORLD, corners=BOX)
