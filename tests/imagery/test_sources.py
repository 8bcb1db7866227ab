import sqlite3
from contextlib import closing

import pytest
import rasterio
from rasterio.enums import Resampling

from geoaim.base.errors import ImageryError
from geoaim.base.world import transform_crs
from geoaim.imagery.mosaic import read_imagery
from geoaim.imagery.tiles import Tiles
from tests.imagery.painted_ground import (
    BOX,
    HERE,
    WORLD,
    misplaced,
    ortho,
    painted,
    tile_place,
    tiles_here,
    write,
)


def test_zoom_is_refused_for_what_is_not_tiles(tmp_path):
    path = ortho(tmp_path / "a.tif", "EPSG:3857", 0.5)
    with pytest.raises(ImageryError, match="mbtiles file; omit"):
        read_imagery(Tiles(path, zoom=3))


@pytest.mark.parametrize("source", ["nowhere.tif", "nowhere/*.tif", "empty"])
def test_missing_files_are_named(tmp_path, source):
    (tmp_path / "empty").mkdir()
    with pytest.raises(FileNotFoundError, match=source.replace("*", r"\*")):
        read_imagery(tmp_path / source)


def test_address_without_a_scheme_is_not_a_service():
    with pytest.raises(ImageryError, match="for files give the folder"):
        read_imagery("tiles/{z}/{x}/{y}.png", world=WORLD, corners=BOX, resolution=1.0)


def test_file_that_is_not_an_image_is_refused(tmp_path):
    (tmp_path / "a.tif").write_text("not a picture")
    with pytest.raises(ImageryError, match=r"a\.tif cannot be read as imagery: .*not recognized"):
        read_imagery(tmp_path / "a.tif")
    with pytest.raises(ImageryError, match=r"none of the 1 file\(s\) of .* can be read"):
        read_imagery(tmp_path)


@pytest.mark.parametrize("zoom", [None, 18, 17])
def test_mbtiles_are_read_at_any_zoom(tmp_path, zoom):
    place = tile_place(*tiles_here(17)[0], 512)
    bands = painted("EPSG:3857", place, (512, 512), 15.0)
    write(tmp_path / "a.mbtiles", bands, "EPSG:3857", place, driver="MBTILES", TILE_FORMAT="PNG")
    with rasterio.open(tmp_path / "a.mbtiles", "r+") as dataset:
        dataset.build_overviews([2], Resampling.average)
    corners = transform_crs(
        "EPSG:3857", WORLD.crs, place[:2, :2] @ [250.0, 250.0] + place[None, :2, 2]
    )
    corners = corners - HERE + BOX * 0.7
    tiles = Tiles(tmp_path / "a.mbtiles", zoom=zoom)
    aim = read_imagery(tiles, world=WORLD, corners=corners, resolution=0.6)
    assert aim.coverage.all()
    assert misplaced(aim, 15.0) < 0.05


def set_metadata(path, **values):
    with closing(sqlite3.connect(path)) as database, database:
        for name, value in values.items():
            database.execute("DELETE FROM metadata WHERE name = ?", (name,))
            database.execute("INSERT INTO metadata VALUES (?, ?)", (name, value))


def write_mbtiles(path):
    place = tile_place(*tiles_here(17)[0], 512)
    bands = painted("EPSG:3857", place, (512, 512), 15.0)
    return write(path, bands, "EPSG:3857", place, driver="MBTILES", TILE_FORMAT="PNG")


def test_mbtiles_whose_rows_count_from_the_north_are_refused(tmp_path):
    path = write_mbtiles(tmp_path / "a.mbtiles")
    read_imagery(path, world=WORLD, corners=BOX, resolution=1.0)
    with closing(sqlite3.connect(path)) as database, database:
        [(text,)] = database.execute("SELECT value FROM metadata WHERE name = 'bounds'")
        west, south, east, north = map(float, text.split(","))
    set_metadata(path, scheme="xyz")  # a slip: the bounds agree with the rows
    read_imagery(path, world=WORLD, corners=BOX, resolution=1.0)
    set_metadata(path, bounds=f"{west},{-north},{east},{-south}", scheme="tms")
    with pytest.raises(ImageryError, match=r"rows count from the north .its bounds"):
        read_imagery(path, world=WORLD, corners=BOX, resolution=1.0)
    set_metadata(path, bounds="", scheme="xyz")
    with pytest.raises(ImageryError, match=r"rows count from the north .its scheme is xyz"):
        read_imagery(path, world=WORLD, corners=BOX, resolution=1.0)


VRT_PART = (
    '<{kind}><SourceFilename relativeToVRT="1">{file}</SourceFilename>'
    "<SourceBand>{band}</SourceBand></{kind}>"
)


def write_vrt(path, *files, kind="SimpleSource"):
    bands = "".join(
        f'<VRTRasterBand dataType="Byte" band="{band}">'
        + "".join(VRT_PART.format(kind=kind, file=file, band=band) for file in files)
        + "</VRTRasterBand>"
        for band in (1, 2, 3)
    )
    path.write_text(f'<VRTDataset rasterXSize="640" rasterYSize="320">{bands}</VRTDataset>')
    return path


def test_a_vrt_of_files_beside_it_is_read_and_no_other(tmp_path):
    (tmp_path / "maps").mkdir()
    ortho(tmp_path / "maps/a.tif")
    path = write_vrt(tmp_path / "all.vrt", "maps/a.tif")
    area = {"world": WORLD, "corners": BOX, "resolution": 0.5}
    assert misplaced(read_imagery(path, **area), 15.0) < 0.05
    with pytest.raises(ImageryError, match="name these files themselves"):
        read_imagery(write_vrt(tmp_path / "maps/up.vrt", "../maps/../all.vrt"), **area)
    with pytest.raises(ImageryError, match="does more than putting files side by side"):
        read_imagery(write_vrt(path, "maps/a.tif", kind="KernelFilteredSource"), **area)
