"""The README's pictures, from the bundled sample and other made places.

python -m geoaim.bench.figures samples docs/images
"""

from pathlib import Path
from typing import Annotated

import matplotlib.pyplot as plt
import numpy as np
import torch
import typer
from matplotlib.axes import Axes

from geoaim.aim import AIM
from geoaim.geometry import transform_points
from geoaim.hdmap.lanelet2 import read_hdmap
from geoaim.imagery.alignment.pipeline import align_tiles
from geoaim.lights import read_lights
from geoaim.mapping import (
    build_aim,
    open_video,
    read_boxes,
    transform_boxes,
)
from geoaim.mapping.registration.register import choose_reference, place_frames
from geoaim.prediction import predict, read_model, shipped
from geoaim.prediction.pictures import draw_futures
from geoaim.quicklook import draw_alignment, write_quicklook
from geoaim.simulation import View, make_scene
from geoaim.simulation.pictures import film_agent
from geoaim.simulation.scene import Scene, agent_number, step_at, step_at_time
from geoaim.synthetic import Day, draw_place, make_sample, tracks_of, world_from_image
from geoaim.synthetic.roads.layouts import Kind
from geoaim.synthetic.sample import RATE
from geoaim.track_changes import resample_tracks, to_world
from geoaim.tracks import read_tracks

METRES = 0.1  # a pixel of the drawn places
MOMENT = 6.0  # s of the frame that is shown
VIEWS = {"12": 7.0, "14": 12.0, "45": 7.0, "63": 30.0}  # agents and seconds
DAYS: dict[Kind, Day] = {
    "junction": Day(),
    "t": Day(season="autumn", azimuth=0.7, elevation=0.7, number=1),
    "roundabout": Day(season="spring", azimuth=4.0, elevation=0.9, number=2),
    "street": Day(season="winter", azimuth=2.4, elevation=0.5, number=3),
}


def main(
    samples: Annotated[Path, typer.Argument(help="the bundled sample")],
    output: Annotated[Path, typer.Argument(help="folder for the pictures")],
) -> None:
    """Draw a frame, the map made of the video, and the frame's vehicles on the map."""
    output.mkdir(parents=True, exist_ok=True)
    video = open_video(samples / "hover.mp4")
    aim = build_aim(video, samples / "gcps.csv")
    write_quicklook(aim, output / "quicklook.png")
    frame = next(iter(video.frames_at([MOMENT])))
    reference = choose_reference(video, time=0.0)
    [(_, placement)] = place_frames([frame], reference)
    boxes = read_boxes(samples / "boxes")(frame)
    figure, axes = plt.subplots(1, 2, figsize=(16, 5.1), layout="constrained")
    _show(axes[0], frame.image, f"a frame of the drone's video, {frame.time:.0f} s")
    _show(axes[1], aim.image, "the map: ground without traffic, the frame's vehicles placed on it")
    for box in transform_boxes(placement.matrix, np.empty((0, 4)) if boxes is None else boxes):
        axes[1].fill(*box.T, facecolor="#ff6a0060", edgecolor="#ff6a00", linewidth=1.2)
    figure.savefig(output / "video_to_aim.png", dpi=85)
    _show_places(output / "made_places.jpg")
    _show_views(aim, samples, output / "views.jpg")
    _show_futures(aim, samples, output / "futures.jpg")
    tracks = to_world(read_tracks(samples / "tracks.csv"), aim.world)
    laid = align_tiles(samples / "tiles", aim=aim, tracks=tracks)
    draw_alignment(laid, aim=aim, tracks=tracks).savefig(output / "alignment_sample.jpg", dpi=75)


def _show_places(path: Path) -> None:
    """Four kinds of made place on days of four seasons, with half a minute of traffic."""
    figure, axes = plt.subplots(2, 2, figsize=(14, 8.6), layout="constrained")
    for axis, (kind, day) in zip(axes.ravel(), DAYS.items(), strict=True):
        sample = make_sample(2, kind=kind, minutes=0.5, video=None)
        tracks = tracks_of(sample)
        image = draw_place(sample.place, day, resolution=METRES)
        image_from_world = np.linalg.inv(world_from_image(sample.place, METRES))
        _show(axis, image, f"{kind}, {day.season}")
        for states, kind_of_agent in zip(tracks.states, tracks.types, strict=True):
            u, v = transform_points(image_from_world, states[:, :2]).T
            on_foot = kind_of_agent in ("pedestrian", "cyclist")
            axis.plot(u, v, color="#ffd400" if on_foot else "#ff3c28", linewidth=1.0)
    figure.savefig(path, dpi=85)


def _show_views(aim: AIM, samples: Path, path: Path) -> None:
    """What four agents of the sample have around them."""
    scene = _scene(aim, samples, RATE)
    figure, axes = plt.subplots(1, 4, figsize=(16, 4.3), layout="constrained")
    for axis, (name, time) in zip(axes, VIEWS.items(), strict=True):
        agent = agent_number(scene, name)
        step = step_at(scene, agent, time)[None]
        (picture,) = film_agent(scene, agent, View(400, 400, 0.15), step, trail=2.0)
        _show(axis, picture, f"{scene.types[agent]} {name}, {time:.0f} s")
    figure.savefig(path, dpi=85)


def _show_futures(aim: AIM, samples: Path, path: Path) -> None:
    """What vehicles and people of the sample may do, by the shipped models."""
    figure, axes = plt.subplots(1, 2, figsize=(14, 8), layout="constrained")
    for kind, steps, time, shown in (
        ("vehicle", 40, 9.0, axes[0]),
        ("pedestrian", 20, 20.0, axes[1]),
    ):
        model = read_model(shipped(kind))
        scene = _scene(aim, samples, 1 / model.config.seconds)
        start = step_at_time(scene, time)
        futures = predict(
            model, scene, steps=steps, start=start, generator=torch.Generator().manual_seed(0)
        )
        title = f"{kind}s, {steps * model.config.seconds:g} s"
        _show(shown, draw_futures(scene, futures, start), title)
    figure.savefig(path, dpi=80)


def _scene(aim: AIM, samples: Path, rate: float) -> Scene:
    """The sample's traffic and lights on its map, at so many steps a second."""
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
