"""The alignment benchmark on tiny input."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.alignment import benchmark as alignment
from benchmarks.alignment import pairs as alignment_pairs
from benchmarks.alignment import placing
from benchmarks.alignment import real as alignment_real
from benchmarks.alignment.pairs import Pair, measure_error, misplace_picture
from geoaim.aim.aim import AIM
from geoaim.base.geometry import translation
from geoaim.base.world import World
from geoaim.imagery.alignment.result import ImageryAlignment
from geoaim.tracks.tracks import Tracks
from tests.conftest import textured

pytestmark = pytest.mark.slow


def _make_pair(seed):
    image = textured(np.random.default_rng(seed), 200, 260)
    matrix = np.array([[0.25, 0, 0], [0, -0.25, 50], [0, 0, 1.0]])
    aim = AIM.from_image(image, matrix, World(None), "a test")
    return Pair(f"junction {seed}", aim, aim, np.eye(3))


def test_error_of_the_inverse_misplacement_is_zero():
    case = misplace_picture(_make_pair(1), np.random.default_rng(0))
    assert measure_error(case, np.linalg.inv(case.stated_from_true)) == pytest.approx(0, abs=1e-9)
    assert measure_error(case, np.eye(3)) > 1


def test_methods_align_a_shifted_picture_and_refuse_another_place(monkeypatch):
    monkeypatch.setattr(alignment_pairs, "MAX_SHIFT_M", 3.0)
    pairs, methods = [_make_pair(1), _make_pair(2)], alignment.list_methods()
    some = {name: methods[name] for name in ("geoaim", "SIFT + MAGSAC++")}
    rows = alignment._compare_methods(pairs, 1, some)
    assert [row["method"] for row in rows] == list(some)
    assert rows[0]["median, px"] < 0.5


def test_a_view_is_placed_from_far_off_and_another_place_is_refused(monkeypatch):
    monkeypatch.setattr(placing, "SIZE_PX", (240, 320))
    generator = np.random.default_rng(4)
    world = World("EPSG:32635", (500_000.0, 5_600_000.0))
    matrix = np.array([[0.2, 0, 0], [0, -0.2, 160], [0, 0, 1.0]])
    one, other = (
        AIM.from_image(textured(generator, 800, 800), matrix, world, "drawn") for _ in range(2)
    )
    pair = Pair("junction 1", one, one, np.eye(3))
    view = placing.look_at(pair, generator)
    rows = [
        placing.measure_case(replace(pair, picture=picture), view, generator)
        for picture in (one, other)
    ]
    assert [row["placed"] for row in rows] == [True, False]
    table = [placing.summarize("it", rows[:1]), placing.summarize("another", rows[1:])]
    assert table[0]["largest of corners, px"] < 1
    assert [row["placed"] for row in table] == [1, 0]
    assert table[1]["over 2 px"] == 0


def test_ecc_finds_the_shift_of_a_picture():
    pair = _make_pair(1)
    moved = translation(1.0, -0.5) @ pair.picture.world_from_image
    pair = replace(pair, picture=replace(pair.picture, world_from_image=moved))
    np.testing.assert_allclose(alignment_real._estimate_shift_by_ecc(pair), [-1.0, 0.5], atol=0.25)


def test_tracks_row_counts_errors_and_refusals(monkeypatch):
    pair = _make_pair(1)
    states, present = np.zeros((1, 2, 4)), np.ones((1, 2), bool)
    tracks = Tracks(np.arange(2.0), states, present, np.ones((1, 2)), ("car",), ("a",), World(None))

    def align(moved, _):
        stated = moved.world_from_image @ pair.picture.grid.grid_from_world
        return ImageryAlignment(np.linalg.inv(stated), "rigid", np.eye(2), np.zeros(2))

    monkeypatch.setattr(alignment_real, "align_tracks", align)
    row = alignment_real._measure_tracks("a", [(pair.picture, tracks)], 3)
    assert (row["cases"], row["refused"], row["in the 95 % region"]) == (3, 0, 3)
    assert row["largest, m"] == pytest.approx(0, abs=1e-9)
