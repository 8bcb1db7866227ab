"""Textures and corner frames of AIMs: read with numpy and pillow alone, without GDAL or OpenCV."""

import hashlib
import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array
from PIL import Image

from geoaim.aim.aim import AIM
from geoaim.aim.position import bind_report, read_position_covariance
from geoaim.base.checksums import FileFormat, verify_checksum
from geoaim.base.errors import AimError
from geoaim.base.grid import Grid
from geoaim.base.limits import check_memory, name_file, refuse_damaged
from geoaim.base.world import World

VERSION = 1  # version of the corner frame: docs/schemas/corner_frame-1.json
CORNERS = ("top-left", "top-right", "bottom-right", "bottom-left")
FRAME_FILE, PICTURE_FILE = "texture.json", "texture.png"
BYTES_PER_PIXEL = 12  # memory needed to read a texture
FORMAT = FileFormat("corner frame", VERSION, VERSION, VERSION + 1, AimError, editable=True)
SIZES = ("height", "width", "pixel_height", "pixel_width")
PICTURE_FORMATS = ("PNG", "JPEG", "WEBP", "BMP", "TIFF")  # of pillow: none starts a program
REQUIRED = frozenset({"version", "image", *SIZES, "corner_order", "corners", "world"})
POSITION_KEYS = ("position", "place")  # of the report: how well it is known, and where that holds
OPTIONAL = frozenset({"image_sha256", "checksum", *POSITION_KEYS})  # which geoaim writes
ORIENTATION_TAG, UPRIGHT = 0x0112, 1  # EXIF
MAX_SIZE_ERROR = 0.01  # of a pixel's stated size, as a share: it is rounded in files of others
MAX_SKEW = 1e-12  # largest skew of a parallelogram as a share of its sides: rounding


def is_texture(path: str | os.PathLike[str]) -> bool:
    """Whether a path is a folder with a corner frame, such as `export_texture` writes."""
    return Path(path, FRAME_FILE).is_file()


def read_map(path: str | os.PathLike[str]) -> AIM:
    """Read an AIM from a GeoTIFF of `write_aim`, or from a folder as `read_texture`.

    Raises:
        AimError: the file or folder is neither, or is damaged.
    """
    if is_texture(path):
        return read_texture(path)
    from geoaim.aim.files import read_aim  # which needs rasterio and OpenCV

    return read_aim(path)


def read_texture(folder: str | os.PathLike[str]) -> AIM:
    """Read a folder that `export_texture` wrote, or another program by the same schema.

    Neither rasterio nor OpenCV is imported. Checksums are verified where the JSON has them.

    Args:
        folder: a folder with texture.json (docs/schemas/corner_frame-1.json) and the picture that
            it names.

    Returns:
        The AIM. Its transform is that of the four corners: affine where they are a parallelogram,
        otherwise a homography. Pixels of alpha 0 have coverage 0, all others 1; none are contested,
        and the report says where the texture comes from and how well its position is known, since
        a texture keeps no more.

    Raises:
        AimError: a file is damaged, the JSON does not follow the schema, or the picture has more
            than 8 bits a channel or is turned by EXIF.
        GeoreferenceError: its CRS is unknown.
    """
    path = Path(folder, FRAME_FILE)
    frame, grid = read_frame(path)
    picture = path.with_name(frame["image"])
    if not picture.is_file():
        raise AimError(f"{path} names the picture {picture.name!r}, which is not beside it")
    with refuse_damaged(picture, AimError, "the PNG of a texture"):
        _check_picture(picture, frame.get("image_sha256"))
        pixels = _read_pixels(picture, frame["height"], frame["width"])
    with name_file(path):
        assert grid.world is not None
        image, name = pixels[..., :3].copy(), f"texture {path}"
        aim = AIM.from_image(image, grid.world_from_grid, grid.world, name)
    aim.coverage[:] = pixels[..., 3] > 0
    stated = {name: frame[name] for name in POSITION_KEYS if name in frame}
    return replace(aim, report={**aim.report, **stated})


def read_frame(path: Path) -> tuple[dict[str, Any], Grid]:
    """Read and check the JSON of a corner frame, without its picture.

    Returns:
        What the JSON holds, and the grid of the texture.

    Raises:
        AimError: it is damaged, or does not follow the schema.
        GeoreferenceError: its CRS is unknown.
    """
    with refuse_damaged(path, AimError, "the JSON of a corner frame"):
        frame = json.loads(path.read_text("utf-8"))
        _check_frame(frame)
        read_position_covariance(frame)
        if verify_checksum(path, FORMAT) != ("checksum" in frame):
            raise AimError("the checksum is damaged; export the texture again")
        east, north = frame["world"]["origin"]
        world = World(frame["world"]["crs"], (float(east), float(north)))
        corners, size = np.array(frame["corners"], float), (frame["height"], frame["width"])
        grid = Grid(size, fit_corners(corners, *size), world)
        _check_corners(corners, frame)
        bind_report({name: frame[name] for name in POSITION_KEYS if name in frame}, grid)
    return frame, grid


def hash_picture(picture: bytes) -> str:
    """Compute the SHA-256 of a picture's file."""
    return hashlib.sha256(picture).hexdigest()


def _check_picture(picture: Path, stated: str | None) -> None:
    if stated is not None and hash_picture(picture.read_bytes()) != stated:
        raise AimError(
            f"{picture} is not the picture that {FRAME_FILE} was written with: its SHA-256 is "
            "another one than image_sha256; export the texture again, or remove that key from the "
            "JSON if the picture was changed on purpose"
        )


