"""Seeded mutations of files: of bytes, of the fields of a text, of the structure of a format."""

import io
import json
import pickle
import re
import sqlite3
import struct
import tempfile
import warnings
import zlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from geoaim.base.checksums import PATTERN, PLACEHOLDER, write_checksum

Mutation = Callable[[bytes, np.random.Generator], bytes]

NUMBERS = [0, 1, 2, 127, 255, 256, 0x7FFF, 0xFFFF, 60_000, 100_000, 0x7FFFFFFF, 0xFFFFFFFF, 2**63]
FIELDS = [
    *("", "0", "-1", "1e308", "-1e308", "1e-320", "nan", "inf", "-inf", "NaN", "null", "true"),
    *("12345678901234567890", "9" * 310, "54,7006", "1_000", "0x10", "1e9", "-9e15", "12:00"),
    *('"', "'", "<", ">", "&", "{", "]", "\\", "\0", "\ufeff", "\u00b2", "\U0001f4a5", "[/b]"),
    *("A" * 100_000, "../../x", "NA", " ", "\t", "\n", "\r", "2" * 40, "é", "٣"),
]
VALUES: list[Any] = [None, True, 0, -1, 2**70, 1e308, float("nan"), "", "x", [], {}, [[]], [1, "a"]]
XML_PARTS = [
    *(b'<?xml version="1.0" encoding="klingon"?>', b"<!DOCTYPE a []>", b"<tag/>", b"<a>" * 20_000),
    *(b"<node/>", b'<way id="1"><nd ref="1"/></way>', b"</osm>", b"&x;", b"<relation/>"),
]


def mutate_bytes(content: bytes, generator: np.random.Generator) -> bytes:
    """Flip, overwrite, remove, repeat or cut off bytes, at one to eight places."""
    changed = bytearray(content)
    for _ in range(generator.integers(1, 9)):
        start = int(generator.integers(len(changed) + 1))
        if generator.random() < 0.5:  # headers are at the ends of a file
            start = min(start, int(generator.integers(512)))
        elif generator.random() < 0.3:
            start = max(start, len(changed) - int(generator.integers(512)))
        length = int(2 ** generator.uniform(0, 10))
        end = start + length
        match generator.integers(7):
            case 0 if start < len(changed):
                changed[start] ^= 1 << int(generator.integers(8))
            case 1:
                changed[start:end] = generator.bytes(len(changed[start:end]))
            case 2:
                changed[start:end] = bytes(len(changed[start:end]))
            case 3:
                del changed[start:end]
            case 4:
                changed[start:start] = changed[start:end]
            case 5:
                _write_number(changed, start, generator)
            case 6 if generator.random() < 0.2:
                del changed[start:]
    return bytes(changed)


def mutate_fields(content: bytes, generator: np.random.Generator) -> bytes:
    """Replace one to four numbers or words of a text."""
    text = content.decode("utf-8", errors="replace")
    pattern = r"[-+]?\d[\d.e+-]*" if generator.random() < 0.7 else r"[\w.+-]+"
    for _ in range(generator.integers(1, 5)):
        places = list(re.finditer(pattern, text))
        if places:
            place = places[_choose_index(len(places), generator)]
            text = text[: place.start()] + _choose(FIELDS, generator) + text[place.end() :]
    return text.encode("utf-8", errors="replace")


