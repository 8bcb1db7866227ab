from dataclasses import replace

import torch

from geoaim.prediction.checkpoints import read_model, write_model
from geoaim.prediction.familiarity import learn_known_views, measure_strangeness
from geoaim.prediction.training import init_model
from tests.prediction.tiny import TINY, drive, hill


def make_model():
    model = init_model(TINY).eval()
    model.known_views = learn_known_views(model, drive(10, 40), drive(10, 40), hill(), step=3)
    return model


def test_about_one_view_in_twenty_of_validation_is_strange():
    distances = measure_strangeness(make_model(), drive(10, 40), hill(), step=3)
    assert 0 < (distances > 1).float().mean() < 0.1


def test_another_map_is_strange():
    ground, generator = hill(), torch.Generator().manual_seed(0)
    noise = torch.rand(ground.image.shape, generator=generator)
    strange = replace(ground, image=noise)
    assert (measure_strangeness(make_model(), drive(10, 5), strange, step=3) > 1).all()


def test_a_model_file_keeps_what_views_are_known(tmp_path):
    model = make_model()
    write_model(model, tmp_path / "model.pt")
    again = read_model(tmp_path / "model.pt")
    for name in ("mean", "whitening"):
        assert torch.allclose(getattr(again.known_views, name), getattr(model.known_views, name))
    assert again.known_views.limit == model.known_views.limit


def test_a_model_that_was_not_trained_does_not_tell():
    assert measure_strangeness(init_model(TINY), drive(10, 5), hill(), step=3) is None
