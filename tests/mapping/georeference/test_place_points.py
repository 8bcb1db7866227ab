import cv2
import numpy as np
import pytest

from geoaim.base.errors import GeoaimWarning
from geoaim.mapping.pipeline import build_aim
from tests.conftest import textured

LEFT_PX = (0, 220, 440, 660, 880)  # of photos of 500 px on one ground of 0.05 m a pixel
PICKED = ((0, 60, 40), (220, 40, 300), (440, 250, 180), (660, 460, 60), (880, 300, 320))
UNRELATED = "unrelated.png"


@pytest.fixture(scope="module")
def photos(tmp_path_factory):
    folder = tmp_path_factory.mktemp("photos")
    ground = textured(np.random.default_rng(8), 360, 1400)
    for left in LEFT_PX:
        cv2.imwrite(str(folder / f"{left:04d}.png"), ground[:, left : left + 500, ::-1])
    cv2.imwrite(str(folder / UNRELATED), textured(np.random.default_rng(9), 360, 500))
    return folder


def test_points_on_photos_that_only_overlap_in_a_chain_place_the_central_one(photos):
    points = [
        {"u": u, "v": v, "x": 0.05 * (left + u), "y": -0.05 * v, "frame": f"{left:04d}.png"}
        for left, u, v in PICKED
    ]
    points.append({"u": 9.0, "v": 9.0, "x": 0.0, "y": 9.0, "frame": UNRELATED, "name": "lost"})
    points = [{"crs": "local", **point} for point in points]
    with pytest.warns(GeoaimWarning) as warned:
        aim = build_aim(photos, points)
    messages = " ".join(str(warning.message) for warning in warned)
    assert f"left out: lost on frame {UNRELATED}" in messages
    assert "of 6 photos show the ground of photo 3: too few" in messages
    assert aim.report["registration"]["reference_index"] == 2
    np.testing.assert_allclose(aim.corners[0], [0.05 * LEFT_PX[2], 0.0], atol=0.2)
