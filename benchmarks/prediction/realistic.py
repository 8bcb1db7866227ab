"""Recordings and maps of synthetic places as detectors, drones and other sources give them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from benchmarks.prediction.places import (
    PlaceRecording,
    add_blur_and_noise,
    make_place_scene,
    read_map,
    read_recordings,
)
from benchmarks.synthetic import draw_place, make_place, world_from_image
from benchmarks.synthetic.imagery import make_other_day
from geoaim.aim.aim import AIM
from geoaim.aim.files import read_aim, write_aim
from geoaim.base.progress import Progress, notebook_progress
from geoaim.prediction.config import Config
from geoaim.prediction.dataset import Dataset, make_dataset
from geoaim.rendering.scene import Scene
from geoaim.tracks.changes import cut_tracks
from geoaim.tracks.formats.motion import derive_motion
from geoaim.tracks.tracks import Tracks

RATE = 10.0  # Hz, of the tracks of synthetic places
PIECE_S = 100.0  # of a recording, as one scene
# agents who stand all the time, added to a recording, by their type; none within CLEARANCE_M of
# where others ever are
STANDING: Mapping[str, int] = {"car": 24, "van": 4, "pedestrian": 12}
STANDING_SIZES: Mapping[str, tuple[float, float]] = {
    "car": (4.5, 1.8),
    "van": (5.5, 2.0),
    "pedestrian": (0.5, 0.5),
}
CLEARANCE_M = 1.8
MAX_ROW, ROW_PITCH_M = 5, 2.7  # most vehicles side by side; from one to the next
STANDING_S = 30.0  # for which each of them is seen
# standard deviations of detections, drawn for each recording: of each position alone, and of an
# error that changes over DRIFT_S, as by a box that takes the shadow in; and of lengths and widths
WHITE_M, DRIFT_M, DRIFT_S = (0.01, 0.06), (0.03, 0.15), 1.0
# seconds by which an agent is seen too early or late, in half of the recordings, and over which
# that changes: as where frames are doubled or detections come late
TIMING_S, TIMING_DRIFT_S = (0.0, 0.08), 0.3
SIZE_NOISE = 0.08  # as a share
STILL_SPEED = 0.3  # m/s; who is slower stands
HALF_WINDOW_S = 0.25  # over which headings and speeds are differenced, as of geo-trax
# metres of blur, and standard deviation of noise, of full brightness, of a bad map
BLUR_M, MAP_NOISE = (0.2, 1.2), (0.02, 0.2)
LATER_RESOLUTION = 0.2  # metres per pixel at which places are drawn on another day
# maps of the recordings with exact states, and of those with noisy ones
EXACT_MAPS = ("drawn", "later")
NOISY_MAPS = ("video", "bad", "bad later", "lanes", "later", "bad", "bad later", "lanes")


def make_realistic_dataset(
    train: Sequence[Path],
    val: Sequence[Path],
    config: Config,
    *,
    progress: Progress = notebook_progress,
) -> Dataset:
    """Make a dataset of synthetic places with standing agents, noise and maps of all sorts.

    Each recording is there twice: with exact states, and as a detector finds it.

    Args:
        train: folders of places to train on.
        val: folders of other places, to validate with.
        config: configuration of the model.
        progress: takes stage, done and total.

    Returns:
        Segments of all places, and their maps.
    """
    parts = [make_scenes(places, config.dt, progress=progress) for places in (train, val)]
    return make_dataset(parts[0], config, val_scenes=parts[1], progress=progress)


def make_scenes(
    places: Sequence[Path], dt: float, *, progress: Progress = notebook_progress
) -> list[Scene]:
    """Make four scenes of each place: two recordings, exact and noisy, each on another map.

    Args:
        places: folders of synthetic places.
        dt: time between steps, s.
        progress: takes stage, done and total.

    Returns:
        The scenes, place by place.
    """
    scenes = []
    for number, place in enumerate(places):
        progress("places", number, len(places))
        generator = np.random.default_rng([int(place.name.rsplit("_", 1)[1]), 50])
        for index, recording in enumerate(read_recordings(place)[:2]):
            exact, noisy = (
                add_standing(cut_tracks(recording.tracks, start, PIECE_S), generator)
                for start in (0.0, PIECE_S)
            )
            noisy = add_detection_noise(noisy, generator)
            noisy_map = NOISY_MAPS[(2 * number + index) % len(NOISY_MAPS)]
            for tracks, name in ((exact, EXACT_MAPS[index]), (noisy, noisy_map)):
                one = PlaceRecording(tracks, recording.lights, recording.hdmap)
                scenes.append(make_place_scene(one, read_realistic_map(place, name), dt=dt))
    return scenes


def add_standing(tracks: Tracks, generator: np.random.Generator) -> Tracks:
    """Add agents who stand where no other agent ever is; each is seen for `STANDING_S`.

    Vehicles stand in rows of one or more, as in a car park. Half of the rows are turned as the
    nearest path, as beside a road, the others anyhow.

    Args:
        tracks: a recording.
        generator: source of places and directions.

    Returns:
        The recording with `STANDING` more agents, or fewer where there is no room.
    """
    paths = tracks.states[tracks.present][::2]
    low, high = paths[:, :2].min(axis=0), paths[:, :2].max(axis=0)
    poses, kinds, starts = np.empty((0, 3)), list[str](), list[float]()
    for kind, count in STANDING.items():
        reach = CLEARANCE_M + max(STANDING_SIZES[kind]) / 4
        wanted = len(kinds) + count
        for place in generator.uniform(low, high, (20 * count, 2)):
            row = _draw_row(place, kind, paths, generator)[: wanted - len(kinds)]
            for others in (paths, poses):
                away = np.hypot(*(others[:, None, :2] - row[:, :2]).T) > reach  # (row, others)
                row = row[away.all(axis=1)]
            poses = np.vstack([poses, row])
            kinds += [kind] * len(row)
            latest = tracks.times[-1] - STANDING_S
            starts += [generator.uniform(tracks.times[0], latest)] * len(row)
            if len(kinds) == wanted:
                break
    states = np.concatenate([poses, np.zeros((len(poses), 1))], axis=1)[:, None]
    start = np.array(starts)[:, None]
    present = (tracks.times >= start) & (tracks.times <= start + STANDING_S)
    states = np.where(present[..., None], states, np.nan)
    sizes = np.array([STANDING_SIZES[kind] for kind in kinds]).reshape(-1, 2)
    return replace(
        tracks,
        states=np.concatenate([tracks.states, states]),
        present=np.concatenate([tracks.present, present]),
        sizes=np.concatenate([tracks.sizes, sizes]),
        types=(*tracks.types, *kinds),
        ids=(*tracks.ids, *(f"standing {number}" for number in range(len(kinds)))),
    )


def add_detection_noise(tracks: Tracks, generator: np.random.Generator) -> Tracks:
    """Replace states by what a detector gives: noisy positions, and what follows from them.

    Args:
        tracks: a recording at `RATE`.
        generator: source of the noise.

    Returns:
        Tracks whose headings and speeds come from their noisy positions; sizes are noisy too. Who
        stands keeps the heading, as a tracker has it: by noise alone it would turn at random.
    """
    white, drift = generator.uniform(*WHITE_M), generator.uniform(*DRIFT_M)
    shape = *tracks.present.shape, 2
    noise = white * generator.standard_normal(shape)
    noise += drift * _draw_drift(shape, DRIFT_S, generator)
    timing = generator.choice([0.0, generator.uniform(*TIMING_S)])
    late = timing * _draw_drift(tracks.present.shape, TIMING_DRIFT_S, generator)
    states = tracks.states.copy()
    heading, speed = states[..., 2], states[..., 3]
    noise -= (late * speed)[..., None] * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    states[..., :2] += noise
    sizes = tracks.sizes * (1 + SIZE_NOISE * generator.standard_normal(tracks.sizes.shape))
    noisy = replace(tracks, states=states, sizes=np.maximum(sizes, 0.5 * tracks.sizes))
    noisy = derive_motion(noisy, half_window=HALF_WINDOW_S)
    assert noisy.observed is not None
    stands = np.nan_to_num(np.abs(tracks.states[..., 3])) < STILL_SPEED
    for some in (noisy.states, noisy.observed):
        held = stands & np.isfinite(some[..., 2])
        some[held, 2] = tracks.states[held, 2]
    return noisy


def read_realistic_map(place: Path, name: str) -> AIM:
    """Read or make a map of a place.

    `name` is "drawn", "later" (drawn on another day), "video" (built from a video), "bad" and "bad
    later" (blurred and noisy, of either day), or "lanes" (the HD map).
    """
    readers: dict[str, Callable[[Path], AIM]] = {
        "drawn": lambda place: read_map(place, "aim"),
        "later": _read_later,
        "video": lambda place: read_map(place, "video"),
        "bad": lambda place: _spoil(place, read_map(place, "aim")),
        "bad later": lambda place: _spoil(place, _read_later(place)),
        "lanes": lambda place: read_map(place, "hdm"),
    }
    return readers[name](place)


def _draw_row(
    place: Float[Array, "2"], kind: str, paths: Float[Array, "_ 4"], generator: np.random.Generator
) -> Float[Array, "_ 3"]:
    """Draw the poses of vehicles side by side, or of one pedestrian."""
    along = paths[np.hypot(*(paths[:, :2] - place).T).argmin(), 2]
    turn = generator.choice([along, generator.uniform(-np.pi, np.pi)])
    length = 1 if kind == "pedestrian" else generator.integers(1, MAX_ROW + 1)
    steps = ROW_PITCH_M * np.arange(length)
    points = place + steps[:, None] * [-np.sin(turn), np.cos(turn)]
    return np.column_stack([points, np.full(length, turn)])


def _draw_drift(
    shape: tuple[int, ...], seconds: float, generator: np.random.Generator
) -> Float[Array, "N T *_"]:
    """Draw errors of unit variance that change over some time (Ornstein and Uhlenbeck 1930)."""
    keep = np.exp(-1 / (RATE * seconds))
    drift = generator.standard_normal(shape)
    for step in range(1, shape[1]):
        drift[:, step] = keep * drift[:, step - 1] + np.sqrt(1 - keep**2) * drift[:, step]
    return drift


def _spoil(place: Path, aim: AIM) -> AIM:
    """Blur a map and add noise, by an amount that each place draws."""
    generator = np.random.default_rng([int(place.name.rsplit("_", 1)[1]), 51])
    size, noise = generator.uniform(*BLUR_M) / aim.resolution, generator.uniform(*MAP_NOISE)
    image = add_blur_and_noise(aim.image.astype(np.float32) / 255, size, noise=noise)
    return replace(aim, image=np.rint(image * 255).astype(np.uint8))


def _read_later(place: Path) -> AIM:
    path = place / "later.tif"
    if not path.exists():
        kind, seed = place.name.rsplit("_", 1)
        made = make_place(int(seed), kind=kind)  # type: ignore[arg-type]
        image = draw_place(made, make_other_day(made), resolution=LATER_RESOLUTION)
        matrix = world_from_image(made, LATER_RESOLUTION)
        write_aim(AIM.from_image(image, matrix, made.world, "drawn on another day"), path)
    return read_aim(path)
