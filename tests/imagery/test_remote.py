"""Imagery where it lives: files by address, WMS, WMTS and STAC items on servers of this machine."""

import http.server
import json
import re
import time
from urllib.parse import parse_qs, urlsplit

import cv2
import numpy as np
import pytest
import rasterio
from rasterio.transform import from_bounds

from geoaim.base.errors import ImageryError
from geoaim.imagery import remote
from geoaim.imagery.mosaic import read_imagery, read_lonlat
from geoaim.imagery.rasters import make_region
from tests.http_servers import run_servers
from tests.imagery.painted_ground import (
    AREA,
    BOX,
    WORLD,
    misplaced,
    ortho,
    painted,
    tile_png,
    tiles_here,
)

TOP = 559082264.0287178  # scale denominator of zoom 0 of web Mercator
LEVELS = "".join(
    f"<TileMatrix><ows:Identifier>{zoom}</ows:Identifier>"
    f"<ScaleDenominator>{TOP / 2**zoom}</ScaleDenominator>"
    "<TopLeftCorner>-20037508.342789244 20037508.342789244</TopLeftCorner>"
    "<TileWidth>256</TileWidth><TileHeight>256</TileHeight>"
    f"<MatrixWidth>{2**zoom}</MatrixWidth><MatrixHeight>{2**zoom}</MatrixHeight></TileMatrix>"
    for zoom in range(22)
)
CAPABILITIES = f"""<?xml version="1.0"?>
<Capabilities xmlns="http://www.opengis.net/wmts/1.0" version="1.0.0"
 xmlns:ows="http://www.opengis.net/ows/1.1" xmlns:xlink="http://www.w3.org/1999/xlink"><Contents>
<Layer><ows:Title>ground</ows:Title><ows:Identifier>ground</ows:Identifier>
<Style isDefault="true"><ows:Identifier>default</ows:Identifier></Style>
<Format>image/png</Format>
<TileMatrixSetLink><TileMatrixSet>mercator</TileMatrixSet></TileMatrixSetLink>
<ResourceURL format="image/png" resourceType="tile"
 template="ADDRESS/wmts/{{TileMatrix}}/{{TileCol}}/{{TileRow}}.png"/></Layer>
<TileMatrixSet><ows:Identifier>mercator</ows:Identifier>
<ows:SupportedCRS>urn:ogc:def:crs:EPSG::3857</ows:SupportedCRS>{LEVELS}</TileMatrixSet>
</Contents></Capabilities>"""


class Handler(http.server.BaseHTTPRequestHandler):
    """Serves `files` by ranges, painted ground as WMS and WMTS; fails and waits as it is told."""

    def do_GET(self):
        server = self.server
        server.asked.append(self.path)
        time.sleep(server.delay)
        first = server.asked.count(self.path) == 1
        if server.failing and (first or len(server.asked) % server.failing == 0):
            return self._answer(503, b"busy", "text/plain")
        parts = urlsplit(self.path)
        query = {key.lower(): value[0] for key, value in parse_qs(parts.query).items()}
        if parts.path == "/wms":
            box = [float(part) for part in query["bbox"].split(",")]
            size = int(query["height"]), int(query["width"])
            place = np.array(from_bounds(*box, *size[::-1])).reshape(3, 3)
            image = np.moveaxis(painted(query["srs"], place, size, 15.0), 0, -1)
            return self._answer(
                200, cv2.imencode(".png", image[..., ::-1])[1].tobytes(), "image/png"
            )
        if found := re.fullmatch(r"/wmts/(\d+)/(\d+)/(\d+)\.png", parts.path):
            return self._answer(200, tile_png(*map(int, found.groups())), "image/png")
        content = server.files.get(parts.path)
        if content is None:
            return self._answer(404, b"", "text/plain")
        content = content.replace(b"ADDRESS", f"http://{self.headers['Host']}".encode())
        wanted = re.fullmatch(r"bytes=(\d+)-(\d*)", self.headers.get("Range", ""))
        if wanted is None:
            return self._answer(200, content, "application/octet-stream")
        low, last = int(wanted[1]), len(content) - 1
        high = min(int(wanted[2] or last), last)
        server.sent += high + 1 - low
        whole = {"Content-Range": f"bytes {low}-{high}/{len(content)}"}
        return self._answer(206, content[low : high + 1], "image/tiff", whole)

    def do_HEAD(self):
        self.do_GET()

    def _answer(self, code, content, kind, more=None):
        self.send_response(code)
        for key, value in {"Content-Type": kind, "Accept-Ranges": "bytes", **(more or {})}.items():
            self.send_header(key, value)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        if self.command == "GET":
            self.wfile.write(content)

    def log_message(self, *_):
        pass


