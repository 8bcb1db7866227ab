import numpy as np
import pytest
import rasterio
from rasterio.errors import RasterioIOError

from geoaim.base.raster_files import IMAGE_DRIVERS, open_raster_file


@pytest.mark.parametrize("driver", IMAGE_DRIVERS[:-1])
def test_driver_is_known_by_the_first_bytes_not_by_the_name(tmp_path, driver):
    path = tmp_path / "a.dat"
    bands = np.full((1 if driver == "GIF" else 3, 16, 16), 9, np.uint8)
    shape = {"count": len(bands), "height": 16, "width": 16, "dtype": "uint8"}
    transform = rasterio.Affine(1, 0, 9, 0, -1, 9)
    with rasterio.MemoryFile() as memory:
        with memory.open(driver=driver, transform=transform, **shape) as dataset:
            dataset.write(bands)
        path.write_bytes(memory.read())
    with open_raster_file(path) as dataset:
        assert dataset.driver == driver
        assert dataset.shape == (16, 16)


def test_other_files_are_not_recognised(tmp_path):
    (tmp_path / "a.tif").write_text("<VRTDataset>")
    with (
        pytest.raises(RasterioIOError, match="not recognized as GTiff"),
        open_raster_file(tmp_path / "a.tif", ["GTiff"]),
    ):
        pass
