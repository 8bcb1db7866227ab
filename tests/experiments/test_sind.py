import math

import pytest

from geoaim.experiments import sind


@pytest.mark.parametrize("name", sind.JUNCTIONS)
def test_images_lie_where_their_hd_maps_say(data_folder, name):
    aim, found, hdmap = sind.fit(name)
    assert math.sqrt(float((found.residuals**2).sum(axis=1).mean())) < 0.5
    assert found.used.all()
    assert aim.world == hdmap.world
