"""Objects of GIS libraries as inputs and outputs: geopandas, xarray, rasterio."""

import cv2
import numpy as np
import pandas as pd
import pytest
import rasterio
from rasterio.io import MemoryFile
from shapely.geometry import box

import geoaim
from geoaim.base.errors import GeoaimError
from geoaim.base.world import World, lonlat_from_world
from geoaim.hdmap.drivable import read_drivable_area
from geoaim.imagery.mosaic import read_imagery, read_lonlat
from geoaim.mapping.georeference.control_points import read_control_points

geopandas = pytest.importorskip("geopandas")
rioxarray = pytest.importorskip("rioxarray")
ORTHO = "samples/ortho.tif"


@pytest.fixture(scope="module")
def tracks():
    return geoaim.read_tracks("samples/tracks.csv")


def _check_equal(found, tracks):
    """Same agents at the same absolute places and times, whatever the origins."""
    assert found.ids == tracks.ids
    assert found.types == tracks.types
    np.testing.assert_array_equal(found.present, tracks.present)
    np.testing.assert_allclose(found.times, tracks.times, atol=1e-3)
    np.testing.assert_allclose(found.sizes, tracks.sizes, atol=1e-3)
    one, other = (x.states[x.present][:, :2] + np.array(x.world.origin) for x in (found, tracks))
    np.testing.assert_allclose(one, other, atol=1e-3)


def test_tracks_become_a_geodataframe_with_crs_and_clock_time(tracks):
    table = tracks.to_geodataframe(start="2026-05-01T08:00:00+02:00")
    assert table.crs == tracks.world.crs
    assert len(table) == tracks.present.sum()
    row = table.iloc[0]
    assert (row.geometry.x, row.geometry.y) == (row.x, row.y)
    np.testing.assert_allclose(
        [row.x, row.y], tracks.states[tracks.present][0, :2] + tracks.world.origin
    )
    since = table["datetime"] - pd.Timestamp("2026-05-01T06:00:00Z")
    np.testing.assert_allclose(since.dt.total_seconds(), table["time"], atol=1e-6)
    assert "datetime" not in tracks.to_geodataframe()


