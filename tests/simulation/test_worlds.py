"""Objects of different worlds: moved where that is exact, else refused."""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest
import torch
from matplotlib.collections import LineCollection
from shapely import MultiPolygon, box

from geoaim.aim.aim import AIM
from geoaim.base.errors import GeoreferenceError, MapError
from geoaim.base.world import World
from geoaim.prediction import EvalConfig, cut_segments, evaluate
from geoaim.prediction.baselines import replay
from geoaim.prediction.futures import Futures
from geoaim.prediction.metrics import compute_metrics
from geoaim.prediction.realism import compute_realism
from geoaim.prediction.segments import concat
from geoaim.rendering.scene import make_scene, make_tracks
from geoaim.simulation.episodes import simulate_scene
from geoaim.simulation.infractions import Lanes
from geoaim.simulation.road_rules import check_rules, make_road_rules, move_rules, stack_rules
from geoaim.simulation.scene_infractions import detect_infractions
from geoaim.tracks.tracks import Tracks

HERE = World("EPSG:32633", (500_000.0, 5_400_000.0))
SHIFTED = World("EPSG:32633", (500_280.0, 5_399_900.0))
ELSEWHERE = {
    "another CRS": World("EPSG:32634", (500_000.0, 5_400_000.0)),
    "a local plane": World(None),
}
OFFSET = np.subtract(HERE.origin, SHIFTED.origin)
STEPS = 30


@pytest.fixture(scope="module")
def scene():
    """Two cars that drive east on a road of 8 m."""
    x = np.linspace(10, 60, STEPS)
    states = np.zeros((2, STEPS, 4))
    states[0, :, 0], states[1, :, 0], states[:, :, 1] = x, x + 20, 50.0
    states[..., 3] = (x[1] - x[0]) * 10
    tracks = Tracks(
        times=np.arange(STEPS) / 10,
        states=states,
        present=np.ones((2, STEPS), bool),
        sizes=np.full((2, 2), [4.5, 1.8]),
        types=("car", "car"),
        ids=("a", "b"),
        world=HERE,
    )
    matrix = np.array([[0.5, 0.0, 0.0], [0.0, -0.5, 100.0], [0.0, 0.0, 1.0]])
    image = np.random.default_rng(0).integers(0, 255, (200, 240, 3), np.uint8)
    return make_scene(AIM.from_image(image, matrix, HERE, "drawn"), tracks)


def make_rules(world):
    """The road in a world, with lanes."""
    dx, dy = np.subtract(HERE.origin, world.origin) if world.crs == HERE.crs else (0.0, 0.0)
    area = MultiPolygon([box(dx, 46 + dy, dx + 120, 54 + dy)])
    points = torch.tensor([[x + dx, 50.0 + dy] for x in range(0, 100, 2)]).float()
    lanes = Lanes(points, torch.zeros(len(points)), torch.full((len(points),), 3.0))
    return replace(make_road_rules(None, area, world=world), lanes=lanes)


def make_futures(scene):
    states = scene.states[None, :, 10:].repeat(2, 1, 1, 1)
    states[1, ..., 1] += 0.3
    return Futures(states, scene, 9, scene.dt)


def segments_of(scene):
    return cut_segments(scene, "vehicle", steps=20, stride=20, joint=True)


USES = {
    "detect_infractions": lambda scene, rules: {
        name: float(found.float().mean())
        for name, (found, _) in detect_infractions(scene, torch.ones(2).bool(), rules).items()
    },
    "simulate_scene": lambda scene, rules: dict(
        simulate_scene(scene, "constant-velocity", duration=2.0, rules=rules).rates
    ),
    "check_rules": lambda scene, rules: {
        "x": float(check_rules(scene, rules).lanes.points[:, 0].mean())
    },
    "compute_metrics": lambda scene, rules: means(
        compute_metrics(segments_of(scene).states[:, None], segments_of(scene), 5, rules)
    ),
    "evaluate": lambda scene, rules: means(
        evaluate(replay, segments_of(scene), scene.ground, EvalConfig(5, 2), rules=rules)
    ),
    "compute_realism": lambda scene, rules: means(
        compute_realism(segments_of(scene).states[:, None], segments_of(scene), 5, rules)
    ),
}


