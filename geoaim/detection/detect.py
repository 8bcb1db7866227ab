"""Detect the vehicles of a video or pictures, and write them for this and other programs."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from numpy import ndarray as Array

from geoaim.base.errors import warn
from geoaim.base.files import atomic_folder, atomic_write
from geoaim.base.progress import Progress, notebook_progress
from geoaim.detection.scale import FRAMES, Scale, propose_scale
from geoaim.detection.vehicles import MIN_PROBABILITY, detect_vehicles
from geoaim.mapping.video.detections import DetectedBoxes
from geoaim.mapping.video.frames import Frame
from geoaim.mapping.video.video import VideoSource, open_video

DOUBTFUL = 0.5  # metres per pixel: a car is four pixels wide
CLASS = "vehicle"


@dataclass(frozen=True, eq=False)
class Found:
    """The vehicles of a video: a function from a `Frame` to its boxes, as `track_video` takes."""

    boxes: dict[int, DetectedBoxes]  # by the numbers of frames
    names: dict[int, str | None]  # file names of images; None: frames of a video
    size: tuple[int, int]  # (width, height) of a frame, pixels
    scale: Scale

    def __call__(self, frame: Frame) -> DetectedBoxes | None:
        """Get the boxes of a frame; None for one that was not searched."""
        return self.boxes.get(frame.index)


def detect(
    source: VideoSource | Array,
    *,
    resolution: float | None = None,
    min_probability: float = MIN_PROBABILITY,
    progress: Progress = notebook_progress,
) -> Found:
    """Detect the vehicles in each frame of a video, or in pictures, from above.

    Args:
        source: what `open_video` opens, or one RGB picture of shape (H, W, 3).
        resolution: metres per pixel; None: proposed by the vehicles.
        min_probability: boxes below are left out.
        progress: called with the stage, the frames done and the frames in all.

    Returns:
        Oriented boxes of each frame, with probabilities.

    Raises:
        GeoaimError: the scale is not given, and too few vehicles are found to propose one.

    Example:
        >>> found = detect(np.full((240, 320, 3), 90, np.uint8), resolution=0.2)
        >>> [len(boxes.boxes) for boxes in found.boxes.values()]
        [0]
    """
    if isinstance(source, np.ndarray) and source.ndim == 3 and source.shape[2] == 3:
        source = [source]
    video = open_video(source)
    if resolution is None:
        scale = propose_scale([f.image for f in video.sample(FRAMES)], progress=progress)
    else:
        scale = Scale(resolution, 0.0, 0)
    if scale.resolution > DOUBTFUL:
        warn(
            f"a pixel shows {scale.resolution:.2g} m of ground: most vehicles are missed in "
            f"pictures of more than {DOUBTFUL} m"
        )
    boxes, names = {}, {}
    for frame in video:
        boxes[frame.index] = detect_vehicles(
            frame.image, scale.resolution, min_probability=min_probability
        )
        names[frame.index] = frame.name
        progress("detect vehicles", len(boxes), video.frame_count)
    return Found(boxes, names, (video.width, video.height), scale)


def write_detections(found: Found, path: Path) -> None:
    """Write boxes as a table (.csv), or as a new folder of YOLO's oriented boxes.

    Both are read by `read_detections`; the folder by other programs too.
    """
    if path.suffix.lower() == ".csv":
        with atomic_write(path) as temporary:
            make_table(found).to_csv(temporary, index=False, float_format="%.3f")
        return
    with atomic_folder(path) as folder:
        for index, boxes in found.boxes.items():
            name = found.names[index]
            stem = f"{index:06d}" if name is None else Path(name).stem
            shares = boxes.get_corners() / found.size
            rows = zip(shares.reshape(-1, 8), boxes.get_scores(), strict=True)
            lines = [" ".join(["0", *(f"{v:.6f}" for v in row), f"{p:.3f}"]) for row, p in rows]
            (folder / f"{stem}.txt").write_text("".join(f"{line}\n" for line in lines), "utf-8")
        (folder / "classes.txt").write_text(f"{CLASS}\n", "utf-8")


def make_table(found: Found) -> pd.DataFrame:
    """Make a table of boxes: frame, upright bounds, score, class, and four corners, in pixels."""
    parts = []
    for index, boxes in found.boxes.items():
        part = pd.DataFrame(boxes.boxes, columns=["left", "top", "right", "bottom"])
        part.insert(0, "frame", index)
        corners = boxes.get_corners().reshape(-1, 8)
        names = [f"{axis}{corner}" for corner in range(1, 5) for axis in "xy"]
        part = part.assign(score=boxes.get_scores(), **{"class": CLASS})
        parts.append(part.assign(**dict(zip(names, corners.T, strict=True))))
    return pd.concat(parts, ignore_index=True)


def summarize(found: Found) -> dict[str, str]:
    """Say in a few lines what was found, and at which scale."""
    scores = [boxes.get_scores() for boxes in found.boxes.values()]
    counts = [len(part) for part in scores]
    scale, known = found.scale, f"{found.scale.resolution:.3g} m a pixel"
    if scale.vehicles:
        known += f" +- {100 * scale.sigma:.0f} %, proposed by {scale.vehicles} vehicles"
    return {
        "vehicles": f"{sum(counts)} boxes in {len(counts)} frames, {np.median(counts):.0f} in most",
        "probably right": f"{np.concatenate(scores).sum():.0f} of them",
        "scale": known,
    }
