"""The README's pictures, from the bundled sample and other synthetic places.

python docs/pictures.py samples docs/images
"""

from pathlib import Path
from typing import Annotated

import matplotlib.pyplot as plt
import numpy as np
import torch
import typer
from matplotlib.axes import Axes

from benchmarks.synthetic import Day, draw_place, make_sample, tracks_of, world_from_image
from benchmarks.synthetic.roads.layouts import PlaceKind
from benchmarks.synthetic.sample import RATE
from geoaim.aim.aim import AIM
from geoaim.aim.quicklook import draw_quicklook
from geoaim.base.geometry import transform_points
from geoaim.hdmap.lanelet2 import read_hdmap
from geoaim.imagery.alignment.before_after import draw_alignment
from geoaim.imagery.alignment.pipeline import align_tiles
from geoaim.mapping import build_aim, open_video, read_detections, transform_boxes
from geoaim.mapping.registration.register import choose_reference, register_frames
from geoaim.mapping.video.video import Video
from geoaim.prediction import predict, read_pretrained
from geoaim.rendering import View, make_scene
from geoaim.rendering.pictures import render_agent_video
from geoaim.rendering.scene import Scene, find_agent, find_agent_step, find_step
from geoaim.tracks.changes import resample_tracks, to_world
from geoaim.tracks.formats import read_tracks
from geoaim.tracks.lights import read_lights

RESOLUTION = 0.1  # m/px of the drawn places
FRAME_TIME = 6.0  # s, of the frame shown beside the map
VIEWS = {"12": 7.0, "14": 12.0, "45": 7.0, "63": 30.0}  # s at which each agent's view is drawn
DAYS: dict[PlaceKind, Day] = {
    "junction": Day(),
    "t": Day(season="autumn", azimuth=0.7, elevation=0.7, number=1),
    "roundabout": Day(season="spring", azimuth=4.0, elevation=0.9, number=2),
    "street": Day(season="winter", azimuth=2.4, elevation=0.5, number=3),
}


def main(
    samples: Annotated[Path, typer.Argument(help="the bundled sample")],
    output: Annotated[Path, typer.Argument(help="folder to write to")],
) -> None:
    """Write all figures."""
    output.mkdir(parents=True, exist_ok=True)
    video = open_video(samples / "hover.mp4")
    aim = build_aim(video, samples / "gcps.csv")
    draw_quicklook(aim).savefig(output / "quicklook.jpg", dpi=100)
    _draw_registered_frame(video, aim, samples, output / "video_to_aim.jpg")
    _draw_places(output / "synthetic_places.jpg")
    _draw_views(aim, samples, output / "views.jpg")
    _draw_futures(aim, samples, output / "futures.jpg")
    tracks = to_world(read_tracks(samples / "tracks.csv"), aim.world)
    aligned = align_tiles(samples / "tiles", aim=aim, tracks=tracks)
    draw_alignment(aligned, aim=aim, tracks=tracks).savefig(output / "alignment_sample.jpg", dpi=75)


def _draw_registered_frame(video: Video, aim: AIM, samples: Path, path: Path) -> None:
    """Draw a frame of the video beside the map, with the frame's vehicles placed on it."""
    frame = next(iter(video.frames_at([FRAME_TIME])))
    reference = choose_reference(video, time=0.0)
    [(_, placement)] = register_frames([frame], reference)
    boxes = read_detections(samples / "boxes")(frame)
    figure, axes = plt.subplots(1, 2, figsize=(16, 5.1), layout="constrained")
    _show(axes[0], frame.image, f"a frame of the drone's video, {frame.time:.0f} s")
    _show(axes[1], aim.image, "the map: ground without traffic, the frame's vehicles placed on it")
    for box in transform_boxes(
        placement.reference_from_frame, np.empty((0, 4)) if boxes is None else boxes
    ):
        axes[1].fill(*box.T, facecolor="#ff6a0060", edgecolor="#ff6a00", linewidth=1.2)
    figure.savefig(path, dpi=85)


def _draw_places(path: Path) -> None:
    """Draw four kinds of synthetic place in four seasons, with half a minute of traffic."""
    figure, axes = plt.subplots(2, 2, figsize=(14, 8.6), layout="constrained")
    for axis, (kind, day) in zip(axes.ravel(), DAYS.items(), strict=True):
        sample = make_sample(2, kind=kind, minutes=0.5, video=None)
        tracks = tracks_of(sample)
        image = draw_place(sample.place, day, resolution=RESOLUTION)
        image_from_world = np.linalg.inv(world_from_image(sample.place, RESOLUTION))
        _show(axis, image, f"{kind}, {day.season}")
        for states, agent_type in zip(tracks.states, tracks.types, strict=True):
            u, v = transform_points(image_from_world, states[:, :2]).T
            is_slow = agent_type in ("pedestrian", "cyclist")
            axis.plot(u, v, color="#ffd400" if is_slow else "#ff3c28", linewidth=1.0)
    figure.savefig(path, dpi=85)


def _draw_views(aim: AIM, samples: Path, path: Path) -> None:
    """Draw the views of four agents of the sample."""
    scene = _make_sample_scene(aim, samples, RATE)
    figure, axes = plt.subplots(1, 4, figsize=(16, 4.3), layout="constrained")
    for axis, (name, time) in zip(axes, VIEWS.items(), strict=True):
        agent = find_agent(scene, name)
        step = find_agent_step(scene, agent, time)[None]
        (picture,) = render_agent_video(scene, agent, View(400, 400, 0.15), step, trail=2.0)
        _show(axis, picture, f"{scene.types[agent]} {name}, {time:.0f} s")
    figure.savefig(path, dpi=85)


def _draw_futures(aim: AIM, samples: Path, path: Path) -> None:
    """Draw futures of the sample's vehicles and pedestrians, predicted by the shipped models."""
    figure, axes = plt.subplots(1, 2, figsize=(14, 8), layout="constrained")
    for kind, steps, time, shown in (
        ("vehicle", 40, 9.0, axes[0]),
        ("pedestrian", 20, 20.0, axes[1]),
    ):
        model = read_pretrained(kind)
        scene = _make_sample_scene(aim, samples, 1 / model.config.dt)
        start = find_step(scene, time)
        futures = predict(
            model, scene, horizon=steps, start=start, generator=torch.Generator().manual_seed(0)
        )
        title = f"{kind}s, {steps * model.config.dt:g} s"
        futures.plot(shown).set_title(title)
    figure.savefig(path, dpi=80)


def _make_sample_scene(aim: AIM, samples: Path, rate: float) -> Scene:
    """Make a scene of the sample's tracks and lights on its map, at `rate` steps per second."""
    tracks = read_tracks(samples / "tracks.csv")
    hdmap = read_hdmap(samples / "map.osm", tracks.world)
    lights = read_lights(samples / "lights.csv", hdmap.stop_lines, hdmap.world)
    return make_scene(aim, resample_tracks(tracks, rate), lights)


def _show(axes: Axes, image: np.ndarray, title: str) -> None:
    height, width = image.shape[:2]
    axes.imshow(image, extent=(0, width, height, 0))
    axes.set(title=title, xticks=[], yticks=[], xlim=(0, width), ylim=(height, 0))


if __name__ == "__main__":
    typer.run(main)
