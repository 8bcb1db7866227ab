import re

import numpy as np

from geoaim.synthetic.roads.curves import POINT_SPACING_M
from geoaim.synthetic.traffic.overlaps import find_overlaps
from geoaim.synthetic.traffic.ways import make_ways


def _overlaps(roads):
    ways = make_ways(roads)
    return ways, find_overlaps(ways, roads.crossings, ring=roads.layout.ring_radius > 0)


def test_ways_can_be_driven_by_a_bicycle(roads):
    for way in make_ways(roads):
        assert np.abs(way.bend).max() < 1 / 4.0, way.name  # 34 degrees with 2.7 m between axles
        assert np.abs(np.diff(way.heading)).max() < 0.15 or not way.forward.all()


def test_points_of_a_way_lie_a_step_apart(roads):
    for way in make_ways(roads):
        steps = np.hypot(*np.diff(way.line, axis=0).T)
        np.testing.assert_allclose(steps, POINT_SPACING_M, atol=0.03)


def test_who_leaves_a_bay_backs_out_of_where_the_other_came_to_rest(roads):
    ways = {way.name: way for way in make_ways(roads)}
    for name, way in ways.items():
        if name.startswith("out of"):
            inwards = ways[name.replace("out of", "into")]
            np.testing.assert_allclose(way.line[0], inwards.line[-1], atol=0.01)
            turn = way.heading[0] - inwards.heading[-1]
            assert abs(abs((turn + np.pi) % (2 * np.pi) - np.pi) - np.pi) < 0.05
            assert not way.forward[0]
            assert way.forward[-1]


def test_one_of_two_gives_way_where_ways_meet(roads):
    _, overlaps = _overlaps(roads)
    index, meetings = overlaps.meeting, overlaps.meetings
    for a, b, slot in np.argwhere(index >= 0):
        mine, theirs = index[a, b, slot], index[b, a, slot]
        assert meetings.gives_way[mine] != meetings.gives_way[theirs]
        assert meetings.start[mine] == meetings.other_start[theirs]
        assert meetings.line[mine] <= meetings.start[mine] or not meetings.gives_way[mine]


def test_somebody_on_my_own_way_is_where_he_is(roads):
    _, overlaps = _overlaps(roads)
    np.testing.assert_allclose(overlaps.ahead[0, 0, 10:50], np.arange(10, 50))


def test_ways_from_one_lane_are_one_until_they_part(roads):
    ways, overlaps = _overlaps(roads)
    same = [k for k, way in enumerate(ways) if way.entry == ways[0].entry]
    for other in same[1:]:
        np.testing.assert_allclose(overlaps.ahead[0, other, 5:80], np.arange(5, 80), atol=0.1)


def test_straight_ways_of_opposite_directions_never_meet(roads):
    ways, overlaps = _overlaps(roads)
    if roads.layout.kind != "roundabout":
        out, back = (
            [k for k, way in enumerate(ways) if re.fullmatch(f"{a} in . to {b}", way.name)]
            for a, b in (("east", "west"), ("west", "east"))
        )
        assert (overlaps.meeting[np.ix_(out, back)] < 0).all()
        assert min(len(out), len(back)) > 0
