"""Encoded videos with their maps and true tracks: drawn places, and real stills with real cars."""

from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from benchmarks.hover_videos import Kind, make_hover_video
from benchmarks.synthetic.camera import HoverClip, render_frames
from benchmarks.synthetic.place import world_from_image
from benchmarks.synthetic.roads.layouts import PlaceKind
from benchmarks.synthetic.sample import HOVER, MARGIN, VIDEOS, make_sample
from benchmarks.synthetic.traffic.interpolation import interpolate_tracks
from benchmarks.tracking.real_cars import JUNCTIONS, film_junction
from geoaim.aim.aim import AIM
from geoaim.base.encode import write_video
from geoaim.base.geometry import transform_points
from geoaim.base.progress import no_progress
from geoaim.base.world import World
from geoaim.mapping.georeference.from_telemetry import make_local_georeference
from geoaim.mapping.pipeline import build_aim
from geoaim.tracks.tracks import Tracks

STILL_RESOLUTIONS = {"00003": 0.0525, "00972": 0.0555}  # metres per pixel; `detection.stills`
CAR_LENGTH_M = 6.0  # a longer vehicle of the stills is no car


@dataclass(frozen=True, eq=False)
class FilmedCase:
    """A video, the map that was built of it, and the true tracks at the times of its frames."""

    name: str
    video: Path
    aim: AIM  # built of the video, in the true world
    truth: Tracks
    frame_from_world: Float[Array, "T 3 3"]  # exact
    size: tuple[int, int]  # height and width of the frames, pixels
    # where cars may stand that are drawn with the ground, and are not in the tracks
    spots: Float[Array, "n 2"] = field(default_factory=lambda: np.empty((0, 2)))


def film_drawn(
    kind: PlaceKind,
    seed: int,
    folder: Path,
    *,
    seconds: float,
    frame_rate: float = HOVER.frame_rate,
) -> FilmedCase:
    """Film a drawn place in 1080p, and build its map.

    Args:
        kind: of the place.
        seed: of everything in it.
        folder: for the video.
        seconds: of video.
        frame_rate: frames per second.

    Returns:
        The case.
    """
    hover = replace(HOVER, count=round(seconds * frame_rate), frame_rate=frame_rate)
    minutes = max(seconds / 60, 0.2)
    sample = make_sample(seed, kind=kind, minutes=minutes, video=VIDEOS["1080p"], hover=hover)
    clip = sample.clip
    assert clip is not None
    model, recording = sample.traffic_model, sample.recordings[0]
    truth = interpolate_tracks(model, recording, sample.place, times=clip.times, margin=MARGIN)
    from_still = world_from_image(sample.place, sample.resolution)
    spots = np.array([spot.place for spot in sample.place.scenery.spots]).reshape(-1, 2)
    case = _encode(f"{kind} {seed}", clip, truth, from_still, folder)
    return replace(case, spots=transform_points(sample.place.world_from_plan, spots))


def film_still(still: str, kind: Kind, seed: int, folder: Path, *, count: int) -> FilmedCase:
    """Film a real still in 1080p with real cars on its lanes, and build its map.

    Args:
        still: "00003" or "00972".
        kind: of the difficulty, as `make_hover_video` names them.
        seed: of everything in it.
        folder: for the video.
        count: number of frames.

    Returns:
        The case.
    """
    clip = make_hover_video(still, size="1080p", count=count, kind=kind, seed=seed).clip
    return _film_cars(f"{still} {kind}", clip, STILL_RESOLUTIONS[still], folder)


def film_real_cars(
    place: str, condition: str, seed: int, folder: Path, *, count: int
) -> FilmedCase:
    """Film a real junction with its own cars, and build its map; see `film_junction`."""
    clip = film_junction(place, condition, seed, count=count)
    return _film_cars(f"{place} {condition}", clip, JUNCTIONS[place].resolution, folder)


def _film_cars(name: str, clip: HoverClip, resolution: float, folder: Path) -> FilmedCase:
    """Encode a clip of a still whose cars have no model behind them, with their true tracks."""
    scale = np.array([resolution, -resolution])
    from_still = np.diag([*scale, 1.0])
    poses = clip.traffic.poses.swapaxes(0, 1)
    present = np.asarray(np.isfinite(poses).all(axis=2))
    # a car that starts its lane again is another one
    jumps = np.hypot(*np.diff(poses[..., :2], axis=1).transpose(2, 0, 1)) > 100
    part = np.concatenate([np.zeros((len(poses), 1), int), np.cumsum(jumps, axis=1)], axis=1)
    rows = [(n, k) for n in range(len(poses)) for k in range(part[n].max() + 1)]
    agents = np.array([n for n, _ in rows])
    present = np.array([present[n] & (part[n] == k) for n, k in rows])
    states = np.full((*present.shape, 4), np.nan)
    metres = poses[agents][..., :2] * scale
    for row, known in enumerate(present):
        if known.sum() > 1:
            speed = np.hypot(*np.gradient(metres[row, known], clip.times[known], axis=0).T)
            states[row, known] = np.column_stack(
                [metres[row, known], poses[agents[row], known, 2], speed]
            )
    present = np.asarray(np.isfinite(states).all(axis=2))
    kept = np.flatnonzero(present.any(axis=1))
    sizes = clip.traffic.sizes[agents[kept]] * resolution
    truth = Tracks(
        times=clip.times,
        states=states[kept],
        present=present[kept],
        sizes=sizes,
        types=tuple("car" if length < CAR_LENGTH_M else "truck" for length in sizes[:, 0]),
        ids=tuple(str(k) for k in kept),
        world=World(None),
    )
    return _encode(name, clip, truth, from_still, folder)


def _encode(
    name: str, clip: HoverClip, truth: Tracks, from_still: Float[Array, "3 3"], folder: Path
) -> FilmedCase:
    """Encode a clip, and build its map on the true place of its first frame."""
    world_from_frame = from_still @ np.linalg.inv(clip.frame_from_background)
    world_from_frame = world_from_frame / world_from_frame[:, 2:, 2:]
    size = clip.height, clip.width
    path = folder / f"{name.replace(' ', '-')}.mp4"
    write_video(render_frames(clip), path, frame_rate=clip.hover.frame_rate, crf=26)
    local = make_local_georeference(resolution=1.0, size=size)
    aim = build_aim(path, local, progress=no_progress)
    reference = aim.report["registration"]["reference_index"]
    aim = replace(aim, world_from_image=world_from_frame[reference], world=truth.world)
    return FilmedCase(name, path, aim, truth, np.linalg.inv(world_from_frame), size)
