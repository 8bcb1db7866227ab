"""Against torchdrivesim's own renderer; skipped where torchdrivesim is not installed."""

import numpy as np
import pytest
import torch
from torch.nn.functional import avg_pool2d

from geoaim.rendering import make_ground

pytest.importorskip("torchdrivesim", reason="not installed: docs/decisions/0010")

from torchdrivesim.rendering.base import RendererConfig
from torchdrivesim.rendering.cv2 import CV2Renderer, CV2RendererConfig
from torchdrivesim.traffic_controls import TrafficLightControl
from torchdrivesim.utils import Resolution

from geoaim.rendering.torchdrivesim import ImageMapRenderer

RES = Resolution(96, 96)


def _black(**options):
    black = make_ground(
        torch.zeros(3, 1, 1), torch.tensor([[1.0, 0, 0], [0, -1.0, 0]]), outside=torch.zeros(3)
    )
    return ImageMapRenderer(black, RendererConfig(**options), batch_size=2, res=RES, fov=40.0)


def _render_with_torchdrivesim(options, states, sizes, xy, sc, *, controls, mask=None):
    """Render camera by camera: with more than one, torchdrivesim gives a black picture."""
    renderer = CV2Renderer(
        CV2RendererConfig(**options), batch_size=1, res=RES, fov=40.0, device="cpu"
    )
    pictures = []
    for b, c in np.ndindex(*xy.shape[:2]):
        one = slice(b, b + 1)
        seen = None if mask is None else {k: m[one, c : c + 1] for k, m in mask.items()}
        light = TrafficLightControl(controls.pos[one], replay_states=controls.replay_states[one])
        pictures += renderer.render_frame(
            {k: v[one] for k, v in states.items()},
            {k: v[one] for k, v in sizes.items()},
            xy[one, c : c + 1],
            sc[one, c : c + 1],
            rendering_mask=seen,
            traffic_controls={"traffic_light": light},
        )
    return torch.stack(pictures)


def _traffic():
    vehicles = torch.tensor(
        [[[0.0, 0, 0.3, 5], [8, 3, 2.0, 5]], [[1.0, 1, -1, 5], [-9, 6, 0.5, 5]]]
    )
    people = torch.tensor([[[5.0, -6, 1.0, 1]], [[2.0, 9, 0.0, 1]]])
    sizes = torch.tensor([[4.5, 1.9], [8.0, 2.5]]).expand(2, 2, 2)
    return {"vehicle": vehicles, "pedestrian": people}, {
        "vehicle": sizes,
        "pedestrian": torch.full((2, 1, 2), 1.5),
    }


def _controls():
    bars = torch.tensor([[[6.0, 0, 1.0, 4.0, 0.2]], [[3.0, -4, 1.0, 4.0, 1.2]]])
    return TrafficLightControl(bars, replay_states=torch.tensor([[[0]], [[2]]]))


def _assert_alike(ours, theirs):
    """Compare means of 8 x 8 pixels, since torchdrivesim has hard edges on whole pixels."""
    apart = (avg_pool2d(ours, 8) - avg_pool2d(theirs, 8)).abs().amax(dim=1)
    assert apart.max() < 60
    assert (avg_pool2d(theirs, 8).amax(dim=1) > 30).float().mean() > 0.01


@pytest.mark.parametrize("options", [{}, {"left_handed_coordinates": True}])
def test_picture_agrees_with_torchdrivesim_except_at_edges(options):
    states, sizes = _traffic()
    ours = _black(**options).render_frame(
        states, sizes, traffic_controls={"traffic_light": _controls()}
    )
    assert ours.shape == (2, 3, 3, 96, 96)
    poses = torch.cat([states["vehicle"], states["pedestrian"]], 1)
    sc = torch.stack([poses[..., 2].sin(), poses[..., 2].cos()], -1)
    theirs = _render_with_torchdrivesim(
        options, states, sizes, poses[..., :2], sc, controls=_controls()
    )
    _assert_alike(ours.flatten(0, 1), theirs)


def test_given_cameras_and_masks_are_used():
    states, sizes = _traffic()
    xy = torch.tensor([[[4.0, 2.0]], [[0.0, 5.0]]])
    psi = torch.tensor([[[0.7]], [[-2.0]]])
    sc = torch.cat([psi.sin(), psi.cos()], -1)
    mask = {
        "vehicle": torch.tensor([[[True, False]], [[True, True]]]),
        "pedestrian": torch.zeros(2, 1, 1, dtype=torch.bool),
    }
    controls = {"traffic_light": _controls()}
    ours = _black().render_frame(
        states, sizes, xy, sc, rendering_mask=mask, traffic_controls=controls
    )
    theirs = _render_with_torchdrivesim({}, states, sizes, xy, sc, controls=_controls(), mask=mask)
    assert ours.shape == (2, 3, 96, 96)
    _assert_alike(ours, theirs)


def test_map_is_rendered_and_gradients_reach_poses():
    image = torch.rand(3, 40, 40, generator=torch.Generator().manual_seed(0))
    ground = make_ground(image, torch.tensor([[0.5, 0, 20], [0, -0.5, 20]]))
    renderer = ImageMapRenderer(ground, batch_size=2, res=RES, fov=40.0)
    alone = renderer.render_static_meshes()
    assert alone.shape == (2, 96, 96, 3)
    assert alone.std() > 20
    states, sizes = _traffic()
    states["vehicle"].requires_grad_()
    renderer.render_frame(states, sizes).square().mean().backward()
    gradient = states["vehicle"].grad
    assert torch.isfinite(gradient).all()
    assert (gradient[..., :3].abs() > 0).all()


def test_batch_of_the_renderer_can_be_expanded_and_selected():
    renderer = _black().expand(3).select_batch_elements(torch.tensor([0, 4]))
    states, sizes = _traffic()
    assert renderer.render_frame(states, sizes).shape == (2, 3, 3, 96, 96)
    assert renderer.world_center.shape == (2, 2)
    with pytest.raises(ValueError, match="no meshes"):
        renderer.add_static_meshes([])
    assert np.isclose(2 / renderer.scale, 40.0)
