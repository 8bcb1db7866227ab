"""Draw a frame, the median and the background of a clip, what is contested in magenta.

python -m benchmarks.background.crops docs/bench/background-crops.jpg
"""

from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer

from benchmarks.background.methods import METHODS, STANDING
from benchmarks.background.signal_queue import film_signal
from geoaim.base.files import atomic_write

SEED = 2  # of the test
CROP = np.s_[100:300, 380:860]  # the road before the stop line
MAGENTA = (255, 0, 255)
GAP_PX = 6


def main(output: Annotated[Path, typer.Argument(help="picture to write")]) -> None:
    """Write the crops, one below the other."""
    clip = film_signal(standing=STANDING, seed=SEED)
    background = METHODS["geoaim"](clip)
    marked = background.image.copy()
    marked[background.contested] = MAGENTA
    median = np.rint(METHODS["median"](clip)).astype(np.uint8)
    crops = [image[CROP] for image in (clip.frames[len(clip.frames) // 2], median, marked)]
    gap = np.full((GAP_PX, crops[0].shape[1], 3), 255, np.uint8)
    picture = np.vstack([crops[0], gap, crops[1], gap, crops[2]])
    with atomic_write(output) as part:
        cv2.imwrite(str(part), picture[..., ::-1])


if __name__ == "__main__":
    typer.run(main)
