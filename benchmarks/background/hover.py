"""Backgrounds of hover videos against the masked median, on the road.

The masked median is that of all frames where they show no box of a vehicle (of all frames where
there are no boxes), sharpened as the background is. Where a vehicle stands for most of the time
and has no box the median is wrong, not the background. Backgrounds are also made with boxes of
which some are missing, or which are too small; the median keeps all of them.

python -m benchmarks.background.hover --crops build/hover
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer
from jaxtyping import Bool, Float32, UInt8
from numpy import ndarray as Array

from benchmarks.background.methods import SEEDS, damage_boxes, film_queue, list_frames
from benchmarks.data import require_data
from benchmarks.results import JsonFile, Row, print_rows, write_rows
from benchmarks.stills import STILLS
from geoaim.base.files import atomic_write
from geoaim.mapping.background.exposure import apply_gain, estimate_gain, start_exposure
from geoaim.mapping.background.running_mean import Background, Registered, draw_outside
from geoaim.mapping.background.traffic_removal import compute_median
from geoaim.mapping.background.traffic_search import remove_traffic
from geoaim.mapping.background.warping import (
    draw_footprint,
    draw_polygons,
    measure_warp_blur,
    sharpen_mean,
    warp,
)
from geoaim.mapping.registration.register import choose_reference, register_frames
from geoaim.mapping.video.detections import Detections, read_detections
from geoaim.mapping.video.video import open_video

FRAMES = 64  # as many as a build takes at most
DIFFERENT = 8  # grey levels over 3 x 3 pixels
MIN_VALUES = 3  # frames without which the median is not judged
ROWS = 120  # of which the median is computed at a time
CROP_PX = 160
RIM_PX = 50  # not judged with boxes, which vehicles at the frame's edge often lack
MAGENTA, RED = (255, 0, 255), (255, 0, 0)
# quadrilaterals on the road, in tenths of the first frame's width and height, read off the pictures
EVERYWHERE = ((0, 0), (10, 0), (10, 10), (0, 10))
ROADS: dict[str, tuple[tuple[tuple[float, float], ...], ...]] = {
    "hover/kharkiv/drone.mp4": (
        ((0, 5.4), (5, 5.3), (5, 5.85), (0, 5.95)),
        ((5, 5.3), (10, 5.2), (10, 5.65), (5, 5.85)),
        ((5.8, 0), (5.95, 0), (5.65, 5), (5.4, 5)),
    ),
    "static/intel_car-detection.mp4": (EVERYWHERE,),
    "static/opencv4nodejs_traffic.mp4": (EVERYWHERE,),
    "hover/minsk_junction": (
        ((0, 4.2), (10, 4.6), (10, 6.6), (0, 6.8)),
        ((4.75, 0), (5.9, 0), (5.9, 4.5), (4.75, 4.4)),
        ((4.7, 6.8), (6.2, 6.8), (6.1, 10), (4.75, 10)),
    ),
    "hover/minsk_street": (
        ((0, 3.0), (4, 3.0), (4, 3.7), (0, 3.7)),
        ((4.4, 4.3), (9, 4.3), (9, 5), (4.4, 5)),
    ),
}


@dataclass(frozen=True, eq=False)
class Scene:
    """A sequence to measure."""

    name: str
    frames: Sequence[Registered]
    road: Bool[Array, "H W"]  # where the road lies in the reference
    detections: Detections | None
    registered: str  # how many frames are


def read_scenes() -> Iterator[Scene]:
    """Read the real sequences and film the hover videos, in order."""
    for name, road in ROADS.items():
        path = require_data() / name
        video = open_video(path)
        boxes = read_detections(path) if path.is_dir() else None
        reference = choose_reference(video, detections=boxes, time=0.0)
        results = list(register_frames(video.sample(FRAMES), reference, detections=boxes))
        # as RGB, since FFmpeg's conversion and ours differ by a grey level
        pairs = [
            (replace(frame, decoded=frame.image, quarter_turns=0), result.reference_from_frame)
            for frame, result in results
            if result.valid
        ]
        corners = np.array(road) / 10 * [video.width, video.height]
        on_road = draw_polygons(corners, (video.height, video.width)).view(bool)
        yield Scene(name, pairs, on_road, boxes, f"{len(pairs)} of {len(results)}")
    for still in STILLS:
        clip = film_queue(still, SEEDS[0])
        pairs, detections = list_frames(clip), read_detections(clip.boxes or ())
        count = f"{len(pairs)} of {len(pairs)}"
        yield Scene(f"hover video {still}", pairs, clip.share > 0, detections, count)


def compute_masked_median(
    scene: Scene,
) -> tuple[UInt8[Array, "H W 3"], Bool[Array, "H W"], Bool[Array, "H W"]]:
    """Compute the median of the frames outside of boxes.

    Returns:
        The median, where enough frames show it, and where some frame has a box.
    """
    size = scene.road.shape
    exposure = start_exposure(size)
    stack = np.empty((len(scene.frames), *size, 3), np.uint8)
    seen = np.empty((len(scene.frames), *size), bool)
    passed = np.zeros(size, bool)
    blurs = []
    for k, (frame, matrix) in enumerate(scene.frames):
        gain = estimate_gain(exposure, frame, matrix)
        stack[k] = apply_gain(warp(frame.image, matrix, size), gain, 0.0)
        shown = draw_footprint(frame.grey.shape, matrix, size)
        if scene.detections is not None:
            outside = draw_outside(scene.detections, frame, matrix, size)
            outside = np.zeros_like(shown) if outside is None else outside
            passed |= (shown > 0) & (outside == 0)
            shown *= outside
        seen[k] = shown > 0
        blurs.append(measure_warp_blur(matrix, size))
    parts = [
        compute_median(stack[:, row : row + ROWS], seen[:, row : row + ROWS])
        for row in range(0, size[0], ROWS)
    ]
    sharp = sharpen_mean(np.concatenate(parts).astype(np.float32), np.mean(blurs, axis=0))
    judged = seen.sum(0) >= MIN_VALUES
    if scene.detections is not None:
        judged[:RIM_PX] = judged[-RIM_PX:] = judged[:, :RIM_PX] = judged[:, -RIM_PX:] = False
    return np.rint(sharp).clip(0, 255).astype(np.uint8), judged, passed


def find_unmarked_errors(
    ground: Background, median: UInt8[Array, "H W 3"], where: Bool[Array, "H W"]
) -> Bool[Array, "H W"]:
    """Find pixels that differ by over 8 grey levels over 3 x 3 pixels and are not contested.

    Args:
        ground: the background.
        median: (H, W, 3) what it is compared with.
        where: (H, W) pixels that count.

    Returns:
        (H, W) the pixels that a user would take for ground.
    """
    first, second = (_average_nearby(image) for image in (ground.image, median))
    differs = np.abs(first - second) > DIFFERENT
    return np.asarray(differs & where & (ground.coverage > 0) & ~ground.contested)


def _average_nearby(image: UInt8[Array, "H W 3"]) -> Float32[Array, "H W"]:
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32)
    return np.asarray(cv2.blur(grey, (3, 3)))


def cut_worst(
    median: UInt8[Array, "H W 3"], ground: Background, missed: Bool[Array, "H W"]
) -> UInt8[Array, "h w 3"]:
    """Cut out where most of the missed pixels are: the median, the background, and it marked.

    Args:
        median: (H, W, 3) the median.
        ground: the background.
        missed: (H, W) pixels that differ and are not contested.

    Returns:
        (h, w, 3) the crops side by side; contested pixels are magenta, missed ones red.
    """
    near = cv2.boxFilter(missed.astype(np.float32), -1, (CROP_PX, CROP_PX), normalize=False)
    middle = np.unravel_index(near.argmax(), near.shape)
    top, left = (np.array(middle) - CROP_PX // 2).clip(0, np.array(near.shape) - CROP_PX)
    part = np.s_[top : top + CROP_PX, left : left + CROP_PX]
    marked = ground.image.copy()
    marked[ground.contested] = MAGENTA
    marked[missed] = RED
    return np.hstack([image[part] for image in (median, ground.image, marked)])


def measure_scenes(crops: Path | None) -> Iterator[Row]:
    """Measure all scenes; write the crops of their worst places into a folder."""
    for scene in read_scenes():
        median, judged, passed = compute_masked_median(scene)
        road = scene.road & judged
        for name, boxes in list_detections(scene.detections):
            ground = remove_traffic(scene.frames, size=median.shape[:2], detections=boxes)
            missed = find_unmarked_errors(ground, median, road)
            if crops is not None:
                path = crops / f"{scene.name} {name}.png".replace("/", "_").replace(" ", "_")
                with atomic_write(path) as part:
                    cv2.imwrite(str(part), cut_worst(median, ground, missed)[..., ::-1])
            yield {
                "sequence": scene.name,
                "boxes": name,
                "registered": scene.registered,
                "differs and is not contested, % of the road": 100 * float(missed[road].mean()),
                "contested, % of the road": 100 * float(ground.contested[road].mean()),
                "RMS where boxes lay": measure_rms(ground.image, median, passed & judged),
            }


def list_detections(detections: Detections | None) -> list[tuple[str, Detections | None]]:
    """List the detections with which a background is made, and their names."""
    if detections is None:
        return [("none", None)]
    return [
        ("none", None),
        ("all", detections),
        ("10 % missing", damage_boxes(detections, missing=0.1)),
        ("10 % too small", damage_boxes(detections, scale=0.9)),
    ]


def measure_rms(
    one: UInt8[Array, "H W 3"], other: UInt8[Array, "H W 3"], where: Bool[Array, "H W"]
) -> float:
    """Measure the root mean square difference of two images.

    Args:
        one: (H, W, 3) an image.
        other: (H, W, 3) the other.
        where: (H, W) pixels that count.

    Returns:
        Grey levels; NaN where no pixel counts.
    """
    if not where.any():
        return np.nan
    return float(np.sqrt(((one[where].astype(np.float32) - other[where]) ** 2).mean()))


def main(
    json: JsonFile = None,
    crops: Annotated[Path | None, typer.Option(help="folder for the worst places")] = None,
) -> None:
    """Measure the real sequences and the hover videos; print the table; write JSON if asked."""
    cv2.setNumThreads(1)
    rows = print_rows(measure_scenes(crops))
    write_rows(rows, json, command="python -m benchmarks.background.hover", threads=1)


if __name__ == "__main__":
    typer.run(main)
