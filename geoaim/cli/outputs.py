"""Check output paths before the work, so that no result is lost and no input replaced."""

import glob
import os
from collections.abc import Iterable, Sequence
from pathlib import Path

from geoaim.base.files import (
    FILM_FILE,
    LOOK_FILE,
    MAP_FILE,
    REPORT_FILE,
    TRACKS_FILE,
    check_writable,
)

GEOTIFF = (".tif", ".tiff")
TRACKS = (".csv", ".parquet")


def check_output(
    output: Path, suffixes: tuple[str, ...] = (), inputs: Iterable[Path | None] = ()
) -> None:
    """Refuse an output with another suffix, in an unwritable folder, or that is also an input."""
    if suffixes and output.suffix.lower() not in suffixes:
        raise ValueError(f"{output}: give a name that ends in {' or '.join(suffixes)}")
    if output.resolve() in _resolve(inputs):
        raise ValueError(f"{output} is also an input; give another name")
    if output.exists() and is_of_folder(output):
        raise ValueError(
            f"{output} belongs to a folder of geoaim place, whose files are of one run; give "
            "another name, or place the video anew"
        )
    if output.is_dir():
        raise ValueError(f"{output} is a folder; the name of a file is needed")
    check_writable(output)


def is_of_folder(path: Path) -> bool:
    """Whether a file is one of those that `geoaim place` writes together into a folder."""
    folder, written = path.parent, (MAP_FILE, TRACKS_FILE, LOOK_FILE, FILM_FILE, REPORT_FILE)
    has_both = (folder / MAP_FILE).is_file() and (folder / REPORT_FILE).is_file()
    return has_both and path.name in written


def check_map_output(
    output: Path, sources: Iterable[str], inputs: Sequence[Path | None], *, recursive: bool = False
) -> Path:
    """Check the output of a map and the .png beside it."""
    pattern = f"{'**/' if recursive else ''}{glob.escape(output.stem)}.*"
    read = [*inputs, *(path for source in sources for path in _list_files(source, pattern))]
    check_output(output, GEOTIFF, read)
    look = output.with_suffix(".png")
    if look.resolve() in _resolve(read):
        raise ValueError(
            f"the quick look beside {output} would replace the input {look}; give another output"
        )
    check_output(look)
    return look


def _resolve(paths: Iterable[Path | None]) -> list[Path]:
    return [path.resolve() for path in paths if path is not None]


def _list_files(source: str, pattern: str) -> list[Path]:
    """List the files of a source: itself, what it matches as a pattern, or a folder's matches."""
    path = Path(source)
    if os.path.isdir(source):  # False of a name that is too long
        return list(path.glob(pattern))
    return [path, *map(Path, glob.glob(source, recursive=True))]
