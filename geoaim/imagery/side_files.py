"""Georeference of an image by the files beside it: .aux.xml (PAM), world files and .prj.

GDAL would read an .aux.xml whole, and open what it names. Here only its transform and its CRS are
read, in GDAL's order: .aux.xml, the image itself, the world file; for the CRS .prj comes last.
"""

import html
import re
from pathlib import Path

from rasterio import Affine

from geoaim.base.errors import ImageryError

MAX_BYTES = 1_000_000  # a larger .aux.xml or .prj is not read
TRANSFORM = re.compile(r"<GeoTransform>([^<]*)</GeoTransform>")
REFERENCE = re.compile(r"<SRS[^>]*>([^<]*)</SRS>")


def read_pam(path: Path) -> tuple[Affine | None, str | None]:
    """Read the transform and the CRS of the .aux.xml beside an image; None for what it lacks.

    Raises:
        ImageryError: its transform is not six numbers.
    """
    file = Path(f"{path}.aux.xml")
    if not file.is_file():
        return None, None
    text = _read_text(file)
    transform, reference = TRANSFORM.search(text), REFERENCE.search(text)
    crs = html.unescape(reference[1]).strip() if reference else None
    if transform is None:
        return None, crs or None
    numbers = _parse_numbers(transform[1].replace(",", " "), file)
    return Affine.from_gdal(*numbers), crs or None


def read_world_file(path: Path) -> Affine | None:
    """Read the world file beside an image, for the corner of its first pixel; None without one.

    Raises:
        ImageryError: it does not hold six numbers.
    """
    suffix = path.suffix
    for ending in (suffix[:2] + suffix[-1:] + "w", suffix + "w", ".wld"):
        for file in (path.with_suffix(ending), path.with_suffix(ending.upper())):
            if file.is_file():
                a, d, b, e, x, y = _parse_numbers(_read_text(file), file)
                return Affine(a, b, x, d, e, y) @ Affine.translation(-0.5, -0.5)
    return None


def read_prj(path: Path) -> str | None:
    """Read the CRS in the .prj beside an image, as text; None without one."""
    for file in (path.with_suffix(".prj"), path.with_suffix(".PRJ")):
        if file.is_file():
            return _read_text(file).strip() or None
    return None


def _read_text(file: Path) -> str:
    if file.stat().st_size > MAX_BYTES:
        raise ImageryError(f"{file} has more than {MAX_BYTES:.0e} bytes, and is no georeference")
    return file.read_text(encoding="utf-8", errors="replace")


def _parse_numbers(text: str, file: Path) -> list[float]:
    try:
        numbers = [float(word) for word in text.split()]
        if len(numbers) != 6:
            raise ValueError(f"{len(numbers)} numbers")
    except ValueError as error:
        raise ImageryError(f"{file} does not hold six numbers") from error
    return numbers
