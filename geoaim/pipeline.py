"""A video all the way: map, tracks, quick look, film and report, in one folder.

The order: the map (`geoaim.mapping`), its scale and place (`geoaim.detection.scale`,
`geoaim.imagery`), vehicles and tracks (`geoaim.tracking`), a film of them (`geoaim.rendering`).
"""

import json
import os
import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array

from geoaim.aim.aim import AIM
from geoaim.aim.files import write_aim
from geoaim.aim.quicklook import draw_quicklook
from geoaim.aim.rectification import rectify
from geoaim.base.errors import (
    GeoreferenceError,
    RegistrationError,
    TracksError,
    VideoError,
    collect_warnings,
)
from geoaim.base.files import (
    FILM_FILE,
    LOOK_FILE,
    MAP_FILE,
    REPORT_FILE,
    ROAD_FILES,
    TRACKS_FILE,
    atomic_folder,
    write_figure,
)
from geoaim.base.progress import Progress, notebook_progress, report_each
from geoaim.base.world import World
from geoaim.detection.scale import FRAMES, propose_scale
from geoaim.hdmap.lanelet2 import HDMap, read_hdmap
from geoaim.imagery.alignment.place_by_imagery import check_near, place_by_imagery
from geoaim.imagery.sources import Source
from geoaim.mapping.georeference.control_points import ControlPointSource
from geoaim.mapping.georeference.from_telemetry import make_local_georeference
from geoaim.mapping.pipeline import build_aim
from geoaim.mapping.video.detections import DetectionSource
from geoaim.mapping.video.video import Video, VideoSource, find_video_file, open_video
from geoaim.rendering.pictures import FILM_HEIGHT_PX, FILM_TRAIL_S, render_map_video, write_pictures
from geoaim.rendering.scene import make_scene
from geoaim.tracking.overlay import draw_on_video
from geoaim.tracking.pipeline import FollowedVideo, follow_video
from geoaim.tracking.report import WITHOUT_DETECTOR, summarize_tracking
from geoaim.tracking.sizes import get_typical_size
from geoaim.tracking.verdicts import (
    Verdict,
    judge_map,
    judge_scale,
    judge_tracks,
    measure_observed,
    measure_registration,
)
from geoaim.tracks.agent_types import select_group
from geoaim.tracks.changes import MAX_GAP_S, resample_tracks
from geoaim.tracks.files import write_tracks
from geoaim.tracks.formats.shared import check_resolution
from geoaim.tracks.lights import Lights, read_lights, read_stop_lines
from geoaim.tracks.tracks import Tracks

FILM_RATE = 10.0  # pictures per second
MIN_PREDICTED_S = 1.0  # observed seconds from which models predict
MIN_TRAINING_S = 60.0  # of tracks from which a model is trained with profit
MIN_TRAINING_AGENTS = 7  # one of seven is held out


@dataclass(frozen=True)
class PlacedVideo:
    """What became of a video.

    Attributes:
        aim: its map.
        tracks: tracks of its agents; None: none was found, and `missing` says why.
        known: what is known and how surely, by name.
        missing: what is not, by what it would be needed for, with the command that helps.
        verdicts: how far the map, its scale and the tracks can be used, and by what that is judged.
        shares: of the boxes that are in no track, of the vehicles' states that predictions can
            start from, and of the tracks that are expected to be right; with the registration in
            metres.
        warnings: every warning on the way.
    """

    aim: AIM
    tracks: Tracks | None
    known: dict[str, str]
    missing: dict[str, str]
    verdicts: dict[str, Verdict] = field(default_factory=dict)
    shares: dict[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True)
class Evidence:
    """What is known of a video beside its frames; all may be missing.

    Attributes:
        points: control points, as `read_control_points` reads them.
        imagery: an orthophoto or tiles of the place, as `read_imagery` reads them.
        near: latitude and longitude of the frame's middle, degrees, to within 35 m.
        imagery_accuracy: standard deviation of the imagery's own place, metres, as `accuracy` of
            `place_by_imagery`.
        detections: boxes of vehicles, as `read_detections` reads them.
        frame_resolution: metres per pixel of the frames.
        lights: states of traffic lights, as `read_lights` reads them, from the video's start on.
        hdmap: a lanelet2 map of the place, which has the lights' stop lines, and the lanes of
            vehicles that never move.
        stop_lines: stop lines drawn by hand, in place of those of `hdmap`.
    """

    points: ControlPointSource | None = None
    imagery: Source | Sequence[Source] | None = None
    near: tuple[float, float] | None = None
    imagery_accuracy: float | None = None
    detections: DetectionSource | None = None
    frame_resolution: float | None = None
    lights: str | os.PathLike[str] | None = None
    hdmap: str | os.PathLike[str] | None = None
    stop_lines: str | os.PathLike[str] | None = None


