"""The pages look as their pictures in the documentation do."""

import importlib.util
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from skimage.metrics import structural_similarity

import geoaim

ROOT = Path(__file__).parents[2]
SIZE = (640, 400)  # half of the pictures: fonts differ between machines
LEAST = 0.95  # measured: 0.998; without lanes 0.93, without points 0.86


@pytest.fixture(scope="module")
def screenshots():
    spec = importlib.util.spec_from_file_location("screenshots", ROOT / "docs/screenshots.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def read(path):
    return cv2.resize(np.array(Image.open(path).convert("L")), SIZE, interpolation=cv2.INTER_AREA)


def measure_similarity(folder, name):
    return structural_similarity(read(folder / name), read(ROOT / "docs/images" / name))


@pytest.mark.usefixtures("chromium")
def test_the_viewer_looks_as_in_the_documentation(screenshots, tmp_path):
    aim = geoaim.build_aim("samples/hover.mp4", "samples/gcps.csv", frames=12)
    geoaim.write_aim(aim, tmp_path / "aim.tif")
    screenshots.show_view(tmp_path / "aim.tif", tmp_path)
    assert measure_similarity(tmp_path, "view.jpg") > LEAST


@pytest.mark.usefixtures("chromium")
def test_the_page_of_picking_looks_as_in_the_documentation(screenshots, tmp_path, monkeypatch):
    screenshots.show_picking(tmp_path)
    assert measure_similarity(tmp_path, "pick.jpg") > LEAST
    monkeypatch.setattr(screenshots, "PICKED", ())
    screenshots.show_picking(tmp_path)
    assert measure_similarity(tmp_path, "pick.jpg") < LEAST, "points must be seen"
