"""TFRecord files: records with checksums, read without TensorFlow.

A record is its length (8 bytes, little-endian), the masked CRC-32C of these, the data, and the
masked CRC-32C of the data (tensorflow.org/tutorials/load_data/tfrecord).
"""

import os
import struct
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
from jaxtyping import UInt32
from numpy import ndarray as Array

from geoaim.base.errors import TracksError
from geoaim.base.limits import check_memory, check_regular

POLYNOMIAL = 0x82F63B78  # polynomial of CRC-32C (Castagnoli), reflected
MASK_OFFSET = 0xA282EAD8
LANE = 512  # bytes of each of the parts whose checksums are computed side by side
MEMORY_PER_BYTE = 40  # memory for a byte of a record while it is parsed


def read_records(path: str | os.PathLike[str]) -> Iterator[bytes]:
    """Yield the records of a TFRecord file, each checked against its checksums.

    Raises:
        FileNotFoundError: there is no such file.
        TracksError: a checksum does not match, or the file ends within a record.
    """
    path = Path(path)
    check_regular(path, TracksError)
    size, number = os.path.getsize(path), 0
    with path.open("rb") as file:
        while header := file.read(12):
            number += 1
            _check(path, number, header[:8], header[8:])
            (length,) = struct.unpack("<Q", header[:8])
            if length + 4 > size - file.tell():
                raise TracksError(
                    f"{path} ends within record {number}, of {length} bytes; download it again"
                )
            check_memory(path, MEMORY_PER_BYTE * length, size, TracksError, f"{length} bytes")
            data = file.read(length)
            _check(path, number, data, file.read(4))
            yield data


def make_record(data: bytes) -> bytes:
    """Make the bytes of a record of a TFRecord file, with its checksums."""
    length = struct.pack("<Q", len(data))
    return b"".join(
        part + struct.pack("<I", mask_checksum(compute_crc32c(part))) for part in (length, data)
    )


def mask_checksum(checksum: int) -> int:
    """Mask a CRC-32C as TFRecord files do: rotated right by 15 bits, plus a constant."""
    return ((checksum >> 15 | checksum << 17) + MASK_OFFSET) & 0xFFFFFFFF


def compute_crc32c(data: bytes) -> int:
    """Compute the CRC-32C (RFC 3720, appendix B.4) of bytes.

    Parts of `LANE` bytes are computed side by side. A checksum is linear, so that the one of the
    whole is the sum of those of the parts, each shifted by the bytes that follow it.

    >>> hex(compute_crc32c(b"123456789"))
    '0xe3069283'
    """
    table = _make_table()
    if len(data) < LANE:
        register = 0xFFFFFFFF
        for byte in data:
            register = int(table[(register ^ byte) & 0xFF]) ^ register >> 8
        return register ^ 0xFFFFFFFF
    padding = -len(data) % LANE
    padded = np.zeros(padding + len(data), np.uint8)  # zeros ahead leave a register of 0 as it is
    padded[padding:] = np.frombuffer(data, np.uint8)
    padded[padding : padding + 4] ^= 0xFF  # stands for the initial register of ones
    registers = np.zeros(len(padded) // LANE, np.uint32)
    for column in padded.reshape(-1, LANE).T:
        registers = table[(registers ^ column) & 0xFF] ^ registers >> np.uint32(8)
    shift, whole, places = _make_lane_shift(), 0, np.arange(4)
    for part in registers.tolist():
        moved = shift[places, whole >> 8 * places & 0xFF]
        whole = int(np.bitwise_xor.reduce(moved)) ^ part
    return whole ^ 0xFFFFFFFF


def _check(path: Path, number: int, data: bytes, stated: bytes) -> None:
    expected = struct.pack("<I", mask_checksum(compute_crc32c(data)))
    if stated != expected:
        raise TracksError(
            f"{path}: the checksum of record {number} does not match; the file is damaged or no "
            "TFRecord file: download it again"
        )


@cache
def _make_table() -> UInt32[Array, "256"]:
    """The register after each byte, from a register of 0."""
    table = np.arange(256, dtype=np.uint32)
    for _ in range(8):
        table = np.where(table & 1, table >> 1 ^ np.uint32(POLYNOMIAL), table >> 1)
    return table.astype(np.uint32)


@cache
def _make_lane_shift() -> UInt32[Array, "4 256"]:
    """The registers after `LANE` bytes of 0, from each value of each byte of the register."""
    values = np.arange(256, dtype=np.uint32)
    registers = np.stack([values << np.uint32(8 * place) for place in range(4)])
    for _ in range(LANE):
        registers = _make_table()[registers & 0xFF] ^ registers >> np.uint32(8)
    return registers
