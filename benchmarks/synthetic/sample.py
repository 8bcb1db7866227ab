"""A synthetic place, its recordings, and what a drone filmed of the first one."""

from dataclasses import dataclass, replace

import numpy as np

from benchmarks.synthetic.camera import Hover, HoverClip, SpriteTracks, film
from benchmarks.synthetic.compositing import compute_image_poses, draw_agents
from benchmarks.synthetic.place import RESOLUTION, Place, draw_place, make_place
from benchmarks.synthetic.roads.layouts import PlaceKind
from benchmarks.synthetic.scenery.day import Day, compute_shadow_offset
from benchmarks.synthetic.scenery.objects import CAR_HEIGHT_M
from benchmarks.synthetic.traffic.interpolation import interpolate_tracks
from benchmarks.synthetic.traffic.simulate import (
    TrafficModel,
    TrafficRecording,
    prepare_traffic,
    simulate_traffic,
)
from geoaim.tracks.tracks import Tracks

VIDEOS = {"720p": (720, 1280), "1080p": (1080, 1920), "4k": (2160, 3840)}
HOVER = Hover(
    count=300,
    frame_rate=25.0,
    drift=14.0,
    yaw=0.008,
    zoom=0.003,
    perspective=1.0,
    vibration=0.3,
    blur=0.6,
    noise=1.5,
    exposure=0.02,
)
RATE = 10.0  # Hz, of the tracks
LONGEST = 300.0  # s, of one recording
EARLY_YELLOW = 1.5  # s of the first recording after which the main road's light turns yellow
MARGIN = 10.0  # m past the page where vehicles are still filmed, so that none pops up in view
TRAFFIC, FLOW, CAMERA, COLOURS = 10, 11, 20, 21  # streams of random numbers


@dataclass(frozen=True, eq=False)
class Sample:
    """A synthetic place, its recordings, and what a drone filmed of the first one."""

    place: Place  # the place
    traffic_model: TrafficModel  # what its traffic is simulated from
    recordings: tuple[TrafficRecording, ...]  # one after the other, each of at most five minutes
    clip: HoverClip | None  # video of the first recording, from its start; None without a video
    resolution: float  # resolution at which the place is drawn, metres per pixel


def make_sample(
    seed: int,
    *,
    kind: PlaceKind = "junction",
    minutes: float = 1.0,
    video: tuple[int, int] | None = VIDEOS["720p"],
    hover: Hover = HOVER,
    resolution: float = RESOLUTION,
) -> Sample:
    """Make a place and simulate its traffic; `render_frames(sample.clip)` renders its video.

    Args:
        seed: the same seed gives the same data and rendered frames on every machine.
        kind: "junction", "t", "roundabout", "street", "park" or "campus".
        minutes: duration of the traffic, in recordings of at most five minutes.
        video: height and width of its frames, pixels; None for no video.
        hover: the drone's camera.
        resolution: metres per pixel of the drawn place, 0.05 to 0.2.

    Returns:
        The sample.

    Raises:
        ValueError: there is no such kind, less traffic than video, or more video than fits in one
            recording.
    """
    if not 1 / 60 <= minutes < np.inf:
        raise ValueError(f"{minutes:g} minutes of traffic; at least a second is needed")
    if video is not None and (
        len(video) != 2 or not all(isinstance(n, int) and n > 0 for n in video)
    ):
        raise ValueError(f"video is {video!r}; a height and a width in pixels are needed")
    filmed = hover.count / hover.frame_rate if video is not None else 0.0
    if filmed > LONGEST:
        raise ValueError(f"{filmed:g} s of video; a recording has at most {LONGEST:g} s")
    if 60 * minutes < filmed:
        raise ValueError(
            f"{minutes:g} minutes of traffic are shorter than the video; at least "
            f"{filmed / 60:.2f} are needed"
        )
    place = make_place(seed, kind=kind)
    model = prepare_traffic(place.roads, np.random.default_rng([seed, FLOW]))
    recordings = tuple(
        _simulate_recording(model, number, min(LONGEST, 60 * minutes - number * LONGEST), seed)
        for number in range(int(np.ceil(60 * minutes / LONGEST)))
    )
    clip = None
    if video is not None:
        times = np.arange(hover.count) / hover.frame_rate
        tracks = interpolate_tracks(model, recordings[0], place, times=times, margin=MARGIN)
        clip = _film_place(place, tracks, hover, video, resolution)
    return Sample(place, model, recordings, clip, resolution)


def tracks_of(sample: Sample, number: int = 0) -> Tracks:
    """Interpolate the tracks of recording `number` at 10 Hz, in the place's world."""
    place, recording = sample.place, sample.recordings[number]
    times = np.arange(int(recording.times[-1] * RATE + 1e-9) + 1) / RATE
    return interpolate_tracks(sample.traffic_model, recording, place, times=times)


def _simulate_recording(
    model: TrafficModel, number: int, seconds: float, seed: int
) -> TrafficRecording:
    """Simulate a recording; the first one's lights change early, for short videos."""
    generator = np.random.default_rng([seed, TRAFFIC, number])
    cycle = model.signals.cycle
    early = model.signals.green[0][1] - EARLY_YELLOW if cycle else 0.0
    phase = early if number == 0 else generator.uniform(0, 1) * cycle
    signals = replace(model.signals, phase=float(phase))
    return simulate_traffic(replace(model, signals=signals), duration=seconds, generator=generator)


def _film_place(
    place: Place, tracks: Tracks, hover: Hover, size: tuple[int, int], resolution: float
) -> HoverClip:
    """Plan a clip of a place on day 0, with the traffic at the times of the frames."""
    shadow = CAR_HEIGHT_M * compute_shadow_offset(Day()) / resolution
    traffic = SpriteTracks(
        sprites=draw_agents(tracks, resolution, np.random.default_rng([place.seed, COLOURS])),
        sizes=tracks.sizes / resolution,
        poses=compute_image_poses(place, tracks, resolution),
        shadow=(float(shadow[0]), float(-shadow[1])),
        types=tracks.types,
    )
    generator = np.random.default_rng([place.seed, CAMERA])
    still = draw_place(place, resolution=resolution)
    return film(still, traffic, hover, height=size[0], width=size[1], generator=generator)
