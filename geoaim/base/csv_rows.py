"""Rows of CSV tables that users write by hand: cells by the names of their columns."""

import codecs
import csv
import math
from collections.abc import Iterable

BYTE_ORDER_MARKS = {codecs.BOM_UTF8: "utf-8", codecs.BOM_UTF16_LE: "utf-16-le"} | {
    codecs.BOM_UTF16_BE: "utf-16-be"
}


def decode_text(content: bytes) -> str:
    """Decode the text of a table: UTF-8, or what its byte order mark says.

    Raises:
        ValueError: it is no such text.

    >>> decode_text("u,v".encode("utf-16"))
    'u,v'
    """
    mark = next((mark for mark in BYTE_ORDER_MARKS if content.startswith(mark)), b"")
    try:
        return content[len(mark) :].decode(BYTE_ORDER_MARKS.get(mark, "utf-8"))
    except UnicodeDecodeError as error:
        raise ValueError(f"it is no text in UTF-8 ({error}); save it as UTF-8") from error


def trim_comment(line: str) -> str:
    """Remove what a spreadsheet adds to a comment line: separators at its end, and quotes.

    >>> trim_comment('"# crs: EPSG:32635",,,,')
    '# crs: EPSG:32635'
    """
    return line.strip().rstrip(",;\t ").strip('"').rstrip(",;\t ")


def read_rows(lines: Iterable[str]) -> tuple[list[str], list[tuple[int, dict[str, str]]]]:
    """Read a CSV table: the names of its columns, and the line number and cells of each row.

    Commas at the end of a line are no cells, and empty lines no rows.

    Raises:
        ValueError: there is no header, or a line has more cells than it.
        csv.Error: the lines are not CSV.

    >>> read_rows(["name,video,", " north ,a.mp4,", ",b.mp4"])
    (['name', 'video'], [(2, {'name': 'north', 'video': 'a.mp4'}), (3, {'video': 'b.mp4'})])
    """
    reader = csv.reader(lines, skipinitialspace=True, strict=True)
    header = [name.strip() for name in next(reader, [])]
    while header and not header[-1]:
        header.pop()
    if not header:
        raise ValueError("its first line names no columns")
    rows = []
    for row in reader:
        texts = [text.strip() for text in row]
        if any(texts[len(header) :]):
            raise ValueError(
                f"line {reader.line_num} has {len(texts)} cells for {len(header)} columns; quote "
                "cells that have commas"
            )
        if any(texts):
            cells = zip(header, texts, strict=False)
            rows.append((reader.line_num, {name: text for name, text in cells if text}))
    return header, rows


def parse_number(column: str, text: str) -> float:
    """Parse a cell that holds a finite number.

    Raises:
        ValueError: it holds none.
    """
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise ValueError(f"{column} is {text!r}; a finite number is needed")
    return number
