"""The ground of a real sequence, and its cars as sprites."""

import cv2
import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array

from benchmarks.data import require_data
from benchmarks.stills import cut_car
from geoaim.mapping import average_frames, open_video, read_detections, register

WIDTH = 960  # largest width of the pictures, unless another is asked for


def cut_place(
    place: str, width: int = WIDTH
) -> tuple[UInt8[Array, "h w 3"], list[UInt8[Array, "_ _ 4"]]]:
    """Cut a folder of `hover` (see `paste_queue`) into its ground and its cars, RGBA heading right.

    The ground is a mean without the boxes of vehicles.
    """
    folder = require_data(f"hover/{place}")
    video, boxes = open_video(folder), read_detections(folder)
    registration = register(video)
    pairs = [
        (frame, registration.reference_from_frame[frame.index])
        for frame in video
        if registration.valid[frame.index]
    ]
    ground = average_frames(pairs, size=(video.height, video.width), detections=boxes).image
    scale = min(width / video.width, 1.0)
    sprites = []
    for frame, _ in pairs[::4]:
        known = boxes(frame)
        if known is None:
            continue
        for left, top, right, bottom in np.rint(known.boxes).astype(int).tolist():
            inside = left > 2 and top > 2 and right < video.width - 2 and bottom < video.height - 2
            long, short = max(right - left, bottom - top), min(right - left, bottom - top)
            if not inside or not 1.9 < long / max(short, 1) < 3.0 or short * scale < 12:
                continue
            sprite = cut_car(frame.image[top:bottom, left:right], 1.0)
            sprites.append(_resize(sprite, scale))
    lengths = np.array([sprite.shape[1] for sprite in sprites])
    usual = np.abs(lengths / np.median(lengths) - 1) < 0.3
    return _resize(ground, scale), [s for s, keep in zip(sprites, usual, strict=True) if keep]


def _resize(image: UInt8[Array, "H W c"], scale: float) -> UInt8[Array, "h w c"]:
    return np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))
