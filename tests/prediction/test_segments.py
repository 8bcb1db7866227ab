from dataclasses import replace

import numpy as np
import pytest
import torch

from geoaim.errors import TracksError
from geoaim.prediction.atlas import ground_scaled, make_atlas
from geoaim.prediction.segments import cut_segments, joined, repeated, scaled, shifted
from geoaim.prediction.views import Sight, egos_of, egos_see, unlike_underfoot
from geoaim.simulation.ground import fit_ground, make_ground
from geoaim.simulation.scene import Scene
from tests.prediction.made import drive, hill

VIEW = Sight(24, 24, 1.0)


def scene(steps=20):
    """Two cars that drive, one that is parked, one person, and a car that leaves."""
    x = torch.arange(steps).float()
    poses = torch.zeros(5, steps, 3)
    poses[0, :, 0], poses[1, :, 0], poses[1, :, 1] = x, x, 5.0
    poses[2, :, 1], poses[3, :, 1], poses[4, :, 0] = -5.0, 2 + x / 2, x
    present = torch.ones(5, steps, dtype=torch.bool)
    present[4, 8:] = False
    return Scene(
        ground=hill(),
        times=torch.arange(steps) * 0.1,
        poses=torch.where(present[..., None], poses, torch.nan),
        speeds=torch.where(present, 10.0, torch.nan),
        present=present,
        sizes=torch.tensor([[4.0, 2.0]]).expand(5, 2),
        types=("car", "bus", "car", "pedestrian", "car"),
        ids=tuple("abcde"),
        stop_lines=torch.zeros(0, 2, 2),
        light_states=torch.zeros(steps, 0, dtype=torch.int8),
    )


def test_each_mover_who_stays_is_the_ego_of_a_segment():
    found = cut_segments(scene(), "vehicle", steps=10, stride=5)
    assert len(found) == 2 * 3  # two cars, three starts; parked and leaving ones are around only
    assert found.states.shape == (6, 10, 5, 4)
    assert (found.controlled.sum(dim=1) == 1).all()
    assert found.present[:, :, 0].all()
    assert torch.isfinite(found.states).all()


def test_joint_segments_control_all_of_a_kind_at_once():
    found = cut_segments(scene(), "vehicle", steps=10, stride=10, joint=True)
    assert found.controlled.sum(dim=1).tolist() == [2, 2]
    people = cut_segments(scene(), "pedestrian", steps=10, stride=10, joint=True)
    assert people.controlled.sum(dim=1).tolist() == [1, 1]


def test_what_cannot_be_cut_is_refused():
    with pytest.raises(TracksError, match="no vehicle that moves is there for 30 steps"):
        cut_segments(scene(), "vehicle", steps=30, stride=5)
    uneven = replace(scene(), times=torch.tensor(np.r_[np.arange(19) * 0.1, 5.0]))
    with pytest.raises(ValueError, match="not even"):
        cut_segments(uneven, "vehicle", steps=5, stride=5)


def test_segments_of_other_sizes_are_padded():
    one, two = drive(10, 2), cut_segments(scene(), "vehicle", steps=10, stride=10)
    both = joined([one, two])
    assert both.states.shape == (6, 10, 5, 4)
    assert both.lights.shape == (6, 10, 1)
    assert not both.present[:2, :, 2:].any()
    with pytest.raises(ValueError, match="one step's length"):
        joined([one, replace(two, seconds=0.4)])
    assert len(repeated(one, 3)) == 6


@pytest.mark.parametrize("sides", [(1.2, 1.2), (0.9, -0.9)])
def test_views_are_larger_or_mirrored_with_the_world(sides):
    segments, egos = drive(4, 3), egos_of(drive(4, 3))
    sides = torch.tensor(sides)
    before = egos_see(VIEW, hill(), segments, egos, segments.states[:, 0], 0)
    other = scaled(segments, sides)
    other = replace(other, sizes=segments.sizes * sides[0])
    larger = Sight(24, 24, float(sides[0]))
    after = egos_see(larger, ground_scaled(hill(), sides), other, egos, other.states[:, 0], 0)
    after = after.flip(3) if sides[1] < 0 else after
    assert torch.allclose(before[:, :5], after[:, :5], atol=1e-4)  # lights' bars keep their width


def test_a_view_of_the_atlas_is_that_of_the_place():
    generator = torch.Generator().manual_seed(0)
    places = []
    for turn in (0.0, 0.7):
        c, s = np.cos(turn), np.sin(turn)
        image = torch.rand(3, 30, 40, generator=generator)
        smooth = torch.nn.functional.avg_pool2d(image, 5, 1, 2)
        matrix = torch.tensor([[c, s, 100.0], [s, -c, 50.0]], dtype=torch.float32)
        places.append(make_ground(smooth, matrix))
    atlas, offsets = make_atlas(places, VIEW)
    for place, offset in zip(places, offsets, strict=True):
        inverse = torch.linalg.inv(place.image_from_world[:, :2])
        middle = inverse @ (torch.tensor([20.0, 15.0]) - place.image_from_world[:, 2])
        segments = drive(4, 1)
        moved = torch.cat([middle, torch.zeros(2)])
        here = replace(segments, states=segments.states + moved, lights=segments.lights - 1)
        there = shifted(here, offset)
        egos = egos_of(here)
        fitted = fit_ground(place, VIEW.resolution)
        one = egos_see(VIEW, fitted, here, egos, here.states[:, 0], 0)
        two = egos_see(VIEW, atlas, there, egos, there.states[:, 0], 0)
        assert (one - two).abs().mean() < 0.01
        assert (one - two).abs().max() < 0.1


def test_egos_see_others_and_not_themselves():
    segments = drive(4, 2)
    egos = egos_of(segments)
    views = egos_see(VIEW, hill(), segments, egos, segments.states[:, 0], 0)
    assert views.shape == (2, 7, 24, 24)
    assert views[:, 3].sum() == 0  # its own box
    assert (views[:, 4].sum(dim=(1, 2)) > 0).all()  # the walker
    assert (views[:, 5].sum(dim=(1, 2)) == 0).all()  # no light stops
    assert (views[:, 6].sum(dim=(1, 2)) > 0).all()  # a green one


def test_lights_are_seen_as_wide_as_a_model_needs_them():
    segments = drive(4, 2)
    thin, wide = (
        egos_see(view, hill(), segments, egos_of(segments), segments.states[:, 0], 0)
        for view in (VIEW, replace(VIEW, bar=3.0))
    )
    torch.testing.assert_close(wide[:, 6].sum(), 3 * thin[:, 6].sum())
    torch.testing.assert_close(wide[:, :6], thin[:, :6])


def test_unlike_the_ground_underfoot_stays_so_whatever_is_added_to_all_of_it():
    segments, dim = drive(4, 2), hill()
    bright = replace(dim, image=dim.image + 0.1)
    egos = egos_of(segments)
    one, two = (
        egos_see(VIEW, ground, segments, egos, segments.states[:, 0], 0) for ground in (dim, bright)
    )
    assert (one[:, :3] - two[:, :3]).abs().mean() > 0.09
    unlike = unlike_underfoot(one)
    torch.testing.assert_close(unlike, unlike_underfoot(two))
    assert 0 <= unlike.min() <= unlike[:, :, 11:13, 11:13].max() < unlike.mean() < unlike.max() <= 1
