from itertools import pairwise

import numpy as np
import pytest
import torch
from shapely import MultiPolygon, Point, Polygon, box

from geoaim.hdmap.drivable import compute_signed_distance
from geoaim.simulation.infractions import (
    Drivable,
    Lanes,
    compute_offroad_distance,
    detect_collisions,
    detect_offroad,
    detect_red_light_running,
    detect_wrong_way,
    sample_distance,
)
from geoaim.simulation.overlap import box_iou
from geoaim.simulation.road_rules import RoadRules, make_drivable, stack_rules
from geoaim.tracks.lights import GREEN, RED, UNKNOWN

AREA = MultiPolygon([Polygon(box(-40, -5, 40, 5).exterior, [box(-2, -2, 2, 2).exterior.coords])])
CAR = torch.tensor([4.0, 2.0])


def _drivable(resolution=0.2):
    distance, grid = compute_signed_distance(AREA, resolution=resolution)
    matrix = torch.tensor(grid.grid_from_world[:2], dtype=torch.float32)
    return Drivable(torch.tensor(distance), matrix)


def test_distance_agrees_with_shapely():
    generator = np.random.default_rng(0)
    points = generator.uniform([-55, -20], [55, 20], (500, 2))
    outline = AREA.boundary
    expected = [(-1) ** AREA.contains(Point(p)) * outline.distance(Point(p)) for p in points]
    result = sample_distance(_drivable(), torch.tensor(points, dtype=torch.float32))
    assert np.abs(result.numpy() - expected).max() < 0.15  # at the bends of the distance
    assert np.abs(result.numpy() - expected).mean() < 0.02


def test_distance_continues_beyond_the_raster():
    near, far = sample_distance(_drivable(), torch.tensor([[0.0, 24.0], [0.0, 124.0]]))
    assert float(far - near) == pytest.approx(100, abs=0.2)


def test_offroad_distance_is_that_of_the_furthest_corner():
    poses = torch.tensor([[20.0, 3.5, 0.0], [20.0, 4.5, 0.0], [torch.nan] * 3])
    present = torch.tensor([True, True, False])
    metres = compute_offroad_distance(_drivable(), poses, CAR.expand(3, 2), present)
    np.testing.assert_allclose(metres.numpy(), [0, 0.5, 0], atol=0.05)


def test_offroad_has_a_tolerance_and_is_unknown_beyond_the_raster():
    y = torch.tensor([4.4, 4.6, 20.0, 30.0, torch.nan])
    poses = torch.stack([torch.full_like(y, 20.0), y, torch.zeros_like(y)], -1)
    given = poses, CAR.expand(5, 2), torch.isfinite(y)
    offroad, known = detect_offroad(_drivable(), *given)
    assert offroad.tolist() == [False, True, True, False, False]
    assert known.tolist() == [True, True, True, False, False]


def test_collisions_involve_a_vehicle_and_contacts_do_not():
    poses = torch.tensor([[0.0, 0, 0], [3.0, 0, 0], [3.2, 0, 0], [0.0, 30, 0], [0.3, 30, 0]])
    vehicles = torch.tensor([True, False, False, False, False])
    given = poses[None], CAR.expand(1, 5, 2), torch.ones(1, 5).bool(), vehicles
    collisions, contacts = (pairs[0].any(dim=-1).tolist() for pairs in detect_collisions(*given))
    assert collisions == [True, True, True, False, False]
    assert contacts == [False, True, True, True, True]


@pytest.mark.parametrize("lost", [torch.nan, torch.inf])
def test_poses_that_are_not_finite_are_refused(lost):
    poses = torch.tensor([[[0.0, 0, 0], [0.0, lost, 0]]])
    sizes, there = CAR.expand(1, 2, 2), torch.ones(1, 2).bool()
    lights = torch.zeros(1, 2, 2), torch.tensor([[RED]])
    lanes = Lanes(torch.zeros(1, 2), torch.zeros(1), torch.ones(1))
    for find in (
        lambda: box_iou(poses, sizes, there),
        lambda: detect_offroad(_drivable(), poses, sizes, there),
        lambda: detect_red_light_running(poses, poses, sizes[..., 0], there, *lights),
        lambda: detect_wrong_way(lanes, poses, there),
    ):
        with pytest.raises(ValueError, match="1 of 2 present boxes have a pose that is not finite"):
            find()
    assert not box_iou(poses, sizes, torch.tensor([[True, False]])).any()


