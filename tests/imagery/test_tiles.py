import contextlib
import http.server
import threading
from collections import Counter

import cv2
import numpy as np
import pytest

from geoaim.base.errors import GeoaimWarning, ImageryError
from geoaim.base.geometry import transform_points
from geoaim.base.world import choose_world, transform_crs, world_from_crs
from geoaim.imagery import tile_service
from geoaim.imagery.mosaic import read_imagery
from geoaim.imagery.tiles import Tiles
from tests.http_servers import run_servers
from tests.imagery.painted_ground import (
    AREA,
    BOX,
    WORLD,
    misplaced,
    painted,
    tile_place,
    tile_png,
    tiles_here,
    write,
    write_tiles,
)


@pytest.mark.parametrize("name", ["{z}/{x}/{y}.png", "OAM-{x}-{y}-{z}.png", "deep/{x}-{y}-{z}.png"])
def test_tiles_lie_where_their_names_say(tmp_path, name):
    write_tiles(tmp_path / "t", 18, name)
    aim = read_imagery(tmp_path / "t", world=WORLD, corners=BOX, resolution=0.5)
    assert aim.coverage.all()
    assert misplaced(aim, 15.0) < 0.02
    assert aim.report["imagery"][0]["zoom"] == 18


def test_tiles_equal_one_raster_of_the_same_content(tmp_path):
    write_tiles(tmp_path / "t", 18)
    numbers = np.array(tiles_here(18))
    (_, x, y), (_, right, bottom) = numbers.min(axis=0), numbers.max(axis=0)
    shape = (bottom + 1 - y) * 256, (right + 1 - x) * 256
    bands = painted("EPSG:3857", tile_place(18, x, y), shape, 15.0)
    path = write(tmp_path / "a.tif", bands, "EPSG:3857", tile_place(18, x, y))
    for resolution in (0.3, 1.7):
        one, other = (
            read_imagery(source, world=WORLD, corners=BOX, resolution=resolution)
            for source in (path, tmp_path / "t")
        )
        np.testing.assert_array_equal(one.coverage, other.coverage)
        assert np.abs(one.image.astype(int) - other.image).max() <= (1 if resolution < 1 else 3)


def test_tms_tiles_are_counted_from_the_south(tmp_path):
    write_tiles(tmp_path / "t", 17, "{z}/{x}/{tms}.png")
    area = {"world": WORLD, "corners": BOX, "resolution": 1.0}
    aim = read_imagery(Tiles(tmp_path / "t", tms=True), **area)
    assert misplaced(aim, 15.0) < 0.02
    with pytest.raises(ImageryError, match="tms="):
        read_imagery(tmp_path / "t", **area)


@pytest.mark.parametrize(
    ("resolution", "zoom"), [(5.0, 16), (1.0, 17), (0.5, 18), (0.4, 18), (None, 18)]
)
def test_coarsest_zoom_that_is_fine_enough_is_read(tmp_path, resolution, zoom):
    for level in (16, 17, 18):  # 1.6, 0.8 and 0.4 m
        write_tiles(tmp_path / "t", level)
    aim = read_imagery(tmp_path / "t", world=WORLD, corners=BOX, resolution=resolution)
    assert aim.report["imagery"][0]["zoom"] == zoom


def test_zooms_agree(tmp_path):
    for level in (17, 18):
        write_tiles(tmp_path / "t", level)
    for zoom in (17, 18):
        tiles = Tiles(tmp_path / "t", zoom=zoom)
        aim = read_imagery(tiles, world=WORLD, corners=BOX, resolution=0.5)
        assert misplaced(aim, 15.0) < 0.02
    with pytest.raises(ImageryError, match=r"no tile of zoom 19 there; it has \[17, 18\]"):
        read_imagery(Tiles(tmp_path / "t", zoom=19), world=WORLD, corners=BOX)


def test_missing_and_transparent_tiles_are_holes(tmp_path):
    write_tiles(tmp_path / "t", 18)
    first, second = [tmp_path / "t" / f"{z}/{x}/{y}.png" for z, x, y in tiles_here(18)[:2]]
    first.unlink()
    second.write_bytes(tile_png(*tiles_here(18)[1], alpha=0))
    aim = read_imagery(tmp_path / "t", world=WORLD, resolution=0.5)
    assert 1 - aim.coverage.mean() == pytest.approx(2 / len(tiles_here(18)), abs=0.05)
    assert misplaced(aim, 15.0) < 0.02  # nothing dark where tiles end


