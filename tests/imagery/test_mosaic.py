import contextlib
import http.server
import threading
import time
import warnings
from collections import Counter
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np
import pytest
import rasterio
import rasterio.shutil
from rasterio.enums import ColorInterp, Resampling
from rasterio.transform import Affine, from_origin

from geoaim.aim import AIM
from geoaim.aim_files import read_aim, write_aim
from geoaim.errors import AimError, GeoaimWarning, ImageryError
from geoaim.geometry import transform_points
from geoaim.imagery import resampling
from geoaim.imagery.mosaic import read_imagery
from geoaim.imagery.tiles import HALF_WORLD_M, Tiles
from geoaim.world import World, choose_world, lonlat_from_world, transform_crs, world_from_crs

WORLD = World("EPSG:32633", (600_000.0, 5_340_000.0))  # Vienna
HERE = np.array(WORLD.origin)
BOX = np.array([[-60.0, -40.0], [60.0, 40.0]])


def centres(height: int, width: int) -> np.ndarray:
    grid = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    return np.stack(grid, axis=-1).reshape(-1, 2)


def paint(places: np.ndarray, wave: float = 15.0) -> np.ndarray:
    """Smooth colours (0 to 255) of places in the world's CRS, waves of so many metres."""
    x, y = (places - HERE).T * 2 * np.pi / wave
    return 127.5 + 90 * np.stack([np.sin(x), np.cos(y), np.sin(0.6 * x + 0.8 * y)], axis=-1)


def painted(crs: str, place: np.ndarray, shape: tuple[int, int], wave: float) -> np.ndarray:
    points = transform_points(place, centres(*shape))
    colours = paint(transform_crs(crs, WORLD.crs, points), wave)
    return np.moveaxis(np.rint(colours).astype(np.uint8).reshape(*shape, 3), -1, 0)


def place_around(crs: str, pixel: float, shape: tuple[int, int], turn: float = 0.0) -> np.ndarray:
    """crs_from_raster of a raster amid HERE with pixels of about so many metres."""
    around = transform_crs(WORLD.crs, crs, HERE + np.array([[0, 0], [pixel, 0], [0, pixel]]))
    sizes = np.linalg.norm(around[1:] - around[0], axis=1)
    cos, sin = np.cos(turn), np.sin(turn)
    matrix = np.array([[sizes[0] * cos, sizes[0] * sin], [sizes[1] * sin, -sizes[1] * cos]])
    middle = matrix @ [shape[1] / 2 + 0.3, shape[0] / 2 - 0.2]
    return np.vstack([np.column_stack([matrix, around[0] - middle]), [0, 0, 1]])


def write(path: Path, bands: np.ndarray, crs: str | None, place: np.ndarray, **profile) -> Path:
    profile = {"driver": "GTiff", "dtype": bands.dtype, "crs": crs, **profile}
    transform = Affine(*place[:2].flat) if place is not None else None
    shape = dict(zip(("count", "height", "width"), bands.shape, strict=True))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        with rasterio.open(path, "w", transform=transform, **shape, **profile) as dataset:
            dataset.write(bands)
    return path


def ortho(path: Path, crs: str = "EPSG:32633", pixel: float = 0.5, side: int = 320, **more) -> Path:
    place = place_around(crs, pixel, (side, side))
    return write(path, painted(crs, place, (side, side), 15.0), crs, place, **more)


def misplaced(aim: AIM, wave: float, rows: int = 3) -> float:
    """By how many pixels parts of an image of painted ground are off, at most."""
    height, width = aim.coverage.shape
    points = transform_points(aim.world_from_image, centres(height, width)) + aim.world.origin
    step = aim.world_from_image[0, 0]
    slopes = [
        (paint(points + d, wave) - paint(points - d, wave)) / 2
        for d in ([step / 2, 0], [0, step / 2])
    ]
    slopes = np.stack(slopes, axis=-1).reshape(height, width, 3, 2) * 2
    wrong = aim.image - paint(points, wave).reshape(height, width, 3)
    inside = cv2.erode(aim.coverage.astype(np.uint8), np.ones((9, 9)), borderValue=0) > 0
    found = []
    for part in np.array_split(np.arange(height), rows):
        for across in np.array_split(np.arange(width), rows):
            cell = np.ix_(part, across)
            use = inside[cell]
            if use.sum() > 100:
                a, b = slopes[cell][use].reshape(-1, 2), wrong[cell][use].reshape(-1)
                found.append(np.abs(np.linalg.lstsq(a, b, rcond=None)[0]).max())
    assert found
    return max(found)


