"""Waymo scenarios made by hand, byte by byte, by the published scenario.proto and map.proto."""

import struct

from geoaim.tracks.formats.tfrecord import make_record

STEPS = 11
STOP, GO, FLASHING_STOP = 4, 6, 7


def encode_varint(value: int) -> bytes:
    value, parts = value % 2**64, []
    while value > 0x7F:
        parts.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*parts, value])


def integer(number: int, value: int) -> bytes:
    return encode_varint(number << 3) + encode_varint(value)


def double(number: int, value: float) -> bytes:
    return encode_varint(number << 3 | 1) + struct.pack("<d", value)


def single(number: int, value: float) -> bytes:
    return encode_varint(number << 3 | 5) + struct.pack("<f", value)


def message(number: int, *parts: bytes) -> bytes:
    content = b"".join(parts)
    return encode_varint(number << 3 | 2) + encode_varint(len(content)) + content


def make_state(x: float, y: float, size: tuple[float, float], vx: float = 0.0) -> bytes:
    numbers = (double(2, x), double(3, y), double(4, 30.0), single(5, size[0]), single(6, size[1]))
    return message(3, *numbers, single(7, 1.5), single(8, 0.0), single(9, vx), integer(11, 1))


def make_track(number: int, kind: int, states: list[bytes]) -> bytes:
    return message(2, integer(1, number), integer(2, kind), *states)


def make_point(number: int, x: float, y: float) -> bytes:
    return message(number, double(1, x), double(2, y), double(3, 30.0))


def make_lights(*signals: tuple[int, int]) -> bytes:
    """Lane and state of each signal of a step; the stop point is at (8510, -2000)."""
    return message(
        7,
        *(
            message(1, integer(1, lane), integer(2, state), make_point(3, 8510, -2000))
            for lane, state in signals
        ),
    )


def make_scenario(name: str = "ab12", more: bytes = b"") -> bytes:
    """A car at 10 m/s east, a long vehicle in reverse, a pedestrian in step 3, and an object.

    The map has a lane to the east, with a light that turns from red to green in step 5.
    """
    absent = message(3, integer(11, 0))
    times = [double(1, k / 10) for k in range(STEPS)]
    moving = [make_state(8500 + k, -2000, (4.8, 2.1), 10.0) for k in range(STEPS)]
    reversing = [make_state(8520 - k / 10, -2010, (12.0, 2.6), -1.0) for k in range(STEPS)]
    once = [make_state(8490, -1990, (0.9, 0.8)) if k == 3 else absent for k in range(STEPS)]
    still = [make_state(8480, -1990, (1.0, 1.0)) for _ in range(STEPS)]
    tracks = [
        make_track(*track)
        for track in ((7, 1, moving), (9, 1, reversing), (4, 2, once), (5, 4, still))
    ]
    lane = message(3, integer(2, 2), *(make_point(8, 8500 + 5 * k, -2000) for k in range(5)))
    edge = message(5, integer(1, 1), *(make_point(2, 8500 + 5 * k, -2002) for k in range(5)))
    features = message(8, integer(1, 31), lane) + message(8, integer(1, 32), edge)
    lights = [make_lights((31, STOP if k < 5 else GO)) for k in range(STEPS)]
    parts = (*times, *tracks, message(5, name.encode()), integer(6, 0), *lights, features, more)
    return b"".join(parts)


def make_file(*scenarios: bytes) -> bytes:
    return b"".join(map(make_record, scenarios))
