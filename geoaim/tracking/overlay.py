"""Tracks drawn on the frames of their video, for people to check them."""

from collections.abc import Iterator

import cv2
import numpy as np
from jaxtyping import Float, UInt8
from numpy import ndarray as Array

from geoaim.base.geometry import transform_points
from geoaim.mapping.video.video import Video
from geoaim.tracking.frame_poses import FramePoses
from geoaim.tracks.agent_types import get_colour
from geoaim.tracks.tracks import Tracks

SHIFT = 3  # bits of the fractions of pixels in which lines are drawn
LINE_PX = 2
FRONT_COLOUR = (255, 255, 255)
BOX = np.array([[0.5, 0.5], [0.5, -0.5], [-0.5, -0.5], [-0.5, 0.5]])  # its front comes first


def draw_on_video(
    video: Video, poses: FramePoses, tracks: Tracks, *, height: int, trail: float
) -> Iterator[UInt8[Array, "H W 3"]]:
    """Draw outlines of the agents, white at their fronts, and their trails on a video's frames.

    Yields the frame nearest to each time of the tracks, RGB, with even sides and of this height;
    on one whose pose is not known nothing is drawn. Trails last for so many seconds.
    """
    nearest = np.abs(tracks.times[:, None] - poses.times).argmin(axis=1)
    waiting = iter(zip(range(len(nearest)), nearest.tolist(), strict=True))
    item = next(waiting, None)
    picture = np.zeros((height, 2 * round(video.width / video.height * height / 2), 3), np.uint8)
    scale = np.diag([picture.shape[1] / video.width, height / video.height, 1.0])
    size = picture.shape[1], height
    for frame in video.read_all():
        while item is not None and poses.registration.index[item[1]] <= frame.index:
            step, pose = item
            picture = np.asarray(cv2.resize(frame.image, size, interpolation=cv2.INTER_AREA))
            matrix = poses.world_from_frame[pose]
            if np.isfinite(matrix).all():
                _draw(picture, scale @ np.linalg.inv(matrix), tracks, step, trail)
            yield picture
            item = next(waiting, None)
    while item is not None:  # frames that could be read once and not again
        yield picture
        item = next(waiting, None)


def _draw(
    picture: UInt8[Array, "H W 3"],
    picture_from_world: Float[Array, "3 3"],
    tracks: Tracks,
    step: int,
    trail: float,
) -> None:
    """Draw the agents that are there at a step, and where they came from."""
    first = int(np.searchsorted(tracks.times, tracks.times[step] - trail))
    for agent in np.flatnonzero(tracks.present[:, step]).tolist():
        colour = tuple(round(255 * part) for part in get_colour(tracks.types[agent]))
        past = tracks.states[agent, first : step + 1, :2]
        past = past[np.isfinite(past[:, 0])]
        x, y, heading, _ = tracks.states[agent, step]
        ahead = np.array([np.cos(heading), np.sin(heading)])
        axes = np.stack([ahead, [-ahead[1], ahead[0]]]) * tracks.sizes[agent][:, None]
        box = [x, y] + BOX @ axes
        for points, ink in ((past, colour), (box[[0, 3, 2, 1]], colour), (box[:2], FRONT_COLOUR)):
            pixels = transform_points(picture_from_world, points) * 2**SHIFT
            line = pixels.round().astype(np.int32)
            cv2.polylines(picture, [line], False, ink, LINE_PX, cv2.LINE_AA, SHIFT)
