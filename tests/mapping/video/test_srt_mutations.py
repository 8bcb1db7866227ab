"""Damaged .SRT files are refused, or what is read from them is plausible."""

from pathlib import Path

import numpy as np
import pytest

from geoaim.base.errors import GeoreferenceError
from geoaim.mapping.video.srt import read_srt

MUTATIONS = 250  # of each of the eight dialects
DIALECTS = sorted((Path(__file__).parent / "srt").glob("*.SRT"))


def replace_decimal_points(text: str, generator: np.random.Generator) -> str:
    points = [index for index in range(1, len(text)) if text[index] == "."]
    if generator.random() < 0.5:
        return text.replace(".", ",")
    index = points[generator.integers(len(points))]
    return f"{text[:index]},{text[index + 1 :]}"


def change_characters(text: str, generator: np.random.Generator) -> str:
    letters = list(text)
    for index in generator.integers(len(letters), size=generator.integers(1, 4)):
        kind = generator.integers(3)
        letter = chr(generator.integers(32, 127))
        letters[index] = ["", letter, letters[index] + letter][kind]
    return "".join(letters)


def change_digit(text: str, generator: np.random.Generator) -> str:
    digits = [index for index, letter in enumerate(text) if letter.isdigit()]
    index = digits[generator.integers(len(digits))]
    return f"{text[:index]}{generator.integers(10)}{text[index + 1 :]}"


def move_line(text: str, generator: np.random.Generator) -> str:
    lines = text.splitlines(keepends=True)
    line = lines.pop(generator.integers(len(lines)))
    lines.insert(generator.integers(len(lines) + 1), line)
    return "".join(lines)


def cut(text: str, generator: np.random.Generator) -> str:
    start, end = np.sort(generator.integers(len(text), size=2))
    return text[:start] + text[end:]


MUTATORS = (replace_decimal_points, change_characters, change_digit, move_line, cut)


@pytest.mark.parametrize("path", DIALECTS, ids=lambda path: path.stem)
def test_mutations_do_not_move_the_camera(path: Path, tmp_path: Path) -> None:
    generator = np.random.default_rng(23)
    text, moved = path.read_bytes().decode(), []
    for number in range(MUTATIONS):
        damaged = MUTATORS[number % len(MUTATORS)](text, generator)
        (tmp_path / "a.SRT").write_bytes(damaged.encode())
        try:
            found = read_srt(tmp_path / "a.SRT")
        except GeoreferenceError:
            continue
        north, east = found.latitude - 54.6872, (found.longitude - 25.2797) * np.cos(0.9545)
        shift = 111_320 * np.nanmax(np.hypot(north, east))
        plausible = (
            shift < 220  # in up to three seconds
            and np.nanmax(np.abs(found.height - 60), initial=0) < 100
            and np.nanmax(np.abs(found.focal_length / 24 - 1), initial=0) < 0.6
        )
        if not plausible:
            moved.append((number, damaged))
    assert not moved, f"{len(moved)} of {MUTATIONS}, such as {moved[0]}"
