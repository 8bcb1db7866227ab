import numpy as np
import pytest

from geoaim.aim.files import read_aim, write_aim
from geoaim.base.errors import AimError, GeoaimWarning, ImageryError
from geoaim.base.world import World
from geoaim.imagery.mosaic import read_imagery
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


def test_raster_on_the_grid_is_returned_as_it_is(tmp_path):
    bands = np.random.default_rng(0).integers(0, 256, (3, 90, 120), dtype=np.uint8)
    place = np.array([[0.5, 0, HERE[0] - 30], [0, -0.5, HERE[1] + 20], [0, 0, 1]])
    path = write(tmp_path / "a.tif", bands, "EPSG:32633", place)
    aim = read_imagery(path, world=WORLD)
    np.testing.assert_array_equal(aim.image, np.moveaxis(bands, 0, -1))
    np.testing.assert_allclose(aim.corners[0], [-30, 20])
    assert aim.report["imagery"][0] == {
        "name": str(path),
        "rasters": 1,
        "crs": ["EPSG:32633"],
        "resolution_m": pytest.approx(0.5),
        "bands": [[1, 2, 3]],
        "zoom": None,
        "stretch": None,
        "share": 1.0,
        "unreadable": [],
    }
    write_aim(aim, tmp_path / "aim.tif")
    np.testing.assert_array_equal(read_aim(tmp_path / "aim.tif").image, aim.image)


def test_corners_outside_the_imagery_are_covered_by_nothing(tmp_path):
    path = ortho(tmp_path / "a.tif")
    aim = read_imagery(path, world=WORLD, corners=BOX + np.array([70.0, 0.0]), resolution=1.0)
    east = 80.0 - 10.0  # the imagery's edge, in pixels of the image
    assert aim.coverage[:, : int(east) - 1].all()
    assert not aim.coverage[:, int(east) + 1 :].any()
    assert (aim.image[aim.coverage == 0] == 0).all()
    assert aim.report["covered"] == pytest.approx(aim.coverage.mean())


def test_earlier_sources_lie_on_top(tmp_path):
    small = constant(50, side=40)
    small[0, 10:20, 10:20] = 0
    over = flat(tmp_path, small, "over.tif", nodata=0)
    under = flat(tmp_path, constant(150), "under.tif")
    aim = read_imagery([over, under], world=WORLD)
    middle = aim.image[20:60, 20:60, 0]
    assert (middle[10:20, 10:20] == 150).all()
    assert (middle[:10] == 50).all()
    assert (aim.image[:20] == 150).all()
    shares = [row["share"] for row in aim.report["imagery"]]
    assert shares == pytest.approx([1500 / 6400, 4900 / 6400])
    assert (read_imagery([under, over], world=WORLD).image == 150).all()


@pytest.mark.parametrize("resolution", [0.21, 0.5, 0.9, 2.3])
def test_adjacent_rasters_leave_no_seam(tmp_path, resolution):
    place = place_around("EPSG:4326", 0.5, (300, 300))
    bands = painted("EPSG:4326", place, (300, 300), 15.0)
    whole = write(tmp_path / "whole.tif", bands, "EPSG:4326", place)
    (tmp_path / "parts").mkdir()
    for row in range(0, 300, 100):
        for column in range(0, 300, 100):
            part = bands[:, row : row + 100, column : column + 100]
            shifted = place @ np.array([[1, 0, column], [0, 1, row], [0, 0, 1]])
            write(tmp_path / "parts" / f"{row}_{column}.tif", part, "EPSG:4326", shifted)
    area = {"world": WORLD, "corners": BOX * 0.8, "resolution": resolution}
    one = read_imagery(whole, **area)
    for many in (tmp_path / "parts", f"{tmp_path}/parts/*_*.tif"):
        other = read_imagery(many, **area)
        assert other.coverage.all()
        assert np.abs(one.image.astype(int) - other.image).max() <= (1 if resolution < 1 else 6)


def test_sources_in_several_systems_are_one_image(tmp_path):
    first = ortho(tmp_path / "a.tif", "EPSG:31256", 0.5, 150)
    second = ortho(tmp_path / "b.tif", "EPSG:3857", 0.7, 300)
    aim = read_imagery([first, second], world=WORLD, corners=BOX, resolution=0.5)
    assert aim.coverage.all()
    assert misplaced(aim, 15.0) < 0.02
    assert [row["crs"] for row in aim.report["imagery"]] == [["EPSG:31256"], ["EPSG:3857"]]


def test_nodata_alone_is_refused(tmp_path):
    path = flat(tmp_path, constant(0, 0, 0), nodata=0)
    with pytest.raises(ImageryError, match="nothing but nodata"):
        read_imagery(path, world=WORLD)


def test_world_without_a_place_on_earth_is_refused(tmp_path):
    with pytest.raises(ImageryError, match=r"world that should place .* no CRS"):
        read_imagery(ortho(tmp_path / "a.tif"), world=World(None), corners=BOX)


@pytest.mark.parametrize("resolution", [0.0, -1.0, np.nan, np.inf])
def test_invalid_resolution_is_refused(resolution):
    with pytest.raises(ValueError, match="positive number of metres"):
        read_imagery("a.tif", resolution=resolution)


def test_incomplete_calls_are_refused():
    with pytest.raises(ValueError, match="no source"):
        read_imagery([])
    with pytest.raises(ValueError, match="give the world"):
        read_imagery("a.tif", corners=BOX)
    with pytest.raises(ValueError, match="span an area"):
        read_imagery("a.tif", world=WORLD, corners=BOX[:1])


def test_too_many_pixels_are_refused(tmp_path):
    path = ortho(tmp_path / "a.tif")
    with pytest.raises(AimError, match="use a resolution of"):
        read_imagery(path, world=WORLD, resolution=0.001)


def test_coarse_source_is_upsampled_with_a_warning(tmp_path):
    path = ortho(tmp_path / "a.tif", pixel=2.0, side=90)
    with pytest.warns(GeoaimWarning, match="pixels of 2 m, and 0.5 m were wanted"):
        aim = read_imagery(path, world=WORLD, corners=BOX, resolution=0.5)
    assert aim.coverage.all()


def test_coarse_grids_follow_curved_projections(tmp_path):
    place = place_around("EPSG:4326", 80.0, (250, 250))
    path = write(
        tmp_path / "a.tif", painted("EPSG:4326", place, (250, 250), 3000.0), "EPSG:4326", place
    )
    assert misplaced(read_imagery(path, world=WORLD, resolution=100.0), 3000.0, 6) < 0.03


def test_blocks_meet_without_a_seam(tmp_path, monkeypatch):
    path = ortho(tmp_path / "a.tif", "EPSG:4326")
    for resolution in (0.4, 1.3):
        whole = read_imagery(path, world=WORLD, resolution=resolution)
        with monkeypatch.context() as small:
            small.setattr("geoaim.imagery.mosaic.BLOCK_PX", 64)
            parts = read_imagery(path, world=WORLD, resolution=resolution)
        both = (whole.coverage > 0) & (parts.coverage > 0)
        assert both.sum() > whole.coverage.sum() - 9  # on the very edge either may be right
        assert np.abs(whole.image[both].astype(int) - parts.image[both]).max() <= 2
