"""Small files that would need much memory, and tables that would send requests, are refused."""

import gzip
import sqlite3
import zipfile
from contextlib import closing

import numpy as np
import pandas as pd
import pyarrow
import pyarrow.parquet as parquet
import pytest
import torch

import geoaim
from geoaim.base.errors import CatalogError, GeoaimError, ImageryError, ModelError, TracksError
from geoaim.base.limits import open_text
from geoaim.base.world import World
from geoaim.catalog import read_recordings
from geoaim.prediction.checkpoints import (
    PRETRAINED,
    read_model,
    read_pretrained,
    read_state,
    write_model,
    write_state,
)
from geoaim.prediction.plain import PlainNetwork
from geoaim.tracks.files import read_plain_tracks
from geoaim.web.moving_layers import describe_futures_file

ROWS = 1000
STATE = {"time": 0.0, "x": 1.0, "y": 2.0, "heading": 0.0, "speed": 1.0, "length": 4.0, "width": 2.0}


@pytest.fixture
def small_limit(monkeypatch):
    monkeypatch.setenv("GEOAIM_MAX_GB", "0.01")


def test_packed_text_has_a_limit(tmp_path, small_limit):
    path = tmp_path / "a.csv.gz"
    path.write_bytes(gzip.compress(b"0" * 10_000_000))
    with pytest.raises(GeoaimError, match="MB of text"), open_text(path, GeoaimError):
        pass


def test_a_path_is_no_address(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.csv").write_text("sample,id,time,x,y\n0,a,0,1,2\n")
    with pytest.raises(FileNotFoundError):
        describe_futures_file(f"file:{tmp_path}/a.csv")


@pytest.mark.parametrize("rows", ["", "0,a,0,inf,2\n", "0,a,0,,2\n"])
def test_futures_without_places_are_refused(tmp_path, rows):
    path = tmp_path / "a.csv"
    path.write_text(f"sample,id,time,x,y\n{rows}")
    with pytest.raises(TracksError, match="finite"):
        describe_futures_file(path)


def test_parquet_reads_the_columns_that_it_knows(tmp_path):
    rows = pd.DataFrame([{"id": "a", "type": "car", **STATE}])
    table = pyarrow.Table.from_pandas(rows).append_column("more", [[[1, 2]]])
    parquet.write_table(table, tmp_path / "a.parquet")
    assert read_plain_tracks(tmp_path / "a.parquet", world=World(None)).ids == ("a",)


def test_a_text_that_parquet_tells_often_has_a_limit(tmp_path, small_limit):
    rows = pd.DataFrame([{"id": "a" * 100_000, "type": "car", **STATE}] * ROWS)
    rows["time"] = np.arange(ROWS) / 10
    parquet.write_table(pyarrow.Table.from_pandas(rows), tmp_path / "a.parquet")
    with pytest.raises(TracksError, match="texts"):
        read_plain_tracks(tmp_path / "a.parquet", world=World(None))


@pytest.fixture
def state():
    state = read_state(PRETRAINED / "pedestrian.pt")
    del state["format"]
    return state


@pytest.mark.parametrize("value", [0, -1.0, float("nan"), 1e9, "x", None])
@pytest.mark.parametrize("name", ["dt", "resolution"])
def test_models_with_impossible_numbers_are_refused(tmp_path, state, name, value):
    state["config"][name] = value
    write_state(state, tmp_path / "a.pt")
    with pytest.raises(ModelError, match=f"its {name} is"):
        read_model(tmp_path / "a.pt")


@pytest.mark.parametrize(
    "change", [lambda _: torch.zeros(1).expand(10**10), torch.Tensor.to_sparse, lambda x: x[:1]]
)
def test_weights_that_the_file_does_not_hold_are_refused(tmp_path, state, change):
    name = next(iter(state["weights"]))
    state["weights"][name] = change(state["weights"][name])
    write_state(state, tmp_path / "a.pt")
    with pytest.raises(ModelError, match=name):
        read_model(tmp_path / "a.pt")


@pytest.mark.parametrize("name", ["cells", "propose.0.weight"])
def test_networks_of_a_place_that_the_file_does_not_hold_are_refused(tmp_path, name):
    model = read_pretrained("vehicle")
    model.own_place = PlainNetwork(model.config, 10, 40, cells=torch.zeros(3, 2))
    write_model(model, tmp_path / "a.pt")
    assert read_model(tmp_path / "a.pt").own_place.cells.shape == (3, 2)
    state = read_state(tmp_path / "a.pt")
    del state["format"]
    state["own_place"]["weights"][name] = torch.zeros(1).expand(10**10, 2)
    write_state(state, tmp_path / "a.pt")
    with pytest.raises(ModelError, match=name):
        read_model(tmp_path / "a.pt")


def test_packed_models_are_refused(tmp_path):
    with (
        zipfile.ZipFile(PRETRAINED / "pedestrian.pt") as archive,
        zipfile.ZipFile(tmp_path / "a.pt", "w", zipfile.ZIP_DEFLATED) as packed,
    ):
        for name in archive.namelist():
            packed.writestr(name, archive.read(name))
    with pytest.raises(ModelError, match="not a model"):
        read_model(tmp_path / "a.pt")


@pytest.mark.parametrize(
    "cell",
    ["http://user:secret@host/a.mp4", "file:///etc/hostname", "simplecache::a.mp4", "s3://b/a"],
)
def test_a_table_names_no_store_that_was_not_allowed(tmp_path, cell):
    (tmp_path / "a.csv").write_text(f"video\n{cell}\n")
    with pytest.raises(CatalogError, match="did not name") as caught:
        read_recordings(tmp_path / "a.csv", stores=["s3://bucket/"])
    assert "secret" not in str(caught.value)


@pytest.mark.parametrize(
    "rows",
    [
        "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n) SELECT 1, 0, 0, '' FROM n",
        "SELECT 1, 0, 0, zeroblob(50000000)",
    ],
)
def test_views_of_map_tiles_have_limits(tmp_path, rows):
    path = tmp_path / "a.mbtiles"
    with closing(sqlite3.connect(path)) as database, database:
        names = "zoom_level, tile_column, tile_row, tile_data"
        database.execute(f"CREATE VIEW tiles ({names}) AS {rows}")
        database.execute("CREATE TABLE metadata (name, value)")
    with pytest.raises(ImageryError):
        geoaim.read_imagery(path)
