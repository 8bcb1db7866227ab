"""Files that are written whole or not at all."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@contextmanager
def atomic_write(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path whose file replaces `path` when the block ends without an error.

    The folder is created when it is missing. When the block fails, an existing file stays as it
    was.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=path.parent, prefix=".writing-") as folder:
        yield Path(folder, path.name)
        os.replace(Path(folder, path.name), path)


def write_figure(figure: "Figure", path: str | os.PathLike[str]) -> None:
    """Write a figure as a PNG."""
    with atomic_write(path) as temporary:
        figure.savefig(temporary, dpi=100, format="png")
