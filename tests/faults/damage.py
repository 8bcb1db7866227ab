"""Flip single bits of geoaim's own files, and count what is accepted.

    python -m tests.faults.damage -o docs/bench/damage.json

CSV tracks are text that people edit: they have no checksum, and stand here for comparison.
"""

import argparse
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.results import write_json
from geoaim.aim.files import read_aim
from geoaim.base.checksums import MARK, PLACEHOLDER
from geoaim.base.errors import GeoaimError
from geoaim.prediction.checkpoints import read_model, read_state
from geoaim.tracks.files import read_plain_tracks

FORMATS = Path(__file__).parents[1] / "formats"  # tiny files as each version wrote them
FLIPS = 10_000
CHECKED = {
    "aim-3.tif": read_aim,
    "model-3.pt": read_model,
    "checkpoint-3.pt": read_state,
    "tracks-2.parquet": read_plain_tracks,
}


def flip_bits(
    source: Path, read: Callable[[Path], object], folder: Path
) -> tuple[list[int], list[str]]:
    """Flip `FLIPS` bits one at a time, all those of the checksum among them.

    Args:
        source: the file; a copy of it is changed.
        read: reads it.
        folder: of the copy.

    Returns:
        The bits without which the file was accepted, and the errors that do not name it.
    """
    path = Path(shutil.copy(source, folder))
    whole = path.read_bytes()
    bits = np.random.default_rng(23).integers(8 * len(whole), size=FLIPS)
    if MARK in whole:
        inside = 8 * whole.index(MARK) + np.arange(8 * len(PLACEHOLDER))
        bits[: len(inside)] = inside
    accepted, unnamed = [], []
    with path.open("r+b", buffering=0) as file:
        for bit in bits.tolist():
            file.seek(bit // 8)
            file.write(bytes([whole[bit // 8] ^ (1 << bit % 8)]))
            try:
                read(path)
                accepted.append(bit)
            except GeoaimError as error:
                unnamed += [] if path.name in str(error) else [str(error)]
            file.seek(bit // 8)
            file.write(whole[bit // 8 : bit // 8 + 1])
    read(path)  # whole again
    return accepted, unnamed


def main() -> None:
    """Count the accepted flips of each format."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True, help="JSON to write")
    arguments = parser.parse_args()
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for name, read in {**CHECKED, "tracks-1.csv": read_plain_tracks}.items():
            accepted, unnamed = flip_bits(FORMATS / name, read, Path(folder))
            counts = {"flipped": FLIPS, "accepted": len(accepted), "not_named": len(unnamed)}
            rows.append({"format": name, "bytes": (FORMATS / name).stat().st_size, **counts})
            print(rows[-1], flush=True)
    command = "python -m tests.faults.damage -o docs/bench/damage.json"
    write_json({"command": command, "rows": rows}, arguments.output)


if __name__ == "__main__":
    main()
