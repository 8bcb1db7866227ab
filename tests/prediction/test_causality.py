"""No state that a predictor gets depends on what the file holds after the last observed step."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from geoaim.aim.aim import AIM
from geoaim.prediction.baselines import BASELINES
from geoaim.prediction.batches import Process, draw_batch
from geoaim.prediction.config import TrainConfig
from geoaim.prediction.cutting import cut_segments
from geoaim.prediction.observation import index_controlled
from geoaim.prediction.predict import predict
from geoaim.prediction.training import init_model
from geoaim.rendering.scene import make_scene, slice_scene
from geoaim.tracks.changes import resample_tracks
from geoaim.tracks.formats import formats, read_tracks
from tests.prediction.tiny import TINY
from tests.prediction.track_files import FORMS, make_rows
from tests.sizes import keep_quick

FIRST, LAST, STEPS = 5, 12, 16  # first and last observed step, and the end of the predicted ones
PAST = slice(FIRST, LAST + 1)
HISTORY, HORIZON = LAST + 1 - FIRST, STEPS - LAST - 1


@pytest.fixture(params=keep_quick(FORMS, "plain, other rate", "ScenarioNet", "SDD, pedestrians"))
def form(request, monkeypatch):
    """A format of tracks; noise is read without the checks of what is implausible."""
    monkeypatch.setattr(formats, "check_plausibility", lambda *_: None)
    monkeypatch.setattr(formats, "derive_contradicted_motion", lambda _, tracks: tracks)
    return FORMS[request.param]


@pytest.fixture
def scenes(form, tmp_path):
    """The scene of a file, and that of the same file with noise after the last observed step.

    Before the first observed step agents are seen for long enough to know their speeds.
    """
    dt, read = get_dt(form), []
    for noise_after in (None, LAST * dt):
        rows = make_rows(form, noise_after=noise_after, duration=(STEPS + 3) * dt)
        folder = tmp_path / str(noise_after)
        folder.mkdir()
        read.append(read_tracks(form.write(rows, folder), **form.options))
    aim = make_aim(read[0])
    return [make_scene(aim, resample_tracks(tracks, 1 / dt)) for tracks in read]


def get_dt(form):
    return 0.4 if form.rate < 5 else 0.1


def make_aim(tracks):
    """A map of random colours about the tracks, in their world."""
    low, high = (f(tracks.states[tracks.present, :2], axis=0) for f in (np.min, np.max))
    size = int((high - low).max()) + 80
    image = np.random.default_rng(0).integers(0, 255, (size, size, 3), np.uint8)
    matrix = np.array([[1.0, 0, low[0] - 40], [0, -1, low[1] - 40 + size], [0, 0, 1]])
    return AIM.from_image(image, matrix, tracks.world, "random")


def list_models(form):
    """Every motion model, with views, without them, and with proposals."""
    config = replace(TINY, kind=form.kind, dt=get_dt(form))
    proposals = {"num_anchors": 3, "anchor_points": 2, "history": HISTORY, "horizon": HORIZON}
    return [
        init_model(replace(config, motion=motion, **changes)).eval()
        for motion in ("bicycle", "unicycle", "slide")
        for changes in ({}, {"use_observations": False}, proposals)
    ]


def cut(scene, form, **options):
    steps = STEPS - FIRST
    part = slice_scene(scene, slice(FIRST, None))
    return cut_segments(part, form.kind, steps=steps, stride=steps, **options)


def noise():
    return torch.Generator().manual_seed(0)


def test_every_format_is_tested():
    tested = {name.split(",")[0] for name in FORMS}
    assert tested == {track_format.name for track_format in formats.list_formats()}


def test_observed_states_and_predictions_ignore_the_future(form, scenes):
    scene, other = scenes
    assert (scene.poses[:, LAST + 2 :] - other.poses[:, LAST + 2 :]).abs().max() > 1
    assert scene.observed[:, PAST].isfinite().all()
    assert torch.equal(scene.observed[:, PAST], other.observed[:, PAST])
    assert torch.equal(scene.sizes, other.sizes)
    assert scene.types == other.types
    given = {"samples": 2, "horizon": HORIZON, "start": LAST}
    for model in list_models(form):
        one, two = (predict(model, s, **given, generator=noise()).states for s in scenes)
        assert torch.equal(one, two)


def test_evaluations_ignore_the_future(form, scenes):
    one, two = (cut(scene, form, joint=True) for scene in scenes)
    assert one.controlled.all()
    ground, given = scenes[0].ground, {"history": HISTORY, "samples": 2}
    for predictor in (*BASELINES.values(), *(model.sample for model in list_models(form))):
        futures, same = (predictor(s, ground, **given, generator=noise()) for s in (one, two))
        assert torch.equal(futures, same)


def test_trainings_observe_the_same_states_whatever_follows(form, scenes):
    config = TrainConfig(steps=1, batch_size=4, history=(HISTORY, HISTORY), mirror=True)
    observed = []
    for scene in scenes:
        segments = cut(scene, form)
        process = Process(0, 1, torch.device("cpu"))
        batch, *_ = draw_batch(config, segments, scene.ground, 0, process)
        index = index_controlled(batch)
        observed.append(batch.states[index.segment, index.agent, :HISTORY])
    assert len(observed[0])
    assert torch.equal(*observed)


def test_predictions_ignore_what_other_agents_do_later(tmp_path):
    """Pedestrians walk elsewhere and a car enters: views of predicted cars would show both."""
    form = FORMS["plain"]
    tracks = read_tracks(form.write(make_rows(form, duration=2.0), tmp_path))
    tracks = replace(tracks, types=("car", "pedestrian", "pedestrian", "car"))
    present, states = tracks.present.copy(), tracks.states.copy()
    present[3, : LAST + 1], states[3, : LAST + 1] = False, np.nan
    entering = replace(tracks, present=present, states=states)
    present, states = present.copy(), states.copy()
    present[3], states[3], states[1:3, LAST + 1 :, :2] = False, np.nan, 30.0
    alone = replace(tracks, present=present, states=states)
    model, given = list_models(form)[0], {"samples": 2, "horizon": 3, "start": LAST}
    scenes = (make_scene(make_aim(tracks), part) for part in (entering, alone))
    one, two = (predict(model, scene, **given, generator=noise()).states for scene in scenes)
    assert torch.equal(one[:, :3], two[:, :3])
    assert torch.isnan(one[:, 3]).all()
