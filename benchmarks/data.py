"""The folder of real data that GEOAIM_DATA names; none of it is part of the project."""

import os
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array

from geoaim.base.errors import TracksError


def find_data() -> Path | None:
    """Return the folder that GEOAIM_DATA names, or None where it is not set.

    Raises:
        FileNotFoundError: GEOAIM_DATA is set and is not a folder.
    """
    name = os.environ.get("GEOAIM_DATA")
    if not name:
        return None
    if not Path(name).is_dir():
        raise FileNotFoundError(f"GEOAIM_DATA={name} is not a folder; unset it or correct it")
    return Path(name)


def require_data(name: str = ".") -> Path:
    """Return a folder of the real data.

    Args:
        name: its path below the folder that GEOAIM_DATA names; ".": that folder itself.

    Returns:
        The path, which is a folder.

    Raises:
        TracksError: GEOAIM_DATA is not set, or there is no such folder below it.
        FileNotFoundError: GEOAIM_DATA is set, but names no folder.
    """
    data = find_data()
    if data is None:
        raise TracksError(f"{name} is needed; set GEOAIM_DATA to the folder of real data")
    if not (data / name).is_dir():
        raise TracksError(f"{data} holds no folder {name}; set GEOAIM_DATA to the folder that does")
    return data / name


def read_image(path: Path) -> UInt8[Array, "H W 3"]:
    """Read an image as RGB.

    Raises:
        TracksError: the file is missing or not an image.
    """
    image = cv2.imread(str(path))
    if image is None:
        raise TracksError(f"{path} is missing or not an image")
    return np.ascontiguousarray(image[..., ::-1], np.uint8)