def means(metrics):
    return {name: metric.mean for name, metric in metrics.items()}


@pytest.mark.parametrize("use", USES)
def test_rules_of_another_origin_are_moved(scene, use):
    same, moved = (USES[use](scene, make_rules(world)) for world in (HERE, SHIFTED))
    assert moved == pytest.approx(same, abs=1e-4)
    if "off-road rate" in same or "off road" in same:
        assert same.get("off-road rate", same.get("off road")) == 0


@pytest.mark.parametrize("use", USES)
@pytest.mark.parametrize("world", ELSEWHERE)
def test_rules_of_another_plane_are_refused(scene, use, world):
    with pytest.raises(MapError, match=r"the road rules lie in .*, and are needed in EPSG:32633"):
        USES[use](scene, make_rules(ELSEWHERE[world]))


def test_moved_rules_lie_where_they_were(scene):
    moved, given = move_rules(make_rules(SHIFTED), HERE), make_rules(HERE)
    torch.testing.assert_close(moved.lanes.points, given.lanes.points)
    points = torch.tensor([[30.0, 50.0], [100.0, 60.0]])
    from geoaim.simulation.infractions import sample_distance

    one, two = (sample_distance(rules.drivable, points) for rules in (moved, given))
    torch.testing.assert_close(one, two, atol=1e-2, rtol=0)


def test_segments_of_two_worlds_have_no_rules_of_one(scene):
    other = replace(scene, world=SHIFTED)
    both = concat([segments_of(scene), segments_of(other)])
    assert both.worlds == (HERE, SHIFTED)
    with pytest.raises(MapError, match="the segments lie in 2 worlds"):
        compute_metrics(both.states[:, None], both, 5, make_rules(HERE))
    assert stack_rules([make_rules(HERE), make_rules(SHIFTED)]).world is None


def test_a_ground_of_another_origin_is_moved(scene):
    from geoaim.rendering.ground import move_ground

    there = move_ground(scene.ground, SHIFTED)
    low = (there.bounds[0, 0] - scene.ground.bounds[0, 0]).tolist()
    assert low == pytest.approx(OFFSET.tolist(), abs=1e-3)
    for world in ELSEWHERE.values():
        with pytest.raises(MapError, match="the maps lie in"):
            evaluate(
                replay, segments_of(replace(scene, world=world)), scene.ground, EvalConfig(5, 1)
            )


def test_tracks_and_futures_are_drawn_where_they_lie(scene):
    """In axes of another origin all that is drawn is moved by the same offset."""
    tracks = make_tracks(scene)
    assert tracks.world == HERE
    shifted = replace(tracks, world=SHIFTED, states=tracks.states + np.array([*OFFSET, 0, 0]))
    axes = scene.plot()
    shifted.plot(axes)
    lines = [part for part in axes.collections if isinstance(part, LineCollection)]
    low = [np.min([p.vertices.min(axis=0) for p in part.get_paths()], axis=0) for part in lines]
    np.testing.assert_allclose(low, [[10.0, 50.0]] * len(low), atol=1e-3)
    other = shifted.plot()
    make_futures(scene).plot(other)
    left, right = other.get_xlim()
    assert left < 40 + OFFSET[0] < right
    with pytest.raises(GeoreferenceError):
        replace(tracks, world=World(None)).plot(scene.plot())
    plt.close("all")


def test_segments_have_times_and_ids(scene):
    segments = segments_of(scene)
    assert segments.ids == (("a", "b"),)
    assert segments.times.tolist() == [0.0]
    apart = cut_segments(scene, "vehicle", steps=10, stride=10)
    assert {row[0] for row in apart.ids} == {"a", "b"}  # the controlled agent comes first
    assert concat([segments_of(scene), segments_of(scene)]).ids == (("a", "b"),) * 2
