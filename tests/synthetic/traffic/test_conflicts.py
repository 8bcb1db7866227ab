import re

import numpy as np

from geoaim.synthetic.traffic.conflicts import find_conflicts
from geoaim.synthetic.traffic.paths import make_paths


def _conflicts(roads):
    paths = make_paths(roads)
    return paths, find_conflicts(roads, paths)


def test_one_of_two_conflicting_paths_yields(roads):
    _, conflicts = _conflicts(roads)
    index, zones = conflicts.zone_index, conflicts.zones
    for a, b, slot in np.argwhere(index >= 0):
        own, other = index[a, b, slot], index[b, a, slot]
        assert zones.yields[own] != zones.yields[other]
        assert zones.start[own] == zones.other_start[other]
        assert zones.wait[own] <= zones.start[own] or not zones.yields[own]


def test_projection_on_the_own_path_is_the_identity(roads):
    _, conflicts = _conflicts(roads)
    np.testing.assert_allclose(conflicts.projection[0, 0, 10:50], np.arange(10, 50))


def test_paths_from_one_lane_are_identical_until_they_diverge(roads):
    paths, conflicts = _conflicts(roads)
    same = [k for k, path in enumerate(paths) if path.entry == paths[0].entry]
    for other in same[1:]:
        projection = conflicts.projection[0, other, 5:80]
        np.testing.assert_allclose(projection, np.arange(5, 80), atol=0.1)


def test_straight_paths_in_opposite_directions_never_conflict(roads):
    paths, conflicts = _conflicts(roads)
    if roads.layout.kind != "roundabout":
        there, back = (
            [k for k, path in enumerate(paths) if re.fullmatch(f"{a} in . to {b}", path.name)]
            for a, b in (("east", "west"), ("west", "east"))
        )
        assert (conflicts.zone_index[np.ix_(there, back)] < 0).all()
        assert min(len(there), len(back)) > 0
