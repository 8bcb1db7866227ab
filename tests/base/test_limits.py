import errno
import os

import numpy as np
import pytest
import rasterio

from geoaim.aim.files import read_aim
from geoaim.base.errors import AimError, GeoaimError, TracksError, VideoError
from geoaim.base.limits import check_memory, name_file, refuse_damaged
from geoaim.imagery.mosaic import read_imagery
from geoaim.mapping.video.video import open_video
from geoaim.tracks.formats import read_sdd, read_tracks


def test_need_of_memory_is_compared_with_the_limit_and_the_size_of_the_file(monkeypatch):
    check_memory("a.tif", 1e9, 0, GeoaimError, "2 x 2 pixels")
    check_memory("a.tif", 3e9, 1e7, GeoaimError, "2 x 2 pixels")
    with pytest.raises(VideoError, match=r"a\.tif has 1 KB and claims 2 x 2 pixels, .* 3\.0 GB"):
        check_memory("a.tif", 3e9, 1e3, VideoError, "2 x 2 pixels")
    monkeypatch.setenv("GEOAIM_MAX_GB", "4")
    check_memory("a.tif", 3e9, 1e3, VideoError, "2 x 2 pixels")
    monkeypatch.setenv("GEOAIM_MAX_GB", "much")
    with (
        pytest.raises(ValueError, match=r"^GEOAIM_MAX_GB is 'much'; a number of GB"),
        refuse_damaged("a.tif", VideoError, "a video"),
    ):
        check_memory("a.tif", 3e9, 1e3, VideoError, "2 x 2 pixels")


def test_errors_of_libraries_become_one_line_and_others_pass():
    with (
        pytest.raises(TracksError, match=r"a\.csv is not a table, .*\(ValueError: b c\)"),
        refuse_damaged("a.csv", TracksError, "a table"),
    ):
        raise ValueError("b\nc")
    with pytest.raises(FileNotFoundError), refuse_damaged("a.csv", TracksError, "a table"):
        raise FileNotFoundError


def test_errors_of_data_become_one_line_that_names_the_file():
    with pytest.raises(TracksError, match=r"^b/a\.csv: row 3 is short$"), name_file("b/a.csv"):
        raise TracksError("row 3\nis short")
    with pytest.raises(TracksError, match=r"^a\.csv has no rows$"), name_file("b/a.csv"):
        raise TracksError("a.csv has no rows")


def test_small_files_with_large_claims_are_refused(tmp_path):
    shape = {"height": 100_000, "width": 100_000, "count": 1, "dtype": "uint8"}
    options = {"driver": "GTiff", "SPARSE_OK": "TRUE", "compress": "deflate", "tiled": True}
    transform = rasterio.Affine(1, 0, 9, 0, -1, 9)
    with rasterio.open(tmp_path / "a.tif", "w", **shape, **options, transform=transform):
        pass
    with pytest.raises(VideoError, match="100000 x 100000 pixels"):
        open_video(tmp_path / "a.tif")
    (tmp_path / "a.txt.gz").write_bytes(compress_zeros(400_000_000))
    with pytest.raises(TracksError, match="MB of text"):
        read_sdd(tmp_path / "a.txt.gz", resolution=0.04)


def compress_zeros(size: int) -> bytes:
    import gzip

    part = gzip.compress(bytes(size // 100))  # parts of gzip may follow one another
    return part * 100


def test_sparse_tracks_are_refused_before_they_fill_memory(tmp_path):
    number = np.arange(20_000)
    lines = [f'{i} 0 100 20 140 {i} 0 0 0 "Biker"' for i in number]
    (tmp_path / "a.txt").write_text("\n".join(lines))
    with pytest.raises(TracksError, match="20000 agents times 20000 times, of 20000 rows"):
        read_sdd(tmp_path / "a.txt", resolution=0.04)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no named pipes")
@pytest.mark.parametrize("read", [read_aim, read_imagery, read_tracks, open_video])
def test_pipe_is_refused_without_waiting_for_it(tmp_path, read):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(GeoaimError, match="is a pipe or a device"):
        read(tmp_path / "pipe")


def test_an_error_of_another_file_is_not_blamed_on_the_one_that_is_read(tmp_path):
    path = tmp_path / "map.tif"
    full = OSError(errno.ENOSPC, "No space left on device", str(tmp_path / "view.html"))
    with (
        pytest.raises(OSError, match=r"view\.html") as caught,
        refuse_damaged(path, AimError, "it"),
    ):
        raise full
    assert caught.value is full
    with pytest.raises(AimError, match=r"map\.tif"), refuse_damaged(path, AimError, "it"):
        raise OSError(errno.EIO, "Input/output error", str(path))
