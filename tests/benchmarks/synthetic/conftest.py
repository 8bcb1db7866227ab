"""Made places that several tests look at."""

import numpy as np
import pytest

from benchmarks.synthetic import Hover, make_sample, tracks_of
from benchmarks.synthetic.roads.layouts import PLACE_KINDS
from benchmarks.synthetic.roads.plan import make_roads
from tests.sizes import keep_quick

SMALL = Hover(count=25, frame_rate=2.0, drift=4.0, perspective=0.3)


@pytest.fixture(scope="session")
def sample():
    """A junction, drawn coarsely, with a short video."""
    return make_sample(3, minutes=0.3, video=(180, 320), hover=SMALL, resolution=0.2)


KINDS = keep_quick(PLACE_KINDS, "junction", "street")


@pytest.fixture(scope="session", params=KINDS)
def roads(request):
    """A plan of each kind."""
    return make_roads(request.param, np.random.default_rng(5))


@pytest.fixture(scope="session", params=KINDS)
def recorded(request):
    """Two minutes of traffic in a place of each kind, and its tracks."""
    sample = make_sample(11, kind=request.param, minutes=2.0, video=None)
    return sample, tracks_of(sample)