def place_video(
    video: VideoSource,
    folder: str | os.PathLike[str],
    evidence: Evidence | None = None,
    *,
    progress: Progress = notebook_progress,
) -> PlacedVideo:
    """Make a map of a video, track its vehicles, and write all of it into a new folder.

    The map is placed by control points, by imagery or by the telemetry beside the video. Without
    any of these it lies in a plane of its own, at the scale at which vehicles look like vehicles.

    Args:
        video: what `open_video` opens.
        folder: a new folder for map.tif, map.png, tracks.csv, film.mp4 (the video beside the map)
            and report.json, and for what is known of lights and roads.
        evidence: what is known beside the frames; None: nothing.
        progress: called with the stage, how much is done and how much there is.

    Returns:
        The map and the tracks, with what is known and what is missing. Where no boxes are given and
        no vehicle is found, the folder has neither tracks nor film.

    Raises:
        VideoError: the video cannot be read or has one frame only.
        GeoaimError: as of `build_aim`, `place_by_imagery` and `track_video`.
        ValueError: the folder holds files, or the evidence contradicts itself.
    """
    evidence = evidence or Evidence()
    with collect_warnings() as warnings:
        opened = open_video(video)
        if opened.frame_count == 1:
            raise VideoError(
                f"{opened.source} has one frame, in which nothing moves; geoaim build makes a map "
                "of it"
            )
        _check(evidence, opened)
        with atomic_folder(folder) as temporary:
            return _place(opened, temporary, evidence, warnings, progress)


def _place(
    video: Video, folder: Path, evidence: Evidence, warnings: list[str], progress: Progress
) -> PlacedVideo:
    """Do what `place_video` does, in a folder that is there; warnings are added to the list."""
    built = _build(video, evidence, progress)
    aim = built if built.is_affine else rectify(built)  # as `write_aim` writes it
    of_map = tuple(warnings)
    write_aim(aim, folder / MAP_FILE)
    write_figure(draw_quicklook(aim), folder / LOOK_FILE)
    hdmap, lights = _copy_roads(evidence, aim.world, folder)
    followed, reason = _track(video, built, evidence, hdmap, progress)
    of_tracks = tuple(warnings[len(of_map) :])
    tracks = None if followed is None else followed.tracks
    if followed is not None:
        write_tracks(followed.tracks, folder / TRACKS_FILE)
        _film(aim, followed, lights, folder / FILM_FILE, video, progress)
    placed = _report(aim, tracks, evidence, reason)
    if lights is not None:
        placed.known.update({f"lights: {k}": v for k, v in lights.summarize().items()})
    placed = _judge(placed, followed, (of_map, of_tracks))
    _write_report(placed, video, folder / REPORT_FILE)
    return placed


def _judge(
    placed: PlacedVideo,
    followed: FollowedVideo | None,
    warnings: tuple[tuple[str, ...], tuple[str, ...]],
) -> PlacedVideo:
    """Add verdicts by what is measured and by the warnings of the map and of the tracks."""
    aim = placed.aim
    verdicts = {
        "map": judge_map(aim, warnings[0]),
        "scale": judge_scale(aim, placed.tracks),
        "tracks": Verdict("unusable", (placed.missing.get("tracks", ""),)),
    }
    shares = {"registration_m": measure_registration(aim)}
    if followed is not None:
        interval = float(np.median(np.diff(followed.poses.times)))
        judged = judge_tracks(interval, followed.unused, followed.certainty, warnings[1])
        if verdicts["map"].grade == "unusable":
            judged = Verdict("unusable", ("the map that they lie on is", *judged.by))
        elif followed.certainty is not None and verdicts["scale"].grade == "unusable":
            judged = Verdict("unusable", ("their scale is", *judged.by))
        verdicts["tracks"] = judged
        shares |= {"unused_boxes": followed.unused, "observed": measure_observed(followed.tracks)}
        shares["expected_right"] = followed.certainty
    rounded = {name: round(value, 4) for name, value in shares.items() if value is not None}
    known = {f"verdict: {name}": str(verdict) for name, verdict in verdicts.items()}
    return replace(
        placed,
        known=known | placed.known,
        verdicts=verdicts,
        shares=rounded,
        warnings=(*warnings[0], *warnings[1]),
    )