def test_gradient_leads_back_to_the_road():
    poses = torch.tensor([[20.0, 8.0, 0.0], [200.0, 0.0, 0.0]], requires_grad=True)
    metres = compute_offroad_distance(_drivable(), poses, CAR.expand(2, 2), torch.ones(2).bool())
    (gradient,) = torch.autograd.grad(metres.sum(), poses)
    torch.testing.assert_close(gradient[0, :2], torch.tensor([0.0, 1.0]), atol=0.05, rtol=0)
    torch.testing.assert_close(gradient[1, :2], torch.tensor([1.0, 0.0]), atol=0.05, rtol=0)


def test_collision_is_the_largest_overlap():
    poses = torch.tensor([[[0.0, 0, 0], [3.0, 0, 0], [3.5, 0, 0], [0.0, 30, 0]]])
    iou = box_iou(poses, CAR.expand(1, 4, 2), torch.ones(1, 4).bool())
    result = iou.amax(dim=-1)[0]
    expected = torch.tensor([1 / 7, 3.5 / 4.5, 3.5 / 4.5, 0])
    torch.testing.assert_close(result, expected, atol=1e-4, rtol=0)


@pytest.mark.parametrize(
    ("start", "end", "state", "ran"),
    [
        (-3.0, -1.0, RED, True),
        (-3.0, -1.0, GREEN, False),
        (-3.0, -1.0, UNKNOWN, False),
        (-5.0, -3.0, RED, False),  # still before the line
        (1.0, 3.0, RED, False),  # long past it
    ],
)
def test_red_light_is_run_when_the_front_crosses_its_line(start, end, state, ran):
    line = torch.tensor([[[0.0, -2.0], [0.0, 2.0]]])
    before, after = torch.tensor([[[start, 0.0, 0.0]]]), torch.tensor([[[end, 0.0, 0.0]]])
    lengths, there = torch.full((1, 1), 4.0), torch.ones(1, 1).bool()
    states = torch.tensor([[state]])
    assert bool(detect_red_light_running(before, after, lengths, there, line, states)) is ran
    beside = torch.tensor([0.0, 4.0, 0.0])
    assert not detect_red_light_running(
        before + beside, after + beside, lengths, there, line, states
    )


def test_red_light_is_not_run_backwards_nor_counted_twice():
    line, red = torch.tensor([[[0.0, -2.0], [0.0, 2.0]]]), torch.tensor([[RED]])

    def count(*centres):
        """Cars of 4 m that head east, from one centre to the next."""
        poses = [torch.tensor([[[x, 0.0, 0.0]]]) for x in centres]
        given = torch.full((1, 1), 4.0), torch.ones(1, 1).bool(), line, red
        return sum(int(detect_red_light_running(*step, *given)) for step in pairwise(poses))

    assert count(-3.0, -1.0) == 1
    assert count(-1.0, -3.0) == 0  # rolls back over it
    assert count(-3.0, -2.0, -2.0, -1.0) == 1  # stands on it
    assert count(-3.0, -2.0, -2.0) == 0  # stops exactly at it
    assert count(-2.0, -2.0, -1.0) == 1  # starts exactly at it


def test_wrong_way_is_against_every_lane_at_the_agent():
    lanes = Lanes(
        torch.tensor([[0.0, 0.0], [2.0, 0.0], [0.0, 3.0]]),
        torch.tensor([0.0, 0.0, np.pi]),
        torch.tensor([1.8, 1.8, 1.8]),
    )
    poses = torch.tensor(
        [[0.5, 0, 0.2], [0.5, 0, np.pi], [0, 3, np.pi], [0, 1.5, np.pi], [30, 0, np.pi]]
    )
    there = torch.ones(5, dtype=torch.bool)
    wrong, on_lane = detect_wrong_way(lanes, poses, there)
    assert wrong.tolist() == [False, True, False, False, False]
    assert on_lane.tolist() == [True, True, True, True, False]
    assert not any(mask.any() for mask in detect_wrong_way(lanes, poses, ~there))


