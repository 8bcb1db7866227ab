from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import torch
from PIL import Image

from benchmarks.prediction.windows import (
    DT_S,
    HISTORY_STEPS,
    WINDOW_STEPS,
    WindowFiles,
    evaluate_windows,
    make_path_segments,
    make_window_predictor,
    read_windows,
    reverse_paths,
)
from geoaim.base.errors import TracksError
from geoaim.prediction.baselines import BASELINES, NOISY
from geoaim.prediction.config import Config
from geoaim.prediction.itra import ITRA
from geoaim.prediction.training import init_model

CONFIG = Config(
    kind="pedestrian",
    motion="slide",
    dt=DT_S,
    view_size=16,
    resolution=1.0,
    view_stride=12,
    num_anchors=4,
    history=8,
    horizon=12,
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two scenes of pedestrians that walk straight, 20 and 40 pixels a second."""
    folder = tmp_path_factory.mktemp("windows")
    generator = np.random.default_rng(0)
    for scene, speed in (("park_0", 20), ("square_1", 40)):
        rows = []
        for track in range(5):
            turn = generator.uniform(0, 2 * np.pi)
            ways = speed * DT_S * np.arange(WINDOW_STEPS)
            u, v = 200 + ways * np.cos(turn), 150 + ways * np.sin(turn)
            rows += [(12 * k, track, *uv) for k, uv in enumerate(zip(u, v, strict=True))]
        table = pd.DataFrame(rows, columns=["frame", "track", "u_px", "v_px"])
        (folder / "w").mkdir(exist_ok=True)
        table.to_csv(folder / "w" / f"{scene}.csv", index=False)
        image = generator.integers(0, 255, (300, 400, 3), np.uint8)
        (folder / "i").mkdir(exist_ok=True)
        Image.fromarray(image).save(folder / "i" / f"{scene}.jpg")
    lines = "scene,metres_per_pixel\npark_0,0.05\nsquare_1,0.025\n"
    (folder / "scenes.csv").write_text(lines)
    return folder


def read(folder, images="i", **options):
    images = None if images is None else folder / images
    files = WindowFiles(folder / "w", images, folder / "scenes.csv")
    return read_windows(files, CONFIG.view, **options)


def test_windows_are_in_metres(folder):
    windows = read(folder)
    assert len(windows.segments) == 10
    speed = windows.segments.states[:, 0, :, 3]
    assert torch.allclose(speed, torch.ones_like(speed), atol=1e-3)  # 20 x 0.05 and 40 x 0.025
    assert windows.scenes[0] == "park_0"
    assert windows.resolutions[[0, -1]].tolist() == pytest.approx([0.05, 0.025])
    assert len(read(folder, scenes=["square_1"]).segments) == 5


def test_heading_comes_from_observed_steps_only():
    paths = torch.randn(6, WINDOW_STEPS, 2, generator=torch.Generator().manual_seed(0)).cumsum(
        dim=1
    )
    other = torch.cat([paths[:, :8], paths[:, 8:] + 5], dim=1)
    one, two = make_path_segments(paths).states, make_path_segments(other).states
    assert torch.equal(one[:, :, :8], two[:, :, :8])
    assert torch.equal(one[..., 2], two[..., 2])
    back = reverse_paths(make_path_segments(paths)).states
    assert torch.equal(back[:, 0, :, :2], paths.flip(1))


def test_straight_paths_are_predicted_and_measured_in_pixels(folder):
    metrics = evaluate_windows(BASELINES["constant velocity"], read(folder, None), 20)
    assert metrics["minADE_px"].mean < 0.05
    assert set(metrics) == {"minADE_px", "minADE_m", "minFDE_px", "minFDE_m"}
    noisy = evaluate_windows(BASELINES[NOISY], read(folder, None), 1)
    ratio = noisy["minADE_px"].sums / noisy["minADE_m"].sums
    assert ratio == pytest.approx(np.r_[np.full(5, 20), np.full(5, 40)], rel=1e-4)


def test_missing_and_malformed_files_are_reported(folder, tmp_path):
    with pytest.raises(TracksError, match=r"neither park_0\.jpg nor park_0\.png"):
        read(folder, "w")
    with pytest.raises(TracksError, match="the scenes lake_3 must be in both"):
        read(folder, scenes=["lake_3"])
    table = pd.read_csv(folder / "w" / "park_0.csv")
    (tmp_path / "w").mkdir()
    (tmp_path / "scenes.csv").write_text("scene,metres_per_pixel\npark_0,0.05\n")
    for broken, why in (
        (table[:-1], "99 rows; windows of 20 rows each"),
        (table.assign(u_px=1e15), "pixels of an image"),
        (table.assign(track=np.arange(len(table)) // 10), "more than one track"),
        (table.drop(columns="u_px"), "lacks the columns u_px"),
    ):
        broken.to_csv(tmp_path / "w" / "park_0.csv", index=False)
        with pytest.raises(TracksError, match=why):
            read(tmp_path, None)
    (tmp_path / "scenes.csv").write_text("scene,metres_per_pixel\npark_0,0\n")
    with pytest.raises(TracksError, match="metres_per_pixel of park_0 is 0"):
        read(tmp_path, None)


def test_images_that_are_too_large_are_refused(folder, tmp_path):
    Image.new("RGB", (255, 60_000)).save(tmp_path / "park_0.png")
    files = WindowFiles(folder / "w", tmp_path, tmp_path / "scenes.csv")
    (tmp_path / "scenes.csv").write_text("scene,metres_per_pixel\npark_0,0.05\n")
    found = r"park_0\.png .*60000 x 255 pixels of 0\.05 m, which need 1\.\d GB"
    with pytest.raises(TracksError, match=found):
        read_windows(files, CONFIG.view)


def test_a_model_without_observations_needs_no_images(folder):
    torch.manual_seed(0)
    blind = ITRA(replace(CONFIG, use_observations=False)).eval()
    one, two = (
        evaluate_windows(make_window_predictor(blind, 4), read(folder, i), 4) for i in ("i", None)
    )
    assert one["minADE_m"].mean == pytest.approx(two["minADE_m"].mean, abs=1e-4)


def test_predictions_of_windows_ignore_the_future(tmp_path):
    """Windows of the Stanford Drone Dataset are read without `Tracks`."""
    model, horizon = init_model(CONFIG).eval(), WINDOW_STEPS - HISTORY_STEPS
    predictors = (make_window_predictor(model, 3), *BASELINES.values())
    generator = np.random.default_rng(0)
    pixels = generator.uniform(0, 300, (5, WINDOW_STEPS, 2)).cumsum(axis=1)
    (tmp_path / "scenes.csv").write_text("scene,metres_per_pixel\na,0.05\n")
    predicted = []
    for _ in range(2):
        rows = {"frame": np.tile(12 * np.arange(WINDOW_STEPS), 5)}
        rows |= {"track": np.repeat(np.arange(5), WINDOW_STEPS)}
        rows |= {"u_px": pixels[..., 0].ravel(), "v_px": pixels[..., 1].ravel()}
        pd.DataFrame(rows).to_csv(tmp_path / "a.csv", index=False)
        files = WindowFiles(tmp_path, None, tmp_path / "scenes.csv")
        windows = read_windows(files, CONFIG.view, scenes=["a"])
        given = windows.segments, windows.ground
        options = {"history": HISTORY_STEPS, "samples": 3}
        predicted.append(
            [
                one(*given, **options, generator=torch.Generator().manual_seed(0))
                for one in predictors
            ]
        )
        pixels[:, HISTORY_STEPS:] += generator.normal(0, 100, (5, horizon, 2))
    assert (predicted[0][0][:, 0, :, -1] - windows.segments.states[:, :, -1]).abs().max() > 1
    assert all(map(torch.equal, *predicted))