def _write_report(placed: PlacedVideo, video: Video, path: Path) -> None:
    parts = ("verdicts", "shares", "known", "missing", "warnings")
    content: dict[str, Any] = {name: getattr(placed, name) for name in parts}
    file = find_video_file(video.source)  # which `geoaim view` shows beside the map
    content["video"] = None if file is None else str(file)
    content["verdicts"] = {name: asdict(one) for name, one in placed.verdicts.items()}
    path.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def _check(evidence: Evidence, video: Video) -> None:
    places = evidence.hdmap, evidence.stop_lines
    if evidence.lights is not None and places == (None, None):
        raise ValueError("lights need an HD map or stop lines, for their places")
    if evidence.stop_lines is not None and evidence.lights is None:
        raise ValueError("stop lines need lights, for their states")
    if evidence.frame_resolution is not None:
        _check_resolution(evidence.frame_resolution)
    if evidence.imagery is None:
        if evidence.near is not None or evidence.imagery_accuracy is not None:
            raise ValueError("near and imagery_accuracy need imagery, which places the map")
        return
    if evidence.points is not None:
        raise ValueError("control points and imagery both place the map; give one")
    if evidence.near is None and video.telemetry is None:
        raise ValueError(
            f"{video.source} has no telemetry, so that the imagery is not searched; give latitude "
            "and longitude of the frame's middle (--near, near=)"
        )
    if evidence.near is not None:
        check_near(evidence.imagery, evidence.near)


def _check_resolution(resolution: float) -> None:
    """Refuse a resolution at which a car is narrower than a pixel."""
    check_resolution(resolution)
    if resolution > (width := get_typical_size("car")[1]):
        raise ValueError(
            f"a frame resolution of {resolution:g} m per pixel: a car is {width:g} m wide, and "
            "nothing narrower than a pixel is found"
        )


def _build(video: Video, evidence: Evidence, progress: Progress) -> AIM:
    """Build the map, in the pixels of its reference frame, in its place where that is known."""
    chosen: dict[str, Any] = {"detections": evidence.detections, "progress": progress}
    size = video.height, video.width
    if evidence.frame_resolution is not None:
        local = make_local_georeference(resolution=evidence.frame_resolution, size=size)
        aim = build_aim(video, local, **chosen)
    else:
        try:
            aim = build_aim(video, evidence.points, **chosen)
        except GeoreferenceError:
            if evidence.points is not None:
                raise
            aim = _build_by_vehicles(video, chosen)
    if evidence.imagery is None:
        return aim
    return place_by_imagery(
        aim,
        evidence.imagery,
        near=evidence.near,
        accuracy=evidence.imagery_accuracy,
        progress=progress,
    )


def _build_by_vehicles(video: Video, chosen: dict[str, Any]) -> AIM:
    """Build a map in a plane of its own, at the scale at which vehicles look like vehicles."""
    images = [frame.image for frame in video.sample(FRAMES)]
    scale = propose_scale(images, progress=chosen["progress"])
    size = video.height, video.width
    aim = build_aim(
        video, make_local_georeference(resolution=scale.resolution, size=size), **chosen
    )
    proposed = {"vehicles": scale.vehicles, "sigma": scale.sigma}
    georeference = {**aim.report["georeference"], "scale_by_vehicles": proposed}
    return replace(aim, report={**aim.report, "georeference": georeference})


