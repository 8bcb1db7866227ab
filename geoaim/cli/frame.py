"""Save a frame of a video as a picture."""

from pathlib import Path
from typing import Annotated

import typer

from geoaim.cli import options
from geoaim.cli.console import console, report_errors
from geoaim.cli.outputs import check_output


def frame(
    video: options.VideoSource,
    output: Annotated[Path, options.output(".png to write")],
    time: Annotated[float, typer.Option(help="time of the frame, s", min=0)] = 0.0,
) -> None:
    """Save a frame of a video as a .png, to pick control points on it.

    Example: geoaim frame samples/hover.mp4 -o frame.png
    """
    from PIL import Image

    from geoaim.base.files import atomic_write
    from geoaim.mapping.video.video import open_video, read_frame

    with report_errors():
        check_output(output, (".png",), [Path(video)])
        found = read_frame(open_video(video), time)
        with atomic_write(output) as temporary:
            Image.fromarray(found.image).save(temporary, format="png")
    height, width = found.image.shape[:2]
    console.print(f"{output}: frame {found.index} at {found.time:.2f} s, {width} x {height} px")
