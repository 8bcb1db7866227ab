"""Georeference the reference frame of a video: by control points on any frame, or by telemetry."""

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.sparse.csgraph import dijkstra

from geoaim.base.errors import GeoaimWarning, GeoreferenceError, name_option, warn
from geoaim.base.geometry import transform_points, wrap_angle
from geoaim.base.world import LONLAT, METRES_PER_DEGREE, choose_world, transform_crs
from geoaim.mapping.georeference.control_points import (
    ControlPoints,
    merge_observations,
    select_points,
)
from geoaim.mapping.georeference.estimate import estimate_georeference
from geoaim.mapping.georeference.from_telemetry import approximate_georeference
from geoaim.mapping.georeference.georeference import Georeference
from geoaim.mapping.georeference.point_checks import MIN_POINTS, check_inside, warn_of_small_part
from geoaim.mapping.registration.features import detect_features, match_features
from geoaim.mapping.registration.frame_registration import mask_detections
from geoaim.mapping.registration.register import (
    TIME_TOLERANCE_S,
    Reference,
    choose_reference,
    register_frames,
)
from geoaim.mapping.video.detections import Detections
from geoaim.mapping.video.frames import Frame, FrameList
from geoaim.mapping.video.telemetry import Telemetry
from geoaim.mapping.video.video import Video

# largest angle between the camera and straight down, without control points
MAX_TILT = np.radians(10.0)
MAX_DISTANCE_M = 10_000.0  # no camera of a drone sees streets from farther; zones are 300 km apart
MAX_GAP_S = 1.0  # a warning is given where the nearest entry that states a position is further away
# What a caller gives where telemetry lacks a field: by an option of build, or in Python.
ADVICE = {
    "height": (
        "--flying-height (metres above the ground)",
        "override_telemetry(height=...) (metres above the ground)",
    ),
    "yaw": (
        "--yaw (compass heading of the image's top, degrees)",
        "override_telemetry(yaw=...) (compass heading of the image's top, degrees)",
    ),
    "focal_length": (
        "--focal-length (35 mm equivalent with any zoom, mm)",
        "override_telemetry(focal_length=...) (35 mm equivalent with any zoom, mm)",
    ),
}
FrameName = str | int | None  # names the frame that a control point was picked on


def choose_reference_time(gcps: ControlPoints | Georeference | None, video: Video) -> float | None:
    """Choose the time of the reference: of the frame that `gcps` are of; None leaves it open."""
    if isinstance(gcps, ControlPoints):
        frames = {_find_frame_index(picked, video) for picked in gcps.frames}
        is_open = len(frames) > 1 or (video.names is not None and frames != {0})
        return None if is_open else video.find_time(frames.pop())
    return None if gcps is None or is_anywhere(gcps) else video.start


def is_anywhere(gcps: ControlPoints | Georeference | None) -> bool:
    """Whether a georeference only gives a scale, so that any frame can be the reference."""
    return isinstance(gcps, Georeference) and gcps.approximate and gcps.world.crs is None


def georeference_reference_frame(
    points: ControlPoints | None,
    video: Video,
    reference: Reference,
    detections: Detections | None,
    crs: str | None,
) -> tuple[Georeference, ControlPoints | None, Reference]:
    """Georeference the reference frame by control points, or without them by telemetry."""
    if points is None:
        return _georeference_by_telemetry(video.telemetry, video.listed, reference), None, reference
    check_inside(points, (video.height, video.width))
    warn_of_small_part(points, (video.height, video.width))
    points, reference = _place_points(points, video, reference, detections)
    world = None
    if crs is not None and points.crs is not None:
        world = choose_world(transform_crs(points.crs, LONLAT, points.coordinates), crs=crs)
    height, width = reference.height, reference.width
    georeference = estimate_georeference(
        points, height=height, width=width, world=world, outside=True
    )
    _warn_of_telemetry(points, video)
    return georeference, points, reference


