"""Fetch tiles of a service into a cache; only the host in its address is contacted."""

import hashlib
import re
import time
import urllib.request
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from http.client import HTTPException, HTTPMessage
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.parse import urlsplit

from geoaim.base.errors import ImageryError, name_option
from geoaim.base.files import atomic_write
from geoaim.base.raster_files import open_raster_file
from geoaim.imagery.addresses import hide_keys
from geoaim.imagery.tiles import make_quadkey

CONNECTIONS = 4
TIMEOUT_S = 20  # for one tile
TOTAL_S = 120.0  # for all that is needed of one source
RETRIES = 2  # how often a failed request is repeated
MAX_AGE_S = 30 * 24 * 3600.0  # older tiles in the cache are fetched again
MAX_TILE_BYTES = 20_000_000
MISSING_CODES = (204, 404)  # HTTP codes by which services say that they do not have a tile
TILE_DRIVERS = ("PNG", "JPEG", "WEBP")


@dataclass(frozen=True)
class Service:
    """A tile service."""

    # its URL with {z}, {x} and {y}, or {-y} where y counts from the south, or {q}: a quadkey
    address: str
    name: str  # used in messages; without access keys
    tile_size: int  # pixels
    cache: Path  # folder


class _SameHost(urllib.request.HTTPRedirectHandler):
    """Follows redirects on the same host only: another may be in a private network."""

    def redirect_request(
        self,
        request: urllib.request.Request,
        response: Any,
        code: int,
        message: str,
        headers: HTTPMessage,
        url: str,
    ) -> urllib.request.Request | None:
        new, old = urlsplit(url), urlsplit(request.full_url)
        if new.scheme not in ("http", "https") or new.netloc != old.netloc:
            response.close()
            raise ImageryError(f"redirected to {new.netloc or new.scheme}, another host")
        return super().redirect_request(request, response, code, message, headers, url)


def fetch_tiles(
    service: Service, zoom: int, numbers: Sequence[tuple[int, int]]
) -> Iterator[tuple[int, int, Path]]:
    """Fetch tiles, or find them in the cache, where they stay for 30 days."""
    if urlsplit(service.address).scheme not in ("http", "https"):
        raise ImageryError(
            f"{service.name} is not the URL of a tile service (https://...); for files give the "
            "folder"
        )
    key = hashlib.sha256(service.address.encode()).hexdigest()[:16]
    folder = service.cache.expanduser() / key
    for old in folder.rglob("*.tile"):
        with suppress(FileNotFoundError):  # another process may remove it too
            if time.time() - old.stat().st_mtime > MAX_AGE_S:
                old.unlink()
    paths = [folder / f"{zoom}/{x}/{y}.tile" for x, y in numbers]
    wanted = [item for item in zip(numbers, paths, strict=True) if not item[1].exists()]
    with ThreadPoolExecutor(CONNECTIONS) as threads:
        urls = [_make_url(service.address, zoom, *number) for number, _ in wanted]
        contents = threads.map(partial(request, name=service.name), urls)
        try:
            end = time.monotonic() + TOTAL_S
            for done, ((_, path), content) in enumerate(zip(wanted, contents, strict=True)):
                if time.monotonic() > end:
                    raise ImageryError(
                        f"{service.name} took over {TOTAL_S:.0f} s for {done} of {len(wanted)} "
                        "tiles, which are kept: ask again, or for a coarser zoom"
                    )
                if content:
                    with atomic_write(path, shared=True) as temporary:
                        temporary.write_bytes(content)
                        _check_size(service, temporary)
        finally:
            threads.shutdown(cancel_futures=True)
    for (x, y), path in zip(numbers, paths, strict=True):
        if path.exists():
            yield x, y, path


def _make_url(address: str, zoom: int, x: int, y: int) -> str:
    values = {"z": zoom, "x": x, "y": y, "-y": 2**zoom - 1 - y, "s": "a"}
    values["q"] = make_quadkey(zoom, x, y)
    return re.sub(r"\{(-?[xyzsq])\}", lambda found: str(values[found[1]]), address)


def request(url: str, name: str) -> bytes:
    """Ask for a tile, or another small file; empty where the service has none.

    Raises:
        ImageryError: it does not answer, also when it is asked again; `name` is in the message.
    """
    asked = urllib.request.Request(url, headers={"User-Agent": "geoaim"})
    opener = urllib.request.build_opener(_SameHost)
    for attempt in range(RETRIES + 1):
        try:
            with opener.open(asked, timeout=TIMEOUT_S) as response:
                return _read_in_time(response)
        except (OSError, HTTPException, ImageryError) as error:  # URLError is an OSError
            code = 0
            if isinstance(error, HTTPError):
                code = error.code
                error.close()
            if code in MISSING_CODES:
                return b""
            if attempt == RETRIES or isinstance(error, ImageryError):
                raise ImageryError(f"{name} cannot be read: {hide_keys(str(error))}") from error
        time.sleep(0.2 * 2**attempt)
    raise AssertionError


def _read_in_time(response: Any) -> bytes:
    """Read an answer, whose parts may each come in time and yet take for ever."""
    parts, end = [], time.monotonic() + TIMEOUT_S
    while part := response.read1(MAX_TILE_BYTES):
        parts.append(part)
        if time.monotonic() > end or sum(map(len, parts)) > MAX_TILE_BYTES:
            raise TimeoutError(f"it takes over {TIMEOUT_S} s or {MAX_TILE_BYTES / 1e6:.0f} MB")
    return b"".join(parts)


def _check_size(service: Service, path: Path) -> None:
    try:
        with open_raster_file(path, TILE_DRIVERS) as dataset:
            height, width = dataset.shape
    except OSError as error:
        raise ImageryError(
            f"{service.name} answered with something other than PNG, JPEG or WebP"
        ) from error
    if (height, width) != (service.tile_size, service.tile_size):
        raise ImageryError(
            f"{service.name} has tiles of {height} x {width} pixels; give that as "
            + name_option("--tile-size", "tile_size=")
        )
