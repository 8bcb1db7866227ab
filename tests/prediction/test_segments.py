from dataclasses import replace

import numpy as np
import pytest
import torch

from geoaim.base.errors import TracksError
from geoaim.prediction.augmentation import scale_ground
from geoaim.prediction.cutting import cut_segments
from geoaim.prediction.dataset import stack_maps
from geoaim.prediction.observation import (
    ObservationView,
    compute_surface_contrast,
    index_controlled,
    render_observation,
)
from geoaim.prediction.segments import concat, repeat, scale
from geoaim.rendering.ground import make_ground
from geoaim.rendering.prefiltering import prefilter_ground
from geoaim.rendering.scene import Scene
from tests.prediction.tiny import drive, hill

VIEW = ObservationView(24, 24, 1.0)


def scene(steps=20):
    """Two moving cars, a parked one, a pedestrian, and a car that leaves."""
    x = torch.arange(steps).float()
    poses = torch.zeros(5, steps, 3)
    poses[0, :, 0], poses[1, :, 0], poses[1, :, 1] = x, x, 5.0
    poses[2, :, 1], poses[3, :, 1], poses[4, :, 0] = -5.0, 2 + x / 2, x
    present = torch.ones(5, steps, dtype=torch.bool)
    present[4, 8:] = False
    poses = torch.where(present[..., None], poses, torch.nan)
    speeds = torch.where(present, 10.0, torch.nan)
    return Scene(
        ground=hill(),
        times=torch.arange(steps) * 0.1,
        poses=poses,
        speeds=speeds,
        present=present,
        sizes=torch.tensor([[4.0, 2.0]]).expand(5, 2),
        types=("car", "bus", "car", "pedestrian", "car"),
        ids=tuple("abcde"),
        stop_lines=torch.zeros(0, 2, 2),
        light_states=torch.zeros(steps, 0, dtype=torch.int8),
        observed=torch.cat([poses, speeds[..., None]], dim=2),
    )


def test_each_moving_agent_gets_a_segment():
    segments = cut_segments(scene(), "vehicle", steps=10, stride=5)
    assert len(segments) == 2 * 3  # two cars at three starts; not the others
    assert segments.states.shape == (6, 5, 10, 4)
    assert (segments.controlled.sum(dim=1) == 1).all()
    assert segments.present[:, 0].all()
    assert torch.isfinite(segments.states).all()


def test_joint_segments_control_all_of_a_kind_at_once():
    segments = cut_segments(scene(), "vehicle", steps=10, stride=10, joint=True)
    assert segments.controlled.sum(dim=1).tolist() == [3, 2]  # one car leaves within the first
    assert segments.present[0].sum(dim=1).tolist() == [10, 10, 10, 10, 8]
    pedestrians = cut_segments(scene(), "pedestrian", steps=10, stride=10, joint=True)
    assert pedestrians.controlled.sum(dim=1).tolist() == [1, 1]


def test_scenes_that_cannot_be_cut_are_rejected():
    with pytest.raises(TracksError, match="no moving vehicle is there for 3 s at a time"):
        cut_segments(scene(), "vehicle", steps=30, stride=5)
    uneven = replace(scene(), times=torch.tensor(np.r_[np.arange(19) * 0.1, 5.0]))
    with pytest.raises(ValueError, match="not at even intervals"):
        cut_segments(uneven, "vehicle", steps=5, stride=5)


def test_segments_of_other_sizes_are_padded():
    one, two = drive(10, 2), cut_segments(scene(), "vehicle", steps=10, stride=10)
    both = concat([one, two])
    assert both.states.shape == (6, 5, 10, 4)
    assert both.light_states.shape == (6, 10, 1)
    assert not both.present[:2, 2:].any()
    with pytest.raises(ValueError, match="of one dt are needed"):
        concat([one, replace(two, dt=0.4)])
    assert len(repeat(one, 3)) == 6


