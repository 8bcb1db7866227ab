"""The README's pictures, from the bundled sample.

python -m geoaim.bench.pictures samples docs/images
"""

from pathlib import Path
from typing import Annotated

import matplotlib.pyplot as plt
import numpy as np
import typer
from matplotlib.axes import Axes

from geoaim.mapping import (
    build_aim,
    open_video,
    read_boxes,
    transform_boxes,
)
from geoaim.mapping.registration import choose_reference, place_frames
from geoaim.quicklook import write_quicklook

MOMENT = 6.0  # s of the frame that is shown


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


def _show(axes: Axes, image: np.ndarray, title: str) -> None:
    height, width = image.shape[:2]
    axes.imshow(image, extent=(0, width, height, 0))
    axes.set(title=title, xticks=[], yticks=[], xlim=(0, width), ylim=(height, 0))


if __name__ == "__main__":
    typer.run(main)
