import numpy as np
import pytest
from shapely import LineString, MultiLineString

from geoaim.base.errors import MapError, TracksError
from geoaim.base.geojson import Feature
from geoaim.base.world import World
from geoaim.tracks.lights import (
    GREEN,
    RED,
    UNKNOWN,
    YELLOW,
    StopLine,
    find_light_states,
    read_lights,
    read_stop_lines,
)
from tests.geojson_files import write_features

LINES = (StopLine("a", np.array([[0.0, 0], [3, 0]])), StopLine("b", np.array([[0.0, 9], [3, 9]])))
WORLD = World(None)
TABLE = "time,signal,state\n0,a,green\n2,b,red\n24.5,a,yellow\n27,a,red\n0,walk,green\n"


def _read(tmp_path, content=TABLE, lines=LINES):
    path = tmp_path / "lights.csv"
    path.write_text(content)
    return read_lights(path, lines, WORLD)


def test_state_lasts_until_its_next_change(tmp_path):
    lights = _read(tmp_path)
    assert lights.names == ("a", "b")  # "walk" has no stop line
    states = find_light_states(lights, np.array([-1.0, 0.0, 1.9, 24.4, 24.5, 100.0]))
    assert states[:, 0].tolist() == [UNKNOWN, GREEN, GREEN, GREEN, YELLOW, RED]
    assert states[:, 1].tolist() == [UNKNOWN, UNKNOWN, UNKNOWN, RED, RED, RED]


def test_signal_may_be_called_na(tmp_path):
    lines = (StopLine("NA", LINES[0].ends),)
    assert _read(tmp_path, "time,signal,state\n0,NA,red\n0,NA,red\n", lines).names == ("NA",)


SIND = """RawFrameID,timestamp(ms),Vehicle Traffic light 1,Vehicle Traffic light 2
1737,27927.9,0,3
1827,30930.9,1,0
3000,70070.0,3,
"""


def test_sinds_table_has_a_column_for_each_light(tmp_path):
    north, south = (StopLine("Vehicle Traffic light 1", line.ends) for line in LINES)
    east = StopLine("Vehicle Traffic light 2", LINES[0].ends)
    lights = _read(tmp_path, SIND, (north, south, east))
    states = find_light_states(lights, np.array([0.0, 28.0, 30.95, 80.0]))
    assert states[:, 0].tolist() == [UNKNOWN, RED, GREEN, YELLOW]
    assert (states[:, 0] == states[:, 1]).all()  # one signal at two lines
    assert states[:, 2].tolist() == [UNKNOWN, YELLOW, RED, RED]  # a state without a change stays
    names, rows = SIND.split("\n", 1)
    again = _read(tmp_path, names + "\n" + rows.replace("\n", ",\n"), (north, south, east))
    assert (again.states == lights.states).all()


@pytest.mark.parametrize(
    ("table", "count"),
    [
        ("Changchun/changchun_pudong_507_009/Traffic_Lights.csv", 2),
        ("Chongqing/6_22_NR_1/TrafficLight_06_22_NR1_add_plight.csv", 4),
    ],
)
def test_sinds_recordings_have_three_seconds_of_yellow(data_folder, table, count):
    lines = [StopLine(f"Vehicle Traffic light {n}", LINES[0].ends) for n in range(1, count + 1)]
    lights = read_lights(data_folder / "tracks" / "sind" / table, lines, WORLD)
    assert len(lights.names) == count
    yellow = np.diff(lights.times)[(lights.states[:-1] == YELLOW).any(axis=1)]
    assert abs(np.median(yellow) - 3) < 0.1
    assert not (lights.states == GREEN).all(axis=1).any()


def test_hand_drawn_stop_lines_are_read(tmp_path):
    world, path = World("EPSG:32635", (500000.0, 5900000.0)), tmp_path / "lines.geojson"
    lines = [Feature(LineString(line.ends), {"signal": "east"}) for line in LINES]
    write_features([*lines, Feature(LineString([[0, 0], [9, 9]]), {"name": "kerb"})], world, path)
    found = read_stop_lines(path, world)
    assert [line.signal for line in found] == ["east", "east"]
    for line, drawn in zip(found, LINES, strict=True):
        np.testing.assert_allclose(line.ends, drawn.ends, atol=1e-6)


def test_multi_lines_and_a_byte_order_mark_are_read(tmp_path):
    """Several lines of one signal, a line without a signal, and a byte order mark."""
    path, parts = tmp_path / "lines.geojson", [line.ends for line in LINES]
    named = Feature(MultiLineString(parts), {"signal": "a"})
    write_features([named, Feature(LineString(parts[0]), {"signal": None})], WORLD, path)
    path.write_text("\ufeff" + path.read_text(), encoding="utf-8")
    found = read_stop_lines(path, WORLD)
    assert [line.signal for line in found] == ["a", "a"]
    np.testing.assert_allclose([line.ends for line in found], parts)


@pytest.mark.parametrize("line", [[], [[27.5, 53.9], [27.50003, 53.90001]]])
def test_lines_without_a_length_are_refused(tmp_path, line):
    path = tmp_path / "lines.geojson"
    write_features([Feature(LineString(line), {"signal": "a"})], WORLD, path)
    with pytest.raises(MapError, match=r"signal 'a' is shorter than 0\.1 m.*for metres"):
        read_stop_lines(path, WORLD)


def test_drawing_without_signals_is_refused(tmp_path):
    path = tmp_path / "lines.geojson"
    write_features([Feature(LineString([[0, 0], [9, 9]]))], WORLD, path)
    with pytest.raises(MapError, match=r"holds LineString.*'signal' is needed"):
        read_stop_lines(path, WORLD)


def test_bundled_lights_stop_traffic_at_the_maps_lines():
    from geoaim.hdmap.lanelet2 import read_hdmap

    hdmap = read_hdmap("samples/map.osm")
    lights = read_lights("samples/lights.csv", hdmap.stop_lines, hdmap.world)
    assert sorted(lights.names) == ["east", "north", "south", "west"]
    states = find_light_states(lights, np.arange(0, 60, 0.1))
    crossing = (states[:, [0]] == GREEN) & (states[:, 2:] == GREEN)
    assert (states >= 0).all()
    assert not crossing.any()  # east and west are never green with north and south


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("a,b\n1,2\n", "has the columns a, b"),
        ("time,signal,state\n0,a,blue\n", r"1 rows have no time.*blue"),
        ("time,signal,state\nnoon,a,red\n", "1 rows have no time"),
        ("time,signal,state\n1e39,a,red\n", "1 rows have no time"),
        ("time,signal,state\n0,a,red\n0,a,green\n", "two states at one time.*red.*green"),
        ("time,signal,state\n0,a,red,9\n", "is not a table of traffic lights"),
        (
            "time,signal,state\n0,c,red\n",
            r"none of the signals c has a stop line; stop lines were given of a at \(2, 0\) m, "
            r"b at \(2, 9\) m. Draw a line .* property 'signal' such as 'c', and give that as stop",
        ),
        ("", "is not a table of traffic lights"),
    ],
)
def test_a_broken_table_is_refused_with_its_reason(tmp_path, content, message):
    with pytest.raises(TracksError, match=message):
        _read(tmp_path, content)


def test_missing_file_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"none\.csv"):
        read_lights(tmp_path / "none.csv", LINES, WORLD)


def test_a_folder_is_refused_as_no_table(tmp_path):
    with pytest.raises(TracksError, match="not a table of traffic lights"):
        read_lights(tmp_path, LINES, WORLD)
