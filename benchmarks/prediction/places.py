"""Synthetic places for training and testing: written once, then read as any recording is."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

from benchmarks.synthetic import (
    draw_place,
    make_place,
    make_sample,
    tracks_of,
    world_from_image,
    write_sample,
)
from benchmarks.synthetic.roads.lanelet import make_lanelet_map
from benchmarks.synthetic.roads.layouts import PlaceKind
from benchmarks.synthetic.sample import HOVER, VIDEOS
from benchmarks.synthetic.traffic.signals import compute_light_states
from benchmarks.synthetic.video_files import write_video_files
from geoaim.aim.aim import AIM
from geoaim.aim.files import read_aim, write_aim
from geoaim.base.progress import Progress, no_progress, notebook_progress
from geoaim.hdmap.lanelet2 import HDMap, read_hdmap
from geoaim.hdmap.rasterize import draw_hdmap
from geoaim.imagery.alignment.pipeline import align_tiles
from geoaim.mapping.pipeline import build_aim
from geoaim.rendering.scene import Scene, make_scene
from geoaim.simulation.road_rules import RoadRules, make_road_rules
from geoaim.tracks.changes import resample_tracks
from geoaim.tracks.formats import read_tracks
from geoaim.tracks.lights import Lights, read_lights
from geoaim.tracks.tracks import Tracks

Places = Sequence[tuple[int, PlaceKind]]
KINDS_OF_ROADS: Sequence[PlaceKind] = (
    *("junction", "junction", "t", "roundabout", "junction"),
    *("street", "junction", "t", "junction", "roundabout"),
)
ROADS: Places = tuple(enumerate(KINDS_OF_ROADS, 201))
NEW_ROADS: Places = tuple(enumerate(KINDS_OF_ROADS[:4], 301))
PARKS: Places = ((241, "park"), (242, "park"), (243, "park"), (244, "park"))
NEW_PARKS: Places = ((341, "park"), (342, "park"))
CAMPUS: Places = ((251, "campus"), (252, "campus"), (253, "campus"), (254, "campus"))
NEW_CAMPUS: Places = ((351, "campus"), (352, "campus"))
# in parks and on campuses agents leave what HD maps show
TRAIN: Mapping[str, Places] = {"vehicle": (*ROADS, *CAMPUS), "pedestrian": (*ROADS, *PARKS)}
TEST: Mapping[str, Places] = {
    "vehicle": (*NEW_ROADS, *NEW_CAMPUS),
    "pedestrian": (*NEW_ROADS, *NEW_PARKS),
}
RECORDING_MINUTES = 10.0
RESOLUTION = 0.1  # metres per pixel of drawn places
LANES, FULL = "map.osm", "map_full.osm"  # lanes; walkways, car parks and private roads as well
DEGRADED_RESOLUTION = 1.0  # metres per pixel of blur and noise: that of vehicles' views
DRAWN_RESOLUTION = 0.25  # metres per pixel of maps that are not kept
FILMED_RESOLUTION = 0.2  # metres per pixel at which places are drawn to be filmed
VIDEO_FRAMES, VIDEO_RATE = 30, 3.0  # of the videos that maps are built from: ten seconds
NOISE = 0.2  # standard deviation, of full brightness, as in the paper


@dataclass(frozen=True, eq=False)
class PlaceRecording:
    """A recording at a synthetic place."""

    tracks: Tracks  # the agents
    lights: Lights | None  # states of the traffic lights, if any
    hdmap: HDMap  # lanes, private roads and car parks, and also walkways

    @cached_property
    def rules(self) -> RoadRules:
        """Where vehicles may drive."""
        return make_road_rules(self.hdmap)


def make_places(
    folder: Path, places: Places, *, progress: Progress = notebook_progress
) -> list[Path]:
    """Make places that are missing in a folder.

    Args:
        folder: folder of all places.
        places: seeds and kinds.
        progress: takes stage, done and total.

    Returns:
        The folder of each place.
    """
    paths = []
    for number, (seed, kind) in enumerate(places):
        progress("places", number, len(places))
        path = folder / f"{kind}_{seed}"
        if not (path / "README.md").exists():
            sample = make_sample(
                seed, kind=kind, minutes=RECORDING_MINUTES, video=None, resolution=RESOLUTION
            )
            write_sample(sample, path)
        paths.append(path)
    progress("places", len(places), len(places))
    return paths


@lru_cache(maxsize=len(TRAIN["pedestrian"]) + len(TEST["pedestrian"]))
def read_recordings(place: Path) -> tuple[PlaceRecording, ...]:
    """Read all recordings in a place's folder; they stay in memory for the next case."""
    recordings = []
    for path in sorted(place.glob("tracks*.csv")):
        tracks = read_tracks(path)
        hdmap = read_hdmap(place / FULL, tracks.world)
        lights_path = path.with_name(path.name.replace("tracks", "lights"))
        lights = None
        if lights_path.exists():
            lights = read_lights(lights_path, hdmap.stop_lines, tracks.world)
        recordings.append(PlaceRecording(tracks, lights, hdmap))
    return tuple(recordings)


def read_map(place: Path, name: str) -> AIM:
    """Read a map from a place's folder; maps that take long to make are kept there.

    XX
    (grey): a key of `MAPS`.

    Raises:
        ValueError: there is no such map.
    """
    if name not in MAPS:
        raise ValueError(f"there is no map {name!r}; there are {', '.join(MAPS)}")
    return MAPS[name](place)