def mutate_lines(content: bytes, generator: np.random.Generator) -> bytes:
    """Remove, repeat, swap, join or cut lines; exchange separators, columns or the encoding."""
    lines = content.split(b"\n")
    index, other = (_choose_index(len(lines), generator) for _ in range(2))
    match generator.integers(12):
        case 0:
            del lines[index]
        case 1:
            lines.insert(other, lines[index])
        case 2:
            lines[index], lines[other] = lines[other], lines[index]
        case 3:
            lines[index] = lines[index][: len(lines[index]) // 2]
        case 4:
            lines[index] += lines[other]
        case 5:
            separators = [b",", b";", b"\t", b" ", b":", b"\r\n", b""]
            old, new = (_choose(separators[:6], generator), _choose(separators, generator))
            return content.replace(old, new)
        case 6:
            codec = _choose(["utf-16", "utf-8-sig", "utf-32", "cp037"], generator)
            return content.decode("utf-8", errors="replace").encode(codec, errors="replace")
        case 7:
            return b"" if generator.random() < 0.1 else b"\n".join(lines[: min(index, 3)])
        case 8:
            column = int(generator.integers(12))
            return b"\n".join(_move_column(line, column, None) for line in lines)
        case 9:
            column, target = (int(n) for n in generator.integers(12, size=2))
            return b"\n".join(_move_column(line, column, target) for line in lines)
        case 10:
            return content.replace(b"\n", b"\r")
        case 11:
            lines[index:index] = lines[index : index + 1] * 2000
    return b"\n".join(lines)


def mutate_json(content: bytes, generator: np.random.Generator) -> bytes:
    """Replace, remove, repeat or nest a value of JSON."""
    try:
        root = [json.loads(content)]
    except ValueError:
        return mutate_bytes(content, generator)
    if generator.random() < 0.02:
        return b"[" * 100_000 if generator.random() < 0.5 else b'{"features":' * 50_000
    for _ in range(generator.integers(1, 4)):
        _replace_value(root, generator)
    return json.dumps(root[0]).encode()


def mutate_xml(content: bytes, generator: np.random.Generator) -> bytes:
    """Insert a declaration or an element, or remove one."""
    places = [match.start() for match in re.finditer(b"<", content)]
    start = _choose(places, generator) if generator.random() < 0.8 else 0
    end = content.find(b">", start) + 1 if generator.random() < 0.5 else start
    return content[:start] + _choose([*XML_PARTS, b""], generator) + content[end:]


def mutate_numbers(content: bytes, generator: np.random.Generator) -> bytes:
    """Overwrite one to three binary numbers, most of them near the beginning or the end."""
    changed = bytearray(content)
    for _ in range(generator.integers(1, 4)):
        near = int(min(len(content) - 1, 2 ** generator.uniform(0, 11)))
        start = near if generator.random() < 0.7 else len(content) - near
        _write_number(changed, start & ~1, generator)
    return bytes(changed)


def mutate_chunks(content: bytes, generator: np.random.Generator) -> bytes:
    """Overwrite numbers of a PNG's chunks with valid checksums; remove or repeat chunks."""
    chunks, start = [], 8
    while start + 12 <= len(content):
        (length,) = struct.unpack(">I", content[start : start + 4])
        chunks.append((content[start + 4 : start + 8], content[start + 8 : start + 8 + length]))
        start += 12 + length
    index = _choose_index(len(chunks), generator)
    kind, data = chunks[index]
    match generator.integers(4):
        case 0:
            del chunks[index]
        case 1:
            chunks.insert(index, chunks[index])
        case _:
            changed = bytearray(data)
            _write_number(changed, int(generator.integers(9)), generator)
            chunks[index] = kind, bytes(changed)
    parts = (
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks
    )
    return content[:8] + b"".join(parts)


def mutate_gzipped(content: bytes, generator: np.random.Generator) -> bytes:
    """Mutate what is gzipped."""
    import gzip

    inner = gzip.decompress(content)
    mutate = _choose([mutate_fields, mutate_lines], generator)
    return gzip.compress(mutate(inner, generator), 1)


def mutate_geotiff_tags(content: bytes, generator: np.random.Generator) -> bytes:
    """Mutate the JSON in a GeoTIFF's tags, or its transform."""
    import rasterio
    from rasterio.io import MemoryFile

    with warnings.catch_warnings(), MemoryFile(content) as memory:
        warnings.simplefilter("ignore")
        with memory.open() as dataset:
            profile, tags, pixels = dataset.profile, dataset.tags(), dataset.read()
            descriptions = dataset.descriptions
        for name in [name for name in tags if name in ("GEOAIM", "GEOAIM_REPORT")]:
            if generator.random() < 0.7:
                changed = mutate_json(tags[name].encode(), generator)
                tags[name] = changed.decode().replace("\0", "") if len(changed) < 10**6 else "[" * 9
        if generator.random() < 0.3:
            numbers = list(profile["transform"][:6])
            numbers[int(generator.integers(6))] = _choose([0, 1e308, -1e30, 1e-300], generator)
            profile["transform"] = rasterio.Affine(*numbers)
        if generator.random() < 0.2:
            profile["count"] = int(generator.integers(1, 7))
            pixels, descriptions = pixels[: profile["count"]], descriptions[: profile["count"]]
        profile.pop("photometric", None)
        with MemoryFile() as new:
            with new.open(**{**profile, "driver": "GTiff"}) as dataset:
                dataset.write(pixels)
                dataset.descriptions = descriptions
                dataset.update_tags(**tags)
            return bytes(new.read())


def mutate_parquet(content: bytes, generator: np.random.Generator) -> bytes:
    """Mutate the metadata, a column's type or its values."""
    import pyarrow
    from pyarrow import parquet

    table = parquet.read_table(io.BytesIO(content))
    metadata = dict(table.schema.metadata)
    name = _choose(table.column_names, generator)
    index = table.column_names.index(name)
    match generator.integers(4):
        case 0:
            key = _choose(sorted(metadata), generator)
            metadata[key] = mutate_json(metadata[key], generator)
        case 1:
            table = table.drop_columns([name])
        case 2:
            other = _choose([[None], ["x"], [[1]], [True], [b"\xff"], [2**62]], generator)
            table = table.set_column(index, name, pyarrow.array(other * len(table)))
        case 3:
            values = table[name].to_pylist()
            special = [None, *((-1.0, 1e308, float("nan"), 0.0) if index > 1 else ("", "x"))]
            values[_choose_index(len(values), generator)] = _choose(special, generator)
            table = table.set_column(index, name, pyarrow.array(values))
    sink = io.BytesIO()
    parquet.write_table(table.replace_schema_metadata(metadata), sink)
    return sink.getvalue()


def mutate_pickle(content: bytes, generator: np.random.Generator) -> bytes:
    """Mutate values of a pickle, or the numbers, shape or type of one of its arrays."""
    root = [pickle.loads(content)]
    for _ in range(generator.integers(1, 4)):
        if generator.random() < 0.5:
            _replace_value(root, generator)
            continue
        arrays = list(_list_arrays(root[0]))
        node, key = _choose(arrays, generator)
        array = np.array(node[key])
        special = _choose([float("nan"), float("inf"), 1e300, -1e12, 0.0], generator)
        changed = array.astype(np.float64).ravel()
        changed[int(generator.integers(len(changed)))] = special
        others = [changed.reshape(array.shape), array[:-1], array[None], array.astype(str)]
        node[key] = _choose([*others, array.astype(object), array * 0, array.T], generator)
    return pickle.dumps(root[0], int(generator.integers(3, 6)))


def _list_arrays(node: Any) -> Iterator[tuple[Any, Any]]:
    """The places of all arrays in nested dicts."""
    for key, value in node.items() if isinstance(node, dict) else ():
        if isinstance(value, np.ndarray) and value.size:
            yield node, key
        yield from _list_arrays(value)


def mutate_state(content: bytes, generator: np.random.Generator) -> bytes:
    """Mutate a value or a tensor of a file of torch."""
    import torch

    state = torch.load(io.BytesIO(content), weights_only=True)
    parts: list[tuple[Any, Any]] = []

    def collect(node: Any) -> None:
        for key in node if isinstance(node, dict) else range(len(node)):
            parts.append((node, key))
            if isinstance(node[key], dict | list):
                collect(node[key])

    collect(state)
    for _ in range(generator.integers(1, 4)):
        node, key = _choose(parts, generator)
        value = node.get(key) if isinstance(node, dict) else node[key]
        if isinstance(value, torch.Tensor) and generator.random() < 0.8:
            special = [
                value * float("nan"),
                value[:0],
                value.double(),
                value.flatten(),
                value[None],
            ]
            node[key] = _choose(special, generator) if value.ndim else torch.tensor(float("inf"))
        elif generator.random() < 0.2 and isinstance(node, dict):
            node.pop(key, None)
        else:
            node[key] = _choose(VALUES, generator)
    sink = io.BytesIO()
    torch.save(state, sink)
    return sink.getvalue() + PLACEHOLDER.encode()


def mutate_mbtiles(content: bytes, generator: np.random.Generator) -> bytes:
    """Mutate metadata, tile numbers or tiles of an MBTiles database."""
    connection = sqlite3.connect(":memory:")
    connection.deserialize(content)
    for _ in range(generator.integers(1, 4)):
        if generator.random() < 0.5:
            name, value = _choose(
                connection.execute("SELECT name, value FROM metadata").fetchall(), generator
            )
            changed = mutate_fields(str(value).encode(), generator).decode(errors="replace")
            connection.execute("UPDATE metadata SET value=? WHERE name=?", (changed, name))
        else:
            row, data = _choose(
                connection.execute("SELECT rowid, tile_data FROM tiles").fetchall(), generator
            )
            column = _choose(["zoom_level", "tile_column", "tile_row", "tile_data"], generator)
            number = _choose([*NUMBERS[:12], -1, None, "x"], generator)
            value = mutate_bytes(data or b"", generator) if column == "tile_data" else number
            connection.execute(f"UPDATE tiles SET {column}=? WHERE rowid=?", (value, row))
    connection.commit()
    return connection.serialize()


def mutate_geopackage(content: bytes, generator: np.random.Generator) -> bytes:
    """Mutate values, geometries and tables of a GeoPackage."""
    connection = sqlite3.connect(":memory:")
    connection.deserialize(content)
    tables = ["states", "states", "gpkg_contents", "gpkg_spatial_ref_sys"]
    for _ in range(generator.integers(1, 4)):
        table = _choose(tables, generator)
        rows = connection.execute(f"SELECT rowid, * FROM {table}").fetchall()
        names = [row[1] for row in connection.execute(f"PRAGMA table_info({table})")]
        column, row = int(generator.integers(len(names))), _choose(rows, generator)
        value = row[column + 1]
        if isinstance(value, bytes):
            value = mutate_numbers(value, generator)
        else:
            value = _choose([*FIELDS[:20], None, -1, 2**62, 1e300, value, b"GP"], generator)
        with suppress(sqlite3.IntegrityError):
            connection.execute(
                f"UPDATE {table} SET {names[column]} = ? WHERE rowid = ?", (value, row[0])
            )
    if generator.random() < 0.1:
        connection.execute(f"DROP TABLE {_choose(tables, generator)}")
    connection.commit()
    return connection.serialize()


def _choose(options: Any, generator: np.random.Generator) -> Any:
    return options[int(generator.integers(len(options)))]


def _choose_index(count: int, generator: np.random.Generator) -> int:
    """Indices near the beginning, where headers are, are chosen more often."""
    return int(count * generator.random() ** _choose([1, 4], generator))


def _write_number(changed: bytearray, start: int, generator: np.random.Generator) -> None:
    code = _choose("BHIQ", generator)
    number = _choose(NUMBERS, generator) % 256 ** struct.calcsize(code)
    packed = struct.pack(_choose("<>", generator) + code, number)
    changed[start : start + len(packed)] = packed


def _move_column(line: bytes, column: int, target: int | None) -> bytes:
    fields = line.split(b",")
    if column < len(fields):
        field = fields.pop(column)
        if target is not None:
            fields.insert(target, field)
    return b",".join(fields)


def _replace_value(root: list[Any], generator: np.random.Generator) -> None:
    """Replace a value somewhere below a list; values near the root are chosen more often."""
    node: Any = root
    while True:
        keys = list(node) if isinstance(node, dict) else list(range(len(node)))
        key = _choose(keys, generator) if keys else None
        if key is None:
            return
        if isinstance(node[key], dict | list) and node[key] and generator.random() < 0.8:
            node = node[key]
            continue
        match generator.integers(5):
            case 0 if node is not root:
                del node[key]
            case 1:
                node[key] = [node[key]]
            case 2:
                node[key] = {"type": node[key]}
            case 3 if isinstance(node[key], list):
                node[key] = node[key] * 2
            case _:
                node[key] = _choose(VALUES, generator)
        return


def mutate_file(path: Path, mutations: tuple[Mutation, ...], seed: tuple[int, int]) -> bytes:
    """Mutate a file's content by one of the mutations; a quarter are of plain bytes.

    Where a library refuses to write what was mutated, the bytes are mutated instead.
    """
    generator = np.random.default_rng(seed)
    content = path.read_bytes()
    mutate = mutate_bytes if generator.random() < 0.25 else _choose(mutations, generator)
    try:
        changed = mutate(content, generator)
    except Exception:
        changed = mutate_bytes(content, generator)
    return _renew_checksum(changed) if generator.random() < 0.7 else changed


def _renew_checksum(content: bytes) -> bytes:
    """Give a file of ours a checksum that matches what was mutated, as its author could."""
    content = PATTERN.sub(PLACEHOLDER.encode(), content)
    if PLACEHOLDER.encode() not in content:
        return content
    with tempfile.NamedTemporaryFile() as file:
        file.write(content)
        file.flush()
        write_checksum(Path(file.name))
        return Path(file.name).read_bytes()
