"""Protocol-buffer messages, parsed from their bytes (protobuf.dev/programming-guides/encoding).

A message is parsed without its schema into values by the numbers of its fields. The functions
`get_...` decode a field by its type in the schema; an absent one is 0 or "".
"""

import struct

Value = int | bytes  # a varint, or the bytes of any other field
Fields = dict[int, list[Value]]  # all values of each field, by its number

VARINT, FIXED64, LENGTH, FIXED32 = 0, 1, 2, 5
MAX_VARINT_BYTES = 10


def parse_message(message: bytes) -> Fields:
    """Parse a message into the values of its fields; submessages stay bytes.

    Raises:
        ValueError: the bytes are no message, or it has groups, which are obsolete.

    >>> parse_message(bytes.fromhex("08960112026869"))
    {1: [150], 2: [b'hi']}
    """
    fields: Fields = {}
    position, end = 0, len(message)
    while position < end:
        key, position = _parse_varint(message, position)
        kind = key & 7
        value: Value
        if kind == VARINT:
            value, position = _parse_varint(message, position)
        else:
            if kind == LENGTH:
                length, position = _parse_varint(message, position)
            elif kind in (FIXED64, FIXED32):
                length = 8 if kind == FIXED64 else 4
            else:
                raise ValueError(f"field {key >> 3} has the unknown wire type {kind}")
            value = message[position : position + length]
            position += length
        if position > end:
            raise ValueError(f"field {key >> 3} ends {position - end} bytes after its message")
        fields.setdefault(key >> 3, []).append(value)
    return fields


def get_integer(fields: Fields, number: int) -> int:
    """Get an integer, a truth value or an enumerator; of several values the last one counts."""
    value = fields[number][-1] if number in fields else 0
    if not isinstance(value, int):
        raise ValueError(f"field {number} has {len(value)} bytes; an integer is needed")
    return value - (1 << 64) if value >> 63 else value


def get_number(fields: Fields, number: int) -> float:
    """Get a float or a double, by its length; of several values the last one counts."""
    return _unpack(fields[number][-1], number) if number in fields else 0.0


def get_numbers(fields: Fields, number: int) -> list[float]:
    """Get all doubles of a repeated field, packed or not."""
    numbers: list[float] = []
    for value in fields.get(number, []):
        if isinstance(value, bytes) and len(value) % 8 == 0:
            numbers += struct.unpack(f"<{len(value) // 8}d", value)
        else:
            raise ValueError(f"field {number} has no doubles")
    return numbers


def get_text(fields: Fields, number: int) -> str:
    """Get a text; of several values the last one counts."""
    value = fields[number][-1] if number in fields else b""
    if not isinstance(value, bytes):
        raise ValueError(f"field {number} is the integer {value}; a text is needed")
    return value.decode()


def get_messages(fields: Fields, number: int) -> list[Fields]:
    """Parse all submessages of a repeated field."""
    return [parse_message(value) for value in get_parts(fields, number)]


def get_parts(fields: Fields, number: int) -> list[bytes]:
    """Get the bytes of all submessages of a repeated field."""
    values = fields.get(number, [])
    parts = [value for value in values if isinstance(value, bytes)]
    if len(parts) < len(values):
        raise ValueError(f"field {number} is an integer; a message is needed")
    return parts


def _unpack(value: Value, number: int) -> float:
    if isinstance(value, int) or len(value) not in (4, 8):
        raise ValueError(f"field {number} is no float and no double")
    return float(struct.unpack("<f" if len(value) == 4 else "<d", value)[0])


def _parse_varint(message: bytes, position: int) -> tuple[int, int]:
    """The integer at a position, and the position after it."""
    value = 0
    for count, byte in enumerate(message[position : position + MAX_VARINT_BYTES]):
        value |= (byte & 0x7F) << 7 * count
        if byte < 0x80:
            return value & 0xFFFFFFFFFFFFFFFF, position + count + 1
    raise ValueError(f"there is no integer at byte {position} of a message")
