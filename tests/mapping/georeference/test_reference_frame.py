from dataclasses import replace

import pytest

from geoaim.mapping.georeference.from_telemetry import make_local_georeference
from geoaim.mapping.georeference.reference_frame import choose_reference_time
from tests.mapping.georeference.points import make_points


@pytest.mark.parametrize(("frame", "time"), [(None, 0.0), (0, 0.0), (7, None), ("b.jpg", None)])
def test_points_on_the_first_frame_make_it_the_reference(frame, time):
    points = make_points()
    assert choose_reference_time(replace(points, frames=(frame,) * len(points.names))) == time


def test_a_given_georeference_refers_to_the_first_frame():
    assert choose_reference_time(make_local_georeference(resolution=0.1, size=(4, 4))) == 0.0
    assert choose_reference_time(None) is None
