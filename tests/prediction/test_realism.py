"""WOSAC's likelihoods: by hand on made cases, and as waymo_open_dataset 1.6.7 computes them."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from shapely import MultiPoint, MultiPolygon, Point, affinity, box

from geoaim.prediction.likelihood import CONFIG_2024, Estimator, estimate_log_likelihood
from geoaim.prediction.realism import compute_realism
from geoaim.prediction.realism_features import compute_features, compute_kinematics
from geoaim.prediction.segments import Segments
from geoaim.simulation.overlap import compute_box_distance
from geoaim.simulation.road_rules import RoadRules, make_drivable
from tests.prediction.tiny import drive

HISTORY, STEPS, SAMPLES = 11, 91, 4
ROAD = RoadRules(make_drivable(MultiPolygon([box(-25, -25, 25, 25)]), resolution=0.05))
# x, y, heading, speed, turn rate, acceleration; length and width
AGENTS = np.array(
    [
        [-30.03, 0.01, 0.02, 8.07, 0.003, 0.11, 4.5, 1.9],
        [-18.07, 0.32, 0.05, 5.03, 0.004, 0.07, 5.0, 2.0],
        [0.03, 20.01, -1.51, 6.07, 0.113, -0.03, 4.0, 1.8],
        [30.07, 5.02, 3.01, 7.03, 0.057, -0.31, 12.0, 2.5],
        [10.01, -25.03, 1.61, 3.07, 0.203, 0.02, 0.8, 0.7],
    ]
)
# likelihoods of this case by compute_scenario_metrics_for_bundle of waymo_open_dataset 1.6.7, with
# the ranges of 2024; the agents are vehicles, and all but the last are evaluated
OFFICIAL = {
    "linear speed": 0.8315078,
    "linear acceleration": 0.9426416,
    "angular speed": 0.5679128,
    "angular acceleration": 0.97041297,
    "distance to nearest object": 0.22860217,
    "collision": 0.50006247,
    "time to collision": 0.7655835,
    "distance to road edge": 0.2092964,
    "off-road": 0.9997501,
}


def make_rollout(sample: int) -> np.ndarray:
    """Poses (N, T, 3) along arcs; sample 0 is the recording, others change after the history."""
    time = np.arange(STEPS) / 10
    later = np.maximum(time - (HISTORY - 1) / 10, 0)
    x, y, heading, speed, turn, acceleration = AGENTS[:, :6, None].transpose(1, 0, 2)
    change = sample * (0.11 + 0.07 * np.arange(len(AGENTS))[:, None])
    angle = heading + turn * time + 0.13 * change * later + 0.02 * change * np.sin(3 * later)
    pace = speed + acceleration * time + change * np.sin(1.3 * later)
    step = np.stack([pace * np.cos(angle), pace * np.sin(angle)], axis=-1) / 10
    start = np.concatenate([x, y], axis=1)[:, None]
    position = start + np.cumsum(np.pad(step, ((0, 0), (1, 0), (0, 0)))[:, :-1], axis=1)
    wrapped = (angle + np.pi) % (2 * np.pi) - np.pi
    return np.concatenate([position, wrapped[..., None]], axis=-1)


def make_segment(poses: np.ndarray, controlled, sizes) -> Segments:
    states = torch.tensor(np.pad(poses, ((0, 0), (0, 0), (0, 1))))[None]
    count, steps = poses.shape[:2]
    return Segments(
        states=states.float(),
        present=torch.ones(1, count, steps, dtype=torch.bool),
        sizes=torch.tensor(np.array(sizes), dtype=torch.float32)[None],
        layers=torch.zeros(1, count, dtype=torch.long),
        controlled=torch.tensor(controlled)[None],
        places=torch.zeros(1, dtype=torch.long),
        stop_lines=torch.zeros(1, 0, 2, 2),
        light_states=torch.zeros(1, steps, 0, dtype=torch.long),
        dt=0.1,
    )


def make_case() -> tuple[torch.Tensor, Segments]:
    rollouts = [make_rollout(sample) for sample in range(SAMPLES)]
    controlled = [True] * (len(AGENTS) - 1) + [False]
    segment = make_segment(rollouts[0], controlled, AGENTS[:, 6:])
    futures = torch.stack([make_segment(x, controlled, AGENTS[:, 6:]).states[0] for x in rollouts])
    return futures[None], segment


def score(futures, segments, *more):
    return {
        name: metric.mean
        for name, metric in compute_realism(futures, segments, HISTORY, *more).items()
    }


def test_likelihoods_are_those_of_the_official_code():
    found = score(*make_case(), ROAD)
    for name, value in OFFICIAL.items():
        assert found[name] == pytest.approx(value, abs=1e-4), name


def test_groups_and_meta_metric_are_weighted_means():
    found = score(*make_case(), ROAD)
    kinematic = [found[name] for name in list(CONFIG_2024)[:4]]
    assert found["kinematic"] == pytest.approx(np.mean(kinematic), rel=1e-5)
    total = sum(estimator.weight * found[name] for name, estimator in CONFIG_2024.items())
    assert found["realism"] == pytest.approx(total, rel=1e-5)
    assert sum(x.weight for x in CONFIG_2024.values()) == pytest.approx(1)


def test_constant_speeds_have_the_shares_of_their_bins():
    poses = np.zeros((1, STEPS, 3))
    poses[0, :, 0] = 0.613 * np.arange(STEPS)  # 6.13 m/s, in the third bin of 2.5 m/s
    segment = make_segment(poses, [True], [[4.5, 1.8]])
    futures = segment.states[:, None].expand(-1, 3, -1, -1, -1)
    found = score(futures, segment)
    steps = STEPS - HISTORY
    # of 3 samples; the last step has no speed and counts in the last bin
    assert found["linear speed"] == pytest.approx((3 * steps - 3 + 0.1) / (3 * steps + 1), rel=1e-5)
    assert found["angular acceleration"] == pytest.approx(
        (3 * steps - 6 + 0.1) / (3 * steps + 1.1), rel=1e-5
    )
    assert found["distance to nearest object"] == pytest.approx(
        (3 * steps + 0.1) / (3 * steps + 1), rel=1e-5
    )
    assert found["collision"] == pytest.approx(3.001 / 3.002, rel=1e-6)
    assert "distance to road edge" not in found
    assert "realism" not in found
    assert {"kinematic", "interactive"} <= set(found)


def test_collision_and_offroad_have_the_shares_of_samples():
    """One of two agents drives into the other and off the road, in one sample of four."""
    poses = np.zeros((2, STEPS, 3))
    poses[1, :, 0] = 12.0
    segment = make_segment(poses, [True, False], [[4.0, 2.0], [4.0, 2.0]])
    futures = segment.states[:, None].repeat(1, 4, 1, 1, 1)
    futures[0, 1, 0, 30:, 0] = 9.0
    futures[0, 2, 0, 60, 1] = 30.0
    found = score(futures, segment, ROAD)
    for name in ("collision", "off-road"):
        assert found[name] == pytest.approx(3.001 / 4.002, rel=1e-5)


def test_features_of_a_follower_are_those_computed_by_hand():
    steps = torch.arange(21) / 10
    poses = torch.zeros(1, 3, 21, 3)
    poses[0, 0, :, 0] = 10 * steps  # m/s
    poses[0, 1, :, 0] = 30 + 6 * steps
    poses[0, 2] = torch.tensor([15.0, 3.0, 0.0])  # beside the lane
    sizes = torch.tensor([[4.0, 2.0], [6.0, 2.0], [1.0, 1.0]])
    present = torch.ones(1, 3, 21, dtype=torch.bool)
    evaluated = torch.tensor([True, False, False])
    found = compute_features(poses, present, sizes, evaluated, dt=0.1, drivable=ROAD.drivable)
    assert float(found["linear speed"][0, 0, 5]) == pytest.approx(10, abs=1e-4)
    assert float(found["time to collision"][0, 0, 10]) == pytest.approx(5)  # 21 m at 4 m/s
    ahead = 30 - 4 * 1.5 - 2 - 3
    assert float(found["time to collision"][0, 0, 15]) == pytest.approx(ahead / 4, abs=1e-3)
    # at 1 s the agent beside the lane is ahead; corners are rounded by 0.7 of half a width
    cores = np.hypot(15 - 10 - (2 - 0.7) - (0.5 - 0.35), 3 - (1 - 0.7) - (0.5 - 0.35))
    assert float(found["distance to nearest object"][0, 0, 10]) == pytest.approx(
        cores - 0.7 - 0.35, abs=1e-4
    )
    edge = found["distance to road edge"][0, 0]
    assert float(edge[10]) == pytest.approx(10 + 2 - 25, abs=0.05)


def test_kinematics_are_central_differences():
    poses = torch.zeros(1, 1, 6, 3)
    poses[..., 0] = torch.tensor([0.0, 1.0, 4.0, 9.0, 16.0, 25.0])  # t² with t in steps
    poses[..., 2] = torch.tensor([3.0, 3.1, -3.08, -2.98, -2.88, -2.78])
    found = {name: x[0, 0].tolist() for name, x in compute_kinematics(poses, 0.5).items()}
    assert found["linear speed"][1:5] == pytest.approx([4, 8, 12, 16])
    assert found["linear acceleration"][2:4] == pytest.approx([8, 8])
    assert found["angular speed"][1] == pytest.approx((2 * np.pi - 6.08) / 2 / 0.5, abs=1e-5)
    assert np.isnan(found["linear speed"][0])
    assert np.isnan(found["linear acceleration"][1])


def test_histogram_has_closed_ends_and_counts_what_is_beyond_them():
    estimator = Estimator(0.0, 1.0, 4, 1.0, pseudocount=0.5)
    simulated = torch.tensor([[[0.0, 0.25, 1.0, 7.0, -3.0]]])
    logged = torch.tensor([[-1.0, 0.3, 0.6, 1.0]])
    shares = estimate_log_likelihood(logged, simulated, estimator).exp()
    assert shares[0].tolist() == pytest.approx([2.5 / 7, 1.5 / 7, 0.5 / 7, 2.5 / 7])


def test_box_distances_are_those_of_shapely():
    generator = np.random.default_rng(3)
    poses = generator.uniform([-6, -6, -7], [6, 6, 7], (300, 2, 3))
    sizes = generator.uniform(0.5, 6, (300, 2, 2))
    parts = [torch.tensor(x) for x in (poses[:, 0], sizes[:, 0], poses[:, 1], sizes[:, 1])]
    found = compute_box_distance(*parts).numpy()
    for distance, pose, size in zip(found, poses, sizes, strict=True):
        shapes = [
            affinity.translate(
                affinity.rotate(box(*(-half), *half), heading, use_radians=True), x, y
            )
            for (x, y, heading), half in zip(pose, size / 2, strict=True)
        ]
        if distance > 0:
            assert distance == pytest.approx(shapes[0].distance(shapes[1]), abs=1e-9)
            continue
        corners = [np.array(shape.exterior.coords)[:4] for shape in shapes]
        difference = MultiPoint((corners[0][:, None] - corners[1]).reshape(-1, 2)).convex_hull
        assert -distance == pytest.approx(difference.exterior.distance(Point(0, 0)), abs=1e-9)


def test_absent_states_are_not_judged():
    futures, segment = make_case()
    present = segment.present.clone()
    present[0, 0, 60:] = False
    gone = replace(segment, present=present, states=segment.states * present[..., None])
    found, whole = score(futures, gone, ROAD), score(futures, segment, ROAD)
    assert all(np.isfinite(list(found.values())))
    assert found["linear speed"] != whole["linear speed"]


def test_short_histories_and_infinite_states_are_refused():
    futures, segment = make_case()
    with pytest.raises(ValueError, match="history=1; 2 or more"):
        compute_realism(futures, segment, 1)
    futures[0, 0, 0, 30, 0] = torch.nan
    with pytest.raises(ValueError, match="a state that is not finite"):
        compute_realism(futures, segment, HISTORY)


def test_realism_of_each_segment_is_a_metric():
    segments = drive(steps=30)
    futures = segments.states[:, None].expand(-1, 2, -1, -1, -1)
    metrics = compute_realism(futures, segments, 5)
    assert metrics["kinematic"].counts.tolist() == [1.0] * len(segments)
