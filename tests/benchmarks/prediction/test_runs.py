"""Every experiment runs on tiny input: one-step trainings of tiny models at one small place."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import torch
from PIL import Image

from benchmarks.prediction import (
    aim_or_hdmap,
    closed_loop,
    known_views,
    latent_scales,
    models,
    pedestrians,
    pretrained,
    protocol,
    realistic,
    sind,
    songdo,
    stanford,
    stanford_baselines,
    unsure_speeds,
    vehicles,
)
from benchmarks.prediction.places import TEST, TRAIN, make_place_scene, read_map, read_recordings
from benchmarks.prediction.results import Workspace
from benchmarks.prediction.windows import WINDOW_STEPS, make_path_segments
from geoaim.prediction.baselines import BASELINES
from geoaim.prediction.checkpoints import read_model
from geoaim.prediction.config import SEGMENT_STEPS, SEGMENT_STRIDES
from geoaim.prediction.dataset import split_scene
from geoaim.prediction.familiarity import KnownViews
from geoaim.prediction.training import init_model
from geoaim.rendering.scene import slice_scene
from tests.prediction.tiny import hill

SMALL_LOOP = {"CHUNK_STEPS": 3, "SEGMENT_STEPS": 20, "SEGMENTS": 2}
SMALL = {"view_size": 16, "view_stride": 50, "hidden_size": 16, "feature_size": 12}


@pytest.fixture
def workspace(place, monkeypatch, tmp_path):
    """A workspace with one place, in which all trainings are tiny."""
    (tmp_path / "places").symlink_to(place.parent)
    for kind, steps in {"vehicle": 20, "pedestrian": 14}.items():
        monkeypatch.setitem(SEGMENT_STEPS, kind, steps)
        monkeypatch.setitem(SEGMENT_STRIDES, kind, 50)
        monkeypatch.setitem(TRAIN, kind, ((5, "t"),))
        monkeypatch.setitem(TEST, kind, ((5, "t"),))
        training = replace(models.TRAININGS[kind], steps=1, batch_size=2)
        monkeypatch.setitem(models.TRAININGS, kind, training)
    for name, spec in models.MODELS.items():
        small = replace(spec, config=replace(spec.config, **SMALL), seeds=1)
        monkeypatch.setitem(models.MODELS, name, small)
    monkeypatch.setattr(protocol, "VAL_FRACTION", 0.4)
    monkeypatch.setattr(protocol, "SAMPLES", 2)
    monkeypatch.setattr(protocol, "split_scene", lambda scene, share: split_scene(scene, share / 5))
    monkeypatch.setattr("geoaim.prediction.training.MAX_VAL_SEGMENTS", 2)
    return Workspace(tmp_path, tmp_path / "results")


def read_methods(paths):
    """The metrics in an experiment's JSON, after a check of all its files."""
    assert all(path.stat().st_size for path in paths)
    (path,) = (path for path in paths if path.suffix == ".json")
    return json.loads(path.read_text())["methods"]


@pytest.mark.parametrize(
    "experiment", [pytest.param(vehicles, marks=pytest.mark.slow), pedestrians]
)
def test_tables_are_written_with_a_figure(experiment, workspace, monkeypatch):
    names = ("HD map", "AIM", "constant velocity")
    cases = {name: experiment.TABLE.cases[name] for name in names}
    table = replace(
        experiment.TABLE, cases=cases, pairs=(("AIM", "HD map"),), shown=("AIM", "HD map"), time=20
    )
    monkeypatch.setattr(experiment, "TABLE", table)
    paths = experiment.run(workspace)
    assert tuple(read_methods(paths)) == names
    assert paths[2].read_bytes().startswith(b"\x89PNG")


@pytest.fixture
def tiny_places(monkeypatch):
    """Short realistic recordings of the one place, for validation too."""
    for module in (pretrained, latent_scales):
        monkeypatch.setattr(module, "VAL", dict.fromkeys(("vehicle", "pedestrian"), ((5, "t"),)))
    monkeypatch.setattr(realistic, "PIECE_S", 25.0)
    monkeypatch.setattr(realistic, "STANDING_S", 10.0)
    monkeypatch.setattr(realistic, "NOISY_MAPS", ("bad later",))
    # noisy agents are not yet observed at the first step
    monkeypatch.setitem(SEGMENT_STRIDES, "pedestrian", 5)


