"""Days of one place: each map in the world of the first one, with its tracks and what differs."""

from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from geoaim.aim.aim import AIM
from geoaim.aim.position import CHI2_2D
from geoaim.aim.rectification import change_aim_world, resample
from geoaim.base.errors import AlignmentError
from geoaim.base.grid import make_north_up_grid
from geoaim.base.progress import Progress
from geoaim.base.world import lonlat_from_world
from geoaim.catalog.recordings import FROM_VIDEO, Recording
from geoaim.hdmap.lanelet2 import read_hdmap
from geoaim.imagery.alignment.place_by_imagery import parse_near, place_by_imagery
from geoaim.mapping.video.video import open_video
from geoaim.tracking.pipeline import track_video
from geoaim.tracks.changes import to_world
from geoaim.tracks.formats.formats import read_tracks
from geoaim.tracks.tracks import Tracks

MAX_APART_M = 0.1  # 95 %; a quarter of the width of a lane's marking is lost above
LIGHT_M = 10.0  # ground whose mean and contrast are taken as the light of the day
DETAIL_M = 0.5  # what is smaller than that is not compared
CHANGED = 1.5  # difference of two days, in contrasts of the ground about, that is shown as changed
CHANGED_COLOUR = (255, 40, 40)


def place_day(
    aim: AIM, recording: Recording, reference: tuple[str, AIM] | None, progress: Progress
) -> AIM:
    """Place a map by the imagery of its recording or, not 0.1 m off, by an earlier day's map."""
    near = None if recording.near is None else parse_near(recording.near)
    if reference is None:
        if recording.imagery is None:
            return aim
        return place_by_imagery(aim, recording.imagery, near=near, progress=progress)
    name, first = reference
    is_local = first.world.crs is None
    if is_local:
        near = None
    elif aim.world.crs is not None:
        aim, near = change_aim_world(aim, first.world), None
    elif near is None:
        longitude, latitude = lonlat_from_world(first.world, first.corners.mean(axis=0)[None])[0]
        near = float(latitude), float(longitude)
    placed = place_by_imagery(
        aim, first, near=near, accuracy=0.0 if is_local else None, progress=progress
    )
    placed = change_aim_world(placed, first.world)
    position = placed.report["position"]
    position["reference"] = name
    relative = np.linalg.eigvalsh(position["relative_covariance_m2"])[-1]
    if (apart := float(np.sqrt(CHI2_2D * relative))) > MAX_APART_M:
        raise AlignmentError(
            f"its place relative to {name}, the first of its place, is known to ±{apart:.2f} m "
            f"(95 %), and ±{MAX_APART_M:g} m is needed: film nearer to it, or leave place empty"
        )
    return placed


def collect_tracks(recording: Recording, aim: AIM, progress: Progress) -> Tracks | None:
    """Read the tracks of a recording, or make them from its video; None where none are wanted."""
    if recording.tracks is None:
        return None
    if recording.tracks != FROM_VIDEO:
        return to_world(read_tracks(recording.tracks), aim.world)
    return track_video(
        open_video(recording.video, threads=1),
        aim,
        None if recording.detections is None else Path(recording.detections),
        hdmap=None if recording.hdmap is None else read_hdmap(recording.hdmap, aim.world),
        progress=progress,
    )


def draw_changes(aim: AIM, reference: AIM) -> tuple[UInt8[Array, "h w 3"], float]:
    """Draw a map in a coarse picture, with red edges of what differs from an earlier day's.

    Light is taken out by the mean and the contrast of the ground about; shadows stay.

    Returns:
        The picture, and the share of the ground of both days that differs.
    """
    resolution = max(aim.resolution, reference.resolution, DETAIL_M / 4)
    grid = make_north_up_grid(aim.corners, resolution, aim.world)
    days = [resample(day, grid) for day in (aim, reference)]
    seen = np.logical_and.reduce([(day.coverage > 0) & ~day.contested for day in days])
    if not seen.any():
        return days[0].image, 0.0
    one, other = (_take_out_light(day.image, seen, resolution) for day in days)
    changed = seen & (np.abs(one - other) > CHANGED)
    picture = days[0].image.copy()
    edge = changed & (cv2.erode(changed.astype(np.uint8), np.ones((5, 5), np.uint8)) == 0)
    picture[edge] = CHANGED_COLOUR
    return picture, float(changed.sum() / seen.sum())


def _take_out_light(
    image: UInt8[Array, "h w 3"], seen: Bool[Array, "h w"], resolution: float
) -> Float[Array, "h w"]:
    """Grey values in contrasts from the mean of the ground about, without what is small."""
    weight = seen.astype(np.float32)
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32)

    def blur(values: Float[Array, "h w"], metres: float) -> Float[Array, "h w"]:
        sigma = metres / resolution / 2
        total = cv2.GaussianBlur(values * weight, (0, 0), sigma)
        return total / np.maximum(cv2.GaussianBlur(weight, (0, 0), sigma), 1e-3)

    mean = blur(grey, LIGHT_M)
    contrast = np.sqrt(np.maximum(blur((grey - mean) ** 2, LIGHT_M), 1.0))
    return blur((grey - mean) / contrast, DETAIL_M)
