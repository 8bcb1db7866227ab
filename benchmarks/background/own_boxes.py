"""Whether vehicles that geoaim's network finds improve the background when they are left out of it.

    python -m benchmarks.background.own_boxes --json docs/bench/own_boxes.json

Clips of 20 s in which queues stand for 60 or 85 % of the time, as videos. A map is built without
boxes, with those that the network finds in the frames that are used, and, where the truth is known,
with all true boxes.
"""

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from benchmarks.background.drawn_queue import draw_queue
from benchmarks.background.methods import SEEDS, STANDING, measure_background
from benchmarks.background.queue_clips import QueueClip, paste_queue
from benchmarks.background.signal_queue import film_signal
from benchmarks.data import find_data
from benchmarks.results import JsonFile, Row, print_rows, write_rows
from geoaim.aim.aim import AIM
from geoaim.base.encode import write_video
from geoaim.base.progress import no_progress
from geoaim.detection.vehicles import detect_vehicles
from geoaim.mapping.background.running_mean import Background
from geoaim.mapping.georeference.from_telemetry import make_local_georeference
from geoaim.mapping.pipeline import build_aim
from geoaim.mapping.video.detections import DetectedBoxes
from geoaim.mapping.video.frames import Frame

FRAMES, FRAME_RATE = 200, 10.0
VALIDATION_SEED = 1
# how a clip is made, and metres per pixel by which its cars are as large as cars
CLIPS: dict[str, tuple[Callable[..., QueueClip], float]] = {
    "drawn": (draw_queue, 0.09),
    "signal": (film_signal, 0.1),
}
PLACES = {"minsk_junction": 0.12, "munich_street02": 0.13}  # on which real cars are pasted
COLUMNS = ("passed", "stood", "wrong %", "wrong marked %", "good marked %")


def measure_clip(clip: QueueClip, resolution: float, folder: Path) -> Iterator[Row]:
    """Yield a row for each kind of boxes that are left out of the background."""
    height, width = (side // 2 * 2 for side in clip.ground.shape[:2])
    clip = replace(
        clip,
        frames=clip.frames[:, :height, :width],
        ground=clip.ground[:height, :width],
        share=clip.share[:height, :width],
    )
    path = write_video(clip.frames, folder / "clip.mp4", frame_rate=FRAME_RATE, crf=23)
    place = make_local_georeference(resolution=resolution, size=(height, width))

    build = partial(build_aim, path, place, progress=no_progress)
    found = partial(_find_vehicles, resolution)
    maps = {"none": build(), "found": build(detections=found)}
    if clip.boxes is not None:
        maps["true"] = build(detections=list(clip.boxes))
    for name, aim in maps.items():
        measured = measure_background(clip, partial(_take_ground, aim))
        yield {"boxes": name} | {column: measured[column] for column in COLUMNS}


def _find_vehicles(resolution: float, frame: Frame) -> DetectedBoxes:
    return detect_vehicles(frame.image, resolution)


def _take_ground(aim: AIM, clip: QueueClip) -> Background:
    found = aim.image[..., :3], aim.coverage, aim.contested
    return Background(*found, frames_used=len(clip.frames), gains=clip.share[:0, 0])


def measure_clips(seeds: tuple[int, ...], folder: Path) -> Iterator[Row]:
    """Measure all clips; those of real cars only where there are real data."""
    clips = dict(CLIPS)
    if find_data() is not None:
        for place, resolution in PLACES.items():
            clips[f"pasted on {place}"] = partial(paste_queue, place), resolution
    for name, (make, resolution) in clips.items():
        for seed in seeds:
            clip = make(standing=STANDING, seed=seed, count=FRAMES)
            for row in measure_clip(clip, resolution, folder):
                yield {"clip": f"{name} {seed}", **row}


def main(
    json: JsonFile = None,
    validation: Annotated[bool, typer.Option(help="the validation clips")] = False,
) -> None:
    """Measure backgrounds without boxes, with found ones and with true ones."""
    with tempfile.TemporaryDirectory() as folder:
        seeds = (VALIDATION_SEED,) if validation else SEEDS
        rows = print_rows(measure_clips(seeds, Path(folder)))
    write_rows(rows, json, command="python -m benchmarks.background.own_boxes")


if __name__ == "__main__":
    typer.run(main)