CRSES = ["EPSG:32633", "EPSG:32634", "EPSG:4326", "EPSG:3857", "EPSG:31256", "EPSG:2154"]


@pytest.mark.parametrize("crs", CRSES)
@pytest.mark.parametrize("ratio", [0.4, 1.0, 1.5, 2.7, 7.3])
def test_pixels_show_their_own_place(tmp_path, crs, ratio):
    pixel, shape = 0.4 / max(ratio, 1.0), (300, 300)
    wave = 12.0 * max(ratio * pixel, pixel)
    place = place_around(crs, pixel, shape)
    path = write(tmp_path / "a.tif", painted(crs, place, shape, wave), crs, place)
    reach = (0.2 if ratio < 1 else 0.4) * 300 * pixel
    corners = np.array([[-reach, -reach], [reach, reach]])
    aim = read_imagery(path, world=WORLD, corners=corners, resolution=ratio * pixel)
    assert aim.coverage.all()
    assert misplaced(aim, wave) < 0.02


@pytest.mark.parametrize("turn", [0.3, -1.2, 3.0])
def test_turned_raster_is_turned_back(tmp_path, turn):
    place = place_around("EPSG:32633", 0.25, (250, 200), turn)
    bands = painted("EPSG:32633", place, (250, 200), 8.0)
    path = write(tmp_path / "a.tif", bands, "EPSG:32633", place)
    assert misplaced(read_imagery(path, world=WORLD, resolution=0.3), 8.0) < 0.02


def test_coarse_grids_follow_the_bend_of_projections(tmp_path):
    place = place_around("EPSG:4326", 80.0, (250, 250))
    path = write(
        tmp_path / "a.tif", painted("EPSG:4326", place, (250, 250), 3000.0), "EPSG:4326", place
    )
    assert misplaced(read_imagery(path, world=WORLD, resolution=100.0), 3000.0, 6) < 0.03


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


def test_whole_imagery_lies_in_the_utm_world_around_it(tmp_path):
    path = ortho(tmp_path / "a.tif", "EPSG:4326")
    aim = read_imagery(path)
    assert aim.world == choose_world(lonlat_from_world(WORLD, np.zeros((1, 2))))
    assert aim.report["resolution_m"] == pytest.approx(0.5, rel=1e-3)
    assert aim.coverage.mean() > 0.95
    assert misplaced(aim, 15.0) < 0.02


def test_corners_outside_the_imagery_are_covered_by_nothing(tmp_path):
    path = ortho(tmp_path / "a.tif")
    aim = read_imagery(path, world=WORLD, corners=BOX + np.array([70.0, 0.0]), resolution=1.0)
    east = 80.0 - 10.0  # the imagery's edge, in pixels of the image
    assert aim.coverage[:, : int(east) - 1].all()
    assert not aim.coverage[:, int(east) + 1 :].any()
    assert (aim.image[aim.coverage == 0] == 0).all()
    assert aim.report["covered"] == pytest.approx(aim.coverage.mean())


# tiles


def tile_place(zoom: int, x: int, y: int, side: int = 256) -> np.ndarray:
    span = 2 * HALF_WORLD_M / 2**zoom
    place = from_origin(x * span - HALF_WORLD_M, HALF_WORLD_M - y * span, span / side, span / side)
    return np.array(place).reshape(3, 3)


def tiles_here(zoom: int) -> list[tuple[int, int, int]]:
    mercator = transform_crs(WORLD.crs, "EPSG:3857", HERE + BOX * 1.2)
    x, y = ((mercator * [1, -1] + HALF_WORLD_M) / (2 * HALF_WORLD_M) * 2**zoom).astype(int).T
    return [(zoom, i, j) for i in range(x.min(), x.max() + 1) for j in range(y.min(), y.max() + 1)]


@lru_cache(maxsize=64)
def tile_png(zoom: int, x: int, y: int, side: int = 256, alpha: int | None = None) -> bytes:
    bands = painted("EPSG:3857", tile_place(zoom, x, y, side), (side, side), 15.0)
    rgb = np.moveaxis(bands, 0, -1)
    if alpha is not None:
        rgb = np.dstack([rgb, np.full((side, side), alpha, np.uint8)])
        return cv2.imencode(".png", cv2.cvtColor(rgb, cv2.COLOR_RGBA2BGRA))[1].tobytes()
    return cv2.imencode(".png", rgb[..., ::-1])[1].tobytes()


