"""A small bundled recording, for children that are interrupted while writing it."""

from importlib import import_module
from pathlib import Path
from unittest.mock import patch

SMALL = Path(__file__).parents[2] / "samples" / "tiles"
command = import_module("geoaim.cli.testing")  # the package has the command under this name


def write_small_sample(folder: Path) -> None:
    """Write tiles alone as the bundled recording."""
    with patch.object(command, "find_sample", lambda: SMALL):
        command.write_sample(folder)
