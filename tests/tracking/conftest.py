"""The map of the sample's video by its exact truth."""

from pathlib import Path

import cv2
import numpy as np
import pytest

import geoaim
from geoaim.aim.aim import AIM

SAMPLES = Path(__file__).parents[2] / "samples"


@pytest.fixture(scope="session")
def aim():
    truth = np.load(SAMPLES / "truth.npz")
    image = np.asarray(cv2.imread(str(SAMPLES / "background.jpg")), np.uint8)[..., ::-1].copy()
    matrix = truth["world_from_frame"][0]
    world = geoaim.World(str(truth["crs"]), tuple(truth["origin"].tolist()))
    return AIM.from_image(image, matrix / matrix[2, 2], world, "sample")
