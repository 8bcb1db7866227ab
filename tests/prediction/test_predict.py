import csv
from dataclasses import replace

import numpy as np
import pytest
import torch
from typer.testing import CliRunner

import geoaim
from geoaim.base.errors import ModelError, TracksError
from geoaim.cli import app
from geoaim.hdmap.lanelet2 import read_hdmap
from geoaim.hdmap.rasterize import draw_hdmap
from geoaim.prediction.baselines import BASELINES, NOISY
from geoaim.prediction.checkpoints import PRETRAINED, read_model, read_pretrained, write_model
from geoaim.prediction.cutting import cut_segments
from geoaim.prediction.evaluation import EvalConfig, evaluate
from geoaim.prediction.itra import ITRA
from geoaim.prediction.networks import build_cnn
from geoaim.prediction.pictures import draw_futures, film_futures, write_futures
from geoaim.prediction.predict import DRAWS, predict
from geoaim.prediction.sureness import MAX_SPEED_SIGMA, UNKNOWN, UNSURE
from geoaim.prediction.training import init_model
from geoaim.prediction.trial import choose_noise, compare_with_noise, describe_trial, judge_before
from geoaim.rendering.prefiltering import prefilter_ground
from geoaim.rendering.scene import make_scene, slice_scene
from geoaim.tracks.agent_types import select_group
from geoaim.tracks.changes import resample_tracks
from geoaim.tracks.lights import read_lights
from tests.prediction.tiny import TINY
from tests.sizes import keep_quick

run = CliRunner().invoke


@pytest.fixture(scope="module")
def hdmap():
    return read_hdmap("samples/map_full.osm", geoaim.read_tracks("samples/tracks.csv").world)


def sample_scene(hdmap, rate=10.0):
    tracks = resample_tracks(geoaim.read_tracks("samples/tracks.csv"), rate)
    lights = read_lights("samples/lights.csv", hdmap.stop_lines, hdmap.world)
    return make_scene(draw_hdmap(hdmap, resolution=0.5), tracks, lights)


@pytest.fixture(scope="module")
def scene(hdmap):
    return sample_scene(hdmap)


def noise(seed=0):
    return torch.Generator().manual_seed(seed)


@pytest.mark.parametrize("kind", ["vehicle", "pedestrian"])
def test_pretrained_models_are_small_and_control_their_kind(hdmap, kind):
    assert (PRETRAINED / f"{kind}.pt").stat().st_size < 2e6
    model = read_pretrained(kind)
    scene = sample_scene(hdmap, 1 / model.config.dt)
    futures = predict(model, scene, samples=3, horizon=10, start=12, generator=noise())
    futures = futures.states
    assert futures.shape == (3, len(scene.ids), 10, 4)
    there = scene.present[:, 12]
    mine = torch.tensor([(kind == "pedestrian") == (k == "pedestrian") for k in scene.types])
    mine &= torch.tensor([k != "cyclist" for k in scene.types]) & there
    assert torch.isfinite(futures[:, mine]).all()
    others = there & ~mine
    way = (futures[0, others, -1, :2] - scene.poses[others, 12, :2]).norm(dim=-1)
    assert torch.allclose(way, 10 * scene.dt * scene.speeds[others, 12].abs(), atol=1e-3)
    assert torch.isnan(futures[:, ~there]).all()


def test_samples_are_the_same_whether_or_not_the_map_is_prefiltered(scene):
    model = init_model(TINY)
    segments = cut_segments(scene, "vehicle", steps=12, stride=12, joint=True)
    plain, fine = scene.ground, prefilter_ground(scene.ground, model.config.resolution)
    first, second = (
        model.sample(segments, ground, history=2, samples=2, generator=noise())
        for ground in (plain, fine)
    )
    assert torch.equal(first, second)
    assert prefilter_ground(fine, model.config.resolution) is fine
    assert fine.image.shape != plain.image.shape


