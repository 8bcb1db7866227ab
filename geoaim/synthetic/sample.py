"""A made place, its recordings, and what a drone filmed of the first one."""

from dataclasses import dataclass, replace

import numpy as np

from geoaim.synthetic.camera import HoverClip
from geoaim.synthetic.filming import film_place
from geoaim.synthetic.hover import Hover
from geoaim.synthetic.place import RESOLUTION, Place, make_place
from geoaim.synthetic.roads.layouts import PlaceKind
from geoaim.synthetic.scenery.day import Day
from geoaim.synthetic.traffic.interpolation import interpolate_tracks
from geoaim.synthetic.traffic.simulate import (
    TrafficModel,
    TrafficRecording,
    prepare_traffic,
    simulate_traffic,
)
from geoaim.tracks import Tracks

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
TRAFFIC, FLOW = 10, 11  # streams of random numbers


@dataclass(frozen=True, eq=False)
class Sample:
    """A made place, its recordings, and what a drone filmed of the first one.

    Attributes:
        place: the place.
        traffic_model: what its traffic is simulated from.
        recordings: one after the other, each of at most five minutes.
        clip: video of the first recording, from its start; None without a video.
        resolution: at which the place is drawn.
    """

    place: Place
    traffic_model: TrafficModel
    recordings: tuple[TrafficRecording, ...]
    clip: HoverClip | None
    resolution: float


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
        seed: the same seed gives the same numbers and frames on every machine.
        kind: "junction", "t", "roundabout", "street", "park" or "campus".
        minutes: duration of the traffic.
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
    if 60 * minutes < max(filmed, 1.0):
        raise ValueError(
            f"{minutes:g} minutes of traffic; at least {max(filmed, 1) / 60:.2f} needed"
        )
    place = make_place(seed, kind=kind)
    model = prepare_traffic(place.roads, np.random.default_rng([seed, FLOW]))
    recordings = tuple(
        _simulate_recording(model, number, min(LONGEST, 60 * minutes - number * LONGEST), seed)
        for number in range(int(np.ceil(60 * minutes / LONGEST)))
    )
    clip = None
    if video is not None:
        given = place.world_from_plan, place.world
        times = np.arange(hover.count) / hover.frame_rate
        tracks = interpolate_tracks(model, recordings[0], *given, times=times, margin=MARGIN)
        clip = film_place(place, Day(), tracks, hover, size=video, resolution=resolution)
    return Sample(place, model, recordings, clip, resolution)


def tracks_of(sample: Sample, number: int = 0) -> Tracks:
    """Return the tracks of a recording, 10 per second."""
    place, recording = sample.place, sample.recordings[number]
    times = np.arange(int(recording.times[-1] * RATE + 1e-9) + 1) / RATE
    return interpolate_tracks(
        sample.traffic_model, recording, place.world_from_plan, place.world, times=times
    )


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