@pytest.mark.parametrize("sides", [(1.2, 1.2), (0.9, -0.9)])
def test_views_scale_and_mirror_with_the_plane(sides):
    segments, controlled = drive(4, 3), index_controlled(drive(4, 3))
    sides = torch.tensor(sides)
    before = render_observation(VIEW, hill(), segments, controlled, segments.states[:, :, 0], 0)
    other = scale(segments, sides)
    other = replace(other, sizes=segments.sizes * sides[0])
    larger = ObservationView(24, 24, float(sides[0]))
    after = render_observation(
        larger, scale_ground(hill(), sides), other, controlled, other.states[:, :, 0], 0
    )
    after = after.flip(3) if sides[1] < 0 else after
    assert torch.allclose(before[:, :5], after[:, :5], atol=1e-4)  # bars of lights keep their width


def test_a_view_of_stacked_maps_is_that_of_the_place():
    generator = torch.Generator().manual_seed(0)
    places = []
    for turn in (0.0, 0.7):
        c, s = np.cos(turn), np.sin(turn)
        image = torch.rand(3, 30, 40, generator=generator)
        smooth = torch.nn.functional.avg_pool2d(image, 5, 1, 2)
        matrix = torch.tensor([[c, s, 100.0], [s, -c, 50.0]], dtype=torch.float32)
        places.append(make_ground(smooth, matrix))
    stacked = stack_maps(places, VIEW)
    for number, place in enumerate(places):
        matrix = place.image_from_world[0]
        inverse = torch.linalg.inv(matrix[:, :2])
        middle = inverse @ (torch.tensor([20.0, 15.0]) - matrix[:, 2])
        segments = drive(4, 1)
        moved = torch.cat([middle, torch.zeros(2)])
        here = replace(
            segments, states=segments.states + moved, light_states=segments.light_states - 1
        )
        there = replace(here, places=torch.full_like(here.places, number))
        controlled = index_controlled(here)
        fitted = prefilter_ground(place, VIEW.resolution)
        one = render_observation(VIEW, fitted, here, controlled, here.states[:, :, 0], 0)
        two = render_observation(VIEW, stacked, there, controlled, there.states[:, :, 0], 0)
        torch.testing.assert_close(one, two, atol=1e-5, rtol=0)


def test_observations_show_other_agents_and_not_the_agent_itself():
    segments = drive(4, 2)
    controlled = index_controlled(segments)
    views = render_observation(VIEW, hill(), segments, controlled, segments.states[:, :, 0], 0)
    assert views.shape == (2, 7, 24, 24)
    assert views[:, 3].sum() == 0  # its own box
    assert (views[:, 4].sum(dim=(1, 2)) > 0).all()  # the pedestrian
    assert (views[:, 5].sum(dim=(1, 2)) == 0).all()  # no red or yellow light
    assert (views[:, 6].sum(dim=(1, 2)) > 0).all()  # a green light


def test_lights_have_the_width_of_the_view():
    segments = drive(4, 2)
    thin, wide = (
        render_observation(
            view, hill(), segments, index_controlled(segments), segments.states[:, :, 0], 0
        )
        for view in (VIEW, replace(VIEW, light_width=3.0))
    )
    torch.testing.assert_close(wide[:, 6].sum(), 3 * thin[:, 6].sum())
    torch.testing.assert_close(wide[:, :6], thin[:, :6])


def test_surface_contrast_is_invariant_to_brightness():
    segments, dim = drive(4, 2), hill()
    bright = replace(dim, image=dim.image + 0.1)
    controlled = index_controlled(segments)
    one, two = (
        render_observation(VIEW, ground, segments, controlled, segments.states[:, :, 0], 0)
        for ground in (dim, bright)
    )
    assert (one[:, :3] - two[:, :3]).abs().mean() > 0.09
    contrast = compute_surface_contrast(one)
    torch.testing.assert_close(contrast, compute_surface_contrast(two))
    assert 0 <= contrast.min() <= contrast[:, :, 11:13, 11:13].max() < contrast.mean()
    assert contrast.mean() < contrast.max() <= 1
