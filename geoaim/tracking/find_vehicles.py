"""Vehicles without a detector: what differs from the map in registered frames."""

import cv2
import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from scipy import ndimage

from geoaim.aim.aim import AIM
from geoaim.base.errors import TracksError
from geoaim.base.geometry import transform_points
from geoaim.base.progress import Progress, no_progress, notebook_progress
from geoaim.mapping.video.detections import DetectedBoxes
from geoaim.mapping.video.video import Video, VideoSource, open_video
from geoaim.tracking.background_difference import Ground, find_foreground, learn_ground
from geoaim.tracking.frame_poses import FramePoses, locate_frames
from geoaim.tracking.ground_grid import GroundGrid, make_grid, measure_resolution
from geoaim.tracking.vehicle_shapes import find_shapes
from geoaim.tracks.tracks import STATED, Tracks

LEARNING_FRAMES = 30  # spread over the video, by which the ground's noise and shadows are learnt
MAX_RESOLUTION = 0.6  # metres per pixel; a car is no longer several pixels wide in coarser frames
MAX_SMALL_RESOLUTION = 0.1  # metres per pixel up to which people and cyclists are told from noise
MAX_POSE_SIGMA_M = 0.45  # a quarter of a car's width; rims of what stands then differ as cars do
MIN_VEHICLE_M2 = 2.0
BORDER_M = 0.5  # a box that ends this near to where nothing is known may be cut off
SHAPE_SIGMA_M = 0.1  # of a vehicle's middle, by errors of its shape that last
MIN_SEEN = 0.5  # of a track's time
MIN_PATH_M = 1.0  # of what is smaller; such a piece that stays is a blemish of the map


def find_vehicles(
    video: VideoSource, aim: AIM, *, progress: Progress = notebook_progress
) -> list[DetectedBoxes | None]:
    """Find the vehicles of a video without a detector: what moves, and what came or left.

    The frames are registered to the map and compared with it; shadows are told from vehicles, and
    neighbours apart. What stands all the time is a part of the map, and is not found.

    Args:
        video: what `open_video` opens.
        aim: an AIM that was built of this video.
        progress: called with the stage, the frames done and the frames in all.

    Returns:
        Turned boxes of each frame, with scores, for `track_video`; None for a frame that could not
        be registered.

    Raises:
        RegistrationError: the frames cannot be registered to the AIM.
        TracksError: a pixel shows too much ground.
    """
    opened = open_video(video)
    return search_frames(opened, aim, locate_frames(opened, aim, None, progress), progress)


def search_frames(
    video: Video, aim: AIM, poses: FramePoses, progress: Progress = no_progress
) -> list[DetectedBoxes | None]:
    """Search the vehicles of a video whose frames are located; see `find_vehicles`."""
    size = video.height, video.width
    matrices = dict(zip(poses.registration.index.tolist(), poses.world_from_frame, strict=True))
    known = [index for index, matrix in matrices.items() if np.isfinite(matrix).all()]
    reference = int(np.abs(poses.times - poses.registration.reference.time).argmin())
    grid = make_grid(poses.world_from_frame, size, reference)
    if grid.resolution > MAX_RESOLUTION:
        raise TracksError(
            f"a pixel shows {grid.resolution:.2g} m of ground; vehicles are found without a "
            f"detector up to {MAX_RESOLUTION} m: give boxes (--detections), or check the scale"
        )
    _check_registration(poses, measure_resolution(poses.world_from_frame[reference], size))
    ground = _learn(video, aim, grid, matrices, known)
    area = ndimage.binary_fill_holes(ground.covered)  # vehicles drive out of it, and not into holes
    small = grid.resolution <= max(MAX_SMALL_RESOLUTION, 0.12)
    found: dict[int, DetectedBoxes] = {}
    for frame in video.read_all():
        matrix = matrices.get(frame.index)
        if matrix is None or not np.isfinite(matrix).all():
            continue
        image, seen = grid.view(frame.image, matrix)
        strength, shaded = find_foreground(ground, image, seen)
        shapes = find_shapes(
            strength, shaded, grid.resolution, ground.sun, 0.25 if small else MIN_VEHICLE_M2
        )
        frame_from_grid = np.linalg.inv(grid.grid_from_world @ matrix)
        corners = transform_points(frame_from_grid, shapes.corners.reshape(-1, 2)).reshape(-1, 4, 2)
        boxes = np.concatenate([corners.min(axis=1), corners.max(axis=1)], axis=1)
        ends = _find_ends(seen & area, shapes.corners, grid.resolution)
        found[frame.index] = DetectedBoxes(boxes, corners, shapes.scores, at_border=ends)
        progress("find vehicles", len(found), len(known))
    return [found.get(index) for index in matrices]


