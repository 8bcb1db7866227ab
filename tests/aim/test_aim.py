from dataclasses import replace

import numpy as np
import pytest

from geoaim.aim.aim import AIM
from geoaim.base.errors import AimError
from geoaim.base.world import World

UTM = World("EPSG:32633", (500_000.0, 5_400_000.0))
TURNED = np.array([[0.05, 0.01, 3.7], [0.01, -0.05, 21.3], [0.0, 0.0, 1.0]])


def make_aim(
    height: int = 40,
    width: int = 60,
    place: np.ndarray = TURNED,
    world: World = UTM,
    seed: int = 0,
    report: dict | None = None,
) -> AIM:
    generator = np.random.default_rng(seed)
    return AIM(
        image=generator.integers(0, 256, (height, width, 3), dtype=np.uint8),
        world_from_image=place,
        world=world,
        coverage=generator.integers(0, 65536, (height, width), dtype=np.uint16),
        contested=generator.random((height, width)) < 0.1,
        report=report or {},
    )


@pytest.mark.usefixtures("unchecked")
@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("image", np.zeros((40, 60), np.uint8), "image must be uint8"),
        ("image", np.zeros((40, 60, 3), np.float32), "found float32"),
        ("image", np.zeros((0, 60, 3), np.uint8), "coverage must be"),
        ("coverage", np.zeros((60, 40), np.uint16), r"uint16 \(40, 60\), found uint16 \(60, 40\)"),
        ("contested", np.zeros((40, 60), np.uint8), "contested must be bool"),
        ("world_from_image", np.eye(3, dtype=np.float32), "must be float64"),
        ("world_from_image", np.full((3, 3), np.nan), "finite and invertible"),
        ("world_from_image", np.zeros((3, 3)), "finite and invertible"),
    ],
)
def test_a_field_of_the_wrong_type_or_shape_is_refused(field, value, message):
    with pytest.raises(ValueError, match=message):
        replace(make_aim(), **{field: value})


def test_image_without_pixels_is_refused():
    with pytest.raises(ValueError, match="no pixels"):
        make_aim(0, 60)


def test_image_that_reaches_past_the_horizon_is_refused():
    place = TURNED.copy()
    place[2, 1] = -1 / 20
    with pytest.raises(AimError, match="horizon"):
        make_aim(place=place)


def test_image_off_the_earth_is_refused():
    with pytest.raises(AimError, match=r"a corner .* lies .*e\+09 m from the world's origin"):
        make_aim(place=np.diag([1e8, 1e8, 1.0]))
