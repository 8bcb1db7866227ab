import numpy as np
import pytest

from geoaim.errors import TracksError
from geoaim.lights import GREEN, RED, UNKNOWN, YELLOW, read_lights, states_at
from geoaim.world import World

LINES = {"a": np.array([[0.0, 0], [3, 0]]), "b": np.array([[0.0, 9], [3, 9]])}
WORLD = World(None)
TABLE = "time,signal,state\n0,a,green\n2,b,red\n24.5,a,yellow\n27,a,red\n0,walk,green\n"


def _read(tmp_path, content=TABLE, lines=LINES):
    path = tmp_path / "lights.csv"
    path.write_text(content)
    return read_lights(path, lines, WORLD)


def test_state_lasts_until_its_next_change(tmp_path):
    lights = _read(tmp_path)
    assert lights.names == ("a", "b")  # nobody knows where "walk" stops whom
    states = states_at(lights, np.array([-1.0, 0.0, 1.9, 24.4, 24.5, 100.0]))
    assert states[:, 0].tolist() == [UNKNOWN, GREEN, GREEN, GREEN, YELLOW, RED]
    assert states[:, 1].tolist() == [UNKNOWN, UNKNOWN, UNKNOWN, RED, RED, RED]


def test_bundled_lights_stop_traffic_at_the_maps_lines():
    from geoaim.mapping.hdmap import read_hdmap

    hdmap = read_hdmap("samples/map.osm")
    lights = read_lights("samples/lights.csv", hdmap.stop_lines, hdmap.world)
    assert sorted(lights.names) == ["east", "north", "south", "west"]
    states = states_at(lights, np.arange(0, 60, 0.1))
    crossing = (states[:, [0]] == GREEN) & (states[:, 2:] == GREEN)
    assert (states >= 0).all()
    assert not crossing.any()  # east and west never with north and south


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("a,b\n1,2\n", "has the columns a, b"),
        ("time,signal,state\n0,a,blue\n", r"1 rows have no time.*blue"),
        ("time,signal,state\nnoon,a,red\n", "1 rows have no time"),
        ("time,signal,state\n0,c,red\n", "none of the lights c has a stop line.*a, b"),
        ("", "is no table of lights"),
    ],
)
def test_what_is_no_table_of_lights_is_refused(tmp_path, content, message):
    with pytest.raises(TracksError, match=message):
        _read(tmp_path, content)


def test_missing_file_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"none\.csv"):
        read_lights(tmp_path / "none.csv", LINES, WORLD)
