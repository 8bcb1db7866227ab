import numpy as np
import pytest

from benchmarks import stills
from benchmarks.data import find_data, require_data
from geoaim.base.errors import TracksError


def test_box_is_filled_with_what_lies_around_it():
    generator = np.random.default_rng(0)
    road = (110 + 4 * generator.standard_normal((200, 300, 1))).repeat(3, axis=2).astype(np.uint8)
    spoilt = road.copy()
    spoilt[80:110, 120:180] = 255
    clean = stills._remove_boxes(spoilt, np.array([[120, 80, 180, 110]]))
    assert np.abs(clean[80:110, 120:180].astype(int) - 110).mean() < 6


@pytest.mark.skipif(find_data() is None, reason="needs hover/songdo_stills: set GEOAIM_DATA")
def test_sprites_are_cut_from_the_stills():
    sprites = stills.cut_sprites("00972")
    assert len(sprites) > 20
    assert all(sprite.shape[1] > sprite.shape[0] for sprite in sprites)


def test_data_folder_that_is_named_wrongly_is_an_error(monkeypatch, tmp_path):
    monkeypatch.setenv("GEOAIM_DATA", str(tmp_path / "nowhere"))
    with pytest.raises(FileNotFoundError, match="GEOAIM_DATA"):
        find_data()


def test_data_that_is_not_there_names_the_folder_and_the_variable(monkeypatch, tmp_path):
    monkeypatch.setenv("GEOAIM_DATA", str(tmp_path))
    with pytest.raises(TracksError, match=r"no folder hover/x; set GEOAIM_DATA"):
        require_data("hover/x")
    monkeypatch.delenv("GEOAIM_DATA")
    with pytest.raises(TracksError, match="set GEOAIM_DATA"):
        require_data("hover/x")
