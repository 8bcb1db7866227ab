"""Checksums and versions in geoaim's own files.

A file is written with `PLACEHOLDER` in its metadata or at its end. `write_checksum` fills in four
fields: the file's size, a CRC-32 of that number, a CRC-32 of the file's first part, and the SHA-256
of the file with zeros in this field. The first three tell a file that another program rewrote from
a damaged one.
"""

import hashlib
import mmap as maps
import os
import re
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from mmap import ACCESS_READ, PAGESIZE, mmap
from pathlib import Path

from geoaim.base.errors import GeoaimError, warn
from geoaim.base.limits import check_regular

MARK = b"geoaim-sha256:"
ZEROS = b"0" * 64
PART_BYTES = 2**24
PLACEHOLDER = f"{MARK.decode()}{0:012d}:{0:08x}:{0:08x}:{0:064x}"
PATTERN = re.compile(MARK + rb"(\d{12}):([0-9a-f]{8}):([0-9a-f]{8}):([0-9a-f]{64})")


@dataclass(frozen=True)
class FileFormat:
    """A file format of geoaim, with the versions that can be read."""

    name: str  # what messages call it
    oldest: int  # version of the oldest files that are read
    newest: int  # version of the files that are written
    first_checked: int  # version since which files have a checksum
    error: type[GeoaimError]  # raised for a file that is damaged or of another version
    editable: bool = False  # whether a file that another program rewrote is accepted


def write_checksum(path: Path) -> None:
    """Replace the `PLACEHOLDER` that a complete file contains, once, by its checksum."""
    with path.open("r+b") as file, mmap(file.fileno(), 0) as data:
        start = data.rfind(PLACEHOLDER.encode())  # most often in the last part
        size = b"%012d" % len(data)
        head = (
            MARK + size + b":%08x:%08x:" % (zlib.crc32(size), _crc_of_start(data, start, len(data)))
        )
        data[start : start + len(head)] = head
        start += len(head)
        data[start : start + len(ZEROS)] = _hash(data, start)


def verify_checksum(path: str | os.PathLike[str], file_format: FileFormat) -> bool:
    """Verify the checksum of a file; return False if it has none.

    Raises:
        GeoaimError: the checksum does not match; the type is `file_format.error`. In an editable
            format, a file that another program rewrote is accepted.
    """
    check_regular(path, file_format.error)
    if os.path.getsize(path) == 0:
        return False
    with open(path, "rb") as file, mmap(file.fileno(), 0, access=ACCESS_READ) as data:
        start = data.find(MARK)
        if start < 0:
            return False
        found = PATTERN.match(data, start)
        intact = edited = False
        if found and int(found[2], 16) == zlib.crc32(found[1]):
            size = int(found[1])
            same_start = int(found[3], 16) == _crc_of_start(data, start, size)
            edited = size != len(data) and not same_start
            intact = found[4] == _hash(data, found.start(4))
        del found  # a match would keep the file mapped
    if not (intact or (edited and file_format.editable)):
        raise file_format.error(
            f"{path} is damaged, or another program changed it: its contents do not match the "
            "checksum that was written with them; make it again, or take it from a backup"
        )
    return True


def check_version(
    path: str | os.PathLike[str], stated: object, file_format: FileFormat, *, has_checksum: bool
) -> None:
    """Check a file's version; warn of one that is older than checksums.

    Raises:
        GeoaimError: this version cannot be read, or its files have checksums and this one has none.
    """
    name, oldest, newest = file_format.name, file_format.oldest, file_format.newest
    if not isinstance(stated, int) or not oldest <= stated <= newest:
        known = f"{newest}" if oldest == newest else f"{oldest} to {newest}"
        by = " (of a map by `geoaim build`)" if name == "AIM" else ""
        raise file_format.error(
            f"{path} has {name} format {stated}; this version reads {known}: make it again with "
            f"this version{by}, or read it with a later one"
        )
    if has_checksum:
        return
    if stated >= file_format.first_checked:
        raise file_format.error(
            f"{path} is damaged: it has no checksum, which {name} format {stated} has; make it "
            "again, or take it from a backup"
        )
    warn(
        f"{path} is of an earlier version ({name} format {stated}) and has no checksum, so that "
        "damage to it would go unseen; read it and write it again"
    )


def _crc_of_start(data: mmap, start: int, size: int) -> int:
    """CRC-32 of what comes before the checksum and of an eighth of what follows it."""
    after = start + len(PLACEHOLDER)
    crc = 0
    for begin, end in ((0, start), (after, min(after + (size - start) // 8, len(data)))):
        for part in _read_parts(data, begin, end):
            crc = zlib.crc32(part, crc)
    return crc


def _hash(data: mmap, start: int) -> bytes:
    """SHA-256 of a file as if its checksum, from `start` on, were zeros."""
    digest = hashlib.sha256()
    for part in _read_parts(data, 0, start):
        digest.update(part)
    digest.update(ZEROS)
    for part in _read_parts(data, start + len(ZEROS), len(data)):
        digest.update(part)
    return digest.hexdigest().encode()


def _read_parts(data: mmap, begin: int, end: int) -> Iterator[bytes]:
    """Read a part of a file piece by piece; what was read leaves the memory of this process."""
    for start in range(begin, end, PART_BYTES):
        stop = min(start + PART_BYTES, end)
        yield data[start:stop]
        if hasattr(data, "madvise"):  # not on Windows
            page = start - start % PAGESIZE
            data.madvise(maps.MADV_DONTNEED, page, stop - page)
