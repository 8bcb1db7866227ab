from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image
from typer.testing import CliRunner

import geoaim
from geoaim import World
from geoaim.base.errors import TracksError
from geoaim.cli import app
from geoaim.hdmap.lanelet2 import read_hdmap
from geoaim.hdmap.rasterize import draw_hdmap
from geoaim.prediction.checkpoints import write_model
from geoaim.prediction.pictures import draw_panels
from geoaim.prediction.predict import predict
from geoaim.prediction.training import init_model
from geoaim.rendering.ground import move_ground
from geoaim.rendering.scene import make_scene
from geoaim.tracks.changes import resample_tracks
from tests.prediction.tiny import TINY

TRACKS = "samples/tracks.csv"


@pytest.fixture(scope="module")
def aim():
    world = geoaim.read_tracks(TRACKS).world
    return draw_hdmap(read_hdmap("samples/map.osm", world), resolution=0.5)


@pytest.fixture(scope="module")
def futures(aim):
    tracks = resample_tracks(geoaim.read_tracks(TRACKS), 1 / TINY.dt)
    noise = torch.Generator().manual_seed(0)
    scene = make_scene(aim, tracks)
    return predict(init_model(TINY), scene, samples=2, horizon=6, start=20, generator=noise)


def test_futures_of_one_agent_are_selected(futures):
    (name, *_) = (futures.scene.ids[row] for row in futures.mark_predicted().nonzero()[:, 0])
    chosen = futures.select([name])
    rows = chosen.mark_predicted().nonzero()[:, 0].tolist()
    assert [futures.scene.ids[row] for row in rows] == [name]
    assert torch.equal(chosen.states[:, rows], futures.states[:, rows])
    with pytest.raises(TracksError, match="no future of 999 at 2 s; there are those of"):
        futures.select([name, "999"])


def test_all_panels_show_the_same_square(futures):
    figure = draw_panels([[futures, futures], [futures, futures]], ["left", "right"])
    panels = figure.axes
    assert [axes.get_title() for axes in panels] == ["left", "right", "", ""]
    limits = {(*axes.get_xlim(), *axes.get_ylim()) for axes in panels}
    ((left, right, bottom, top),) = limits
    assert right - left == pytest.approx(top - bottom)
    shown = futures.states[:, futures.mark_predicted(), :, 0].numpy()
    assert left < shown.min()
    assert shown.max() < right


def test_maps_with_other_origins_show_the_same_ground(futures):
    here = futures.scene.world
    there = World(here.crs, (here.origin[0] - 300.0, here.origin[1] + 100.0))
    shift = torch.tensor([300.0, -100.0])
    scene = futures.scene
    poses = torch.cat([scene.poses[..., :2] + shift, scene.poses[..., 2:]], dim=-1)
    states = torch.cat([futures.states[..., :2] + shift, futures.states[..., 2:]], dim=-1)
    ground = move_ground(scene.ground, there)
    moved = replace(
        futures, states=states, scene=replace(scene, ground=ground, poses=poses, world=there)
    )
    same, other = (draw_panels([[futures, one]], ["a", "b"]).axes for one in (futures, moved))
    for one, two in zip(same, other, strict=True):
        np.testing.assert_allclose(one.get_xlim(), two.get_xlim(), atol=0.1)
        np.testing.assert_allclose(one.get_ylim(), two.get_ylim(), atol=0.1)
        paths = [axes.collections[1].get_paths()[0].vertices for axes in (one, two)]
        np.testing.assert_allclose(*paths, atol=0.1)
        pictures = [axes.images[0].get_array() for axes in (one, two)]
        assert (pictures[0] == pictures[1]).mean() > 0.95


def test_panels_lie_close_to_each_other_and_the_legend_beside_them(futures):
    figure = draw_panels([[futures, futures], [futures, futures]], ["left", "right"])
    figure.draw_without_rendering()
    left, right, below = (axes.get_window_extent() for axes in figure.axes[:3])
    assert 0 < right.x0 - left.x1 < 0.1 * left.width
    assert 0 < left.y0 - below.y1 < 0.1 * left.height
    legend = figure.axes[1].get_legend().get_window_extent()
    assert right.x1 < legend.x0
    assert legend.x1 < figure.bbox.x1


def test_command_draws_a_column_for_each_map_and_a_row_for_each_duration(aim, tmp_path):
    model = tmp_path / "model.pt"
    write_model(init_model(TINY), model)
    for name in ("one.tif", "two.tif"):
        geoaim.write_aim(aim, tmp_path / name)
    given = ["--tracks", TRACKS, "--start", "5", "--samples", "2", "--weights", str(model)]

    def compare(*maps, durations, more=()):
        picture = tmp_path / "figure.png"
        asked = [word for seconds in durations for word in ("--duration", seconds)]
        paths = [str(tmp_path / name) for name in maps]
        done = CliRunner().invoke(
            app, ["compare", *paths, *given, *asked, *more, "-o", str(picture)]
        )
        return done, picture

    done, picture = compare("one.tif", durations=["0.5"])
    assert done.exit_code == 0, done.output
    single = np.asarray(Image.open(picture)).shape
    done, picture = compare("one.tif", "two.tif", durations=["0.5", "1"], more=["--history", "1"])
    assert done.exit_code == 0, done.output
    assert "2 futures on 2 maps" in done.output
    double = np.asarray(Image.open(picture)).shape
    assert double[0] == 2 * single[0]
    assert double[1] > 1.5 * single[1]
    done, _ = compare("one.tif", durations=["0.5"], more=["--weights", str(model)])
    assert done.exit_code == 1
    assert "2 --weights for 1 maps" in " ".join(done.output.split())