def write_tiles(folder: Path, zoom: int, name: str = "{z}/{x}/{y}.png") -> Path:
    for z, x, y in tiles_here(zoom):
        file = folder / name.format(z=z, x=x, y=y, tms=2**z - 1 - y)
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(tile_png(z, x, y))
    return folder


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


def test_tiles_counted_from_the_south_are_turned_over(tmp_path):
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
    with pytest.warns(GeoaimWarning, match=rf"left as a hole: .*{y}\.png"):
        aim = read_imagery(tmp_path / "t", world=WORLD, corners=BOX, resolution=0.5)
    assert 0 < (aim.coverage == 0).mean() < 1
    assert aim.report["imagery"][0]["unreadable"] == [str(file)]


def test_cut_jpeg_is_no_grey_image(tmp_path):
    image = np.random.default_rng(0).integers(0, 256, (200, 200, 3), dtype=np.uint8)
    whole = cv2.imencode(".jpg", image)[1].tobytes()
    (tmp_path / "a.jpg").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "a.jgw").write_text("0.5\n0\n0\n-0.5\n600000\n5340000\n")
    with pytest.raises(ImageryError, match=r"a\.jpg cannot be read"):
        read_imagery(tmp_path / "a.jpg", crs="EPSG:32633")


# services


class Handler(http.server.BaseHTTPRequestHandler):
    def do_GET(self):
        self.server.seen[self.path] += 1
        status, body, wait = self.server.answer(self.path, self.server.seen[self.path])
        time.sleep(wait)
        self.send_response(status)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        with contextlib.suppress(OSError):  # who does not wait has gone
            self.wfile.write(body)

    def log_message(self, *_):
        pass


@pytest.fixture
def service():
    """Start a tile server that answers a path, and how often it was asked, as a function says."""
    running = []

    def start(answer):
        server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        server.answer, server.seen, server.daemon_threads = answer, Counter(), True
        threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True).start()
        running.append(server)
        return server, f"http://127.0.0.1:{server.server_port}/{{z}}/{{x}}/{{y}}.png"

    yield start
    for server in running:
        server.shutdown()
        server.server_close()


def numbers(path: str) -> tuple[int, int, int]:
    return tuple(int(part) for part in path.split("?")[0].removesuffix(".png").split("/")[1:])


def good(path: str, _: int) -> tuple[int, bytes, float]:
    return 200, tile_png(*numbers(path)), 0.0


AREA = {"world": WORLD, "corners": BOX, "resolution": 0.5}


def test_service_gives_what_a_folder_of_its_tiles_gives_and_is_asked_once(tmp_path, service):
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


def test_service_that_counts_from_the_south(tmp_path, service):
    def turned(path, _):
        z, x, y = numbers(path)
        return 200, tile_png(z, x, 2**z - 1 - y), 0.0

    _, address = service(turned)
    aim = read_imagery(Tiles(address.replace("{y}", "{-y}"), cache=tmp_path), **AREA)
    assert misplaced(aim, 15.0) < 0.02


@pytest.mark.parametrize("status", [404, 204])
def test_tiles_that_a_service_lacks_are_holes(tmp_path, service, status):
    gone = tiles_here(18)[0]
    _, address = service(lambda p, n: (status, b"", 0.0) if numbers(p) == gone else good(p, n))
    aim = read_imagery(Tiles(address, cache=tmp_path), **AREA)
    assert 0.01 < (aim.coverage == 0).mean() < 0.9
    assert misplaced(aim, 15.0) < 0.02
    _, address = service(lambda *_: (status, b"", 0.0))
    with pytest.raises(ImageryError, match="missing tiles"):
        read_imagery(Tiles(address, cache=tmp_path), **AREA)


def test_failed_requests_are_tried_again(tmp_path, service):
    server, address = service(lambda p, n: (500, b"", 0.0) if n == 1 else good(p, n))
    aim = read_imagery(Tiles(address, cache=tmp_path, retries=2), **AREA)
    assert aim.coverage.all()
    assert max(server.seen.values()) == 2


