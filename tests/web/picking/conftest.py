"""The sample's first frame and an orthophoto of the same place."""

import json
from pathlib import Path

import numpy as np
import pytest

from geoaim.base.geometry import transform_points, translation
from geoaim.base.world import World
from geoaim.imagery.mosaic import read_imagery
from geoaim.mapping.video.video import open_video

SAMPLE = Path(__file__).parents[3] / "samples"


@pytest.fixture(scope="module")
def place():
    """The sample's first frame, an orthophoto of another season, and pixels to its metres."""
    truth = json.loads((SAMPLE / "truth.json").read_text())
    world = World(truth["crs"], tuple(truth["origin"]))
    with np.load(SAMPLE / "truth.npz") as arrays:
        matrix = (
            translation(*truth["imagery"]["offset_east_north_m"]) @ arrays["world_from_frame"][0]
        )
    frame = next(iter(open_video(SAMPLE / "hover.mp4").frames_at([0.0]))).image
    corners = transform_points(
        matrix, np.array([[-100.0, -100], [1380, -100], [1380, 820], [-100, 820]])
    )
    return frame, read_imagery(SAMPLE / "ortho.tif", world=world, corners=corners), matrix
