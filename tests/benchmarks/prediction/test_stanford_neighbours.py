"""A plain network that sees the neighbours: what it is given, and that it learns from it."""

from dataclasses import replace

import numpy as np
import pandas as pd
import torch

from benchmarks.prediction import stanford_neighbours
from benchmarks.prediction.results import Workspace
from benchmarks.prediction.stanford_people import (
    People,
    Way,
    cut_windows,
    find_others,
    join_windows,
    read_people,
    reverse_ways,
)
from benchmarks.prediction.windows import HISTORY_STEPS, WINDOW_STEPS

RESOLUTION = 0.05


def write_scene(folder, name, starts):
    """Windows of people who walk to the right, each from a frame and a place, in pixels."""
    (folder / "windows").mkdir(parents=True, exist_ok=True)
    steps = np.arange(WINDOW_STEPS)
    rows = [
        np.column_stack([frame + 12 * steps, 0 * steps + track, u + 10 * steps, v + 0 * steps])
        for track, (frame, u, v) in enumerate(starts)
    ]
    table = pd.DataFrame(np.concatenate(rows), columns=["frame", "track", "u_px", "v_px"])
    table.to_csv(folder / "windows" / f"{name}.csv", index=False)
    with (folder / "scenes.csv").open("a") as file:
        file.write("" if file.tell() else "scene,metres_per_pixel\n")
        file.write(f"{name},{RESOLUTION}\n")


def test_windows_of_one_person_are_joined_and_cut_at_each_step(tmp_path):
    write_scene(tmp_path, "park_0", [(0, 0, 0), (240, 200, 0), (240, 260, 0)])
    people = read_people(tmp_path, ["park_0"], training=True)
    assert len(people.paths) == 2 * (WINDOW_STEPS + 1 + 1)  # two joined, one alone, and reversed
    assert torch.allclose(people.paths.diff(dim=1).norm(dim=2), torch.tensor(0.5))
    assert len(read_people(tmp_path, ["park_0"], training=False).paths) == 3


def test_each_window_goes_on_in_one_only():
    steps = np.arange(WINDOW_STEPS)
    path = np.stack([0.5 * steps, 0.0 * steps], axis=1)
    later = path + np.array([0.5 * WINDOW_STEPS, 0])
    frames = np.stack([12 * steps, 12 * (steps + WINDOW_STEPS), 12 * (steps + WINDOW_STEPS)])
    ways = join_windows(frames, np.stack([path, later + np.array([0.1, 0]), later]))
    assert sorted(len(way.frames) for way in ways) == [WINDOW_STEPS, 2 * WINDOW_STEPS]
    (joined,) = (way for way in ways if len(way.frames) == 2 * WINDOW_STEPS)
    assert np.array_equal(joined.positions[WINDOW_STEPS:], later)


def test_others_are_known_by_what_was_there_before():
    frames = 12 * np.arange(WINDOW_STEPS)
    walk = np.stack([0.5 * np.arange(WINDOW_STEPS), np.zeros(WINDOW_STEPS)], axis=1)
    now = HISTORY_STEPS - 1
    ways = [
        Way(frames, walk),
        Way(frames, walk + np.array([0, 1])),
        Way(frames[now:], walk[now:] + np.array([0, 2])),
    ]
    others = find_others(frames[now : now + 1], walk[now : now + 1], ways)
    assert np.allclose(others[0, :2], [[0, 1, 0.5, 0], [0, 2, 0, 0]])
    assert np.isnan(others[0, 2:]).all()
    for way in ways[1:]:
        way.positions[way.frames > frames[now]] += 7
    again = find_others(frames[now : now + 1], walk[now : now + 1], ways)
    assert np.array_equal(again, others, equal_nan=True)


def test_reversed_ways_lead_back():
    way = Way(12 * np.arange(WINDOW_STEPS), np.arange(2.0 * WINDOW_STEPS).reshape(-1, 2))
    frames, paths = cut_windows(reverse_ways([way]))
    assert (np.diff(frames) == 12).all()
    assert np.array_equal(paths[0, ::-1], way.positions)


def make_followers(count, seed):
    """People who keep on, or stand, as the one beside them does: it alone tells which."""
    draws = torch.Generator().manual_seed(seed)
    goes = torch.randint(2, (count, 1, 1), generator=draws).float()
    steps = torch.arange(float(WINDOW_STEPS))[None, :, None] - HISTORY_STEPS + 1
    paths = 0.5 * (steps.clamp(max=0) + goes * steps.clamp(min=0)) * torch.tensor([1.0, 0.0])
    others = torch.cat(
        [torch.tensor([0.0, 1.0]).expand(count, 2), goes[:, 0] * 0.5, 0 * goes[:, 0]], 1
    )
    others = torch.cat([others[:, None], torch.full((count, 5, 4), torch.nan)], dim=1)
    return People(paths, others, torch.full((count,), RESOLUTION), ())


def test_the_network_learns_from_the_neighbours(monkeypatch):
    monkeypatch.setattr(stanford_neighbours, "STANFORD_SAMPLES", 1)
    monkeypatch.setattr(stanford_neighbours, "WIDTH", 32)
    training = replace(stanford_neighbours.TRAINING, steps=150, batch_size=32, learning_rate=3e-3)
    errors = {}
    for neighbours in (False, True):
        network = stanford_neighbours.train_network(
            make_followers(200, 0), neighbours=neighbours, seed=0, training=training
        )
        metrics = stanford_neighbours.evaluate_network(network, make_followers(100, 1))
        errors[neighbours] = metrics["minFDE_m"].mean
    assert errors[True] < 0.5 * errors[False]


def test_the_frame_of_a_person_does_not_change_what_is_seen():
    people = make_followers(4, 0)
    inputs = stanford_neighbours.make_inputs(people.paths, people.others)
    turned = people.paths.flip(-1) * torch.tensor([-1.0, 1.0]) + 3  # a quarter to the left
    around = people.others[..., [1, 0, 3, 2]] * torch.tensor([-1.0, 1.0, -1.0, 1.0])
    again = stanford_neighbours.make_inputs(turned, around)
    for one, other in zip(vars(inputs).values(), vars(again).values(), strict=True):
        assert torch.allclose(one, other, atol=1e-5, equal_nan=True)


def test_the_test_part_is_judged_where_it_is(tmp_path, monkeypatch):
    for folder in (stanford_neighbours.DATA, stanford_neighbours.TEST_DATA):
        for name in ("park_0", "square_1"):
            write_scene(tmp_path / "data" / folder, name, [(0, 0, 0), (0, 0, 30)])
    monkeypatch.setenv("GEOAIM_DATA", str(tmp_path / "data"))
    monkeypatch.setattr(stanford_neighbours, "VAL_SCENES", ("park_0",))
    monkeypatch.setattr(stanford_neighbours, "SEEDS", {"alone": 1, "neighbours": 1})
    monkeypatch.setattr(stanford_neighbours, "TRAINING", stanford_neighbours.Training(2, 2))
    paths = stanford_neighbours.run(Workspace(tmp_path, tmp_path / "results"))
    table = paths[1].read_text()
    assert "| alone |" in table
    assert "| neighbours, test part |" in table
