from dataclasses import replace

import numpy as np
import pytest

from geoaim import Tracks, World
from geoaim.tracks.tracks import COLUMNS, estimate_heading

WORLD = World("EPSG:32635", (583000.0, 6062000.0))


def two_agents(present=((True, True, False), (False, True, True)), world=WORLD):
    present = np.array(present)
    states = np.arange(present.size * 4, dtype=float).reshape(*present.shape, 4) / 10
    states[~present] = np.nan
    count = len(present)
    return Tracks(
        times=np.array([0.0, 0.1, 0.2])[: present.shape[1]],
        states=states,
        present=present,
        sizes=np.tile([4.5, 1.8], (count, 1)),
        types=("car", "pedestrian")[:count],
        ids=("7", "b")[:count],
        world=world,
    )


def test_absent_agents_have_no_rows_in_the_frame():
    frame = two_agents().to_dataframe()
    assert len(frame) == 4
    assert list(frame.columns) == list(COLUMNS)
    assert not frame.isna().any().any()


def test_wrong_shapes_and_times_are_refused(unchecked):
    t = two_agents()
    with pytest.raises(ValueError, match=r"sizes has the shape \(1, 2\); 2 ids"):
        Tracks(t.times, t.states, t.present, t.sizes[:1], t.types, t.ids, WORLD)
    with pytest.raises(ValueError, match="times do not increase"):
        Tracks(t.times[::-1], t.states, t.present, t.sizes, t.types, t.ids, WORLD)
    with pytest.raises(ValueError, match="not finite where its agent is present"):
        Tracks(t.times, t.states, ~t.present, t.sizes, t.types, t.ids, WORLD)


def test_estimated_heading_is_kept_while_standing_and_known_before_the_first_motion():
    velocity = np.array([[[0.0, 0], [0, 1], [0, 0], [-1, 0]]])
    np.testing.assert_allclose(
        estimate_heading(velocity), [[np.pi / 2, np.pi / 2, np.pi / 2, np.pi]]
    )


def test_agents_with_the_same_id_are_refused():
    tracks = two_agents()
    with pytest.raises(ValueError, match="id of another"):
        replace(tracks, ids=("7", "7"))
