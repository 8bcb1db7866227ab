from dataclasses import replace

import numpy as np
import pytest
import torch

from geoaim.prediction.futures import MARGIN_M, Futures
from geoaim.rendering.ground import make_ground
from geoaim.rendering.scene import make_scene
from tests.faults.seeds import make_aim, make_tracks


@pytest.fixture
def scene():
    """The scene of two agents on a map of 400 m."""
    scene = make_scene(make_aim(), make_tracks())
    matrix = torch.tensor([[1.0, 0.0, 0.0], [0.0, -1.0, 400.0]], dtype=torch.float64)
    ground = make_ground(torch.zeros(3, 400, 400), matrix)
    return replace(scene, ground=ground)


def make_futures(scene, ends):
    """Futures of one step to the given places, (K, N, 2)."""
    ends = torch.tensor(ends)
    states = torch.cat([ends, torch.zeros_like(ends)], dim=-1)[:, :, None]
    return Futures(states, scene, start=0, dt=0.1)


def test_a_picture_shows_all_futures_and_the_start_with_a_margin(scene):
    futures = make_futures(
        scene, [[[150.0, 220.0], [230.0, 290.0]], [[140.0, 225.0], [np.nan] * 2]]
    )
    starts = scene.poses[:, 0, :2].numpy()
    reached = np.vstack([starts, [[140.0, 220.0], [230.0, 290.0]]])
    low, high = futures.fit_limits().numpy()
    np.testing.assert_allclose(low, reached.min(axis=0) - MARGIN_M)
    np.testing.assert_allclose(high, reached.max(axis=0) + MARGIN_M)


def test_a_picture_reaches_as_far_as_the_map(scene):
    futures = make_futures(scene, [[[-900.0, -900.0], [900.0, 900.0]]])
    np.testing.assert_allclose(futures.fit_limits().numpy(), [[0, 0], [400, 400]], atol=1.0)


def test_agents_that_stand_in_all_futures_are_predicted(scene):
    same = make_futures(scene, 2 * [[[150.0, 220.0], [230.0, 290.0]]])
    assert not same.mark_predicted().any()
    moved = torch.tensor([True, False])
    assert replace(same, predicted=moved).mark_predicted().tolist() == [True, False]
