"""A small synthetic place that experiments share."""

import pytest

from benchmarks.prediction import places
from benchmarks.prediction.places import make_places, read_map


@pytest.fixture(scope="session")
def place(tmp_path_factory):
    """A synthetic place as experiments have them, of a minute instead of ten."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(places, "RECORDING_MINUTES", 1.0)
        patch.setattr(places, "RESOLUTION", 0.2)
        folders = make_places(tmp_path_factory.mktemp("work") / "places", [(5, "t")])
        read_map(folders[0], "aim")
        assert make_places(folders[0].parent, [(5, "t")]) == folders  # made once
    return folders[0]
