"""The README's film: a video, the vehicles found in it on its map, and what they may do next.

geoaim place samples/hover.mp4 --points samples/gcps.csv -o placed
python docs/film.py placed docs/images/film.webp --hdmap samples/map.osm --lights samples/lights.csv

Any folder that `geoaim place` wrote can be shown so.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import torch
import typer
from PIL import Image, ImageDraw, ImageFont

from geoaim.aim.aim import AIM
from geoaim.aim.files import read_aim
from geoaim.base.geometry import transform_points
from geoaim.hdmap.lanelet2 import read_hdmap
from geoaim.mapping import open_video
from geoaim.prediction import predict, read_pretrained
from geoaim.prediction.futures import Futures
from geoaim.rendering import make_scene
from geoaim.tracks.changes import resample_tracks
from geoaim.tracks.formats import read_tracks
from geoaim.tracks.lights import Lights, read_lights

RATE = 8.0  # pictures a second
AGAIN_S = 1.0  # the futures are predicted anew
FIRST_S = 1.0  # of the film: the model has seen that much
SAMPLES = 6
TITLES = "the drone's video", "the map, and the vehicles found", "what they may do in 4 s"
COLOUR = (255, 106, 0)  # of the futures: unlike the vehicles'
SHOWN = 0.8  # of the height: the middle


def main(
    placed: Annotated[Path, typer.Argument(help="a folder that `geoaim place` wrote")],
    output: Annotated[Path, typer.Argument(help=".webp to write")],
    hdmap: Annotated[Path | None, typer.Option(help="its HD map, with the stop lines")] = None,
    lights: Annotated[Path | None, typer.Option(help="states of its lights, CSV")] = None,
    side: Annotated[int, typer.Option(help="of each of the three pictures, pixels")] = 320,
    quality: Annotated[int, typer.Option(help="of the WebP, 0 to 100")] = 45,
) -> None:
    """Write the film."""
    aim = read_aim(placed / "map.tif")
    states = None
    if hdmap is not None and lights is not None:
        roads = read_hdmap(hdmap, aim.world)
        states = read_lights(lights, roads.stop_lines, roads.world)
    pictures = [_label(picture) for picture in _draw(placed, aim, states, side)]
    pictures[0].save(
        output,
        save_all=True,
        append_images=pictures[1:],
        duration=round(1000 / RATE),
        loop=0,
        quality=quality,
        method=6,
    )


def _draw(placed: Path, aim: AIM, lights: Lights | None, side: int) -> Iterator[np.ndarray]:
    """Draw the pictures: middles of both halves of `film.mp4`, and the map's half with futures."""
    model = read_pretrained("vehicle")
    tracks = resample_tracks(read_tracks(placed / "tracks.csv"), 1 / model.config.dt)
    scene = make_scene(aim, tracks, lights)
    image_from_world = np.linalg.inv(aim.world_from_image)
    futures, predicted = None, -np.inf
    shown = FIRST_S
    for frame in open_video(placed / "film.mp4").read_all():
        if frame.time + 1e-6 < shown:
            continue
        shown += 1 / RATE
        if frame.time - predicted >= AGAIN_S:
            start = min(round(frame.time / model.config.dt), len(tracks.times) - 1)
            noise = torch.Generator().manual_seed(0)
            futures, predicted = (
                predict(model, scene, samples=SAMPLES, start=start, generator=noise),
                frame.time,
            )
        half = frame.image.shape[1] // 2
        video, ground = frame.image[:, :half], frame.image[:, half:]
        scale = len(ground) / len(aim.image)
        later = ground.copy()
        if futures is not None:
            _draw_paths(later, futures, np.diag([scale, scale, 1.0]) @ image_from_world)
        yield np.hstack([_crop(part, side) for part in (video, ground, later)])


def _draw_paths(picture: np.ndarray, futures: Futures, picture_from_world: np.ndarray) -> None:
    """Draw the paths of all samples onto the picture."""
    drawn = picture.copy()
    for paths in futures.states.double().numpy():
        for path in paths[futures.mark_predicted().numpy()]:
            points = transform_points(picture_from_world, path[:, :2])
            line = np.round(points * 8).astype(np.int32)
            cv2.polylines(drawn, [line], False, COLOUR, 4, cv2.LINE_AA, shift=3)
    picture[:] = cv2.addWeighted(drawn, 0.75, picture, 0.25, 0)


def _crop(picture: np.ndarray, side: int) -> np.ndarray:
    """Cut a square out of the middle, and make it `side` pixels wide."""
    height, width = picture.shape[:2]
    cut = round(SHOWN * height)
    top, left = (height - cut) // 2, (width - cut) // 2
    square = picture[top : top + cut, left : left + cut]
    return np.asarray(cv2.resize(square, (side, side), interpolation=cv2.INTER_AREA))


def _label(picture: np.ndarray) -> Image.Image:
    """Write what each third shows above it."""
    height, width = picture.shape[:2]
    page = Image.new("RGB", (width, height + 24), "white")
    page.paste(Image.fromarray(picture), (0, 24))
    pen, font = ImageDraw.Draw(page), ImageFont.load_default(15)
    for third, title in enumerate(TITLES):
        pen.text((third * width / 3 + 6, 3), title, fill="black", font=font)
    return page


if __name__ == "__main__":
    typer.run(main)
