"""The scripts of docs/tutorials/rendering.md run on tensors shaped like other people's."""

import re
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from torch import nn

from geoaim.rendering import make_ground

TUTORIALS = Path(__file__).parents[2] / "docs/tutorials"
PAGE = (TUTORIALS / "rendering.md").read_text("utf-8")
SECTIONS = {
    part.split("\n", 1)[0]: re.findall(r"```python\n(.*?)```", part, re.DOTALL)
    for part in PAGE.split("\n## ")
}
NORTH_UP = torch.tensor([[2.0, 0.0, 40.0], [0.0, -2.0, 40.0], [0.0, 0.0, 1.0]])


def run(section, **given):
    """Run a section's script, and return its names."""
    (script,) = SECTIONS[section]
    return run_script(script, **given)


def run_script(script, **given):
    """Run a script of at most ten lines beside imports, and return its names."""
    lines = [line for line in script.splitlines() if line and not line.startswith("from ")]
    assert len(lines) <= 10
    names = {"torch": torch, **given}
    exec(script, names)
    return names


def test_unitraj_batch():
    trajectories = torch.rand(4, 6, 21, 39)
    centre = torch.cat([torch.rand(4, 2) * 9, torch.rand(4, 5)], dim=1)
    mask = torch.rand(4, 6, 21) > 0.3
    names = run(
        "Agents as UniTraj has them",
        ground=make_ground(torch.rand(3, 80, 80), NORTH_UP),
        black=make_ground(torch.zeros(1, 1, 1), NORTH_UP),
        white=torch.ones(1),
        batch={"obj_trajs": trajectories, "obj_trajs_mask": mask, "center_objects_world": centre},
    )
    assert names["views"].shape == (4, 3, 128, 128)
    assert names["agents"].amax(dim=(1, 2, 3)).min() > 0


def test_trajdata_batch():
    """By default histories are in the agent's frame; its state and the maps are in the world."""
    state = torch.rand(5, 7) * 100  # x, y, velocity, acceleration, heading
    maps, places = torch.zeros(5, 3, 60, 60), NORTH_UP.repeat(5, 1, 1)
    maps[:, :, 29:31, 29:31] = 1
    places[:, :2, 2] = 30 - (places[:, :2, :2] @ state[:, :2, None])[..., 0]
    batch = SimpleNamespace(
        maps=maps,
        rasters_from_world_tf=places,
        agent_hist=torch.zeros(5, 9, 8),
        curr_agent_state=state,
    )
    views = run("Maps as trajdata has them", batch=batch)["views"]
    assert views.shape == (5, 3, 100, 100)
    assert views[:, :, 49:51, 49:51].min() > 0.7


def test_batches_of_scenes_on_several_maps():
    page = (TUTORIALS / "batches.md").read_text("utf-8")
    (script,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    poses = [(torch.rand(count, 3) * 9).requires_grad_() for count in (2, 4, 1)]
    names = run_script(
        script,
        grounds=[make_ground(torch.rand(3, n, n), NORTH_UP) for n in (80, 60)],
        agents=[(pose, torch.full((len(pose), 2), 2.0)) for pose in poses],
        white=torch.ones(3),
        maps=torch.tensor([1, 0, 1]),
    )
    assert names["views"].shape == (3, 4, 3, 128, 128)
    assert names["views"][0, 2:].abs().max() == 0  # this scene has two agents
    assert all(pose.grad.abs().sum() > 0 for pose in poses)


def test_training_loop():
    torch.manual_seed(0)
    encoder = nn.Sequential(nn.Conv2d(4, 2, 8, 8), nn.Flatten(), nn.Linear(128, 2))
    before = encoder[0].weight.clone()
    poses = torch.rand(4, 3, 3).requires_grad_()
    batch = torch.rand(4, 3), poses, torch.ones(2), torch.tensor([0, 1, 1, 0]), torch.rand(4, 2)
    names = run(
        "A training loop with its own encoder",
        grounds=[make_ground(torch.rand(3, n, n), NORTH_UP) for n in (80, 60)],
        encoder=encoder,
        batches=[batch] * 3,
        white=torch.ones(3),
    )
    assert not torch.equal(before, encoder[0].weight)
    assert poses.grad.abs().sum() > 0
    assert names["loss"].isfinite()


def test_files_and_corners_of_the_page(tmp_path, monkeypatch):
    from geoaim.mapping.texture import export_texture
    from tests.rendering.test_corners import make_aim

    export_texture(make_aim(), tmp_path / "texture")
    monkeypatch.chdir(tmp_path)
    corners = torch.tensor([[0.0, 8.0], [16.0, 8.0], [16.0, 0.0], [0.0, 0.0]])
    names = run("From a file", image=torch.rand(3, 4, 8), corners=corners)
    assert names["ground"].image.shape == (3, 6, 10)
    assert pytest.approx(0.5) == float(names["ground"].image_from_world[0, 0, 0])