def _warn_of_telemetry(points: ControlPoints, video: Video) -> None:
    """Warn where points lie far from the camera by its telemetry, as in another zone."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GeoaimWarning)  # that it cannot be read matters not here
        telemetry = video.telemetry
    if telemetry is None or points.crs is None:
        return
    camera = np.nanmedian([telemetry.longitude, telemetry.latitude], axis=1)
    lon, lat = transform_crs(points.crs, LONLAT, points.coordinates).mean(axis=0).tolist()
    off = (camera - [lon, lat]) * [np.cos(np.radians(lat)), 1.0]
    distance = float(np.hypot(*off)) * METRES_PER_DEGREE
    if distance > MAX_DISTANCE_M:
        warn(
            f"the control points lie about longitude {lon:.4f}, latitude {lat:.4f}, and the camera "
            f"by its telemetry about {camera[0]:.4f}, {camera[1]:.4f}, {distance / 1000:.0f} km "
            "away: do the points state the right CRS, such as the UTM zone, and is it this video?"
        )


def _place_points(
    points: ControlPoints, video: Video, reference: Reference, detections: Detections | None
) -> tuple[ControlPoints, Reference]:
    """Transform control points to the reference; points that cannot be placed are left out."""
    frames = {picked: _find_frame_index(picked, video) for picked in points.frames}
    transforms, reasons = {}, {}
    for picked, index in frames.items():
        time = video.find_time(index)
        if abs(time - reference.time) < TIME_TOLERANCE_S:
            transforms[picked] = np.eye(3)
            continue
        frame = next(iter(video.frames_at([time])))
        [(_, placement)] = register_frames([frame], reference, detections=detections)
        if placement.valid:
            transforms[picked] = placement.reference_from_frame
        elif video.names is not None and len(frames) > 1:
            return _place_by_links(points, frames, video, detections)
        else:
            reasons[picked] = placement.reason
    return _move_points(points, transforms, reasons, reference), reference


def _place_by_links(
    points: ControlPoints,
    frames: Mapping[FrameName, int],
    video: Video,
    detections: Detections | None,
) -> tuple[ControlPoints, Reference]:
    links = link_photos(video, (video.height, video.width), detections)
    central = choose_central_photo(links, list(frames.values()))
    reference = choose_reference(video, detections=detections, time=video.find_time(central))
    chained = {picked: chain_links(links, index, central) for picked, index in frames.items()}
    transforms = {picked: matrix for picked, matrix in chained.items() if matrix is not None}
    reasons = dict.fromkeys(set(chained) - set(transforms), "it overlaps with no other")
    return _move_points(points, transforms, reasons, reference), reference


def _move_points(
    points: ControlPoints,
    transforms: Mapping[FrameName, Float[Array, "3 3"]],
    reasons: Mapping[FrameName, str],
    reference: Reference,
) -> ControlPoints:
    """Points in pixels of the reference; those on frames without a transform are left out."""
    pixels = points.pixels.copy()
    for i, picked in enumerate(points.frames):
        if picked in transforms:
            pixels[i] = transform_points(transforms[picked], pixels[i : i + 1])[0]
    placed = [i for i, picked in enumerate(points.frames) if picked in transforms]
    left = len(np.unique(points.coordinates[placed], axis=0))
    if reasons:
        dropped = ", ".join(
            f"{name} on frame {picked or 0} ({reasons[picked]})"
            for name, picked in zip(points.names, points.frames, strict=True)
            if picked in reasons
        )
        problem = f"cannot be registered to frame {reference.index} and are left out: {dropped}"
        if left < MIN_POINTS:
            raise GeoreferenceError(
                f"control points {problem}. {left} are left, at least {MIN_POINTS} are needed:"
                " pick them on frames that overlap with others"
            )
        warn(f"control points {problem}")
    merged = merge_observations(select_points(replace(points, pixels=pixels), placed))
    return replace(merged, frames=(None,) * len(merged.pixels))


def _find_frame_index(picked: FrameName, video: Video) -> int:
    listed = video.listed
    if picked is None:
        return video.first
    if isinstance(picked, int):
        count = listed.count
        if picked and count is not None and picked >= count:
            raise GeoreferenceError(
                f"control points name frame {picked}, but {listed.source} has {count} frames, "
                "counted from 0"
            )
        return picked
    if listed.names is None or picked not in listed.names:
        raise GeoreferenceError(
            f"control points name the frame {picked!r}, which is not among those of "
            f"{listed.source}; use the file's name, or a frame's number for a video"
        )
    return listed.names.index(picked)


def override_telemetry(
    video: Video,
    *,
    height: float | None = None,
    yaw: float | None = None,
    focal_length: float | None = None,
) -> Video:
    """Replace the height, heading or focal length that the telemetry of a video states."""
    given = {}
    if height is not None:
        given["height"] = height
    if yaw is not None:
        given["yaw"] = float(wrap_angle(np.radians([90.0 - yaw]))[0])
    if focal_length is not None:
        given["focal_length"] = focal_length
    positive = given.get("height", 1.0) > 0.0 and given.get("focal_length", 1.0) > 0.0
    if not (np.isfinite(list(given.values())).all() and positive):
        raise ValueError(
            f"height {height}, yaw {yaw}, focal length {focal_length}: numbers are needed, a "
            "positive height and a positive focal length"
        )

    def read() -> Telemetry | None:
        telemetry = video.read_telemetry()
        if telemetry is None:
            return None
        count = len(telemetry.time)
        values = {name: np.full(count, value) for name, value in given.items()}
        if {"height", "yaw"} & set(given) and np.isnan(telemetry.pitch).all():
            values["pitch"] = np.full(count, -np.pi / 2)
        return replace(telemetry, **values)  # type: ignore[arg-type]  # mypy: or `remarks`

    return replace(video, read_telemetry=read)


def _georeference_by_telemetry(
    telemetry: Telemetry | None, listed: FrameList, reference: Reference
) -> Georeference:
    """Georeference the reference frame approximately by the telemetry of the video."""
    if telemetry is None:
        raise GeoreferenceError(
            f"{listed.source}: no control points were given and no telemetry can be read beside it "
            "(a DJI .SRT or flight log of the same name, or GPS in images' EXIF); give four or "
            f"more control points ({name_option('--points', 'gcps=')}), or for a map in a local "
            "plane the metres "
            + name_option(
                "per pixel of the frames (--frame-resolution, or --resolution of a single image)",
                "per pixel of the frames (gcps=make_local_georeference(resolution=...))",
            )
        )
    image = "" if listed.names is None else f", {listed.names[reference.index]}"
    source, time = f"{listed.source}{image}", reference.time
    names = ("height", "yaw", "pitch", "focal_length")
    stated = {name: _find_nearest(telemetry.time, getattr(telemetry, name), time) for name in names}
    if abs(stated["pitch"] + np.pi / 2) > MAX_TILT:
        raise GeoreferenceError(
            f"{source}: by its telemetry the camera looks {-np.degrees(stated['pitch']):.0f} "
            "degrees down; only one that looks straight down (90) can be georeferenced without "
            "control points: give four or more"
        )
    missing = [name for name in names if np.isnan(stated[name])]
    if missing:
        raise GeoreferenceError(f"{source}: {_describe_missing(telemetry, missing)}")
    known = np.flatnonzero(np.isfinite(telemetry.latitude + telemetry.longitude))
    nearest = known[np.argmin(np.abs(telemetry.time[known] - time))]
    if abs(telemetry.time[nearest] - time) >= MAX_GAP_S:
        warn(
            f"{source}: the telemetry states no position at {time:.2f} s, where the reference is; "
            f"that of {telemetry.time[nearest]:.2f} s is used, so that the map is off by the "
            "distance flown in between"
        )
    half_width = (
        # 43.27 mm: diagonal of the film that a 35 mm equivalent focal length refers to
        43.27 / 2 * reference.width / np.hypot(reference.height, reference.width)
    )
    return approximate_georeference(
        latitude=float(telemetry.latitude[nearest]),
        longitude=float(telemetry.longitude[nearest]),
        height_above_ground=stated["height"],
        yaw=stated["yaw"],
        field_of_view=float(2 * np.arctan(half_width / stated["focal_length"])),
        size=(reference.height, reference.width),
    )


def _describe_missing(telemetry: Telemetry, missing: Sequence[str]) -> str:
    """Describe the fields that telemetry lacks, why, and what to give."""
    reasons = [telemetry.remarks[name] for name in missing if name in telemetry.remarks]
    lacking = f"no {', no '.join(missing).replace('_', ' ')}"
    given = [name_option(*ADVICE[name]) for name in missing if name != "pitch"]
    if "pitch" in missing and not {"height", "yaw"} & set(missing):
        given.append(name_option(*ADVICE["yaw"]))
    straight_down = " of a camera that looks straight down" if "pitch" in missing else ""
    why = f" ({'; '.join(reasons)})" if reasons else ""
    return (
        f"its telemetry (.SRT, flight log, or EXIF and XMP) states {lacking}{why}. Give "
        f"{' and '.join(given)}{straight_down}, or four or more control points "
        f"({name_option('--points', 'gcps=')})"
    )


def _find_nearest(times: Float[Array, " T"], values: Float[Array, " T"], time: float) -> float:
    """The value that is stated nearest to a time; NaN where none is."""
    stated = np.flatnonzero(np.isfinite(values))
    if not len(stated):
        return float("nan")
    return float(values[stated[np.argmin(np.abs(times[stated] - time))]])


STEP_LENGTH = 0.3  # added for each link, in image diagonals: prefers paths of few links


@dataclass(frozen=True, eq=False)
class PhotoLinks:
    """Homographies between overlapping photos."""

    # cost of each link: the distance of the photos' centres in image diagonals, plus `STEP_LENGTH`;
    # 0 where two photos are not linked
    lengths: Float[Array, "T T"]
    # (i, j) -> (3, 3) pixels of photo j to those of photo i, for i < j
    transforms: dict[tuple[int, int], Float[Array, "3 3"]]


def link_photos(
    photos: Iterable[Frame], size: tuple[int, int], detections: Detections | None
) -> PhotoLinks:
    """Match the ORB features of each pair of photos, outside the boxes of detections."""
    features = [
        detect_features(frame.grey, exclude=mask_detections(frame, detections)) for frame in photos
    ]
    lengths, transforms = np.zeros((len(features),) * 2), {}
    middle = np.array([[size[1] / 2, size[0] / 2]])
    for one, other in combinations(range(len(features)), 2):
        matrix = match_features(features[one], features[other], "homography", size=size)
        if matrix is None:
            continue
        transforms[one, other] = matrix
        shift = np.linalg.norm(transform_points(matrix, middle) - middle)
        lengths[one, other] = lengths[other, one] = STEP_LENGTH + shift / np.hypot(*size)
    return PhotoLinks(lengths, transforms)


def choose_central_photo(links: PhotoLinks, wanted: list[int]) -> int:
    """Choose the photo that is linked to most of the wanted ones (indices), then the nearest."""
    distance = dijkstra(links.lengths)[:, wanted]
    linked = np.isfinite(distance)
    total = np.where(linked, distance, 0.0).sum(axis=1)
    return int(np.lexsort([total, -linked.sum(axis=1)])[0])


def chain_links(links: PhotoLinks, photo: int, reference: int) -> Float[Array, "3 3"] | None:
    """Compose the transform of a photo to the reference along the shortest path of links."""
    _, previous = dijkstra(links.lengths, indices=reference, return_predecessors=True)
    matrix = np.eye(3)
    while photo != reference:
        nearer = int(previous[photo])
        if nearer == -9999:  # SciPy: there is no path
            return None
        if nearer < photo:
            matrix = links.transforms[nearer, photo] @ matrix
        else:
            matrix = np.linalg.inv(links.transforms[photo, nearer]) @ matrix
        photo = nearer
    return matrix / matrix[2, 2]