def _check_registration(poses: FramePoses, resolution: float) -> None:
    """Check that frames lie on the map more exactly than what is to be told from it."""
    sigma = float(np.median(poses.registration.uncertainty[poses.registration.valid])) * resolution
    if sigma > MAX_POSE_SIGMA_M:
        raise TracksError(
            f"the frames are registered to {sigma:.2g} m only; up to {MAX_POSE_SIGMA_M} m, "
            "vehicles are told from what stands: give boxes (--detections) or hover"
        )


def _find_ends(
    known: Bool[Array, "H W"], corners: Float[Array, "N 4 2"], resolution: float
) -> Bool[Array, "N 4"]:
    """Find which corners lie where what is known of the ground ends."""
    reach = 2 * round(BORDER_M / resolution) + 1
    inner = cv2.erode(known.view(np.uint8), np.ones((reach, reach), np.uint8), borderValue=0)
    columns, rows = corners.astype(int).clip(0, np.array(inner.shape[::-1]) - 1).T
    return np.asarray(inner[rows, columns].T == 0)


def finish_tracks(tracks: Tracks) -> Tracks:
    """Drop tracks of what is no vehicle, and add the error of shapes to the stated uncertainty.

    Neighbours that are now and then found as one would be joined over the times between; a small
    piece that stays where it is, is a blemish of the map. Rims and shadows last, so that smoothing
    does not remove them.

    Args:
        tracks: of what `find_vehicles` found, each present at some time.

    Returns:
        The tracks of the others.

    Raises:
        TracksError: none is left.
    """
    agent = np.nonzero(tracks.present)[0]
    states, seen = tracks.get_rows("states"), tracks.get_rows("seen")
    first = np.flatnonzero(np.diff(agent, prepend=-1))  # rows are by agent
    places = states[:, :2]
    extent = np.hypot(*(np.maximum.reduceat(places, first) - np.minimum.reduceat(places, first)).T)
    often = np.ones(len(first), bool)
    if seen is not None:
        often = np.add.reduceat(seen.astype(int), first) > MIN_SEEN * np.bincount(agent)
    kept = often & ((tracks.sizes.prod(axis=1) > MIN_VEHICLE_M2) | (extent > MIN_PATH_M))
    if not kept.any():
        raise TracksError(
            f"{len(kept)} tracks are found, all of small pieces that stay where they are, or of "
            "what is seldom seen; vehicles that move are needed, or boxes (--detections)"
        )
    chosen, numbers = kept[agent], np.flatnonzero(kept)
    rows = {name: tracks.get_rows(name) for name in ("states", *STATED)}
    rows = {name: values[chosen] for name, values in rows.items() if values is not None}
    if "uncertainty" in rows:
        rows["uncertainty"][:, 0] = np.hypot(rows["uncertainty"][:, 0], SHAPE_SIGMA_M)
    return Tracks.from_rows(
        tracks.present[numbers],
        rows,
        times=tracks.times,
        sizes=tracks.sizes[numbers],
        types=tuple(tracks.types[number] for number in numbers),
        ids=tuple(tracks.ids[number] for number in numbers),
        world=tracks.world,
    )


def _learn(
    video: Video,
    aim: AIM,
    grid: GroundGrid,
    matrices: dict[int, Float[Array, "3 3"]],
    known: list[int],
) -> Ground:
    """Learn the ground by frames that are spread over the video."""
    rows = np.unique(np.linspace(0, len(known) - 1, LEARNING_FRAMES).round().astype(int))
    chosen = {known[row] for row in rows.tolist()}
    frames = [
        grid.view(frame.image, matrices[frame.index])
        for frame in video.read_all()
        if frame.index in chosen
    ]
    image, inside = grid.view(aim.image, aim.world_from_image)
    hidden = np.asarray(aim.coverage == 0, np.uint8)
    uncovered, _ = grid.view(255 * hidden, aim.world_from_image)
    return learn_ground(image, inside & (uncovered == 0), frames, grid.resolution)