@pytest.fixture
def serve(tmp_path, monkeypatch):
    monkeypatch.setattr(remote, "CACHE", tmp_path / "cache")
    with run_servers(Handler) as start:

        def begin(files=None, failing=0, delay=0.0):
            return start(files=files or {}, failing=failing, delay=delay, asked=[], sent=0)

        yield begin


def test_of_a_remote_file_only_the_needed_part_is_sent(tmp_path, serve):
    options = {"tiled": True, "blockxsize": 256, "blockysize": 256}
    path = ortho(tmp_path / "ortho.tif", pixel=0.25, side=4096, **options)
    server, address = serve({"/data/ortho.tif": path.read_bytes()})
    aim = read_imagery(f"{address}/data/ortho.tif", **AREA)
    assert misplaced(aim, 15.0) < 0.05
    assert aim.report["imagery"][0]["name"].endswith("ortho.tif")
    assert server.sent < path.stat().st_size / 10
    assert len(read_lonlat(f"{address}/data/ortho.tif", None)) >= 4


def test_a_mask_inside_a_file_is_copied_with_its_part(tmp_path):
    path = ortho(tmp_path / "ortho.tif")
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK="YES"), rasterio.open(path, "r+") as dataset:
        mask = np.full(dataset.shape, 255, np.uint8)
        mask[:160] = 0
        dataset.write_mask(mask)
    with rasterio.open(path) as dataset:
        region = make_region(WORLD, BOX)
        remote.copy_part(dataset, tmp_path / "part.tif", region, None, "ortho.tif")
    aim = read_imagery(tmp_path / "part.tif", **AREA)
    assert 0.4 < aim.coverage.mean() < 0.6


def test_a_wms_is_asked_for_the_region_at_the_wanted_resolution(serve):
    server, address = serve()
    aim = read_imagery(f"{address}/wms?service=WMS&layers=dop&format=image/png", **AREA)
    assert misplaced(aim, 15.0) < 0.1
    pixels = sum(
        int(re.search(r"(?i)width=(\d+)", path)[1]) * int(re.search(r"(?i)height=(\d+)", path)[1])
        for path in server.asked
    )
    assert pixels < 2 * aim.coverage.size
    utm = read_imagery(f"wms:{address}/wms?layers=dop&srs=EPSG:32633&format=image/png", **AREA)
    assert misplaced(utm, 15.0) < 0.1


@pytest.mark.parametrize(
    "form", ["{}/WMTSCapabilities.xml", "WMTS:{}/WMTSCapabilities.xml,layer=ground"]
)
def test_a_wmts_is_asked_for_the_tiles_that_are_needed(serve, form):
    server, address = serve({"/WMTSCapabilities.xml": CAPABILITIES.encode()})
    aim = read_imagery(form.format(address), **AREA)
    assert misplaced(aim, 15.0) < 0.1
    tiles = {path for path in server.asked if path.startswith("/wmts/")}
    assert len([path for path in server.asked if path.startswith("/wmts/")]) == len(tiles)
    assert len(tiles) <= 2 * len(tiles_here(19))  # pixels of 0.2 m, the finest that 0.5 m needs
    before = len(server.asked)
    read_imagery(form.format(address), **AREA)
    assert sum(path.startswith("/wmts/") for path in server.asked[before:]) == 0  # in the cache