@pytest.mark.parametrize("kind", keep_quick(["vehicle", "pedestrian"], "pedestrian"))
def test_pretrained_models_beat_constant_velocity_on_the_sample(hdmap, kind):
    """The sample's place is not among those that the models are trained on."""
    model = read_pretrained(kind)
    scene = sample_scene(hdmap, 1 / model.config.dt)
    steps = 40 if kind == "vehicle" else 30
    segments = cut_segments(scene, kind, steps=steps, stride=20, joint=True)
    ground, options = prefilter_ground(scene.ground, model.config.resolution), EvalConfig(10, 6)
    errors = [
        evaluate(predictor, segments, ground, options)["minADE"].mean
        for predictor in (model.sample, BASELINES["constant velocity"])
    ]
    assert errors[0] < errors[1]


def test_predictions_extend_beyond_the_recording(scene):
    torch.manual_seed(0)
    model = ITRA(TINY).eval()
    futures = predict(model, scene, samples=2, horizon=15, generator=noise()).states
    there = scene.present[:, -1]
    assert torch.isfinite(futures[:, there]).all()
    pedestrians = there & torch.tensor([k == "pedestrian" for k in scene.types])
    moved = (futures[0, pedestrians, -1, :2] - scene.poses[pedestrians, -1, :2]).norm(dim=-1)
    assert moved.tolist() == pytest.approx(
        (1.5 * scene.speeds[pedestrians, -1].abs()).tolist(), abs=0.1
    )


def test_one_step_is_enough_to_predict_from(scene):
    model = read_pretrained("vehicle")
    now = slice_scene(scene, slice(12, 13))
    one = predict(model, now, samples=1, horizon=4, generator=noise()).states
    here = scene.present[:, 12]
    way = (one[0, :, 0, :2] - scene.poses[:, 12, :2]).norm(dim=1)[here]
    assert way.max() < 2.5  # of a tenth of a second, not of a second
    assert torch.isfinite(one[0, here]).all()


def test_scenes_that_cannot_be_predicted_are_rejected(scene):
    model = ITRA(TINY).eval()
    with pytest.raises(ValueError, match="resample the tracks"):
        predict(ITRA(replace(TINY, dt=0.4)), scene, horizon=2, generator=noise())
    with pytest.raises(ValueError, match="start=999, but the scene has steps 0 to"):
        predict(model, scene, horizon=2, start=999, generator=noise())
    empty = replace(scene, types=("pedestrian",) * len(scene.types))
    with pytest.raises(TracksError, match="no vehicle is present"):
        predict(model, empty, horizon=2, generator=noise())


def test_pictures_show_the_futures(scene, hdmap, tmp_path):
    futures = predict(ITRA(TINY).eval(), scene, samples=2, horizon=6, start=20, generator=noise())
    [axes] = draw_futures(futures).axes
    assert "2 futures of 0.6 s" in axes.get_title()
    assert {"recorded", "2 futures", "car"} <= {t.get_text() for t in axes.legend_.texts}
    ids = {scene.ids[row] for row in futures.mark_predicted().nonzero()[:, 0].tolist()}
    assert ids
    assert ids <= {text.get_text() for text in axes.texts}
    film = list(film_futures(futures))
    assert len(film) == 6
    orange = (film[-1][..., 0] > 200) & (film[-1][..., 2] < 80) & (film[-1][..., 1] < 160)
    assert orange.sum() > 20
    assert all(side % 2 == 0 for side in film[0].shape[:2])
    write_futures(futures, tmp_path / "f.csv")
    lines = (tmp_path / "f.csv").read_text().splitlines()
    assert lines[0].startswith("# crs: EPSG:")
    rows = list(csv.DictReader(lines[2:]))
    assert {row["sample"] for row in rows} == {"0", "1"}
    assert float(rows[0]["time"]) == pytest.approx(float(scene.times[20]) + 0.1, abs=1e-6)
    assert len(rows) == int(torch.isfinite(futures.states[..., 0]).sum())


def drive_ahead(speed):
    """A stand-in for a model, whose vehicles go on at a share of their speed."""

    def sample(segments, ground, *, history, samples, generator, goals=None):
        states = segments.states[:, None].repeat(1, samples, 1, 1, 1)
        way = torch.arange(1, segments.steps - history + 1) * segments.dt * speed
        now = states[:, :, :, history - 1 : history]
        heading = torch.stack([now[..., 2].cos(), now[..., 2].sin()], dim=-1)
        states[:, :, :, history:, :2] = now[..., :2] + now[..., 3:] * way[:, None] * heading
        return states

    model = init_model(replace(TINY, kind="vehicle"))
    model.sample = sample
    return model