def test_autocast_does_not_change_infractions():
    poses = torch.tensor([[[20.3, 4.7, 0.4], [21.9, 5.1, 0.1], [-31.7, -6.2, 2.0]]])
    sizes, there = CAR.expand(1, 3, 2), torch.ones(1, 3, dtype=torch.bool)
    drivable = _drivable()

    def both():
        offroad = compute_offroad_distance(drivable, poses, sizes, there)
        return offroad, box_iou(poses, sizes, there)

    plain = both()
    with torch.autocast("cpu", torch.bfloat16):
        half = both()
    assert plain[0].any()
    assert plain[1].any()
    assert all(torch.equal(one, two) for one, two in zip(plain, half, strict=True))


def test_float64_gives_the_same_infractions():
    poses, there = torch.tensor([[20.0, 4.5, 0.0]]), torch.ones(1, dtype=torch.bool)
    single, double = (
        compute_offroad_distance(_drivable(), poses.to(kind), CAR[None].to(kind), there)
        for kind in (torch.float32, torch.float64)
    )
    assert double.dtype == torch.float64
    torch.testing.assert_close(double.float(), single, atol=1e-4, rtol=0)
    lanes = Lanes(torch.tensor([[20.0, 4.5]]), torch.tensor([np.pi]), torch.tensor([1.8]))
    assert detect_wrong_way(lanes, poses.double(), there)[0].all()


def test_lanes_far_from_the_origin_keep_their_width():
    apart = torch.tensor([[0.0, 1.7], [0.0, 1.9]]).repeat(20, 1)
    far = torch.tensor([9000.0, -9000.0])
    lanes = Lanes(far + torch.zeros(30, 2), torch.full((30,), np.pi), torch.full((30,), 1.8))
    poses = torch.cat([far + apart, torch.zeros(40, 1)], dim=1)
    wrong, _ = detect_wrong_way(lanes, poses, torch.ones(40, dtype=torch.bool))
    assert wrong.tolist() == [True, False] * 20


def test_rules_of_several_places_are_judged_in_one_batch():
    narrow = MultiPolygon([box(-12, -3, 9, 3)])
    areas, lanes = (
        [AREA, narrow],
        [
            Lanes(torch.zeros(1, 2), torch.zeros(1), torch.ones(1)),
            Lanes(
                torch.tensor([[3.0, 0], [5, 1]]), torch.tensor([np.pi, 0]), torch.full((2,), 2.0)
            ),
        ],
    )
    rules = [RoadRules(make_drivable(a), lane) for a, lane in zip(areas, lanes, strict=True)]
    stacked, places = stack_rules(rules), torch.tensor([1, 0, 1])
    generator = torch.Generator().manual_seed(0)
    poses = torch.rand(3, 40, 3, generator=generator) * torch.tensor([130, 60, 6.2]) - 40
    poses[:, :5, :2] = torch.rand(3, 5, 2, generator=generator) * 6  # near the lanes
    sizes, present = CAR.expand(3, 40, 2), torch.rand(3, 40, generator=generator) > 0.2
    chosen = stacked.select(places)
    for function, field in (
        (compute_offroad_distance, "drivable"),
        (detect_offroad, "drivable"),
        (lambda lanes, poses, _, present: detect_wrong_way(lanes, poses, present), "lanes"),
    ):
        together = function(getattr(chosen, field), poses, sizes, present)
        for k, place in enumerate(places):
            alone = function(getattr(rules[place], field), poses[k], sizes[k], present[k])
            pair = (x if isinstance(x, tuple) else (x,) for x in (alone, together))
            for one, batch in zip(*pair, strict=True):
                torch.testing.assert_close(batch[k], one, atol=2e-3, rtol=0)
    with pytest.raises(ValueError, match="of 2 places 1 have a drivable area and 2 lanes"):
        stack_rules([rules[0], RoadRules(None, lanes[1])])