@pytest.mark.parametrize(
    ("answer", "reason"),
    [
        ((500, b"", 0.0), "500"),
        ((403, b"", 0.0), "403"),
        ((200, b"<html>sorry</html>", 0.0), "not recognized"),
        ((200, tile_png(18, 0, 0, 512), 0.0), "size 512 x 512.*tile_size"),
        ((200, tile_png(18, 0, 0), 1.6), "imed out"),
    ],
    ids=["fails", "forbids", "page", "size", "slow"],
)
def test_service_that_fails_is_an_error_and_no_black_image(tmp_path, service, answer, reason):
    _, address = service(lambda *_: answer)
    tiles = Tiles(address + "?key=secret", cache=tmp_path, retries=0, timeout=1)
    with pytest.raises(ImageryError, match=reason) as caught:
        read_imagery(tiles, **AREA)
    assert "secret" not in str(caught.value)
    assert address in str(caught.value)


def test_service_needs_a_place_and_a_resolution():
    address = "http://127.0.0.1:9/{z}/{x}/{y}.png"
    for area in ({}, {"world": WORLD, "corners": BOX}, {"resolution": 1.0}):
        with pytest.raises(ImageryError, match="give the world, the corners, and a resolution"):
            read_imagery(address, **area)


def test_larger_tiles_of_a_service_are_read_when_their_size_is_told(tmp_path, service):
    _, address = service(lambda p, _: (200, tile_png(*numbers(p), 512), 0.0))
    aim = read_imagery(Tiles(address, cache=tmp_path, tile_size=512), **AREA)
    assert aim.report["imagery"][0]["zoom"] == 17
    assert misplaced(aim, 15.0) < 0.02


# bands, masks and depths


def flat(tmp_path: Path, bands: np.ndarray, name: str = "a.tif", **profile) -> Path:
    """A raster of 0.5 m pixels amid BOX."""
    height, width = bands.shape[1:]
    place = np.array(from_origin(*(HERE - [width / 4, -height / 4]), 0.5, 0.5)).reshape(3, 3)
    return write(tmp_path / name, bands, "EPSG:32633", place, **profile)


def constant(*values: float, dtype: str = "uint8", side: int = 80) -> np.ndarray:
    return np.stack([np.full((side, side), value, dtype) for value in values])


def test_one_band_is_grey(tmp_path):
    aim = read_imagery(flat(tmp_path, constant(77)), world=WORLD)
    assert (aim.image == 77).all()


def test_fourth_band_that_is_not_alpha_is_ignored(tmp_path):
    path = flat(tmp_path, constant(10, 20, 30, 0), photometric="rgb", alpha="no")
    with rasterio.open(path) as dataset:
        assert dataset.colorinterp[3] != ColorInterp.alpha
    aim = read_imagery(path, world=WORLD)
    assert (aim.image == [10, 20, 30]).all()
    assert aim.coverage.all()


def test_bands_are_found_by_their_colours_or_as_told(tmp_path):
    path = flat(tmp_path, constant(10, 20, 30, 40))
    with rasterio.open(path, "r+") as dataset:
        dataset.colorinterp = [
            ColorInterp.blue,
            ColorInterp.green,
            ColorInterp.red,
            ColorInterp.undefined,
        ]
    assert (read_imagery(path, world=WORLD).image == [30, 20, 10]).all()
    assert (read_imagery(path, world=WORLD, bands=[4, 3, 2]).image == [40, 30, 20]).all()
    assert (read_imagery(path, world=WORLD, bands=[2]).image == 20).all()
    with pytest.raises(ImageryError, match=r"has 4 band\(s\), and bands \[5\] were wanted"):
        read_imagery(path, world=WORLD, bands=[5])
    with pytest.raises(ValueError, match="one for grey or three"):
        read_imagery(path, world=WORLD, bands=[1, 2])


