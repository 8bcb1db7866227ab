import numpy as np

from geoaim.synthetic.roads.curves import POINT_SPACING_M
from geoaim.synthetic.traffic.paths import make_paths


def test_paths_are_feasible_for_a_bicycle(roads):
    for path in make_paths(roads):
        assert np.abs(path.curvature).max() < 1 / 4.0, path.name  # 34 degrees, wheelbase 2.7 m
        assert np.abs(np.diff(path.heading)).max() < 0.15 or not path.forward.all()


def test_points_of_a_path_are_equally_spaced(roads):
    for path in make_paths(roads):
        spacing = np.hypot(*np.diff(path.line, axis=0).T)
        np.testing.assert_allclose(spacing, POINT_SPACING_M, atol=0.03)


def test_paths_out_of_a_bay_start_in_reverse_where_paths_into_it_end(roads):
    paths = {path.name: path for path in make_paths(roads)}
    for name, path in paths.items():
        if name.startswith("out of"):
            into = paths[name.replace("out of", "into")]
            np.testing.assert_allclose(path.line[0], into.line[-1], atol=0.01)
            turn = path.heading[0] - into.heading[-1]
            assert abs(abs((turn + np.pi) % (2 * np.pi) - np.pi) - np.pi) < 0.05
            assert not path.forward[0]
            assert path.forward[-1]
