import numpy as np
import pandas as pd
import pytest

from geoaim import World
from geoaim.base.errors import TracksError
from geoaim.tracks.tables import make_tracks
from geoaim.tracks.tracks import COLUMNS

WORLD = World("EPSG:32635", (583000.0, 6062000.0))


def make_row(**changed):
    row = {"id": "1", "type": "car", "time": 0, "x": 1, "y": 2, "heading": 0, "speed": 1}
    return row | {"length": 4, "width": 2} | changed


def test_ids_keep_the_order_of_their_first_rows():
    rows = pd.DataFrame(
        {name: [0.1, 0.1, 0.1] for name in COLUMNS} | {"id": ["9", "10", "9"], "type": "car"}
    ).assign(time=[0.0, 0.0, 0.1])
    tracks = make_tracks(rows, World(None))
    assert tracks.ids == ("9", "10")
    assert tracks.present.tolist() == [[True, True], [True, False]]


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"id": ""}, "id '' is missing"),
        ({"id": None}, "id 'None' is missing"),
        ({"type": np.nan}, "type 'nan' is missing"),
        ({"heading": 90}, "row 0: heading '90' is beyond 2 pi radians: is it in degrees, or"),
        ({"heading": np.nan}, "row 0: heading 'nan' is missing; leave out rows of absent"),
        ({"heading": "N"}, "row 0: heading 'N' is not a number; leave out"),
        ({"length": 0}, "length '0' is not positive"),
        ({"time": 1.7e18}, "is not in seconds"),
    ],
)
def test_rows_with_missing_or_impossible_values_are_refused(changed, message):
    with pytest.raises(TracksError, match=message):
        make_tracks(pd.DataFrame([make_row(**changed)]), WORLD)


def test_heading_is_wrapped():
    tracks = make_tracks(pd.DataFrame([make_row(heading=1.5 * np.pi)]), WORLD)
    assert tracks.states[0, 0, 2] == pytest.approx(-np.pi / 2)