def fit_corners(corners: Float[Array, "4 2"], height: int, width: int) -> Float[Array, "3 3"]:
    """Fit the transform of an image to the places of its four outer corners.

    Args:
        corners: (4, 2) x, y of the top-left, top-right, bottom-right and bottom-left corner.
        height: height of the image, pixels.
        width: width of the image, pixels.

    Returns:
        (3, 3) pixels (corner origin) to x, y, exact at all corners: the homography of Heckbert
        (1989), Fundamentals of texture mapping; affine if they are a parallelogram.

    Raises:
        AimError: the corners are not those of a convex quadrilateral in this order.

    >>> fit_corners(np.array([[0.0, 8.0], [16.0, 8.0], [16.0, 0.0], [0.0, 0.0]]), 4, 8)
    array([[ 2.,  0.,  0.],
           [ 0., -2.,  8.],
           [ 0.,  0.,  1.]])
    """
    edges = np.roll(corners, -1, axis=0) - corners
    turns = edges[:, 0] * np.roll(edges[:, 1], -1) - edges[:, 1] * np.roll(edges[:, 0], -1)
    if not (np.isfinite(corners).all() and ((turns < 0).all() or (turns > 0).all())):
        raise AimError(
            f"the corners {np.asarray(corners).tolist()} are not those of a convex quadrilateral, "
            "from the top-left one on clockwise in the image"
        )
    skew = corners[0] - corners[1] + corners[2] - corners[3]  # 0 of a parallelogram
    depth = np.zeros(2)
    if np.abs(skew).max() > MAX_SKEW * np.abs(edges).max():
        depth = np.linalg.solve(np.column_stack([-edges[1], edges[2]]), skew)
    sides = np.stack([edges[0], -edges[3]]) + depth[:, None] * corners[[1, 3]]
    world_from_square = np.vstack([np.column_stack([*sides, corners[0]]), [*depth, 1.0]])
    return world_from_square @ np.diag([1 / width, 1 / height, 1.0])


def _check_corners(corners: Float[Array, "4 2"], frame: dict[str, Any]) -> None:
    """Refuse corners of a mirror image, or that contradict the stated size of a pixel."""
    top, right, bottom, left = np.roll(corners, -1, axis=0) - corners
    if top[0] * left[1] - top[1] * left[0] < 0:
        raise AimError(
            "the corners show the ground as in a mirror, which no picture from above does: is y "
            "counted downwards? x is east and y north"
        )
    for side, edges in (("width", (top, bottom)), ("height", (right, left))):
        sizes = [float(np.hypot(*edge)) / frame[side] for edge in edges]
        stated = float(frame[f"pixel_{side}"])
        low, high = min(sizes) * (1 - MAX_SIZE_ERROR), max(sizes) * (1 + MAX_SIZE_ERROR)
        if not low <= stated <= high:
            raise AimError(
                f"pixel_{side} is {stated:g} m, and by the corners and {frame[side]} pixels "
                f"{np.mean(sizes):.4g} m: correct what is wrong"
            )


def _read_pixels(picture: Path, height: int, width: int) -> UInt8[Array, "H W 4"]:
    """Read RGBA; refuse pictures of another size, of more than 8 bits, or turned by EXIF."""
    with _open_large(picture) as image:
        content = f"{image.width} x {image.height} pixels"
        if image.size != (width, height):
            raise AimError(f"{picture} has {content}, and {FRAME_FILE} states {width} x {height}")
        needed = BYTES_PER_PIXEL * image.width * image.height
        check_memory(picture, needed, picture.stat().st_size, AimError, content)
        if image.mode[0] in "IF":  # pillow would clip them
            raise AimError(
                f"{picture} has pixels of the kind {image.mode}; save it with 8 bits a channel"
            )
        if image.getexif().get(ORIENTATION_TAG, UPRIGHT) != UPRIGHT:
            raise AimError(
                f"{picture} is turned by its EXIF orientation, so that its top-left corner is in "
                "doubt; save it upright"
            )
        return np.asarray(image.convert("RGBA"))


@contextmanager
def _open_large(picture: Path) -> Iterator[Image.Image]:
    """Open an image without pillow's own limit of its size, since `check_memory` has one."""
    given, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None
    try:
        with Image.open(picture, formats=PICTURE_FORMATS) as image:
            yield image
    finally:
        Image.MAX_IMAGE_PIXELS = given


def _check_frame(frame: Any) -> None:
    """Refuse JSON that does not follow the schema."""
    if not isinstance(frame, dict) or not frame.keys() >= REQUIRED:
        lacking = sorted(REQUIRED - set(frame if isinstance(frame, dict) else ()))
        raise AimError(
            f"the corner frame lacks {', '.join(lacking)}; docs/schemas/corner_frame-1.json says "
            "what is needed, and `geoaim texture` writes it"
        )
    if unknown := sorted(frame.keys() - REQUIRED - OPTIONAL):
        raise AimError(
            f"the corner frame has the unknown key {', '.join(unknown)}; docs/schemas/"
            "corner_frame-1.json lists those that there are"
        )
    if frame["version"] != VERSION:
        raise AimError(f"version {frame['version']} of the corner frame; {VERSION} is needed")
    if tuple(frame["corner_order"]) != CORNERS:
        raise AimError(f"corner_order is {frame['corner_order']}; {list(CORNERS)} is needed")
    if np.shape(frame["corners"]) != (4, 2):
        raise AimError(f"corners have shape {np.shape(frame['corners'])}; (4, 2) is needed")
    for side in (frame["height"], frame["width"]):
        if not (isinstance(side, int) and side > 0):
            raise AimError(f"a side of {side!r} pixels; height and width are whole numbers above 0")
    name = frame["image"]
    if not name or Path(name).name != name:
        raise AimError(f"image is {name!r}; the name of a file beside the JSON is needed")