def _copy_roads(
    evidence: Evidence, world: World, folder: Path
) -> tuple[HDMap | None, Lights | None]:
    """Read lights and roads in the map's world, and copy their files for other commands."""
    hdmap = None if evidence.hdmap is None else read_hdmap(evidence.hdmap, world)
    lights = None
    if evidence.lights is not None:
        lines = () if hdmap is None else hdmap.stop_lines
        if evidence.stop_lines is not None:
            lines = read_stop_lines(evidence.stop_lines, world)
        lights = read_lights(evidence.lights, lines, world)
    for name, file in ROAD_FILES.items():
        if (source := getattr(evidence, name)) is not None:
            shutil.copyfile(source, folder / file)
    return hdmap, lights


def _track(
    video: Video, aim: AIM, evidence: Evidence, hdmap: HDMap | None, progress: Progress
) -> tuple[FollowedVideo | None, str]:
    """Track the vehicles; with why there is none, unless the boxes of a detector were given."""
    try:
        followed = follow_video(video, aim, evidence.detections, hdmap, None, progress)
        if evidence.detections is None:
            followed = replace(followed, tracks=_fill(followed.tracks))
        return followed, ""
    except (TracksError, RegistrationError) as error:
        if evidence.detections is not None:
            raise
        return None, str(error)


def _film(
    aim: AIM,
    followed: FollowedVideo,
    lights: Lights | None,
    path: Path,
    video: Video,
    progress: Progress,
) -> None:
    """Write a film of the tracks on the video, and beside it on the map, with the lights."""
    tracks = followed.tracks
    rate = 1 / float(np.median(np.diff(tracks.times)))
    if rate > FILM_RATE:
        tracks, rate = resample_tracks(tracks, FILM_RATE), FILM_RATE
    on_video = draw_on_video(
        video, followed.poses, tracks, height=FILM_HEIGHT_PX, trail=FILM_TRAIL_S
    )
    on_map = render_map_video(make_scene(aim, tracks, lights), aim)
    pictures = (_put_beside(*pair) for pair in zip(on_video, on_map, strict=True))
    reported = report_each(pictures, progress, "film", len(tracks.times))
    write_pictures(reported, path, frame_rate=rate)


def _fill(tracks: Tracks) -> Tracks:
    """Resample tracks to the rate of the film, unless their states are too far apart."""
    is_close = np.median(np.diff(tracks.times)) <= MAX_GAP_S
    return resample_tracks(tracks, FILM_RATE) if is_close else tracks


def _put_beside(one: UInt8[Array, "h w 3"], other: UInt8[Array, "H W 3"]) -> UInt8[Array, "_ _ 3"]:
    """Put a picture beside another one, black where one of them is lower."""
    height = max(len(one), len(other))
    both = np.zeros((height, one.shape[1] + other.shape[1], 3), np.uint8)
    both[: len(one), : one.shape[1]], both[: len(other), one.shape[1] :] = one, other
    return both


def _report(aim: AIM, tracks: Tracks | None, evidence: Evidence, reason: str) -> PlacedVideo:
    """Collect what is known, how surely, and what is missing for what."""
    known, missing = dict(aim.summarize()), {}
    if aim.world.crs is None:
        missing["a place in the world"] = (
            "give an orthophoto (--imagery ortho.tif --near LATITUDE,LONGITUDE) or control points "
            "(--points; geoaim pick VIDEO)"
        )
        if evidence.frame_resolution is None:
            missing["an exact scale"] = "it is that of vehicles; --frame-resolution gives it"
    if tracks is None:
        missing["tracks"] = f"{reason}; give the boxes of a detector (--detections)"
        return PlacedVideo(aim, None, known, missing)
    known |= {f"tracks: {name}": text for name, text in summarize_tracking(tracks, aim).items()}
    del known["tracks: world"]
    if evidence.detections is None:
        known["tracks: detections"] = WITHOUT_DETECTOR
    seconds = float(tracks.times[-1] - tracks.times[0])
    vehicles = int(select_group(tracks.types, "vehicle").sum())
    needs = {"prediction": (MIN_PREDICTED_S, 1), "training": (MIN_TRAINING_S, MIN_TRAINING_AGENTS)}
    for name, (duration, count) in needs.items():
        if seconds < duration or vehicles < count:
            missing[name] = (
                f"it needs {duration:g} s and {count} vehicles, and these are {seconds:.0f} s "
                f"and {vehicles}: film longer"
            )
    return PlacedVideo(aim, tracks, known, missing)
