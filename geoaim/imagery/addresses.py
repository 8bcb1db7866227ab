"""Addresses of tile services as QGIS, JOSM, iD, Leaflet and OpenLayers write them."""

import re
from urllib.parse import parse_qs, unquote

from geoaim.base.errors import ImageryError

JOSM_PREFIX = re.compile(r"^(tms|wms|wms_endpoint|wmts|bing|scanex)(?:\[[\d,\s]*\])?:(?=\S)", re.I)
WHOLE_EARTH = re.compile(r"[?&]service=wm(t?)s\b|[?&]request=get(map|tile|capabilities)\b", re.I)
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
NEEDED = (
    "{z}, {x} and {y} are needed ({-y} where y counts from the south, or {q} for a quadkey), such "
    "as https://host/{z}/{x}/{y}.png"
)


def is_address(text: str) -> bool:
    """Tell whether a source is the address of a service, and not the name of a file.

    >>> is_address("tms[22]:https://host/{zoom}/{x}/{y}"), is_address("tiles/a.png")
    (True, False)
    """
    has_numbers = "{z}" in text and "{x}" in text and "y}" in text
    is_of_qgis = "type=xyz" in text and "url=" in text
    return "://" in text or has_numbers or is_of_qgis or JOSM_PREFIX.match(text) is not None


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
    if kind != "tms" or WHOLE_EARTH.search(address):
        raise ImageryError(
            f"{name} is not a service of numbered tiles but a WMS, a WMTS or another; {NEEDED}"
        )
    address = PLACEHOLDER.sub(lambda found: _translate(found[1], found[0], name), address)
    has_numbers = {"{z}", "{x}"} <= set(re.findall(r"\{z\}|\{x\}", address)) and "y}" in address
    if not has_numbers and "{q}" not in address:
        raise ImageryError(f"{name} does not say where the numbers of tiles stand: {NEEDED}")
    return address


def make_quadkey(zoom: int, x: int, y: int) -> str:
    """Make the quadkey of a tile: a digit for each zoom level, of the bits of x and y.

    >>> make_quadkey(3, 3, 5)
    '213'
    """
    digits = (
        ((x >> level) & 1) + 2 * ((y >> level) & 1) for level in reversed(range(max(zoom, 0)))
    )
    return "".join(map(str, digits))


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
