"""A synthetic drone video as files: frames, control points, boxes, telemetry, truth."""

from pathlib import Path

import numpy as np
import shapely
from jaxtyping import Float
from numpy import ndarray as Array
from shapely import Point

from benchmarks.synthetic.camera import (
    HoverClip,
    list_boxed_agents,
    render_background,
    render_frames,
)
from benchmarks.synthetic.map_files import write_jpeg
from benchmarks.synthetic.place import Place, world_from_image
from benchmarks.synthetic.roads.markings import list_landmarks
from benchmarks.synthetic.sample import Sample
from geoaim.base.encode import write_video
from geoaim.base.geometry import transform_points
from geoaim.base.progress import Progress, report_each
from geoaim.base.world import lonlat_from_world

CLASSES = ("car", "van", "truck", "bus", "pedestrian", "cyclist")  # numbers in YOLO files
SENSOR_WIDTH_MM, FOCAL_LENGTH_MM = 36.0, 24.0  # focal lengths are stated for 35 mm film
CLOCK = "2026-05-14 10:{minute:02d}:{second:02d}.{milli:03d}"


def write_video_files(sample: Sample, clip: HoverClip, folder: Path, progress: Progress) -> None:
    """Write the video, its control points, boxes and telemetry, and its truth.

    Args:
        sample: the sample.
        clip: its clip.
        folder: folder in which the files are written.
        progress: called with the stage, the frames done and in all.
    """
    place = sample.place
    frames = report_each(render_frames(clip), progress, "film", len(clip.times))
    write_video(frames, folder / "hover.mp4", frame_rate=clip.hover.frame_rate, crf=26)
    world_from_still = world_from_image(place, sample.resolution)
    world_from_frame = world_from_still @ np.linalg.inv(clip.frame_from_background)
    _write_control_points(place, clip, world_from_frame, folder / "gcps.csv")
    _write_boxes(clip, folder / "boxes")
    _write_telemetry(place, world_from_frame, clip, folder / "hover.SRT")
    write_jpeg(render_background(clip), folder / "background.jpg", quality=95)
    np.savez_compressed(
        folder / "truth.npz",
        times=clip.times,
        frame_from_world=np.linalg.inv(world_from_frame),
        world_from_frame=world_from_frame,
        crs=np.array(place.world.crs),
        origin=np.array(place.world.origin),
    )


def _write_control_points(
    place: Place, clip: HoverClip, world_from_frame: Float[Array, "T 3 3"], path: Path
) -> None:
    """Write names, pixels in frame 0 (corner origin), longitudes and latitudes (WGS 84)."""
    names, marks = list_landmarks(place.roads)
    world = transform_points(place.world_from_plan, marks)
    pixels = transform_points(np.linalg.inv(world_from_frame[0]), world)
    lines = ["name,u,v,lon,lat"]
    places = lonlat_from_world(place.world, world)
    crowns = [Point(tree.place).buffer(tree.radius) for tree in place.scenery.trees]
    hidden = shapely.contains_xy(shapely.union_all(crowns), *marks.T)
    for name, (u, v), (lon, lat), is_hidden in zip(names, pixels, places, hidden, strict=True):
        if 0 <= u < clip.width and 0 <= v < clip.height and not is_hidden:
            lines.append(f"{name},{u:.3f},{v:.3f},{lon:.9f},{lat:.9f}")
    path.write_bytes(("\n".join(lines) + "\n").encode())


def _write_boxes(clip: HoverClip, folder: Path) -> None:
    """Write a YOLO text file a frame, named by index: class, centre x and y, width, height."""
    folder.mkdir(exist_ok=True)
    for index in range(len(clip.times)):
        agents, boxes = list_boxed_agents(clip, index)
        low, high = (corner / [clip.width, clip.height] for corner in np.split(boxes, 2, axis=1))
        classes = [CLASSES.index(clip.traffic.types[agent]) for agent in agents]
        rows = np.column_stack([classes, (low + high) / 2, high - low])
        with open(folder / f"{index:06d}.txt", "wb") as file:
            np.savetxt(file, rows, ["%d", *["%.5f"] * 4])


def _write_telemetry(
    place: Place, world_from_frame: Float[Array, "T 3 3"], clip: HoverClip, path: Path
) -> None:
    """Write subtitles as DJI does: the camera's position, height and direction."""
    middle = np.array([clip.width, clip.height]) / 2
    spots = middle + np.array([[0, 0], [0, -1], [-middle[0], 0], [middle[0], 0]])
    centre, above, left, right = np.moveaxis(transform_points(world_from_frame, spots), -2, 0)
    heights = np.hypot(*(right - left).T) * FOCAL_LENGTH_MM / SENSOR_WIDTH_MM
    yaws = np.degrees(np.arctan2(*(above - centre).T))
    places = lonlat_from_world(place.world, centre)
    entries = []
    step = round(1000 / clip.hover.frame_rate)
    for index, (time, (lon, lat)) in enumerate(zip(clip.times.tolist(), places, strict=True)):
        start = round(1000 * time)
        second, milli = divmod(start, 1000)
        clock = CLOCK.format(minute=second // 60 + 21, second=second % 60, milli=milli)
        entries.append(
            f"{index + 1}\n{_format_srt_time(start)} --> {_format_srt_time(start + step)}\n"
            f'<font size="28">FrameCnt: {index + 1}, DiffTime: {step}ms\n{clock}\n'
            f"[iso: 100] [shutter: 1/1000.0] [fnum: 2.8] [ev: 0] "
            f"[focal_len: {FOCAL_LENGTH_MM:.2f}] "
            f"[latitude: {lat:.6f}] [longitude: {lon:.6f}] "
            f"[rel_alt: {heights[index]:.3f} abs_alt: {heights[index] + 181:.3f}] "
            f"[gb_yaw: {yaws[index]:.1f} gb_pitch: -90.0 gb_roll: 0.0] </font>\n"
        )
    path.write_bytes("\n".join(entries).encode())


def _format_srt_time(milliseconds: int) -> str:
    seconds, milli = divmod(milliseconds, 1000)
    return f"{seconds // 3600:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d},{milli:03d}"
