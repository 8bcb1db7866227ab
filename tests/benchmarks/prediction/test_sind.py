import math

import pytest

from benchmarks.prediction import sind


@pytest.mark.parametrize("name", sind.JUNCTIONS)
def test_images_lie_where_their_hd_maps_say(data_folder, name):
    aim, fit, hdmap = sind.georeference_junction(name)
    assert math.sqrt(float((fit.residuals**2).sum(axis=1).mean())) < 0.5
    assert fit.used.all()
    assert aim.world == hdmap.world
