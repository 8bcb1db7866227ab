"""Tracks from a detector's boxes against exact truth, on synthetic videos.

    python -m benchmarks.tracking --json docs/bench/tracking.json

Boxes have 5 % misses, 5 % false ones and 2 px of noise on each side. The videos are encoded,
registered and placed on the exact ground of their first frame. Constants were chosen on the
validation videos (`--validation`); the test videos were judged once. TrackEval judges identities:
`pip install trackeval`.
"""

import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import typer
from jaxtyping import Float
from numpy import ndarray as Array

from benchmarks.results import JsonFile, print_rows, write_rows
from benchmarks.synthetic.camera import HoverClip, render_background, render_frames
from benchmarks.synthetic.place import RESOLUTION, world_from_image
from benchmarks.synthetic.roads.layouts import PlaceKind
from benchmarks.synthetic.sample import HOVER, MARGIN, VIDEOS, make_sample
from benchmarks.synthetic.traffic.interpolation import interpolate_tracks
from benchmarks.tracking.cases import (
    DetectorErrors,
    TrackingCase,
    detect_boxes,
    make_drawn_case,
    project_boxes,
)
from benchmarks.tracking.peers import PeerTracks, list_peers
from benchmarks.tracking.scores import BoxView, make_view, score_tracks
from geoaim.aim.aim import AIM
from geoaim.base.encode import write_video
from geoaim.base.progress import no_progress
from geoaim.mapping.video.video import open_video
from geoaim.tracking.frame_poses import locate_frames
from geoaim.tracking.pipeline import track_boxes
from geoaim.tracks.agent_types import find_group
from geoaim.tracks.tracks import Tracks

KINDS: tuple[PlaceKind, ...] = ("junction", "roundabout", "t", "street")
VALIDATION_SEED, TEST_SEED = 900, 1900
SECONDS, DRAWN_SECONDS = 12.0, 8.0
ERRORS = DetectorErrors()
GROUPS = {"vehicle": ("vehicle",), "person": ("pedestrian", "cyclist")}


def make_case(
    kind: PlaceKind,
    seed: int,
    size: str,
    *,
    seconds: float = SECONDS,
    errors: DetectorErrors = ERRORS,
    resolution: float = RESOLUTION,
) -> TrackingCase:
    """Make a video of a synthetic place, and register it as `track_video` does.

    Args:
        kind: of the place.
        seed: of everything in it.
        size: a name of `VIDEOS`.
        seconds: of video.
        errors: of the detector.
        resolution: of the drawn place, metres per pixel.

    Returns:
        The case.
    """
    hover = replace(HOVER, count=round(seconds * HOVER.frame_rate))
    sample = make_sample(
        seed,
        kind=kind,
        minutes=max(seconds / 60, 0.2),
        video=VIDEOS[size],
        hover=hover,
        resolution=resolution,
    )
    clip = sample.clip
    assert clip is not None
    model, recording = sample.traffic_model, sample.recordings[0]
    truth = interpolate_tracks(model, recording, sample.place, times=clip.times, margin=MARGIN)
    from_still = world_from_image(sample.place, sample.resolution)
    exact = from_still @ np.linalg.inv(clip.frame_from_background)
    exact = exact / exact[:, 2:, 2:]
    frame_from_world = np.linalg.inv(exact)
    shape = clip.height, clip.width
    boxes, visible = project_boxes(truth, frame_from_world, shape)
    generator = np.random.default_rng([seed, len(size)])
    found = detect_boxes(boxes, visible, truth.types, errors, shape, generator)
    poses = _locate(clip, exact[0], truth)
    return TrackingCase(f"{kind} {size}", truth, frame_from_world, poses, found, shape)


def _locate(
    clip: HoverClip, world_from_first: Float[Array, "3 3"], truth: Tracks
) -> Float[Array, "T 3 3"]:
    """Encode the video, and locate its frames on the exact ground of the first one."""
    aim = AIM.from_image(render_background(clip), world_from_first, truth.world, "synthetic")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "hover.mp4"
        write_video(render_frames(clip), path, frame_rate=clip.hover.frame_rate, crf=26)
        return locate_frames(open_video(path), aim, None, no_progress).world_from_frame


