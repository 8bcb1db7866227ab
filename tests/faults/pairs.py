"""Writers of two files that belong together, run in a child process."""

from pathlib import Path

from geoaim.files import atomic_files


def write_pair(target: Path) -> None:
    """Write a map and its picture, both of the next version."""
    version = str(int(target.read_text()) + 1) if target.exists() else "0"
    with atomic_files(target, target.with_suffix(".png")) as temporary:
        for path in temporary:
            path.write_text(version)
