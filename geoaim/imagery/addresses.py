"""Addresses of imagery as services and other programs write them, and what they lead to."""

import re
from pathlib import Path
from urllib.parse import parse_qs, parse_qsl, unquote, urlsplit

from geoaim.base.errors import ImageryError, name_option
from geoaim.base.texts import hide_credentials

JOSM_PREFIX = re.compile(r"^(tms|wms|wms_endpoint|wmts|bing|scanex)(?:\[[\d,\s]*\])?:(?=\S)", re.I)
PLACEHOLDER = re.compile(r"\$?\{([^{}]*)\}")
SYNONYMS = {
    "zoom": "z",
    "col": "x",
    "tilecol": "x",
    "row": "y",
    "tilerow": "y",
    "ty": "-y",
    "quadkey": "q",
    "u": "q",
    "subdomain": "s",
    "r": "",
    "ratio": "",
    "@2x": "",
}
KNOWN = ("z", "x", "y", "-y", "q", "s")
FILES = (".tif", ".tiff", ".jp2")
NEEDED = (
    "{z}, {x} and {y} are needed ({-y} where y counts from the south, or {q} for a quadkey), such "
    "as https://host/{z}/{x}/{y}.png"
)


def is_address(text: str) -> bool:
    """Tell whether a source is an address, and not the name of a file.

    >>> is_address("tms[22]:https://host/{zoom}/{x}/{y}"), is_address("tiles/a.png")
    (True, False)
    """
    is_of_qgis = "type=xyz" in text and "url=" in text
    return "://" in text or _has_numbers(text) or is_of_qgis or JOSM_PREFIX.match(text) is not None


def find_kind(text: str) -> str | None:
    """Find what GDAL reads by an address: "wms", "wmts", a STAC "item" or "file"; of tiles None.

    >>> find_kind("https://host/ortho.tif"), find_kind("https://host/{z}/{x}/{y}.png")
    ('file', None)
    """
    if "://" not in text or _list_numbers(text):
        return None
    path = urlsplit(text).path.lower()
    by_name = "item" if path.endswith("json") else "file" if path.endswith(FILES) else None
    return _find_service(text) or by_name


def name_address(text: str) -> str:
    """Name an address in messages and reports: the file, else the host; no keys.

    >>> name_address("https://me:secret@host/a/ortho.tif?key=1"), name_address("wms:https://host/w")
    ('ortho.tif', 'host')
    """
    parts = urlsplit(hide_credentials(text[text.lower().index("http") :]))
    name = Path(parts.path).name
    return name if name.lower().endswith(FILES) else str(parts.hostname)


def hide_keys(text: str) -> str:
    """Leave user names, passwords and queries out of the addresses in a text.

    >>> hide_keys("https://me:secret@host/a?key=1 failed")
    'https://host/a?... failed'
    """
    return re.sub(r"\?\S*", "?...", hide_credentials(text))


def ask_where(name: str) -> ImageryError:
    """What is said of a service without a region."""
    return ImageryError(
        f"{name} is a service of the whole Earth: give what says where, "
        + name_option("--aim or --tracks", "the world and the corners")
    )


def normalise_address(text: str, name: str) -> str:
    """Write the address of a service with {z}, {x} and {y}, {-y} or {q} alone.

    >>> normalise_address("tms[2,22]:https://{switch:a,b}.host/{zoom}/{x}/{-y}.png", "host")
    'https://a.host/{z}/{x}/{-y}.png'
    """
    address = text.strip()
    if "type=xyz" in address and "url=" in address:
        query = parse_qs(re.sub(r"^[^?]*\?", "", address) if "://" not in address[:8] else address)
        address = query.get("url", [address])[0]
    prefix = JOSM_PREFIX.match(address)
    if prefix is not None:
        address = address[prefix.end() :]
    if "%7b" in address.lower():
        address = re.sub("%7b.*?%7d", lambda found: unquote(found[0]), address, flags=re.I)
    kind = prefix[1].lower() if prefix else "tms"
    if kind != "tms" or _find_service(address) is not None:
        raise ImageryError(
            f"{name} is not a service of numbered tiles but a WMS, a WMTS or another; {NEEDED}"
        )
    address = PLACEHOLDER.sub(lambda found: _translate(found[1], found[0], name), address)
    if not _has_numbers(address):
        raise ImageryError(
            f"{name} does not say where the numbers of tiles stand: {NEEDED}; a file of "
            "another kind is downloaded first"
        )
    return address


def _find_service(text: str) -> str | None:
    prefix = JOSM_PREFIX.match(text)
    address = urlsplit(text[prefix.end() :] if prefix else text)
    if address.path.lower().endswith("wmtscapabilities.xml"):
        return "wmts"
    query = {key.lower(): value.lower() for key, value in parse_qsl(address.query)}
    named = prefix[1].lower() if prefix else query.get("service")
    return named if named in ("wms", "wmts") else None


def _list_numbers(text: str) -> set[str]:
    """Which numbers of tiles an address has in braces."""
    inside = [word.strip().lower() for word in PLACEHOLDER.findall(text)]
    return {SYNONYMS.get(word, word) for word in inside} & set(KNOWN[:-1])


def _has_numbers(text: str) -> bool:
    numbers = _list_numbers(text)
    return "q" in numbers or ({"z", "x"} <= numbers and bool(numbers & {"y", "-y"}))


def _translate(inside: str, written: str, name: str) -> str:
    """Translate what stands in braces."""
    lower = inside.strip().lower()
    if lower.startswith("switch:"):
        return inside.strip()[len("switch:") :].split(",")[0].strip()
    known = SYNONYMS.get(lower, lower)
    if known not in (*KNOWN, ""):
        hint = "put your key there" if "key" in lower or "token" in lower else NEEDED
        raise ImageryError(f"{name} has {written}, which is not known: {hint}")
    return f"{{{known}}}" if known else ""
