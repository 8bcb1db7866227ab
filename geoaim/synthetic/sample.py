"""The sample: a drawn junction filmed by a hovering drone, as the files that a person has."""

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array

from geoaim.geometry import transform_points
from geoaim.synthetic.camera import Clip, Hover, clean_frame, film, frame_boxes, hover_frames
from geoaim.synthetic.drawing import Junction, draw_junction
from geoaim.synthetic.driving import drive_junction
from geoaim.world import lonlat_from_world

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
SENSOR = 36.0  # mm, width of the film that focal lengths are given for
FOCAL_LENGTH = 24.0  # mm
CLOCK = "2026-05-14 10:{minute:02d}:{second:02d}.{milli:03d}"


def make_sample(
    seed: int,
    *,
    hover: Hover = HOVER,
    height: int = 720,
    width: int = 1280,
    metres_per_pixel: float = 0.05,
) -> tuple[Junction, Clip]:
    """The drawn junction and the clip over it; frames come from `hover_frames(clip)`.

    The same seed gives the same frames. `metres_per_pixel` is that of the drawing.
    """
    place, traffic, camera = (np.random.default_rng([seed, part]) for part in range(3))
    junction = draw_junction(place, metres_per_pixel=metres_per_pixel)
    times = np.arange(hover.count) / hover.frame_rate
    moving = drive_junction(junction.image_from_plan, times, traffic)
    clip = film(junction.image, moving, hover, height=height, width=width, generator=camera)
    return junction, clip


def write_sample(folder: Path, *, seed: int) -> None:
    """Make the sample and write its files; `samples/README.md` says what each is.

    Args:
        folder: made if it is not there; files of the same names are replaced.
        seed: the same seed gives the same frames before encoding.
    """
    write_scene(*make_sample(seed), folder)


def write_scene(junction: Junction, clip: Clip, folder: Path) -> None:
    """Write the video of a junction, what a surveyor and a detector would add, and the truth."""
    folder.mkdir(parents=True, exist_ok=True)
    rate = clip.hover.frame_rate
    write_video(hover_frames(clip), folder / "hover.mp4", frame_rate=rate, crf=26)
    write_control_points(junction, clip, folder / "gcps.csv")
    write_boxes(clip, folder / "boxes")
    write_telemetry(junction, clip, folder / "hover.SRT")
    _write_image(clean_frame(clip), folder / "background.jpg")
    frame_from_world = clip.frame_from_background @ np.linalg.inv(junction.world_from_image)
    np.savez_compressed(
        folder / "truth.npz",
        times=clip.times,
        frame_from_world=frame_from_world,
        world_from_frame=np.linalg.inv(frame_from_world),
        crs=np.array(junction.world.crs),
        origin=np.array(junction.world.origin),
    )


def write_video(
    frames: Iterable[UInt8[Array, "H W 3"]],
    path: Path,
    *,
    frame_rate: float = 30,
    crf: int = 20,
    megabits: float | None = None,
) -> Path:
    """Encode frames to H.264, yuv420p, with a keyframe each second; the file appears when done.

    At constant quality `crf`, or at about so many megabits a second.
    """
    rate = Fraction(frame_rate).limit_denominator(1001)
    part = path.with_name(path.stem + ".part" + path.suffix)
    with av.open(str(part), "w") as container:
        second = str(round(frame_rate))
        options = {"preset": "medium", "g": second, "keyint_min": second}
        options |= {"b": f"{megabits}M"} if megabits else {"crf": str(crf)}
        stream = container.add_stream("libx264", rate, options=options | {"sc_threshold": "0"})
        stream.pix_fmt = "yuv420p"
        for index, frame in enumerate(frames):
            if index == 0:
                stream.height, stream.width = frame.shape[:2]
            picture = av.VideoFrame.from_ndarray(frame, format="rgb24")
            picture.pts, picture.time_base = index, 1 / rate
            container.mux(stream.encode(picture))
        container.mux(stream.encode(None))
    return part.replace(path)


