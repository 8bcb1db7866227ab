"""A sample that is written within a second, for children that are interrupted while writing."""

from pathlib import Path

import cv2

from geoaim.synthetic import Hover, Sample, files, make_sample, write_sample

cv2.setNumThreads(1)  # threads do not survive a fork

SMALL = make_sample(
    2, kind="street", minutes=0.1, video=(96, 160), hover=Hover(count=3), resolution=0.2
)


def write_small_sample(folder: Path) -> None:
    """Write the sample, with an empty picture as the imagery of another day."""
    files.write_imagery = _write_no_imagery
    write_sample(SMALL, folder)


def _write_no_imagery(sample: Sample, folder: Path) -> tuple[float, float]:
    for path in (folder / "ortho.tif", folder / "tiles" / "19" / "0" / "0.jpg"):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"")
    return 0.0, 0.0