def measure_case(
    case: TrackingCase, track: Callable[..., Tracks | PeerTracks]
) -> Iterator[dict[str, Any]]:
    """Measure a tracker on a case: a row for vehicles, and one for people."""
    given = case.boxes, case.world_from_frame, case.truth.times, case.truth.world, case.size
    heights = {} if case.flying_height is None else {"flying_height": case.flying_height}
    start = time.process_time()
    result = track(*given, **(heights if track is track_boxes else {}))
    ms = 1e3 * (time.process_time() - start) / len(case.boxes)
    found, own = (result, None) if isinstance(result, Tracks) else (result.tracks, result.boxes)
    for name, groups in GROUPS.items():
        kept = [
            np.array([find_group(kind) in groups for kind in tracks.types], bool)
            for tracks in (case.truth, found)
        ]
        views = [
            make_view(tracks, case.frame_from_world, case.size, chosen)
            for tracks, chosen in zip((case.truth, found), kept, strict=True)
        ]
        if own is not None:
            shown = np.isfinite(own).all(axis=2) & kept[1][:, None]
            views[1] = BoxView(found, own, shown)
        if views[0].visible.any():
            scores = score_tracks(*views)
            yield {"video": case.name, "agents of": name} | scores | {"ms a frame": ms}


def measure_drawn(seed: int, kinds: tuple[PlaceKind, ...] = KINDS) -> list[dict[str, Any]]:
    """Measure all trackers on boxes at 1080p with exact poses: minutes instead of hours."""
    trackers: dict[str, Callable[..., Any]] = {"geoaim": track_boxes, **list_peers()}
    rows = []
    for number, kind in enumerate(kinds):
        case = make_drawn_case(
            kind, seed + number, (1080, 1920), seconds=DRAWN_SECONDS, errors=ERRORS
        )
        for name, tracker in trackers.items():
            rows += [{"method": name} | row for row in measure_case(case, tracker)]
    return rows


def measure_tracking(
    seed: int, kinds: tuple[PlaceKind, ...] = KINDS, sizes: tuple[str, ...] = ("1080p", "4k")
) -> list[dict[str, Any]]:
    """Measure all trackers on synthetic videos.

    Args:
        seed: of the first place; the others follow.
        kinds: of the places.
        sizes: of the videos, names of `VIDEOS`.

    Returns:
        A row for each tracker, video and group of agents.
    """
    trackers: dict[str, Callable[..., Any]] = {"geoaim": track_boxes, **list_peers()}
    rows = []
    for size in sizes:
        for number, kind in enumerate(kinds):
            case = make_case(kind, seed + number, size)
            for name, tracker in trackers.items():
                rows += [{"method": name} | row for row in measure_case(case, tracker)]
            print(f"{case.name}: done", flush=True)
    return rows


def average_rows(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Average the rows of a method and a group over the videos, each alike."""
    keys = list(dict.fromkeys((row["method"], row["agents of"]) for row in rows))
    averages = []
    for method, group in keys:
        part = [row for row in rows if (row["method"], row["agents of"]) == (method, group)]
        names = [name for name, value in part[0].items() if not isinstance(value, str)]
        means = {name: float(np.nanmean([row.get(name, np.nan) for row in part])) for name in names}
        averages.append({"method": method, "agents of": group, "videos": len(part)} | means)
    return averages


def main(
    json: JsonFile = None,
    validation: Annotated[bool, typer.Option(help="the validation videos")] = False,
    size: Annotated[str, typer.Option(help="1080p, 4k or both")] = "both",
    drawn: Annotated[bool, typer.Option("--drawn", help="boxes alone, with exact poses")] = False,
) -> None:
    """Measure tracks from a detector's boxes on synthetic videos."""
    cv2.setNumThreads(1)
    sizes = ("1080p", "4k") if size == "both" else (size,)
    seed = VALIDATION_SEED if validation else TEST_SEED
    rows = measure_drawn(seed) if drawn else measure_tracking(seed, sizes=sizes)
    averages = print_rows(average_rows(rows))
    command = "python -m benchmarks.tracking"
    write_rows(rows, json, command=command, averages=averages)