@pytest.mark.slow
def test_pretrained_models_are_written_to_the_workspace(workspace, monkeypatch, tiny_places, place):
    scene = make_place_scene(read_recordings(place)[0], read_map(place, "aim"), dt=0.1)
    monkeypatch.setattr(closed_loop, "make_drawn_scene", lambda kind, seed: (scene, None))
    monkeypatch.setattr(closed_loop, "CLOSED_LOOP", ((5, "t"),))
    for name, value in {"STEPS": 3, **SMALL_LOOP}.items():
        monkeypatch.setattr(closed_loop, name, value)
    monkeypatch.setattr(pretrained, "REALISTIC_STEPS", {"vehicle": 1, "pedestrian": 1})
    monkeypatch.setattr(pretrained, "REALISTIC_BATCH", 2)
    paths = pretrained.run(workspace)
    assert [path.parent for path in paths[:2]] == [workspace.folder / "pretrained"] * 2
    assert "pedestrians, ITRA" in read_methods(paths)
    before = read_model(workspace.models / "vehicle_realistic" / "model.pt").state_dict()
    after = read_model(paths[0]).state_dict()
    changed = {name for name in before if not before[name].equal(after[name])}
    assert any(name.startswith("decode_action") for name in changed)
    assert read_model(paths[0]).config.brakes


@pytest.mark.slow
def test_aim_and_hd_map_are_compared_over_places_and_trainings(workspace, monkeypatch):
    monkeypatch.setattr(aim_or_hdmap, "TRAIN", ((5, "t"),))
    monkeypatch.setattr(aim_or_hdmap, "TEST", ((5, "t"), (5, "t")))
    monkeypatch.setattr(aim_or_hdmap, "VAL", {"vehicle": ((5, "t"),)})
    monkeypatch.setattr(aim_or_hdmap, "STEPS", 1)
    monkeypatch.setattr(aim_or_hdmap, "BATCH_SIZE", 2)
    monkeypatch.setattr(aim_or_hdmap, "SEEDS", 2)
    small = replace(aim_or_hdmap.VEHICLES_ON_AIM, **SMALL)
    monkeypatch.setattr(aim_or_hdmap, "VEHICLES_ON_AIM", small)
    paths = aim_or_hdmap.run(workspace)
    rows = json.loads(paths[0].read_text())["results"]
    first = next(row for row in rows if row["metric"] == "minADE")
    assert first["number of places"] == 2
    assert first["low"] <= first["difference"] <= first["high"]
    assert "AIM minus HD map" in paths[1].read_text()


@pytest.fixture
def shipped(monkeypatch):
    """Tiny models in place of those that come with the package."""
    for module in (known_views, latent_scales, unsure_speeds):
        monkeypatch.setattr(module, "read_pretrained", make_tiny)


def make_tiny(kind):
    """A tiny model with random weights, which knows views about the origin of its features."""
    model = init_model(replace(models.MODELS[f"{kind}_aim"].config, **SMALL)).eval()
    count = model.config.feature_size
    model.known_views = KnownViews(torch.zeros(count), torch.eye(count), 1e-3)
    return model


@pytest.mark.slow
def test_errors_grow_with_the_uncertainty_of_speeds(workspace, shipped, monkeypatch):
    monkeypatch.setattr(unsure_speeds, "PLACES", unsure_speeds.PLACES[:1])
    monkeypatch.setattr(unsure_speeds, "SPEEDS", {"vehicle": ((0.0, np.inf),)})
    monkeypatch.setattr(unsure_speeds, "MAX_SEGMENTS", 1)
    monkeypatch.setattr(unsure_speeds, "MIN_AGENTS", 1)
    (row,) = json.loads(unsure_speeds.run(workspace)[0].read_text())["rows"]
    assert row["4 m/s"] > row["0 m/s"]


@pytest.mark.slow
def test_scales_of_latents_are_compared_on_exact_and_noisy_states(workspace, shipped, tiny_places):
    rows = json.loads(latent_scales.run(workspace)[0].read_text())["rows"]
    assert len(rows) == 2 * len(latent_scales.SCALES) * 2
    assert {row["states"] for row in rows} == {"exact", "noisy"}
    assert all(row["joint minADE"] > 0 for row in rows)


@pytest.mark.slow
def test_views_beyond_the_limit_are_counted(workspace, shipped, monkeypatch):
    for name in ("KNOWN", "OTHER"):
        places = dict.fromkeys(("vehicle", "pedestrian"), ((5, "t"),))
        monkeypatch.setattr(known_views, name, places)
    monkeypatch.setattr(known_views, "_list_real", lambda model: {})
    rows = json.loads(known_views.run(workspace)[0].read_text())["rows"]
    first = rows[0]
    assert first["where"] == "places of trained kinds"
    assert first["beyond"] == first["warned"] == 1  # the limit is tiny
    assert {row["agents"] for row in rows} == {"vehicles", "pedestrians"}


@pytest.mark.slow
def test_songdo_splits_its_vehicles(place, workspace, monkeypatch):
    recording, aim = read_recordings(place)[0], read_map(place, "aim")
    scene = slice_scene(make_place_scene(recording, aim, dt=0.1), slice(100, 150))
    monkeypatch.setattr(songdo, "read_scene", lambda: scene)
    tuning = replace(songdo.FINE_TUNING, steps=1, batch_size=2)
    monkeypatch.setattr(songdo, "FINE_TUNING", tuning)
    monkeypatch.setattr(songdo, "SAMPLES", 2)
    assert {"zero-shot", "fine-tuned"} < set(read_methods(songdo.run(workspace)))


