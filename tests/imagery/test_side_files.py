import os

import numpy as np
import pytest
import rasterio
from PIL import Image
from pyproj import CRS

from geoaim.base.errors import ImageryError
from geoaim.imagery.mosaic import read_imagery
from geoaim.imagery.rasters import describe_raster

AFFINE = rasterio.Affine(0.5, 0.0, 500_000.0, 0.0, -0.5, 5_000_000.0)
PAM = "<PAMDataset><SRS>{crs}</SRS><GeoTransform>{transform}</GeoTransform></PAMDataset>"


@pytest.fixture
def picture(tmp_path):
    path = tmp_path / "a.png"
    Image.fromarray(np.full((20, 30, 3), 90, np.uint8)).save(path)
    return path


def _write_world_file(path):
    centre = AFFINE * (0.5, 0.5)
    numbers = (AFFINE.a, AFFINE.d, AFFINE.b, AFFINE.e, *centre)
    path.with_suffix(".wld").write_text("\n".join(map(str, numbers)))


def _write_pam(path, crs="EPSG:32632", affine=AFFINE):
    wkt = CRS(crs).to_wkt("WKT1_GDAL").replace('"', "&quot;")
    text = PAM.format(crs=wkt, transform=", ".join(map(str, affine.to_gdal())))
    (path.parent / f"{path.name}.aux.xml").write_text(text)


def _check_place(raster):
    assert raster.crs == "EPSG:32632"
    np.testing.assert_allclose(raster.grid.world_from_grid[:2].ravel(), list(AFFINE)[:6])


def test_world_file_with_prj_places_an_image(picture):
    _write_world_file(picture)
    picture.with_suffix(".prj").write_text(CRS("EPSG:32632").to_wkt("WKT1_ESRI"))
    _check_place(describe_raster(str(picture)))


def test_world_file_with_crs_places_an_image(picture):
    _write_world_file(picture)
    _check_place(describe_raster(str(picture), crs="EPSG:32632"))
    with pytest.raises(ImageryError, match=r"put a \.prj beside it"):
        describe_raster(str(picture))


def test_pam_places_an_image_as_gdal_reads_it(picture):
    _write_pam(picture)
    _check_place(describe_raster(str(picture)))
    with rasterio.open(picture) as file:
        assert file.crs == CRS("EPSG:32632")
        assert file.transform == AFFINE
    assert read_imagery(picture).world.crs == "EPSG:32632"


def test_pam_comes_before_the_file_itself_and_prj_after_it(tmp_path):
    path = tmp_path / "a.tif"
    profile = {"driver": "GTiff", "height": 20, "width": 30, "count": 1, "dtype": "uint8"}
    elsewhere = AFFINE * rasterio.Affine.translation(100, 0)
    with rasterio.open(path, "w", **profile, crs="EPSG:32633", transform=elsewhere) as file:
        file.write(np.full((1, 20, 30), 90, np.uint8))
    path.with_suffix(".prj").write_text(CRS("EPSG:32631").to_wkt())
    assert describe_raster(str(path)).crs == "EPSG:32633"
    _write_pam(path)
    _check_place(describe_raster(str(path)))


@pytest.mark.parametrize("text", ["1 2 3", "1 2 3 4 5 x"])
def test_damaged_world_file_is_none(picture, text):
    picture.with_suffix(".wld").write_text(text)
    with pytest.raises(ImageryError, match=r"no transform .* put a world file .six numbers"):
        describe_raster(str(picture), crs="EPSG:32632")


def test_side_files_open_no_other_file(tmp_path, picture):
    """GDAL opens overviews and masks whatever their format, and they may name any file."""
    other = tmp_path / "secret.tif"
    _write_world_file(picture)
    vrt = (
        "<VRTDataset rasterXSize='30' rasterYSize='20'><VRTRasterBand dataType='Byte' band='1'>"
        f"<SimpleSource><SourceFilename>{other}</SourceFilename></SimpleSource></VRTRasterBand>"
        "</VRTDataset>"
    )
    (tmp_path / "a.png.ovr").write_text(vrt)
    pam = "<PAMDataset><Metadata domain='OVERVIEWS'><MDI key='OVERVIEW_FILE'>{}</MDI></Metadata>"
    (tmp_path / "a.png.aux.xml").write_text(pam.format(other) + "</PAMDataset>")
    os.mkfifo(other)  # opening it would wait for a writer
    assert read_imagery(picture, crs="EPSG:32632").image.mean() > 0
