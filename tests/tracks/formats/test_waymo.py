import numpy as np
import pytest

from geoaim.base.errors import GeoaimWarning, TracksError
from geoaim.base.world import World
from geoaim.tracks.formats import (
    list_waymo_scenarios,
    protobuf,
    read_tracks,
    read_waymo,
    read_waymo_lights,
)
from geoaim.tracks.formats.tfrecord import compute_crc32c, mask_checksum, read_records
from geoaim.tracks.lights import GREEN, RED, UNKNOWN, find_light_states
from tests.tracks.formats import waymo_records as made


def write(folder, *scenarios):
    path = folder / "training.tfrecord-00000-of-01000"
    path.write_bytes(made.make_file(*(scenarios or (made.make_scenario(),))))
    return path


def test_scenario_is_read_with_its_valid_states(tmp_path):
    tracks = read_tracks(write(tmp_path))
    assert tracks.ids == ("7", "9", "4", "5")
    assert tracks.types == ("car", "truck", "pedestrian", "other")
    assert tracks.world == World(None, (8500.0, -2000.0))
    np.testing.assert_allclose(tracks.times, np.arange(made.STEPS) / 10)
    np.testing.assert_allclose(tracks.states[0, 4], [4, 0, 0, 10])
    np.testing.assert_allclose(tracks.states[1, 10], [19, -10, 0, -1])
    assert np.flatnonzero(tracks.present[2]).tolist() == [3]
    np.testing.assert_allclose(tracks.sizes[0], [4.8, 2.1], rtol=1e-6)


def test_one_of_several_scenarios_is_chosen_by_its_id(tmp_path):
    path = write(tmp_path, *(made.make_scenario(name) for name in ("ab12", "cd34")))
    assert list_waymo_scenarios(path) == ("ab12", "cd34")
    assert len(read_tracks(path, scenario="cd34").ids) == 4
    with pytest.raises(TracksError, match=r"holds 2 scenarios: ab12, cd34; name one of them"):
        read_tracks(path)
    with pytest.raises(TracksError, match="'ef56' is none of them"):
        read_waymo(path, scenario="ef56")


def test_lights_stand_across_their_lanes(tmp_path):
    lights = read_waymo_lights(write(tmp_path))
    assert lights.names == ("31",)
    np.testing.assert_allclose(lights.lines, [[[10, -1.75], [10, 1.75]]])
    assert find_light_states(lights, np.array([0.0, 0.45, 0.5]))[:, 0].tolist() == [RED, RED, GREEN]
    assert lights.world == read_waymo(write(tmp_path)).world


def test_flashing_and_unseen_lights_are_unknown(tmp_path):
    flashing = made.make_scenario().replace(
        made.make_lights((31, made.GO)), made.make_lights((31, made.FLASHING_STOP))
    )
    states = read_waymo_lights(write(tmp_path, flashing)).states
    assert states[:, 0].tolist() == [RED] * 5 + [UNKNOWN] * 6
    unseen = made.make_scenario().replace(made.make_lights((31, made.GO)), made.make_lights())
    assert read_waymo_lights(write(tmp_path, unseen)).states[9, 0] == UNKNOWN


def test_lights_without_a_lane_are_left_out_with_a_warning(tmp_path):
    scenario = made.make_scenario()
    for state in (made.STOP, made.GO):
        scenario = scenario.replace(made.make_lights((31, state)), made.make_lights((77, state)))
    with pytest.warns(GeoaimWarning, match="1 signals are left out, whose lanes"):
        assert read_waymo_lights(write(tmp_path, scenario)) is None


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is empty"),
        (made.make_file(made.make_scenario())[:-9], "ends within record 1"),
        (made.make_file(b"\x0a\x02hi"), "is no Scenario: it has no times or no tracks"),
        (made.make_file(made.make_scenario(more=made.double(1, 9.0))), "11 states, and 12 are"),
        (made.make_file(made.make_scenario(more=made.double(1, 0.0))), "times do not increase"),
        (made.make_file(made.make_scenario(more=b"\x0b")), "unknown wire type 3"),
        (made.make_file(made.make_scenario(more=b"\x3a\x7f")), "ends 127 bytes after"),
    ],
)
def test_broken_file_is_refused_with_its_reason(tmp_path, content, message):
    path = tmp_path / "a.tfrecord"
    path.write_bytes(content)
    with pytest.raises(TracksError, match=message):
        read_tracks(path)


@pytest.mark.parametrize("place", [3, 10, 500, -2])
def test_flipped_bit_is_found_by_the_checksums(tmp_path, place):
    path = write(tmp_path)
    content = bytearray(path.read_bytes())
    content[place] ^= 4
    path.write_bytes(content)
    with pytest.raises(TracksError, match=r"checksum of record 1 does not match|ends within"):
        read_waymo(path)


@pytest.mark.parametrize("size", [0, 1, 511, 512, 513, 5000])
def test_checksum_is_that_of_its_definition(size):
    data = np.random.default_rng(size).bytes(size)
    register = 0xFFFFFFFF
    for byte in data:
        register ^= byte
        for _ in range(8):
            register = register >> 1 ^ (0x82F63B78 if register & 1 else 0)
    assert compute_crc32c(data) == register ^ 0xFFFFFFFF


def test_masked_checksum_is_that_of_tensorflow(tmp_path):
    """TensorFlow 2.12 writes these four bytes after the length of a record of one byte."""
    assert mask_checksum(compute_crc32c((1).to_bytes(8, "little"))) == 0x41DE7501
    path = write(tmp_path, b"hi", b"")
    assert list(read_records(path)) == [b"hi", b""]


def test_numbers_are_decoded_by_their_wire_types():
    fields = protobuf.parse_message(
        made.integer(1, -5) + made.single(2, 0.5) + made.double(3, 1.5) + made.message(4, b"hi")
    )
    assert protobuf.get_integer(fields, 1) == -5
    assert (protobuf.get_number(fields, 2), protobuf.get_number(fields, 3)) == (0.5, 1.5)
    assert (protobuf.get_text(fields, 4), protobuf.get_text(fields, 5)) == ("hi", "")
    doubles = made.message(1, made.double(9, 2.0)[1:], made.double(9, 3.0)[1:])
    assert protobuf.get_numbers(protobuf.parse_message(doubles), 1) == [2.0, 3.0]
    for get, number in (("integer", 2), ("number", 1), ("text", 1)):
        with pytest.raises(ValueError, match="field"):
            getattr(protobuf, f"get_{get}")(fields, number)