def test_what_was_recorded_before_tells_whether_a_model_is_better_than_noise(scene):
    errors = judge_before(drive_ahead(1.0), scene, 400, 30)
    assert errors["model"].counts.sum() > 20
    assert list(errors) == ["model", NOISY]
    bad = judge_before(drive_ahead(3.0), scene, 400, 30)
    assert bad["model"].mean > 3 * errors["model"].mean
    assert bad[NOISY].mean == errors[NOISY].mean
    assert compare_with_noise(bad) == "worse"
    assert "the model is worse than that here, so both are mixed: learn" in describe_trial(bad)
    assert choose_noise(bad) == 0.5
    better = {"model": bad[NOISY], NOISY: bad["model"]}
    assert compare_with_noise(better) == "better"
    assert choose_noise(better) == choose_noise({}) == 0.0
    assert compare_with_noise({"model": bad[NOISY], NOISY: bad[NOISY]}) == "as good"


@pytest.mark.parametrize("samples", [6, DRAWS])
def test_noise_is_mixed_into_few_futures_and_many(scene, samples):
    model = drive_ahead(3.0)

    def spread(noise):
        generator = torch.Generator().manual_seed(0)
        given = {"samples": samples, "horizon": 10, "start": 300, "generator": generator}
        futures = predict(model, scene, noise=noise, **given)
        return futures.states[:, futures.mark_predicted(), -1, :2].std(dim=0).max()

    assert spread(0.0) == 0  # all of a model's futures are the same
    assert spread(0.5) > 0.5


def test_nothing_after_the_start_and_no_short_recording_tests_a_model(scene):
    model = drive_ahead(1.0)
    later = replace(scene, observed=scene.observed.clone())
    later.observed[:, 301:] = torch.nan
    for name, errors in judge_before(model, scene, 300, 30).items():
        assert errors.mean == judge_before(model, later, 300, 30)[name].mean
    assert judge_before(model, scene, 36, 30) == {}
    assert "Too little was recorded" in describe_trial({})


@pytest.mark.slow
def test_commands_predict_and_evaluate_the_sample(hdmap, tmp_path):
    geoaim.write_aim(draw_hdmap(hdmap, resolution=0.5), tmp_path / "m.tif")
    given = [str(tmp_path / "m.tif"), "--tracks", "samples/tracks.csv"]
    for name in ("f.csv", "f.png", "f.gif"):
        done = run(
            app,
            [
                "predict",
                *given,
                "-o",
                str(tmp_path / name),
                "--start",
                "5",
                "--samples",
                "2",
                "--duration",
                "1",
            ],
        )
        assert done.exit_code == 0, done.output
        assert (tmp_path / name).stat().st_size > 1000
        assert "the model is better than that here" in " ".join(done.output.split())
    assert "\n# Before the start, minADE of 6 futures of " in (tmp_path / "f.csv").read_text()
    done = run(app, ["predict", *given, "-o", str(tmp_path / "f.txt")])
    assert done.exit_code == 1
    done = run(app, ["predict", *given, "-o", str(tmp_path / "x.csv"), "--start", "500"])
    assert done.exit_code == 1
    assert "500 s is not in the scene" in " ".join(done.output.split())
    done = run(app, ["evaluate", *given, "--kind", "pedestrians", "--hdmap", "samples/map.osm"])
    assert done.exit_code == 0, done.output
    assert "│ joint minADE " in done.output
    assert "┃ constant turn rate " in done.output
    assert "| --- |" not in done.output
    assert "no intervals, which need 10 segments or more" in " ".join(done.output.split())
    done = run(app, ["evaluate", str(tmp_path / "m.tif")])
    assert done.exit_code == 1