def write_control_points(junction: Junction, clip: Clip, path: Path) -> None:
    """Surveyed points: name, pixel in frame 0 (corner origin), longitude and latitude (WGS 84)."""
    image = transform_points(junction.image_from_plan, junction.marks)
    pixels = transform_points(clip.frame_from_background[0], image)
    places = lonlat_from_world(junction.world, transform_points(junction.world_from_image, image))
    lines = ["name,u,v,lon,lat"]
    for name, (u, v), (lon, lat) in zip(junction.landmarks, pixels, places, strict=True):
        if 0 <= u < clip.width and 0 <= v < clip.height:
            lines.append(f"{name},{u:.3f},{v:.3f},{lon:.9f},{lat:.9f}")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def write_boxes(clip: Clip, folder: Path) -> None:
    """A YOLO text file for each frame, named by its index: class, centre x and y, width, height."""
    folder.mkdir(exist_ok=True)
    size = np.array([clip.width, clip.height, clip.width, clip.height])
    for index in range(len(clip.times)):
        boxes = frame_boxes(clip, index) / size
        middle, extent = (boxes[:, :2] + boxes[:, 2:]) / 2, boxes[:, 2:] - boxes[:, :2]
        rows = np.hstack([middle, extent])
        lines = ["0 " + " ".join(f"{value:.5f}" for value in row) + "\n" for row in rows]
        (folder / f"{index:06d}.txt").write_text("".join(lines), encoding="ascii")


def write_telemetry(junction: Junction, clip: Clip, path: Path) -> None:
    """Subtitles as DJI writes them: where the camera is above the ground, and where it looks."""
    world_from_frame = junction.world_from_image @ np.linalg.inv(clip.frame_from_background)
    middle = np.array([clip.width, clip.height]) / 2
    spots = middle + np.array([[0, 0], [0, -1], [-middle[0], 0], [middle[0], 0]])
    centre, above, left, right = np.moveaxis(transform_points(world_from_frame, spots), -2, 0)
    heights = np.hypot(*(right - left).T) * FOCAL_LENGTH / SENSOR
    yaws = np.degrees(np.arctan2(*(above - centre).T))
    places = lonlat_from_world(junction.world, centre)
    entries = []
    for index, time in enumerate(clip.times.tolist()):
        step = round(1000 / clip.hover.frame_rate)
        start, end = (round(1000 * time) + late for late in (0, step))
        second, milli = divmod(start, 1000)
        clock = CLOCK.format(minute=second // 60 + 21, second=second % 60, milli=milli)
        (lon, lat), height = places[index], heights[index]
        entries.append(
            f"{index + 1}\n{_srt_time(start)} --> {_srt_time(end)}\n"
            f'<font size="28">FrameCnt: {index + 1}, DiffTime: {step}ms\n{clock}\n'
            f"[iso: 100] [shutter: 1/1000.0] [fnum: 2.8] [ev: 0] [focal_len: {FOCAL_LENGTH:.2f}] "
            f"[latitude: {lat:.6f}] [longitude: {lon:.6f}] "
            f"[rel_alt: {height:.3f} abs_alt: {height + 181:.3f}] "
            f"[gb_yaw: {yaws[index]:.1f} gb_pitch: -90.0 gb_roll: 0.0] </font>\n"
        )
    path.write_text("\n".join(entries), encoding="utf-8")


def _srt_time(milliseconds: int) -> str:
    seconds, milli = divmod(milliseconds, 1000)
    return f"{seconds // 3600:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d},{milli:03d}"


def _write_image(image: UInt8[Array, "H W 3"], path: Path) -> None:
    parameters = [cv2.IMWRITE_JPEG_QUALITY, 95]
    cv2.imwrite(str(path), np.ascontiguousarray(image[..., ::-1]), parameters)