def test_a_stac_item_leads_to_its_image(tmp_path, serve):
    path = ortho(tmp_path / "ortho.tif")
    assets = {
        "thumbnail": {"href": "look.png", "type": "image/png"},
        "data": {"href": "../files/ortho.tif", "type": "image/tiff; application=geotiff"},
    }
    files = {"/items/a.json": json.dumps({"assets": assets}).encode()}
    _, address = serve(files | {"/files/ortho.tif": path.read_bytes()})
    assert misplaced(read_imagery(f"{address}/items/a.json", **AREA), 15.0) < 0.05
    elsewhere = {"data": {"href": "http://10.0.0.1/a.tif", "type": "image/tiff"}}
    _, address = serve({"/a.json": json.dumps({"assets": elsewhere}).encode()})
    with pytest.raises(ImageryError, match=r"names http://10\.0\.0\.1/a\.tif: give that address"):
        read_imagery(f"{address}/a.json", **AREA)


def test_an_open_dataset_is_read_in_the_part_that_is_needed(tmp_path, monkeypatch):
    path = ortho(tmp_path / "ortho.tif", pixel=0.25, side=2000)
    monkeypatch.setattr(remote.rasterio.shutil, "copy", None)
    with rasterio.open(path) as dataset, rasterio.vrt.WarpedVRT(dataset, crs="EPSG:3857") as vrt:
        assert misplaced(read_imagery(vrt, **AREA), 15.0) < 0.1


@pytest.mark.parametrize(
    "form",
    ["wms?service=WMS&layers=dop&format=image/png", "WMTSCapabilities.xml", "item.json", "a.tif"],
)
def test_services_that_fail_each_first_time_are_asked_again(tmp_path, serve, form):
    item = {"assets": {"data": {"href": "a.tif", "type": "image/tiff"}}}
    files = {
        "/item.json": json.dumps(item).encode(),
        "/WMTSCapabilities.xml": CAPABILITIES.encode(),
    }
    path = ortho(tmp_path / "ortho.tif")
    _, address = serve(files | {"/a.tif": path.read_bytes()}, failing=100)
    assert misplaced(read_imagery(f"{address}/{form}", **AREA), 15.0) < 0.1


def test_what_does_not_answer_as_it_should_is_named_in_one_line(serve, monkeypatch):
    monkeypatch.setattr(remote, "TOTAL_S", 0.0)
    monkeypatch.setattr(remote, "STRIP_PX", 16)
    _, address = serve(
        {"/page.tif": b"<html>", "/item.json": b"[1]", "/Capabilities.xml": b"<a></b>"}
    )
    for source, message in {
        f"{address}/none.tif": "none.tif cannot be read: HTTP response code: 404",
        f"{address}/page.tif": r"page.tif cannot be read: .* no parts of files .* download it",
        f"{address}/none.json": "has no STAC item at this address",
        f"WMTS:{address}/Capabilities.xml": "not answer with the capabilities of a WMTS",
        f"wms:{address}/none?layers=dop": "cannot be read: it answers with the code 404",
        f"{address}/item.json": "cannot be read as a STAC item",
        f"{address}/wms?service=WMS": "name its layer",
        f"{address}/wms?service=WMS&layers=dop&format=image/png": "took over 0 s for",
    }.items():
        with pytest.raises(ImageryError, match=message) as caught:
            read_imagery(source, **AREA)
        assert "\n" not in str(caught.value)
    with pytest.raises(ImageryError, match="service of the whole Earth"):
        read_imagery(f"{address}/wms?service=WMS&layers=dop")


def test_a_remote_file_of_another_place_says_what_it_covers(tmp_path, serve):
    _, address = serve({"/ortho.tif": ortho(tmp_path / "ortho.tif").read_bytes()})
    with pytest.raises(ImageryError, match=r"ortho\.tif covers longitude .* imagery is needed in"):
        read_imagery(f"{address}/ortho.tif", world=WORLD, corners=BOX + 5000, resolution=0.5)


def test_a_service_without_tiles_there_is_named(serve):
    capabilities = CAPABILITIES.replace("/wmts/", "/none/").encode()
    _, address = serve({"/WMTSCapabilities.xml": capabilities})
    with pytest.raises(ImageryError, match=r"^127\.0\.0\.1\S*: nothing but .* missing tiles there"):
        read_imagery(f"{address}/WMTSCapabilities.xml", **AREA)