def add_blur_and_noise(
    image: Float32[Array, "H W 3"], size: float, *, noise: float = NOISE
) -> Float32[Array, "H W 3"]:
    """Degrade an image (0 to 1) by blur and noise, as the paper does.

    Args:
        image: RGB.
        size: standard deviation of the Gaussian blur, and side of the squares that share one draw
            of Gaussian noise, pixels; the paper does not state it.
        noise: standard deviation of the noise, of full brightness.

    Returns:
        The degraded image.
    """
    blurred = cv2.GaussianBlur(image, (0, 0), size)
    height, width = image.shape[:2]
    squares = round(height / size), round(width / size)
    drawn = np.random.default_rng(0).normal(0, noise, (*squares, 3))
    resized = cv2.resize(drawn, (width, height), interpolation=cv2.INTER_NEAREST)
    return np.clip(blurred + resized, 0, 1).astype(np.float32)


def misplace_map(aim: AIM, *, shift: float = 0.0, scale: float = 1.0) -> AIM:
    """Place a map wrongly.

    Args:
        aim: the map.
        shift: metres by which it is moved to the north-east.
        scale: factor by which it is resized about its middle.

    Returns:
        The map.
    """
    matrix, middle = aim.world_from_image.copy(), aim.corners.mean(axis=0)
    matrix[:2] *= scale
    matrix[:2, 2] += (1 - scale) * middle + shift / np.sqrt(2)
    return replace(aim, world_from_image=matrix)


def make_place_scene(
    recording: PlaceRecording, aim: AIM, *, dt: float, lights: bool = True
) -> Scene:
    """Make the scene of a recording on a map of its place.

    Args:
        recording: agents and lights.
        aim: the result of `read_map`.
        dt: time between steps, s, to which tracks are resampled.
        lights: whether the scene has traffic lights.

    Returns:
        The scene.
    """
    return make_scene(
        aim, resample_tracks(recording.tracks, 1 / dt), recording.lights if lights else None
    )


def make_drawn_scene(
    kind: PlaceKind, seed: int, *, minutes: float = 1.0, dt: float = 0.1
) -> tuple[Scene, RoadRules]:
    """Make the traffic of a synthetic place, with its lights, on the map drawn from above.

    Nothing is written; `make_places` keeps longer recordings with imagery of several days.
    """
    sample = make_sample(seed, kind=kind, minutes=minutes, video=None)
    place, recording = sample.place, sample.recordings[0]
    with TemporaryDirectory() as folder:
        path = Path(folder) / LANES
        frame = place.roads, place.world_from_plan, place.world
        path.write_bytes(make_lanelet_map(*frame, complete=True))
        hdmap = read_hdmap(path, place.world)
    image = draw_place(place, resolution=DRAWN_RESOLUTION)
    matrix = world_from_image(place, DRAWN_RESOLUTION)
    aim = AIM.from_image(image, matrix, place.world, "drawn")
    tracks, lights = resample_tracks(tracks_of(sample), 1 / dt), None
    if names := tuple(line.signal for line in hdmap.stop_lines):
        states = compute_light_states(recording.signals, tracks.times)
        states = states[:, [*map(recording.signals.names.index, names)]]
        lines = np.array([line.ends for line in hdmap.stop_lines])
        lights = Lights(names, lines, tracks.times, states, hdmap.world)
    return make_scene(aim, tracks, lights), make_road_rules(hdmap)


def _read_background(place: Path) -> AIM:
    """The place from above without traffic, as the background of a drone video would show it."""
    path = place / "aim.tif"
    if not path.exists():
        kind, seed = place.name.rsplit("_", 1)
        made = make_place(int(seed), kind=kind)  # type: ignore[arg-type]
        image = draw_place(made, resolution=RESOLUTION)
        write_aim(
            AIM.from_image(image, world_from_image(made, RESOLUTION), made.world, "drawn"), path
        )
    return read_aim(path)


def _read_video(place: Path) -> AIM:
    """The map that `build_aim` makes of a video of the place, and of its control points."""
    path = place / "video.tif"
    if not path.exists():
        kind, seed = place.name.rsplit("_", 1)
        sample = make_sample(
            int(seed),
            kind=kind,  # type: ignore[arg-type]
            minutes=VIDEO_FRAMES / VIDEO_RATE / 60,
            hover=replace(HOVER, count=VIDEO_FRAMES, frame_rate=VIDEO_RATE),
            video=VIDEOS["720p"],
            resolution=FILMED_RESOLUTION,
        )
        assert sample.clip is not None
        with TemporaryDirectory() as folder:
            files = Path(folder)
            write_video_files(sample, sample.clip, files, no_progress)
            aim = build_aim(files / "hover.mp4", files / "gcps.csv", progress=no_progress)
        write_aim(aim, path)
    return read_aim(path)


def _read_degraded(place: Path) -> AIM:
    aim = _read_background(place)
    size = DEGRADED_RESOLUTION / aim.resolution
    image = add_blur_and_noise(aim.image.astype(np.float32) / 255, size)
    return replace(aim, image=np.rint(image * 255).astype(np.uint8))


def _read_another_day(place: Path) -> AIM:
    """An orthophoto of another day, aligned to the background."""
    path = place / "another_day.tif"
    if not path.exists():
        write_aim(align_tiles(place / "ortho.tif", aim=_read_background(place)), path)
    return read_aim(path)


def _read_grey(place: Path) -> AIM:
    aim = _read_background(place)
    return replace(aim, image=np.full_like(aim.image, 128))


def _read_annotations(place: Path, name: str) -> HDMap:
    return read_hdmap(place / name, _read_background(place).world)


MAPS: Mapping[str, Callable[[Path], AIM]] = {
    "aim": _read_background,
    "video": _read_video,
    "hdm": lambda place: draw_hdmap(_read_annotations(place, LANES)),
    "full": lambda place: draw_hdmap(_read_annotations(place, FULL)),
    "degraded": _read_degraded,
    "another day": _read_another_day,
    "none": _read_grey,
}
