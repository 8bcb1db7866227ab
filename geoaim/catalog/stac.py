"""STAC: an item for each map, and a collection with a GeoParquet index of all items."""

import json
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pystac

from geoaim.catalog.records import CHANGES, FOLDER, ITEM, LOOK, MAP, TRACKS, Record

COLLECTION = "collection.json"
INDEX = "items.parquet"
EXTENSIONS = [
    "https://stac-extensions.github.io/projection/v2.0.0/schema.json",
    "https://stac-extensions.github.io/file/v2.1.0/schema.json",
]
SHA256_MULTIHASH = "1220"  # the code of SHA-256, and its length
MEDIA_TYPES = {
    MAP: pystac.MediaType.COG,
    LOOK: pystac.MediaType.PNG,
    CHANGES: pystac.MediaType.JPEG,
    TRACKS: "application/vnd.apache.parquet",
}
ROLES = {MAP: "data", LOOK: "overview", CHANGES: "overview", TRACKS: "data"}


def make_item(record: Record) -> pystac.Item:
    """Make the item of a map: its footprint, time, accuracy and files."""
    grid = record.grid
    assert record.datetime is not None
    geometry = bbox = None
    if corners := grid["corners_lonlat"]:
        ring = [*corners[::-1], corners[-1]]  # counter-clockwise
        geometry = {"type": "Polygon", "coordinates": [ring]}
        sides = list(zip(*ring, strict=True))
        bbox = [*map(min, sides), *map(max, sides)]
    item = pystac.Item(
        id=record.name,
        geometry=geometry,
        bbox=bbox,
        datetime=parse_time(record.datetime),
        properties=_list_properties(record),
        stac_extensions=EXTENSIONS,
        collection="geoaim",
    )
    for name, file in record.files.items():
        fields = {"file:size": file.size, "file:checksum": SHA256_MULTIHASH + file.sha256}
        item.add_asset(
            "quicklook" if name == LOOK else Path(name).stem,
            pystac.Asset(
                f"./{name}", media_type=MEDIA_TYPES[name], roles=[ROLES[name]], extra_fields=fields
            ),
        )
    item.add_link(pystac.Link("collection", f"../../{COLLECTION}", pystac.MediaType.JSON))
    return item


def format_item(record: Record) -> bytes:
    """Format the item of a map as JSON."""
    return _format(make_item(record).to_dict(include_self_link=False, transform_hrefs=False))


def format_index(records: Sequence[Record]) -> dict[str, bytes]:
    """Format the collection and the index (stac-geoparquet) of the maps that were built."""
    items = [make_item(record) for record in records if record.status == "built"]
    contents = {COLLECTION: _format(_make_collection(items))}
    placed = [_move_to_root(item) for item in items if item.geometry is not None]
    if placed:
        # imported here, since it imports geopandas, which takes a second
        from stac_geoparquet.arrow import parse_stac_items_to_arrow, to_parquet

        with TemporaryDirectory() as folder:
            path = Path(folder) / INDEX
            to_parquet(parse_stac_items_to_arrow(placed), path)
            contents[INDEX] = path.read_bytes()
    return contents


def _list_properties(record: Record) -> dict[str, Any]:
    grid, report = record.grid, record.report
    registration, georeference = report["registration"], report["georeference"]
    uncertainty = georeference.get("uncertainty") or {}
    return {
        "created": record.started,
        "geoaim:place": record.choices.get("place"),
        "gsd": grid["resolution_m"],
        "proj:code": grid["crs"] if str(grid["crs"]).startswith("EPSG:") else None,
        "proj:shape": grid["shape"],
        "proj:transform": grid["transform"],
        "geoaim:version": record.version,
        "geoaim:datetime_source": record.datetime_source,
        "geoaim:registered_frames": registration["valid"],
        "geoaim:frames": registration["frames"],
        "geoaim:registration_uncertainty_px": registration["uncertainty_px"],
        "geoaim:contested_share": report["background"]["contested_share"],
        "geoaim:approximate": georeference["approximate"],
        "geoaim:median_uncertainty_m": uncertainty.get("median_m"),
        "geoaim:worst_corner_m": uncertainty.get("worst_corner_m"),
    }


def _make_collection(items: Sequence[pystac.Item]) -> Mapping[str, Any]:
    boxes = [item.bbox for item in items if item.bbox is not None] or [[-180.0, -90.0, 180.0, 90.0]]
    sides = list(zip(*boxes, strict=True))
    box = [min(sides[0]), min(sides[1]), max(sides[2]), max(sides[3])]
    times = [item.datetime for item in items if item.datetime is not None]
    collection = pystac.Collection(
        id="geoaim",
        description="Aerial image-based maps (AIM) built by geoaim",
        license="other",
        extent=pystac.Extent(
            pystac.SpatialExtent([box]),
            pystac.TemporalExtent([[min(times, default=None), max(times, default=None)]]),
        ),
    )
    if any(item.geometry for item in items):
        index = pystac.Asset(
            f"./{INDEX}", media_type="application/vnd.apache.parquet", roles=["index"]
        )
        collection.add_asset("index", index)
    for item in items:
        href = f"./{FOLDER}/{item.id}/{ITEM}"
        collection.add_link(pystac.Link("item", href, pystac.MediaType.GEOJSON))
    return collection.to_dict(include_self_link=False, transform_hrefs=False)


def _move_to_root(item: pystac.Item) -> dict[str, Any]:
    """An item whose files are relative to the index."""
    values = item.to_dict(include_self_link=False, transform_hrefs=False)
    for asset in values["assets"].values():
        asset["href"] = f"./{FOLDER}/{item.id}/{asset['href'].removeprefix('./')}"
    values["links"] = []
    return values


def parse_time(text: str) -> datetime:
    """Parse a date and time, of this machine's zone if it names none."""
    time = datetime.fromisoformat(text)
    return time if time.tzinfo else time.astimezone()


def _format(values: Mapping[str, Any]) -> bytes:
    return json.dumps(values, indent=1, allow_nan=False).encode()
