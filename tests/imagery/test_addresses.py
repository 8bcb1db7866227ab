"""Addresses of tile services as other programs write them."""

import re

import pytest

from geoaim.base.errors import ImageryError
from geoaim.imagery.addresses import find_kind, is_address, normalise_address
from geoaim.imagery.tile_service import _make_url


@pytest.mark.parametrize(
    ("address", "url"),
    [
        ("https://h/{z}/{x}/{y}.png", "https://h/3/2/5.png"),
        ("https://{s}.h/{z}/{x}/{y}{r}.png", "https://a.h/3/2/5.png"),  # Leaflet
        ("tms[22]:https://{switch:c,b}.h/{zoom}/{y}/{x}", "https://c.h/3/5/2"),  # JOSM
        ("tms:https://h/{zoom}/{x}/{-y}.png", "https://h/3/2/2.png"),
        ("tms[2,19]:https://h/{zoom}/{x}/{ty}.png", "https://h/3/2/2.png"),  # iD
        ("https://h/%7Bz%7D/%7Bx%7D/%7By%7D.png", "https://h/3/2/5.png"),
        (
            "type=xyz&url=https://h/%7Bz%7D/%7Bx%7D/%7B-y%7D.png&zmax=19",
            "https://h/3/2/2.png",
        ),  # QGIS
        ("https://h/tiles/a{q}.jpeg?g=1", "https://h/tiles/a212.jpeg?g=1"),
        ("https://h/tiles/a{quadkey}.jpeg", "https://h/tiles/a212.jpeg"),
        ("https://h/${z}/${x}/${y}.png", "https://h/3/2/5.png"),  # OpenLayers
    ],
)
def test_addresses_of_other_programs_are_read(address: str, url: str) -> None:
    assert is_address(address)
    assert _make_url(normalise_address(address, "h"), 3, 2, 5) == url


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("https://h/tiles", "{z}, {x} and {y} are needed"),
        ("https://h/{z}/{x}", "{z}, {x} and {y} are needed"),
        ("wms:https://h/?layers=a&bbox={bbox}", "not a service of numbered tiles but a WMS"),
        ("https://h/?SERVICE=WMTS&REQUEST=GetTile&x={x}", "not a service of numbered tiles"),
        ("https://h/{z}/{x}/{y}?key={apikey}", "put your key there"),
        ("https://h/{z}/{x}/{y}/{time}", "{time}, which is not known"),
    ],
)
def test_what_has_no_numbers_of_tiles_is_refused(address: str, message: str) -> None:
    assert is_address(address)
    with pytest.raises(ImageryError, match=re.escape(message)):
        normalise_address(address, "h")


@pytest.mark.parametrize("name", ["tiles/a.png", "C:\\tiles", "tiles/*.jpg", "a.mbtiles"])
def test_names_of_files_are_no_addresses(name: str) -> None:
    assert not is_address(name)


@pytest.mark.parametrize(
    ("address", "kind"),
    [
        ("https://h/ortho.TIF?key=1", "file"),
        ("https://h/item.json", "item"),
        ("wms[3]:https://h/w?layers=a", "wms"),
        ("https://h/WMTSCapabilities.xml", "wmts"),
        ("tms:https://h/{zoom}/{x}/{ty}.tif", None),
        ("https://h/tiles/a{quadkey}.tif", None),
        ("folder/ortho.tif", None),
        ("https://h/page", None),
    ],
)
def test_what_an_address_leads_to(address: str, kind: str | None) -> None:
    assert find_kind(address) == kind