@pytest.mark.parametrize("damage", ["cut", "text", "empty"])
def test_tile_that_cannot_be_read_is_a_hole_with_a_warning(tmp_path, damage):
    write_tiles(tmp_path / "t", 18)
    z, x, y = tiles_here(18)[-1]
    file = tmp_path / "t" / f"{z}/{x}/{y}.png"
    whole = file.read_bytes()
    file.write_bytes({"cut": whole[: len(whole) // 2], "text": b"sorry", "empty": b""}[damage])
    with pytest.warns(GeoaimWarning, match=rf"file skipped, its area stays empty: .*{y}\.png"):
        aim = read_imagery(tmp_path / "t", world=WORLD, corners=BOX, resolution=0.5)
    assert 0 < (aim.coverage == 0).mean() < 1
    assert aim.report["imagery"][0]["unreadable"] == [str(file)]


class Handler(http.server.BaseHTTPRequestHandler):
    def do_GET(self):
        self.server.seen[self.path] += 1
        answer = self.server.answer(self.path, self.server.seen[self.path])
        if answer is None:
            self.server.stopped.wait()
            return
        status, body = answer
        self.send_response(status)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        with contextlib.suppress(OSError):  # who does not wait has gone
            self.wfile.write(body)

    def log_message(self, *_):
        pass


@pytest.fixture
def service():
    """Start a tile server that answers a path, and how often it was asked, as a function says.

    Where the function says None there is no answer until the end of the test.
    """
    stopped = threading.Event()
    with run_servers(Handler) as start:

        def serve(answer):
            server, address = start(answer=answer, seen=Counter(), stopped=stopped)
            return server, f"{address}/{{z}}/{{x}}/{{y}}.png"

        yield serve
        stopped.set()


def numbers(path: str) -> tuple[int, int, int]:
    return tuple(int(part) for part in path.split("?")[0].removesuffix(".png").split("/")[1:])


def good(path: str, _: int) -> tuple[int, bytes]:
    return 200, tile_png(*numbers(path))


def test_service_equals_a_folder_of_its_tiles_and_is_cached(tmp_path, service):
    server, address = service(good)
    tiles = Tiles(address, cache=tmp_path / "cache")
    first = read_imagery(tiles, **AREA)
    assert first.coverage.all()
    assert first.report["imagery"][0]["zoom"] == 18
    assert misplaced(first, 15.0) < 0.02
    folder = read_imagery(write_tiles(tmp_path / "t", 18), **AREA)
    assert np.abs(first.image.astype(int) - folder.image).max() <= 1
    assert set(server.seen.values()) == {1}
    assert {numbers(path)[0] for path in server.seen} == {18}
    np.testing.assert_array_equal(read_imagery(tiles, **AREA).image, first.image)
    assert set(server.seen.values()) == {1}


@pytest.mark.parametrize("zoom", [17, 24])
def test_zoom_of_a_service_can_be_forced(tmp_path, service, zoom):
    server, address = service(good)
    box = BOX if zoom == 17 else BOX / 100
    tiles = Tiles(address, zoom=zoom, cache=tmp_path)
    aim = read_imagery(tiles, world=WORLD, corners=box, resolution=0.5 if zoom == 17 else 0.01)
    assert misplaced(aim, 15.0, 1) < 0.02
    assert {numbers(path)[0] for path in server.seen} == {zoom}


def test_service_with_negative_y_counts_from_the_south(tmp_path, service):
    def turned(path, _):
        z, x, y = numbers(path)
        return 200, tile_png(z, x, 2**z - 1 - y)

    _, address = service(turned)
    aim = read_imagery(Tiles(address.replace("{y}", "{-y}"), cache=tmp_path), **AREA)
    assert misplaced(aim, 15.0) < 0.02


@pytest.mark.parametrize("status", [404, 204])
def test_tiles_that_a_service_lacks_are_holes(tmp_path, service, status):
    gone = tiles_here(18)[0]
    _, address = service(lambda p, n: (status, b"") if numbers(p) == gone else good(p, n))
    aim = read_imagery(Tiles(address, cache=tmp_path), **AREA)
    assert 0.01 < (aim.coverage == 0).mean() < 0.9
    assert misplaced(aim, 15.0) < 0.02
    _, address = service(lambda *_: (status, b""))
    with pytest.raises(ImageryError, match="has no tile there at zoom 18"):
        read_imagery(Tiles(address, cache=tmp_path), **AREA)


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        ((500, b""), "500"),
        ((403, b""), "403"),
        ((200, b"<html>sorry</html>"), "something other than PNG"),
        ((200, tile_png(18, 0, 0, 512)), "tiles of 512 x 512.*tile_size"),
        (None, "imed out"),
    ],
    ids=["fails", "forbids", "page", "size", "slow"],
)
def test_failing_service_is_an_error(tmp_path, service, answer, reason, monkeypatch):
    monkeypatch.setattr(tile_service, "RETRIES", 0)
    if answer is None:
        monkeypatch.setattr(tile_service, "TIMEOUT_S", 0.2)
    _, address = service(lambda *_: answer)
    tiles = Tiles(address + "?key=secret", cache=tmp_path)
    with pytest.raises(ImageryError, match=reason) as caught:
        read_imagery(tiles, **AREA)
    assert "secret" not in str(caught.value)
    assert address in str(caught.value)


def test_messages_have_no_password(tmp_path, service, monkeypatch):
    monkeypatch.setattr(tile_service, "RETRIES", 0)
    _, address = service(lambda *_: (500, b""))
    tiles = Tiles(address.replace("://", "://user:secret@"), cache=tmp_path)
    with pytest.raises(ImageryError) as caught:
        read_imagery(tiles, **AREA)
    assert "secret" not in str(caught.value)


@pytest.mark.parametrize("area", [{}, {"resolution": 1.0}])
def test_service_needs_a_place(area):
    with pytest.raises(ImageryError, match="give what says where, the world and the corners"):
        read_imagery("http://127.0.0.1:9/{z}/{x}/{y}.png", **area)


NOT_AVAILABLE = tile_png(18, 0, 0)  # one picture for every tile


def test_without_a_resolution_the_finest_zoom_with_imagery_is_read(tmp_path, service):
    def answer(path, n):
        return good(path, n) if numbers(path)[0] <= 18 else (200, NOT_AVAILABLE)

    _, address = service(answer)
    aim = read_imagery(Tiles(address, cache=tmp_path), world=WORLD, corners=BOX)
    assert aim.report["imagery"][0]["zoom"] == 18
    assert misplaced(aim, 15.0) < 0.02


def test_tiles_that_are_one_picture_are_holes_with_a_warning(tmp_path, service):
    gone = tiles_here(18)[:2]

    def answer(path, n):
        return (200, NOT_AVAILABLE) if numbers(path) in gone else good(path, n)

    _, address = service(answer)
    with pytest.warns(GeoaimWarning, match=r"2 of \d+ tiles are the same picture"):
        aim = read_imagery(Tiles(address, cache=tmp_path), **AREA)
    assert 0.01 < (aim.coverage == 0).mean() < 0.9
    assert misplaced(aim, 15.0) < 0.02


def test_a_zoom_of_which_all_tiles_are_one_picture_is_refused(tmp_path, service):
    _, address = service(lambda *_: (200, NOT_AVAILABLE))
    with (
        pytest.warns(GeoaimWarning, match="the same picture"),
        pytest.raises(ImageryError, match="all the same picture there at zoom 18"),
    ):
        read_imagery(Tiles(address, cache=tmp_path), **AREA)


def test_a_folder_says_that_y_counts_from_the_south(tmp_path):
    folder = write_tiles(tmp_path / "t", 17, "{z}/{x}/{tms}.png")
    (folder / "tilemapresource.xml").write_text(
        '<TileMap version="1.0.0"><SRS>EPSG:900913</SRS><Origin x="-20037508.34279" '
        'y="-20037508.34279"/><TileSets profile="mercator"/></TileMap>'
    )
    area = {"world": WORLD, "corners": BOX, "resolution": 1.0}
    assert misplaced(read_imagery(folder, **area), 15.0) < 0.02
    (folder / "metadata.json").write_text('{"scheme": "xyz"}')
    with pytest.raises(ImageryError, match=r"tilemapresource.xml, metadata.json of .* differ"):
        read_imagery(folder, **area)
    (folder / "tilemapresource.xml").unlink()
    (folder / "metadata.json").write_text('{"scheme": "tms"}')
    assert misplaced(read_imagery(folder, **area), 15.0) < 0.02


@pytest.mark.parametrize("order", [(0, 1, 2, 3), (1, 0, 3, 2)])  # of old versions, the latter
@pytest.mark.parametrize("rows", ["tms", "y"])
def test_folders_are_read_as_gdal2tiles_writes_them(tmp_path, rows, order):
    folder = write_tiles(tmp_path / "t", 17, f"{{z}}/{{x}}/{{{rows}}}.png")
    mercator = [tile_place(*tile) @ [[0, 256], [256, 0], [1, 1]] for tile in tiles_here(17)]
    places = np.concatenate([place[:2].T for place in mercator])
    lonlat = transform_crs("EPSG:3857", "EPSG:4326", places)
    west, south, east, north = np.take([*lonlat.min(axis=0), *lonlat.max(axis=0)], order)
    (folder / "tilemapresource.xml").write_text(
        '<TileMap version="1.0.0" tilemapservice="http://tms.osgeo.org/1.0.0"><SRS>EPSG:3857</SRS>'
        f'<BoundingBox minx="{west}" miny="{south}" maxx="{east}" maxy="{north}"/>'
        f'<Origin x="{west}" y="{south}"/><TileSets profile="mercator"/></TileMap>'
    )
    aim = read_imagery(folder, world=WORLD, corners=BOX, resolution=1.0)
    assert misplaced(aim, 15.0) < 0.02


@pytest.mark.parametrize(
    ("srs", "profile"), [("EPSG:4326", "geodetic"), ("EPSG:3857", "raster"), ("EPSG:2154", "")]
)
def test_tiles_of_another_grid_are_refused(tmp_path, srs, profile):
    folder = write_tiles(tmp_path / "t", 17)
    (folder / "tilemapresource.xml").write_text(
        f'<TileMap><SRS>{srs}</SRS><TileSets profile="{profile}"/></TileMap>'
    )
    with pytest.raises(ImageryError, match=r"those of web Mercator are read"):
        read_imagery(folder, world=WORLD, corners=BOX, resolution=1.0)


def test_tile_size_of_a_service_is_an_option(tmp_path, service):
    _, address = service(lambda p, _: (200, tile_png(*numbers(p), 512)))
    aim = read_imagery(Tiles(address, cache=tmp_path, tile_size=512), **AREA)
    assert aim.report["imagery"][0]["zoom"] == 17
    assert misplaced(aim, 15.0) < 0.02


def test_failed_requests_are_repeated(tmp_path, service):
    server, address = service(lambda p, n: (500, b"") if n == 1 else good(p, n))
    aim = read_imagery(Tiles(address, cache=tmp_path), **AREA)
    assert aim.coverage.all()
    assert max(server.seen.values()) == 2


def test_zooms_of_real_tiles_agree(data_folder):
    place = tile_place(20, 619227, 523264)
    mercator = transform_points(place, np.array([[20.0, 20.0], [480.0, 480.0]]))
    world = choose_world(transform_crs("EPSG:3857", "EPSG:4326", mercator))
    area = {"world": world, "corners": world_from_crs(world, mercator, "EPSG:3857")}
    grey = []
    for zoom in (20, 21):
        tiles = Tiles(data_folder / "tiles" / "kampala_xyz", zoom=zoom)
        aim = read_imagery(tiles, **area, resolution=0.15)
        assert aim.coverage.mean() > 0.95  # its darkest shadows are transparent
        grey.append(cv2.cvtColor(aim.image, cv2.COLOR_RGB2GRAY)[:400, :400].astype(float))
    shift, response = cv2.phaseCorrelate(*grey, cv2.createHanningWindow((400, 400), cv2.CV_64F))
    assert response > 0.5
    assert np.abs(shift).max() < 0.3
