"""A synthetic place's HD maps, surfaces, orthophoto and tiles as files."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rasterio
import shapely
from jaxtyping import Float, UInt8
from numpy import ndarray as Array
from rasterio.enums import ColorInterp

from benchmarks.synthetic.imagery import (
    Imagery,
    cut_tiles,
    draw_offset,
    georeference_photo,
    make_other_day,
    photograph,
)
from benchmarks.synthetic.place import Place
from benchmarks.synthetic.roads.lanelet import make_lanelet_map
from benchmarks.synthetic.roads.paving import outline_crossing
from benchmarks.synthetic.sample import Sample, tracks_of
from geoaim.base.geometry import transform_points
from geoaim.base.raster_files import create_raster_file
from geoaim.base.world import lonlat_from_world
from geoaim.imagery.tiles import MERCATOR

ZOOM = 19  # zoom level of the tiles


def write_maps(sample: Sample, folder: Path) -> None:
    """Write `map.osm` (public lanes alone), `map_full.osm` (everything) and `surfaces.geojson`."""
    place = sample.place
    frame = place.roads, place.world_from_plan, place.world
    (folder / "map.osm").write_bytes(make_lanelet_map(*frame))
    (folder / "map_full.osm").write_bytes(make_lanelet_map(*frame, complete=True))
    paving = place.roads.paving
    surfaces = {
        "carriageway": paving.carriageway,
        "island": paving.islands,
        "pavement": shapely.union_all([paving.pavement, place.roads.footpaths.surface]),
        "drive": paving.driveway,
        "car park": paving.parking_lot,
    }
    features = [_make_feature(place, area, {"kind": kind}) for kind, area in surfaces.items()]
    for crossing in place.roads.crossings:
        properties = {"kind": "crossing", "name": crossing.name, "marked": crossing.marked}
        features.append(_make_feature(place, outline_crossing(crossing), properties))
    features = [feature for feature in features if feature["geometry"]["coordinates"]]
    content = {"type": "FeatureCollection", "features": features}
    (folder / "surfaces.geojson").write_bytes((json.dumps(content) + "\n").encode())


def write_imagery(sample: Sample, folder: Path) -> tuple[float, float]:
    """Write `ortho.tif` and `tiles/` of another day; return their offset, metres east and north."""
    place = sample.place
    tracks = tracks_of(sample, len(sample.recordings) - 1)
    states, present = tracks.states[:, -1:], tracks.present[:, -1:]
    last = replace(tracks, times=tracks.times[-1:], states=states, present=present)
    offset = draw_offset(place)
    photo = photograph(place, make_other_day(place), last, resolution=sample.resolution)
    ortho = georeference_photo(place, photo, "EPSG:3035", offset=offset)
    _write_geotiff(ortho, folder / "ortho.tif")
    web = georeference_photo(place, photo, MERCATOR, offset=offset)
    for column, row, tile in cut_tiles(web, ZOOM):
        write_jpeg(tile, folder / "tiles" / str(ZOOM) / str(column) / f"{row}.jpg", quality=85)
    return offset


def write_jpeg(image: UInt8[Array, "H W 3"], path: Path, *, quality: int) -> None:
    """Write an image as JPEG.

    Args:
        image: RGB.
        path: file to write; its folders are made.
        quality: 0 to 100.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    bgr = np.ascontiguousarray(image[..., ::-1])
    done, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not done:
        raise OSError(f"{path}: the image could not be encoded")
    path.write_bytes(data.tobytes())


def _make_feature(
    place: Place, area: shapely.Geometry, properties: dict[str, Any]
) -> dict[str, Any]:
    """Make a GeoJSON feature of the part of an area that lies within the place."""

    def to_lonlat(points: Float[Array, "m 2"]) -> Float[Array, "m 2"]:
        world = transform_points(place.world_from_plan, points)
        return np.round(lonlat_from_world(place.world, world), 9)

    parts = shapely.get_parts(area.intersection(place.roads.extent))
    polygons = [part for part in parts if part.geom_type == "Polygon" and part.area]
    whole = shapely.transform(shapely.MultiPolygon(polygons), to_lonlat)
    whole = shapely.make_valid(whole, method="structure")
    parts = shapely.get_parts(shapely.set_precision(whole, 1e-9))  # rounded, and still valid
    polygons = [part for part in parts if part.geom_type == "Polygon"]
    geometry = shapely.geometry.mapping(shapely.MultiPolygon(polygons))
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def _write_geotiff(imagery: Imagery, path: Path) -> None:
    """Write RGB and alpha, as map services deliver them."""
    height, width = imagery.covered.shape
    profile = {"driver": "GTiff", "height": height, "width": width, "count": 4, "dtype": "uint8"}
    transform = rasterio.Affine(*imagery.crs_from_image[:2].flat)
    profile |= {"crs": imagery.crs, "transform": transform, "compress": "deflate", "predictor": 2}
    profile |= {"tiled": True, "blockxsize": 256, "blockysize": 256}
    with create_raster_file(path, profile) as dataset:
        dataset.write(np.moveaxis(imagery.image, -1, 0), [1, 2, 3])
        dataset.write(np.where(imagery.covered, 255, 0).astype(np.uint8), 4)
        dataset.colorinterp = [ColorInterp[name] for name in ("red", "green", "blue", "alpha")]