@pytest.mark.parametrize("suffix", [".gpkg", ".parquet"])
def test_tracks_survive_files_of_geopandas(tracks, tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    table = tracks.to_geodataframe().drop(columns=["x", "y"])
    if suffix == ".gpkg":
        table.rename_geometry("geom").to_file(path, layer="states", driver="GPKG")
    else:
        table.to_parquet(path)
    _check_equal(geoaim.read_tracks(path), tracks)


@pytest.mark.parametrize("suffix", [".gpkg", ".parquet"])
def test_geopandas_reads_written_tracks(tracks, tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    geoaim.write_tracks(tracks, path)
    if suffix == ".gpkg":
        table = geopandas.read_file(path, layer="states")
    else:
        table = geopandas.read_parquet(path)
    assert table.crs == tracks.world.crs
    places = tracks.states[tracks.present][:, :2] + tracks.world.origin
    found = np.column_stack([table.geometry.x, table.geometry.y])
    np.testing.assert_allclose(found, places, atol=1e-6)
    _check_equal(geoaim.read_tracks(path), tracks)


def test_degrees_of_a_geoparquet_become_metres(tracks, tmp_path):
    table = tracks.to_geodataframe().drop(columns=["x", "y"]).to_crs("EPSG:4326")
    table.to_parquet(tmp_path / "a.parquet")
    found = geoaim.read_tracks(tmp_path / "a.parquet")
    lonlat = [lonlat_from_world(x.world, x.states[x.present][:, :2]) for x in (found, tracks)]
    np.testing.assert_allclose(*lonlat, atol=1e-8)
    assert found.world.crs.startswith("EPSG:326")


def test_table_without_a_header_takes_a_world(tracks, tmp_path):
    path = tmp_path / "a.csv"
    tracks.to_dataframe().to_csv(path, index=False)
    found = geoaim.read_tracks(path, world=tracks.world)
    assert found.world == tracks.world
    _check_equal(found, tracks)
    tracks.to_dataframe().to_parquet(path.with_suffix(".parquet"))
    _check_equal(geoaim.read_tracks(path.with_suffix(".parquet"), world=tracks.world), tracks)
    with pytest.raises(GeoaimError, match="no world was given"):
        geoaim.read_tracks(path)
    geoaim.write_tracks(tracks, path)
    with pytest.raises(GeoaimError, match="omit it"):
        geoaim.read_tracks(path, world=World("EPSG:32633"))


def test_map_becomes_an_array_of_xarray_and_is_read_again():
    aim = read_imagery(ORTHO, resolution=0.5)
    array = aim.to_xarray()
    assert array.dims == ("band", "y", "x")
    assert array.rio.crs == aim.world.crs
    left, bottom, right, top = array.rio.bounds()
    corners = aim.corners + aim.world.origin
    np.testing.assert_allclose([left, top], corners[0])
    np.testing.assert_allclose([right, bottom], corners[2])
    found = read_imagery(array, world=aim.world, corners=aim.corners, resolution=0.5)
    np.testing.assert_array_equal(found.coverage, aim.coverage)
    inner = cv2.erode(aim.coverage, np.ones((7, 7))) > 0
    np.testing.assert_array_equal(found.image[inner], aim.image[inner])


def test_open_datasets_are_imagery():
    expected = read_imagery(ORTHO, resolution=0.5)
    with rasterio.open(ORTHO) as dataset:
        np.testing.assert_array_equal(read_imagery(dataset, resolution=0.5).image, expected.image)
        content, profile = dataset.read(), {**dataset.profile, "driver": "GTiff"}
    with MemoryFile() as memory:
        with memory.open(**profile) as dataset:
            dataset.write(content)
        with memory.open() as dataset:
            found = read_imagery([dataset], resolution=0.5)
    np.testing.assert_array_equal(found.image, expected.image)


def test_control_points_come_from_tables():
    table = pd.DataFrame({"u": [1.0, 2.0], "v": [3.0, 4.0], "lon": [9.0, 9.1], "lat": [48.0, 49.0]})
    points = read_control_points(table)
    assert points.crs == "EPSG:4326"
    np.testing.assert_array_equal(points.coordinates, table[["lon", "lat"]])
    places = geopandas.points_from_xy(table["lon"], table["lat"], crs="EPSG:4326")
    frame = geopandas.GeoDataFrame(table[["u", "v"]], geometry=places).to_crs("EPSG:32632")
    found = read_control_points(frame)
    assert found.crs == "EPSG:32632"
    np.testing.assert_allclose(found.coordinates[:, 0], frame.geometry.x)
    np.testing.assert_array_equal(found.pixels, points.pixels)


def test_drivable_area_comes_from_shapes():
    world = World("EPSG:32632", (500_000.0, 5_000_000.0))
    square = box(10, 20, 40, 60)
    assert read_drivable_area(square, world).area == pytest.approx(1200)
    absolute = box(500_010, 5_000_020, 500_040, 5_000_060)
    frame = geopandas.GeoDataFrame(geometry=[absolute], crs="EPSG:32632")
    for given in (frame, frame.to_crs("EPSG:4326")):
        found = read_drivable_area(given, world)
        np.testing.assert_allclose(found.bounds, square.bounds, atol=1e-3)
    with pytest.raises(GeoaimError, match="the GeoDataFrame holds Point"):
        read_drivable_area(geopandas.GeoDataFrame(geometry=frame.centroid, crs=frame.crs), world)


def test_errors_name_no_temporary_folder():
    profile = {"driver": "GTiff", "width": 8, "height": 8, "count": 3, "dtype": "uint8"}
    with MemoryFile() as memory:
        with memory.open(**profile, transform=rasterio.Affine(2, 0, 5, 0, -2, 5)) as made:
            made.write(np.full((3, 8, 8), 99, np.uint8))
        with memory.open() as dataset:
            for read in (read_imagery, lambda source: read_lonlat(source, None)):
                with pytest.raises(GeoaimError) as caught:
                    read(dataset)
                assert str(caught.value).startswith("source 1.tif"), caught.value