@pytest.mark.parametrize("resolution", [0.23, 0.5, 0.7, 1.9])
@pytest.mark.parametrize("kind", ["alpha", "grey alpha", "nodata", "mask"])
def test_holes_stay_holes_and_do_not_darken_their_rims(tmp_path, kind, resolution):
    hole = np.zeros((80, 80), bool)
    hole[:, 50:] = True
    hole[20:28, 20:28] = True
    bands = constant(*{"alpha": (200, 150, 100, 255), "grey alpha": (180, 255)}.get(kind, (180,)))
    bands[:, hole] = 0
    path = flat(tmp_path, bands, nodata=0 if kind == "nodata" else None)
    with rasterio.open(path, "r+") as dataset:
        if "alpha" in kind:
            dataset.colorinterp = [*dataset.colorinterp[:-1], ColorInterp.alpha]
        if kind == "mask":
            dataset.write_mask(~hole)
    aim = read_imagery(path, world=WORLD, corners=BOX / 10, resolution=resolution)
    size = aim.coverage.shape[::-1]
    truth = cv2.resize((~hole[32:48, 28:52]).astype(np.float32), size, interpolation=cv2.INTER_AREA)
    assert (aim.coverage[truth > 0.99] == 1).mean() > 0.97
    seen = read_imagery(path, world=WORLD, resolution=resolution)
    colours = [200, 150, 100] if kind == "alpha" else [180] * 3
    assert np.abs(seen.image[seen.coverage > 0].astype(int) - colours).max() <= 1
    assert seen.coverage.sum() * resolution**2 == pytest.approx(
        (~hole).sum() / 4, rel=0.05 if resolution < 1 else 0.12
    )


def test_palette_is_expanded_and_its_transparency_kept(tmp_path):
    bands = constant(1)
    bands[0, :, 40:] = 2
    bands[0, 40:] = 3
    path = flat(tmp_path, bands, photometric="palette")
    with rasterio.open(path, "r+") as dataset:
        dataset.write_colormap(1, {1: (250, 10, 20, 255), 2: (0, 200, 9, 255), 3: (7, 7, 7, 255)})
    aim = read_imagery(path, world=WORLD)
    assert (aim.image[:40, :40] == [250, 10, 20]).all()
    assert (aim.image[:40, 40:] == [0, 200, 9]).all()
    assert (aim.image[40:] == 7).all()


@pytest.mark.parametrize("dtype", ["uint16", "int16", "float32", "float64"])
def test_deep_values_are_stretched_jointly_over_bands(tmp_path, dtype):
    ramp = np.linspace(300, 1300, 80 * 80).reshape(80, 80)
    path = flat(tmp_path, np.stack([ramp, ramp / 2, ramp]).astype(dtype))
    aim = read_imagery(path, world=WORLD)
    low, high = aim.report["imagery"][0]["stretch"]
    assert (low, high) == pytest.approx(np.percentile([ramp, ramp / 2, ramp], [1, 99]), rel=0.01)
    wanted = np.clip((ramp - low) / (high - low) * 255, 0, 255)
    assert np.abs(aim.image[..., 0] - wanted).max() <= 1
    wanted = np.clip((ramp / 2 - low) / (high - low) * 255, 0, 255)
    assert np.abs(aim.image[..., 1] - wanted).max() <= 1


def test_values_that_are_no_numbers_are_holes(tmp_path):
    bands = np.linspace(0, 1, 6400, dtype=np.float32).reshape(1, 80, 80)
    bands[0, 10:20, 30:50] = np.nan
    bands[0, 60, 60] = np.inf
    aim = read_imagery(flat(tmp_path, bands), world=WORLD)
    assert (aim.coverage == 0).sum() == 201
    assert (aim.coverage[10:20, 30:50] == 0).all()


def test_deep_constant_has_a_colour(tmp_path):
    aim = read_imagery(flat(tmp_path, constant(500, dtype="uint16")), world=WORLD)
    assert len(np.unique(aim.image)) == 1
    mostly = constant(0, dtype="uint16")
    mostly[0, :3, :3] = 9
    image = read_imagery(flat(tmp_path, mostly, "b.tif"), world=WORLD).image
    assert image[0, 0, 0] == 255
    assert image[-1, -1, 0] == 0


def test_alpha_of_16_bits_is_understood(tmp_path):
    bands = constant(1000, 2000, 3000, 65535, dtype="uint16")
    bands[0, :40] = 500
    bands[3, :, :40] = 0
    path = flat(tmp_path, bands, photometric="rgb", alpha="yes")
    aim = read_imagery(path, world=WORLD)
    assert not aim.coverage[:, :40].any()
    assert aim.coverage[:, 40:].all()
    assert aim.report["imagery"][0]["stretch"] == [500.0, 3000.0]


# mosaics


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
def test_rasters_that_abut_leave_no_seam(tmp_path, resolution):
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


