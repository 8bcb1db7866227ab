from dataclasses import replace

import pytest
import torch

from geoaim.errors import GeoaimWarning, TracksError
from geoaim.prediction import lessons
from geoaim.prediction.lessons import make_lessons
from geoaim.simulation.ground import in_world
from geoaim.simulation.scene import scene_steps
from tests.prediction.made import TINY, hill
from tests.prediction.test_segments import scene


@pytest.fixture(autouse=True)
def short(monkeypatch):
    monkeypatch.setitem(lessons.STEPS, "vehicle", 5)
    monkeypatch.setitem(lessons.STRIDES, "vehicle", 5)


def test_what_is_held_out_is_never_learnt():
    found = make_lessons([scene()], TINY, held_out=0.3)
    x = scene().poses[0, :, 0]
    apart = found.train.states[0, 0, 0, 0] - x[0]  # the atlas lies elsewhere
    learnt = (found.train.states[..., 0, 0] - apart).flatten()
    held = (found.valid.states[..., 0, 0] - apart).flatten()
    assert learnt.max() < x[14]
    assert held.min() >= x[14]


def test_scenes_of_one_place_share_its_ground():
    one = scene()
    shared = make_lessons([one, replace(one)], TINY, held_out=0.3)
    apart = make_lessons([one, replace(one, ground=hill())], TINY, held_out=0.3)
    assert apart.ground.image.shape[2] > 1.8 * shared.ground.image.shape[2]
    assert len(apart.train) == len(shared.train) == 10
    for found in (shared, apart):
        height, width = found.ground.image.shape[1:]
        low, high = in_world(found.ground.image_from_world, torch.tensor([[0, height], [width, 0]]))
        places = found.train.states[:, :, 0, :2].double()
        assert ((low < places) & (places < high)).all()


def test_too_short_a_recording_says_so():
    with pytest.raises(TracksError, match=r"nothing to check with .* 5 % are held out"):
        make_lessons([scene()], TINY)
    with pytest.raises(TracksError, match="nothing to learn from in recording 1 of 1"):
        make_lessons([scene()], TINY, held_out=0.9)
    with pytest.warns(GeoaimWarning, match="nothing to learn from in recording 2 of 2"):
        found = make_lessons([scene(), scene_steps(scene(), slice(0, 8))], TINY, held_out=0.7)
    assert len(found.train) == len(make_lessons([scene()], TINY, held_out=0.7).train)