def test_models_are_read_as_they_were_written(tmp_path):
    torch.manual_seed(0)
    model = ITRA(TINY)
    write_model(model, tmp_path / "m.pt")
    again = read_model(tmp_path / "m.pt")
    assert again.config == TINY
    for one, two in zip(model.parameters(), again.parameters(), strict=True):
        assert torch.allclose(one, two, atol=1e-3)
    (tmp_path / "m.pt").write_text("no model")
    with pytest.raises(ModelError, match="is not a model"):
        read_model(tmp_path / "m.pt")
    torch.save({"weights": 1}, tmp_path / "n.pt")
    with pytest.raises(ModelError, match="make it again"):
        read_model(tmp_path / "n.pt")
    with pytest.raises(FileNotFoundError):
        read_model(tmp_path / "none.pt")


def test_encoder_is_small():
    assert sum(p.numel() for p in build_cnn(7, 64, 96).parameters()) < 2e5


def test_baselines_replay_agents_that_are_not_controlled(scene):
    segments = cut_segments(scene, "vehicle", steps=20, stride=20, joint=True)
    futures = BASELINES["constant velocity"](
        segments, scene.ground, history=5, samples=1, generator=noise()
    )
    others = ~segments.controlled[..., None].expand(-1, -1, 20)
    truth = segments.states
    assert torch.equal(futures[:, 0][others], truth[others])


def test_futures_that_need_too_much_memory_are_refused(scene):
    with pytest.raises(ValueError, match=r"24 futures of .* agents .* GB .* a shorter duration"):
        predict(ITRA(TINY).eval(), scene, horizon=10**9, generator=noise())


def test_the_futures_that_are_given_cover_those_that_are_drawn(scene):
    model = init_model(replace(TINY, latent_scale=3.0))
    given = {"horizon": 10, "start": 60}
    drawn, six, one = (
        predict(model, scene, samples=samples, generator=noise(), **given).states[..., :2]
        for samples in (DRAWS, 6, 1)
    )
    known = torch.isfinite(drawn[0, :, 0, 0])
    drawn, six, one = (states[:, known] for states in (drawn, six, one))
    same = (drawn[:, None] == six).all(dim=-1).all(dim=-1)  # (24, 6, n)
    assert same.any(dim=0).all()
    assert torch.equal(six[0], one[0])

    def expect(chosen):
        apart = (drawn[:, None] - chosen).norm(dim=-1).mean(dim=3)
        return float(apart.amin(dim=1).mean())

    assert expect(one) <= min(expect(drawn[[k]]) for k in range(DRAWS)) + 1e-6
    assert expect(six) < expect(drawn[:6])


def test_whose_speed_is_unsure_is_left_out_and_named(scene, tmp_path):
    model, start = init_model(TINY), 20
    vehicles = select_group(scene.types, "vehicle") & scene.present[:, start].numpy()
    one, other, parked = np.flatnonzero(vehicles)[:3].tolist()
    sigma = torch.full(scene.present.shape, MAX_SPEED_SIGMA)
    sigma[one] = MAX_SPEED_SIGMA + 0.1
    observed = scene.observed.clone()
    observed[other] = torch.nan
    observed[parked, :, 3] = torch.nan  # either end may be its front
    unsure = replace(scene, observed=observed, observed_sigma=sigma)
    futures = predict(model, unsure, samples=2, horizon=5, start=start, generator=noise())
    names = [scene.ids[k] for k in (one, other, parked)]
    assert futures.left_out == dict(zip(names, (UNSURE, UNKNOWN, UNKNOWN), strict=True))
    assert not futures.mark_predicted()[[one, other, parked]].any()
    assert futures.mark_predicted().sum() == vehicles.sum() - 3
    assert torch.isfinite(futures.states[:, one]).all()  # in the way of others, straight on
    at = observed[parked, start, :3]
    assert torch.allclose(futures.states[:, parked, start:, :3], at, atol=1e-4)  # so is it
    assert torch.isnan(futures.states[:, other]).all()
    write_futures(futures, tmp_path / "futures.csv")
    text = (tmp_path / "futures.csv").read_text()
    assert f'# left out: "{names[0]}", {UNSURE}' in text
    assert f"1 since {UNSURE}" in futures.summarize()["left out"]


def test_no_sure_agent_is_refused_with_the_reason(scene):
    sigma = torch.full(scene.present.shape, 5.0)
    with pytest.raises(TracksError, match=UNSURE.split("(")[0]):
        predict(init_model(TINY), replace(scene, observed_sigma=sigma), start=20, generator=noise())