def test_source_that_lies_elsewhere_is_left_out_with_a_warning(tmp_path):
    near, far = ortho(tmp_path / "near.tif"), tmp_path / "far.tif"
    write(far, constant(9), "EPSG:32635", np.array([[1.0, 0, 6e5], [0, -1, 0], [0, 0, 1]]))
    with pytest.warns(GeoaimWarning, match=r"far\.tif covers longitude 27\.89.* is needed in lon"):
        aim = read_imagery([far, near], world=WORLD, corners=BOX)
    assert aim.coverage.all()
    with pytest.raises(ImageryError, match=r"far\.tif covers longitude 27\.89.* is needed in lon"):
        read_imagery(far, world=WORLD, corners=BOX)


# other formats


def test_image_with_a_world_file_needs_a_crs(tmp_path):
    image = np.random.default_rng(0).integers(0, 256, (40, 60, 3), dtype=np.uint8)
    for name, world_file in (("a.png", "a.pgw"), ("b.png", "b.wld"), ("c.jpg", "c.jgw")):
        cv2.imwrite(str(tmp_path / name), image[..., ::-1])
        # a world file gives the first pixel's centre
        text = f"0.5\n0\n0\n-0.5\n{HERE[0] + 0.25}\n{HERE[1] - 0.25}\n"
        (tmp_path / world_file).write_text(text)
        with pytest.raises(ImageryError, match=r"names no coordinate.* crs='EPSG:"):
            read_imagery(tmp_path / name)
        aim = read_imagery(tmp_path / name, world=WORLD, crs="EPSG:32633")
        np.testing.assert_allclose(aim.corners[0], [0, 0], atol=1e-6)
        if name.endswith("png"):
            np.testing.assert_array_equal(aim.image, image)


def test_virtual_rasters_and_gdal_strings_are_read(tmp_path):
    path = ortho(tmp_path / "a.tif", "EPSG:3857", 0.5)
    rasterio.shutil.copy(path, tmp_path / "a.vrt", driver="VRT")
    aim = read_imagery(path, world=WORLD, corners=BOX)
    for source in (tmp_path / "a.vrt", f"GTIFF_DIR:1:{path}"):
        other = read_imagery(source, world=WORLD, corners=BOX)
        np.testing.assert_array_equal(aim.image, other.image)
    with pytest.raises(ImageryError, match="no tiles by zoom"):
        read_imagery(Tiles(path, zoom=3))


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


# size


def test_huge_raster_is_cut_without_reading_it(tmp_path):
    side = 60_000
    place = np.array(from_origin(*(HERE - [side / 20, -side / 20]), 0.1, 0.1)).reshape(3, 3)
    path = tmp_path / "a.tif"
    profile = {"driver": "GTiff", "height": side, "width": side, "count": 3, "dtype": "uint8"}
    options = {"tiled": True, "SPARSE_OK": "TRUE", "compress": "deflate", "BIGTIFF": "YES"}
    transform = Affine(*place[:2].flat)
    with rasterio.open(
        path, "w", **profile, **options, crs="EPSG:32633", transform=transform
    ) as dataset:
        middle = painted("EPSG:32633", place @ [[1, 0, 29488], [0, 1, 29488], [0, 0, 1]], *WIDE)
        dataset.write(middle, window=rasterio.windows.Window(29488, 29488, 1024, 1024))
    coarse = np.zeros((3, 938, 938), np.uint8)
    coarse[:, 400:500, 400:500] = 70  # what only overviews hold tells that they were read
    write(f"{path}.ovr", coarse, None, None)
    start = time.perf_counter()
    assert misplaced(read_imagery(path, world=WORLD, corners=BOX / 2), 15.0) < 0.02
    assert read_imagery(path, world=WORLD, resolution=20.0).image[143, 143, 0] == 70
    assert time.perf_counter() - start < 3.0


WIDE = (1024, 1024), 15.0


def test_blocks_meet_without_a_seam(tmp_path, monkeypatch):
    path = ortho(tmp_path / "a.tif", "EPSG:4326")
    for resolution in (0.4, 1.3):
        whole = read_imagery(path, world=WORLD, resolution=resolution)
        with monkeypatch.context() as small:
            small.setattr("geoaim.imagery.blocks.BLOCK_PX", 64)
            parts = read_imagery(path, world=WORLD, resolution=resolution)
        both = (whole.coverage > 0) & (parts.coverage > 0)
        assert both.sum() > whole.coverage.sum() - 9  # on the very edge either may be right
        assert np.abs(whole.image[both].astype(int) - parts.image[both]).max() <= 2


