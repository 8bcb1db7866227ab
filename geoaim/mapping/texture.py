"""Export an AIM as a texture and its corner frame, for a renderer."""

import json
import os
from pathlib import Path
from xml.sax.saxutils import escape

import cv2
import numpy as np

from geoaim.aim.aim import AIM
from geoaim.aim.rectification import rectify
from geoaim.aim.texture_files import (
    CORNERS,
    FRAME_FILE,
    PICTURE_FILE,
    POSITION_KEYS,
    VERSION,
    hash_picture,
)
from geoaim.base.checksums import PLACEHOLDER, write_checksum
from geoaim.base.files import atomic_files, atomic_write, check_not_foreign, lock_folder

PLACE_FILES = ("texture.pgw", "texture.png.aux.xml")  # by which GIS programs place the picture


def export_texture(
    aim: AIM, folder: str | os.PathLike[str], *, resolution: float | None = None
) -> None:
    """Write texture.png (RGBA) and texture.json with its corner frame in world metres.

    Alpha is 255 where the AIM has coverage and 0 elsewhere. The JSON holds the version of the
    format, the picture's name, height and width (pixels), pixel_height and pixel_width (metres),
    the four corners in the order top-left, top-right, bottom-right, bottom-left, and the world
    (CRS and origin), checksums of the picture and of the JSON itself; and how well the position is
    known, where the report of the map states it.

    Args:
        aim: the map. It is rectified first if a resolution is given, or if its transform is not
            affine, since four corners then do not determine the position of every pixel.
        folder: created if it is missing; files of the same names are replaced.
        resolution: metres per pixel of the texture; None keeps that of the image.

    Raises:
        AimError: the texture would have more than 30,000 pixels a side.
        ValueError: the resolution is not positive.
    """
    if resolution is not None or not aim.is_affine:
        aim = rectify(aim, resolution)
    alpha = np.where(aim.coverage > 0, np.uint8(255), np.uint8(0))
    bgra = cv2.cvtColor(np.dstack([aim.image, alpha]), cv2.COLOR_RGBA2BGRA)
    _, png = cv2.imencode(".png", bgra)
    height, width = alpha.shape
    pixel_width, pixel_height = np.linalg.norm(aim.world_from_image[:2, :2], axis=0)
    frame = {
        "version": VERSION,
        "image": PICTURE_FILE,
        "height": height,
        "width": width,
        "pixel_height": float(pixel_height),
        "pixel_width": float(pixel_width),
        "corner_order": CORNERS,
        "corners": aim.corners.tolist(),
        "world": {"crs": aim.world.crs, "origin": list(aim.world.origin)},
        "image_sha256": hash_picture(png.tobytes()),
        "checksum": PLACEHOLDER,
    }
    frame |= {name: aim.report[name] for name in POSITION_KEYS if name in aim.report}
    with lock_folder(folder, wait=True):
        check_not_foreign(Path(folder) / FRAME_FILE)
        _write_files(Path(folder), frame, png.tobytes(), _describe_place(aim))


def _describe_place(aim: AIM) -> tuple[str, str]:
    """Describe a picture's place for GIS programs: a world file, and its CRS in a .aux.xml."""
    crs_from_image = aim.grid.crs_from_grid
    first = crs_from_image @ [0.5, 0.5, 1.0]  # world files place the centre of the first pixel
    numbers = [*crs_from_image[:2, :2].T.ravel(), *first[:2]]
    crs = "" if aim.world.crs is None else f"<SRS>{escape(aim.world.crs)}</SRS>"
    return (
        "".join(f"{float(number)!r}\n" for number in numbers),
        f"<PAMDataset>{crs}</PAMDataset>\n",
    )


def _write_files(
    folder: Path, frame: dict[str, object], png: bytes, place: tuple[str, str]
) -> None:
    """Write a picture, its place, and the JSON that names it; a kill leaves the old or the new.

    Where there are old ones, the JSON names another file while the picture is replaced.
    """
    text = json.dumps(frame, indent=2)
    spare = f"{Path(PICTURE_FILE).stem}-{hash_picture(png):.8}.png"
    is_new = not (folder / FRAME_FILE).exists()
    try:
        for name in (PICTURE_FILE,) if is_new else (spare, PICTURE_FILE):
            sides = PLACE_FILES if name == PICTURE_FILE else ()
            paths = [folder / each for each in (name, *sides)]
            with atomic_files(*paths, shared=True) as (part, *side_parts):
                part.write_bytes(png)
                for side, content in zip(side_parts, place, strict=False):
                    side.write_text(content, "utf-8")
            with atomic_write(folder / FRAME_FILE, shared=True) as part:
                part.write_text(text.replace(f'"{PICTURE_FILE}"', f'"{name}"', 1) + "\n")
                write_checksum(part)
    finally:
        if not is_new and f'"{spare}"' not in (folder / FRAME_FILE).read_text():
            (folder / spare).unlink(missing_ok=True)
