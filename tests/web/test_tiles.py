import io

import numpy as np
import pytest
from PIL import Image

from geoaim.base.grid import Grid
from geoaim.web.tiles import TILE_PX, encode_picture, tile_array


def decode(content):
    return np.array(Image.open(io.BytesIO(content)))


@pytest.fixture
def raster():
    rows, columns = np.mgrid[:1100, :1500]
    pixels = np.stack([rows * 255 / 1100, columns * 255 / 1500, rows * 0, rows * 0 + 255], -1)
    matrix = np.array([[0.5, 0.0, 10.0], [0.0, -0.5, 20.0], [0.0, 0.0, 1.0]])
    return tile_array(pixels.astype(np.uint8), Grid((1100, 1500), matrix))


def test_the_coarsest_level_is_one_tile_and_each_next_has_half_the_metres_per_pixel(raster):
    described = raster.describe()
    assert described["resolutions"] == [2.0, 1.0, 0.5]
    assert described["extent"] == [10.0, 20.0 - 550.0, 10.0 + 750.0, 20.0]
    assert raster.list_tiles(np.inf)[0] == (0, 0, 0)
    assert len(raster.list_tiles(np.inf)) == 1 + 4 + 9


def test_a_tile_shows_its_part_of_the_raster_at_its_level(raster):
    for level, step in ((2, 1), (1, 2), (0, 4)):
        tile = decode(raster.encode_tile(level, 0, 0)).astype(float)
        rows = np.arange(0, min(TILE_PX, 1100 // step))
        truth = (rows + 0.5) * step * 255 / 1100
        assert np.abs(tile[: len(rows), 100, 0] - truth).max() < 4
    second = decode(raster.encode_tile(2, 1, 1)).astype(float)
    assert second[0, 0, 1] == pytest.approx(512 * 255 / 1500, abs=4)


def test_tiles_beyond_the_raster_are_refused(raster):
    for tile in ((3, 0, 0), (-1, 0, 0), (2, 3, 0), (2, 0, 3), (0, 1, 0)):
        with pytest.raises(KeyError):
            raster.encode_tile(*tile)


def test_transparent_parts_make_a_png():
    picture = np.full((8, 8, 4), 255, np.uint8)
    assert encode_picture(picture)[:2] == b"\xff\xd8"
    picture[0, 0] = (1, 2, 3, 0)
    assert decode(encode_picture(picture))[0, 0].tolist() == [1, 2, 3, 0]


def test_a_dataset_is_read_by_its_overviews(aim, tmp_path):
    from geoaim.aim.files import open_aim, write_aim
    from geoaim.web.map_layers import tile_aim, tile_aim_file

    write_aim(aim, tmp_path / "aim.tif")
    with open_aim(tmp_path / "aim.tif") as file:
        filed = tile_aim_file(file, 40.0)
        held = tile_aim(aim)
        for name in ("aim_image", "aim_contested", "aim_coverage"):
            for tile in ((1, 1, 0), (2, 1, 1)):
                if tile[0] < held[name].levels:
                    first, second = (decode(x[name].encode_tile(*tile)) for x in (filed, held))
                    assert np.mean(np.abs(first.astype(float) - second)) < 3