def test_sind_compares_images_and_hd_maps(place, workspace, monkeypatch):
    recording, aim = read_recordings(place)[0], read_map(place, "aim")
    for name, value in {
        "JUNCTIONS": ("here",),
        "georeference_junction": lambda name: (aim, None, recording.hdmap),
        "_summarise_fit": lambda fit: {},
        "_make_scene": lambda name, aim: make_place_scene(recording, aim, dt=0.4),
        "FINE_TUNING": replace(sind.FINE_TUNING, steps=1, batch_size=2),
    }.items():
        monkeypatch.setattr(sind, name, value)
    assert {"aim, fine-tuned", "hdm, zero-shot"} < set(read_methods(sind.run(workspace)))


@pytest.fixture
def stanford_data(tmp_path, monkeypatch):
    """A folder of windows and images of three scenes, for tiny trainings."""
    generator = np.random.default_rng(0)
    for folder in ("windows", "images"):
        (tmp_path / "data" / folder).mkdir(parents=True)
    for name, config in stanford.MODELS.items():
        monkeypatch.setitem(stanford.MODELS, name, replace(config, **SMALL))
    training = replace(stanford.WINDOW_TRAINING, steps=1, batch_size=2)
    monkeypatch.setattr(stanford, "WINDOW_TRAINING", training)
    monkeypatch.setattr(stanford, "require_data", lambda name: tmp_path / "data")
    for scene in ("park_0", "square_1", "square_2"):
        rows = np.column_stack(
            [
                np.tile(12 * np.arange(WINDOW_STEPS), 4),
                np.repeat(np.arange(4), WINDOW_STEPS),
                generator.uniform(100, 200, (4 * WINDOW_STEPS, 2)),
            ]
        )
        table = pd.DataFrame(rows, columns=["frame", "track", "u_px", "v_px"])
        table.to_csv(tmp_path / "data" / "windows" / f"{scene}.csv", index=False)
        pixels = generator.integers(0, 255, (300, 400, 3), np.uint8)
        Image.fromarray(pixels).save(tmp_path / "data" / "images" / f"{scene}.jpg")
    lines = "scene,metres_per_pixel\npark_0,0.05\nsquare_1,0.05\nsquare_2,0.05\n"
    (tmp_path / "data" / "scenes.csv").write_text(lines)
    return tmp_path / "data"


def test_a_plain_network_is_compared_on_scenes_and_on_places(workspace, monkeypatch, stanford_data):
    for name, value in {
        "require_data": lambda name: stanford_data,
        "VAL_SCENES": ("park_0",),
        "VAL_PLACES": ("square",),
        "SEEDS": 2,
        "TRAINING": replace(stanford_baselines.TRAINING, steps=2, batch_size=2),
    }.items():
        monkeypatch.setattr(stanford_baselines, name, value)
    methods = read_methods(stanford_baselines.run(workspace))
    assert {"six scenes, MLP without map", "three places, constant velocity"} < set(methods)
    assert {f"three places, {name}" for name in stanford_baselines.COMPARED} < set(methods)


def test_the_plain_network_learns_to_turn():
    angle = 0.1 * torch.arange(WINDOW_STEPS)
    arc = 3 * torch.stack([angle.sin(), 1 - angle.cos()], dim=1)
    segments = make_path_segments(arc.repeat(64, 1, 1))
    training = replace(stanford_baselines.TRAINING, steps=200, batch_size=16)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(stanford_baselines, "TRAINING", training)
        network = stanford_baselines.train_modes(segments, seed=0)
    given = {"history": 8, "samples": 20, "generator": torch.Generator()}
    futures = stanford_baselines.make_predictor(network)(segments, hill(), **given)
    straight = BASELINES["constant velocity"](segments, hill(), **given)
    truth = segments.states[:, None, :, 8:, :2]
    errors = [
        (one[..., 8:, :2] - truth).norm(dim=-1).mean(dim=3).amin(dim=1).mean()
        for one in (futures, straight)
    ]
    assert errors[0] < errors[1] / 2


def test_stanford_trains_on_other_scenes_than_it_evaluates_on(
    workspace, monkeypatch, stanford_data
):
    for name, value in {"VAL_SCENES": ("park_0",), "SEEDS": {"map": 2, "no map": 1}}.items():
        monkeypatch.setattr(stanford, name, value)
    torch.manual_seed(0)
    methods = read_methods(stanford.run(workspace))
    assert set(methods) == {
        *stanford.MODELS,
        "map, blurred and noisy",
        "constant velocity",
        "constant velocity with noise",
    }
    assert (workspace.models / "stanford_all_scenes" / "model.pt").exists()
