"""What a file holds leads to no other file and to no request, whichever reader opens it."""

import http.server
import shutil
import warnings
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
import rasterio

from geoaim.aim.files import write_aim
from geoaim.base.errors import GeoaimError, ImageryError, VideoError
from geoaim.base.world import parse_crs
from geoaim.imagery.mosaic import read_imagery
from geoaim.imagery.tiles import Tiles
from geoaim.mapping.video.video import open_video
from tests.faults.readers import READERS
from tests.faults.seeds import WORLD, make_aim, write_seeds
from tests.http_servers import run_servers

SECRET = 77  # of all pixels of the canary


class Handler(http.server.BaseHTTPRequestHandler):
    def do_GET(self):
        self.server.requests.append(self.path)
        redirect = getattr(self.server, "redirect", None)
        self.send_response(302 if redirect else 404)
        if redirect:
            self.send_header("Location", redirect)
        self.send_header("Content-Length", "0")
        self.end_headers()

    do_HEAD = do_GET

    def log_message(self, *_):
        pass


@pytest.fixture
def serve():
    """Start servers that note requests, and answer that there is nothing or redirect."""
    with run_servers(Handler) as start:
        yield lambda redirect=None: start(requests=[], redirect=redirect)


@pytest.fixture
def canary(tmp_path) -> Path:
    """A raster beside the file that is read, whose pixels must not appear."""
    path = tmp_path / "canary.tif"
    pixels = np.full((3, 64, 64), SECRET, np.uint8)
    place = rasterio.transform.from_origin(583180, 6062240, 0.5, 0.5)
    shape = {"height": 64, "width": 64, "count": 3, "dtype": "uint8", "driver": "GTiff"}
    with rasterio.open(path, "w", crs=WORLD.crs, transform=place, **shape) as dataset:
        dataset.write(pixels)
    return path


def write_vrt(path: Path, named: str) -> None:
    band = '<VRTRasterBand dataType="Byte" band="{0}"><SimpleSource><SourceFilename>{1}'
    band += "</SourceFilename><SourceBand>{0}</SourceBand></SimpleSource></VRTRasterBand>"
    bands = "".join(band.format(number, named) for number in (1, 2, 3))
    path.write_text(
        '<VRTDataset rasterXSize="64" rasterYSize="64"><SRS>EPSG:32635</SRS><GeoTransform>583180, '
        f"0.5, 0, 6062240, 0, -0.5</GeoTransform>{bands}</VRTDataset>"
    )


def write_wms(path: Path, named: str) -> None:
    url = named if named.startswith("http") else f"file://{named}"
    path.write_text(
        f'<GDAL_WMS><Service name="TMS"><ServerUrl>{url}?${{z}}${{x}}${{y}}</ServerUrl></Service>'
        "<DataWindow><UpperLeftX>583180</UpperLeftX><UpperLeftY>6062240</UpperLeftY><LowerRightX>"
        "583212</LowerRightX><LowerRightY>6062208</LowerRightY><SizeX>64</SizeX><SizeY>64</SizeY>"
        "<TileLevel>0</TileLevel></DataWindow><Projection>EPSG:32635</Projection><BandsCount>3"
        "</BandsCount><BlockSizeX>64</BlockSizeX><BlockSizeY>64</BlockSizeY></GDAL_WMS>"
    )


def write_overviews_tag(path: Path, named: str) -> None:
    write_aim(make_aim(), path)
    named = f"/vsicurl/{named}" if named.startswith("http") else named
    with rasterio.open(path, "r+", IGNORE_COG_LAYOUT_BREAK="YES") as dataset:
        dataset.update_tags(ns="OVERVIEWS", OVERVIEW_FILE=named)


def write_sidecar(ending: str) -> Callable[[Path, str], None]:
    def write(path: Path, named: str) -> None:
        write_aim(make_aim(), path)
        write_vrt(Path(f"{path}{ending}"), f"/vsicurl/{named}" if "://" in named else named)

    return write


def write_playlist(path: Path, named: str) -> None:
    path.write_text(f"#EXTM3U\n#EXT-X-TARGETDURATION:9\n#EXTINF:9,\n{named}\n#EXT-X-ENDLIST\n")


def write_concat(path: Path, named: str) -> None:
    path.write_text(f"ffconcat version 1.0\nfile '{named}'\n")


TRAPS = (
    *(write_vrt, write_wms, write_overviews_tag, write_playlist, write_concat),
    *(write_sidecar(".ovr"), write_sidecar(".msk"), write_sidecar(".aux.xml")),
)


@pytest.fixture(scope="module")
def seeds(tmp_path_factory):
    folder = tmp_path_factory.mktemp("seeds")
    write_seeds(folder)
    return folder


@pytest.mark.slow
@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize("reader", READERS)
def test_file_leads_to_no_other_file_and_no_request(seeds, tmp_path, canary, serve, reader):
    server, address = serve()
    folder = tmp_path / "files"
    shutil.copytree(seeds, folder)
    path = folder / READERS[reader].file
    for trap in TRAPS:
        for named in (str(canary), f"{address}/a.tif"):
            trap(path, named)
            with warnings.catch_warnings(), suppress(GeoaimError, ValueError):
                warnings.simplefilter("ignore")
                found = READERS[reader].read(folder)
                image = np.asarray(getattr(found, "image", 0))
                assert (image == SECRET).mean() < 0.1, trap
            assert server.requests == [], trap
            for sidecar in folder.glob(f"{path.name}.*"):
                sidecar.unlink()


@pytest.mark.parametrize(
    "crs",
    [
        "+init={canary}:a",
        "+proj=longlat +nadgrids={canary} +type=crs",
        "+proj=utm +zone=35 +geoidgrids={canary} +type=crs",
    ],
)
def test_crs_that_names_a_file_is_refused(canary, crs):
    with pytest.raises(GeoaimError, match="names a file"):
        parse_crs(crs.format(canary=canary))


def test_overviews_in_another_file_are_not_read(tmp_path, canary):
    write_overviews_tag(tmp_path / "a.tif", str(canary))
    with pytest.raises(ImageryError, match="names another file for its overviews"):
        read_imagery(tmp_path / "a.tif", resolution=8.0)


def test_video_in_another_file_is_not_read(seeds, tmp_path):
    for write in (write_playlist, write_concat):
        write(tmp_path / "a.mp4", str(seeds / "video.mp4"))
        with pytest.raises(VideoError, match="not a video"):
            open_video(tmp_path / "a.mp4")


def test_service_that_redirects_to_another_host_is_refused(tmp_path, serve):
    other, elsewhere = serve()
    _, address = serve(redirect=f"{elsewhere}/private")
    tiles = Tiles(address + "/{z}/{x}/{y}.png?key=secret", cache=tmp_path)
    corners = np.array([[0.0, 0.0], [50.0, 50.0]])
    with pytest.raises(ImageryError, match="another host") as caught:
        read_imagery(tiles, world=WORLD, corners=corners, resolution=0.5)
    assert "secret" not in str(caught.value)
    assert other.requests == []


def test_service_on_the_disk_is_refused(tmp_path, canary):
    tiles = Tiles(f"file://{canary}?{{z}}{{x}}{{y}}", cache=tmp_path)
    corners = np.array([[0.0, 0.0], [50.0, 50.0]])
    with pytest.raises(ImageryError, match="not the URL of a tile service"):
        read_imagery(tiles, world=WORLD, corners=corners, resolution=0.5)