def test_more_is_not_read_than_the_image_needs(tmp_path, monkeypatch):
    read = []

    def noted(source, *rest):
        read.append(source.size)
        return convolve(source, *rest)

    convolve = resampling._convolve
    monkeypatch.setattr(resampling, "_convolve", noted)
    aim = read_imagery(ortho(tmp_path / "a.tif", pixel=0.1, side=700), world=WORLD, resolution=1.3)
    assert max(read) < 4 * 4 * aim.coverage.size


# refusals


@pytest.mark.parametrize("source", ["nowhere.tif", "nowhere/*.tif", "empty"])
def test_missing_files_are_named(tmp_path, source):
    (tmp_path / "empty").mkdir()
    with pytest.raises(FileNotFoundError, match=source.replace("*", r"\*")):
        read_imagery(tmp_path / source)


def test_pattern_of_an_address_is_no_service():
    with pytest.raises(ImageryError, match="for files give the folder"):
        read_imagery("tiles/{z}/{x}/{y}.png", world=WORLD, corners=BOX, resolution=1.0)


def test_file_that_is_no_image_is_refused(tmp_path):
    (tmp_path / "a.tif").write_text("not a picture")
    with pytest.raises(ImageryError, match=r"a\.tif cannot be read as imagery: .*not recognized"):
        read_imagery(tmp_path / "a.tif")
    with pytest.raises(ImageryError, match=r"none of the 1 file\(s\) of .* can be read"):
        read_imagery(tmp_path)


def test_cut_geotiff_is_refused(tmp_path):
    path = flat(tmp_path, np.random.default_rng(0).integers(1, 255, (3, 300, 300), dtype=np.uint8))
    path.write_bytes(path.read_bytes()[:50_000])
    with pytest.raises(ImageryError, match=r"a\.tif cannot be read"):
        read_imagery(path, world=WORLD)


def test_image_without_a_place_is_refused(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((8, 8, 3), np.uint8))
    with pytest.raises(ImageryError, match=r"no transform.* put a world file beside it"):
        read_imagery(tmp_path / "a.png", crs="EPSG:32633")


def test_nodata_alone_is_refused(tmp_path):
    path = flat(tmp_path, constant(0, 0, 0), nodata=0)
    with pytest.raises(ImageryError, match="nothing but nodata"):
        read_imagery(path, world=WORLD)


def test_world_without_a_place_on_earth_is_refused(tmp_path):
    with pytest.raises(ImageryError, match="the world has no CRS"):
        read_imagery(ortho(tmp_path / "a.tif"), world=World(None), corners=BOX)


@pytest.mark.parametrize("resolution", [0.0, -1.0, np.nan, np.inf])
def test_resolution_that_is_no_length_is_refused(resolution):
    with pytest.raises(ValueError, match="positive number of metres"):
        read_imagery("a.tif", resolution=resolution)


def test_calls_that_say_too_little_are_refused():
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


def test_half_the_world_is_not_read_as_a_whole(tmp_path):
    place = np.array(from_origin(0, 60, 0.1, 0.1)).reshape(3, 3)
    path = write(tmp_path / "a.tif", constant(9, side=100), "EPSG:4326", place)
    with pytest.raises(ImageryError, match="10 by 10 degrees"):
        read_imagery(path)


@pytest.mark.usefixtures("unchecked")
def test_compressed_images_of_gigapixels_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("geoaim.imagery.rasters.MAX_BLOCK_PIXELS", 1000)
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((40, 40, 3), np.uint8))
    with pytest.raises(ImageryError, match="40 x 40 pixels in one piece"):
        read_imagery(tmp_path / "a.png")
    path = flat(tmp_path, constant(9), tiled=True, blockxsize=16, blockysize=16)
    assert read_imagery(path, world=WORLD).coverage.all()


def test_coarse_source_is_upsampled_with_a_warning(tmp_path):
    path = ortho(tmp_path / "a.tif", pixel=2.0, side=90)
    with pytest.warns(GeoaimWarning, match="pixels of 2 m, and 0.5 m were wanted"):
        aim = read_imagery(path, world=WORLD, corners=BOX, resolution=0.5)
    assert aim.coverage.all()


# real data


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
