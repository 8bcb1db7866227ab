"""The command that writes the bundled recording."""

import shutil
from pathlib import Path
from typing import Annotated

import typer

import geoaim
from geoaim.cli.console import console, report_errors

PACKAGE = Path(geoaim.__file__).resolve().parent
NAME = "samples"  # a link in the package, which a checkout on Windows does not follow


def sample(folder: Annotated[Path, typer.Argument(help="folder to write, new or empty")]) -> None:
    """Write a recording to try everything on: video, tracks, lights, HD map and imagery.

    It is of a made place, so that the truth of everything is known. README.md in the folder
    describes each file. The folder appears when it is complete; no existing file is replaced or
    deleted, earlier samples included.

    Example: geoaim sample place
    """
    with report_errors():
        write_sample(folder)
    console.print(f"{folder}: see {folder / 'README.md'}")


def write_sample(folder: Path) -> None:
    """Write the files of the bundled recording into a folder, which appears when it is complete."""
    from geoaim.base.files import atomic_folder

    source = find_sample()
    with atomic_folder(folder) as temporary:
        for path in sorted(source.rglob("*")):
            if path.is_file():
                target = temporary / path.relative_to(source)
                target.parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(path, target)


def find_sample() -> Path:
    """Find the bundled recording, in the package or beside it in a checkout."""
    places = (PACKAGE / NAME, PACKAGE.parent / NAME)
    found = next((place for place in places if place.is_dir()), None)
    if found is None:
        raise FileNotFoundError(
            f"the bundled recording is missing from {PACKAGE}; install geoaim again from its wheel"
        )
    return found.resolve()
