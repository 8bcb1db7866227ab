"""Transform tracks in pixels of a video's frames to the world of its map."""

from dataclasses import replace

import numpy as np

from geoaim.base.errors import TracksError
from geoaim.base.geometry import transform_points
from geoaim.mapping.georeference.georeference import Georeference, world_from_pixels
from geoaim.mapping.registration.register import Registration
from geoaim.tracks.formats.motion import derive_motion
from geoaim.tracks.tracks import Tracks

# largest difference between the times of a track and its frame: half a frame at 25 Hz
MAX_TIME_OFFSET_S = 0.02


def place_tracks(
    tracks: Tracks,
    registration: Registration,
    georeference: Georeference,
    *,
    resolution: float,
    frame_rate: float | None = None,
    half_window: float = 0.5,
) -> Tracks:
    """Transform tracks in pixels of a video's frames to the world of its map.

    Args:
        tracks: tracks as the readers of files in pixels return them: x is u and y is -v of each
            frame, times `resolution`; the times are those of the video.
        registration: registration of all frames of the video to the georeferenced frame.
        georeference: georeference of that frame.
        resolution: metres per pixel with which the tracks were read.
        frame_rate: frames per second with which the tracks were read, where their file has frame
            numbers: these are looked up then, and the times become those of the frames. None: the
            file has times, or the rate of the video is constant.
        half_window: seconds to each side over which `derive_motion` computes headings and speeds.

    Returns:
        The tracks in the world of the georeference; sizes stay, and agents are absent at frames
        that are not registered.

    Raises:
        TracksError: a track has a time at which there is no frame, or no agent is present at a
            registered one.
    """
    if frame_rate is not None:
        tracks = _replace_times(tracks, registration, frame_rate)
    time = registration.time
    nearest = np.rint(np.interp(tracks.times, time, np.arange(len(time)))).astype(int)
    offset = np.abs(time[nearest] - tracks.times)
    if offset.max(initial=0.0) > MAX_TIME_OFFSET_S:
        raise TracksError(
            f"no frame of the registration is at {tracks.times[offset.argmax()]:g} s, where the "
            f"tracks have agents; the nearest is {offset.max():.2g} s off: register all frames of "
            "the video of the tracks"
        )
    present = tracks.present & registration.valid[nearest]
    if not present.any():
        raise TracksError("no agent is present at a frame that is registered")
    pixels = tracks.states[..., :2].swapaxes(0, 1) * [1, -1] / resolution  # (T, N, 2)
    pixels = transform_points(registration.reference_from_frame[nearest], pixels).swapaxes(0, 1)
    states = np.full_like(tracks.states, np.nan)
    states[present] = 0.0
    states[present, :2] = world_from_pixels(georeference, pixels[present])
    placed = replace(tracks, states=states, present=present, world=georeference.world)
    return derive_motion(placed, half_window=half_window)


def _replace_times(tracks: Tracks, registration: Registration, frame_rate: float) -> Tracks:
    """Replace times that were made of frame numbers by those of the frames."""
    numbers = np.rint(tracks.times * frame_rate).astype(int)
    missing = np.setdiff1d(numbers, registration.index)
    if len(missing):
        raise TracksError(
            f"the tracks have agents in frame {missing[0]}, which the registration has not: "
            "register all frames of the video of the tracks"
        )
    times = np.asarray(registration.time)[np.searchsorted(registration.index, numbers)]
    return replace(tracks, times=times)
