"""Backgrounds of real sequences without ground truth: methods are compared with each other."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.base.errors import RegistrationError
from geoaim.mapping.background.running_mean import Background, Registered, average_frames
from geoaim.mapping.background.traffic_removal import MIN_FRAMES
from geoaim.mapping.background.traffic_search import remove_traffic
from geoaim.mapping.registration.register import register
from geoaim.mapping.video.detections import Detections, read_detections
from geoaim.mapping.video.frames import Frame
from geoaim.mapping.video.video import open_video

PLACES = ("hover/minsk_junction", "hover/munich_mos074", "hover/munich_street02")
DIFFERENT = 20  # grey levels over 5 x 5 pixels


def measure_real(data: Path) -> Iterator[dict[str, Any]]:
    """Measure contested pixels, exposures and differences between methods on real sequences."""
    for place in PLACES:
        video, boxes = open_video(data / place), read_detections(data / place)
        try:
            registration = register(video, detections=boxes)
        except RegistrationError as error:
            yield {"sequence": place, "registered": f"refused: {str(error).split(',')[0]}"}
            continue
        pairs = zip(video, registration.reference_from_frame, strict=True)
        keep = [pair for pair, valid in zip(pairs, registration.valid, strict=True) if valid]
        row = {"sequence": place, "registered": f"{len(keep)} of {len(registration.valid)}"}
        yield row | (_compare(keep, boxes) if len(keep) >= MIN_FRAMES else {})
    for path in sorted((data / "static").glob("*.mp4")):
        still: list[tuple[Frame, Float[Array, "3 3"]]] = [
            (frame, np.eye(3)) for frame in open_video(path).sample(64)
        ]
        yield {"sequence": path.name, "registered": "a fixed camera", **_compare(still, None)}


def _compare(frames: Sequence[Registered], detections: Detections | None) -> dict[str, Any]:
    size = frames[0][0].grey.shape
    ground = remove_traffic(frames, size=size)
    boxed = average_frames(frames, size=size, detections=detections) if detections else None
    return {
        "contested %": 100 * float(ground.contested.mean()),
        "gains": f"{ground.gains.min():.3f} to {ground.gains.max():.3f}",
        "differs from mean %": _measure_difference(average_frames(frames, size=size), ground),
        "differs from boxes %": _measure_difference(boxed, ground) if boxed else None,
    }


def _measure_difference(one: Background, other: Background) -> float:
    """Percent of pixels that differ by more than 20 grey levels over 5 x 5 pixels."""
    both = (one.coverage > 0) & (other.coverage > 0)
    differs = cv2.blur(cv2.absdiff(one.image, other.image).max(-1), (5, 5)) > DIFFERENT
    return 100 * float((differs & both).mean())
