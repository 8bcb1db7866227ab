import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from geoaim.base.errors import GeoaimWarning, GeoreferenceError
from geoaim.base.world import World
from geoaim.mapping.georeference.from_telemetry import make_local_georeference
from geoaim.mapping.georeference.reference_frame import (
    _georeference_by_telemetry,
    choose_reference_time,
    georeference_reference_frame,
    override_telemetry,
)
from geoaim.mapping.registration.register import choose_reference
from geoaim.mapping.video.telemetry import PLAUSIBLE, Telemetry
from geoaim.mapping.video.video import open_video
from tests.conftest import textured
from tests.mapping.georeference.points import SIZE, make_points


@pytest.mark.parametrize(
    ("frames", "time"), [((None,), 0.0), ((0,), 0.0), ((2,), 1.0), ((None, 0), 0.0), ((0, 2), None)]
)
def test_points_on_one_frame_make_it_the_reference(frames, time):
    video = open_video(np.zeros((3, 4, 6, 3), np.uint8), rate=2)
    points = replace(make_points(), frames=frames)
    assert choose_reference_time(points, video) == time


@pytest.mark.parametrize(("frame", "time"), [(None, 0.0), ("a.jpg", 0.0), ("b.jpg", None)])
def test_points_on_a_photo_make_the_first_one_alone_the_reference(frame, time):
    points = replace(make_points(), frames=(frame,))
    assert choose_reference_time(points, open_with_telemetry()) == time


def test_points_of_another_zone_than_the_telemetry_are_warned_of():
    points = replace(make_points(crs="EPSG:32635"), crs="EPSG:32636")
    video = replace(
        open_video([textured(np.random.default_rng(1), 300, 400)] * 5),
        read_telemetry=open_with_telemetry().read_telemetry,
    )
    reference = choose_reference(video)
    scaled = replace(points, pixels=points.pixels * [400 / 1920, 300 / 1080])
    with pytest.warns(GeoaimWarning, match="km away: do the points state the right CRS"):
        georeference_reference_frame(scaled, video, reference, None, None)


def test_points_on_the_reference_need_no_registration():
    video = open_video([textured(np.random.default_rng(1), 300, 400)] * 5)
    reference = choose_reference(video, time=0.0)

    def refuse(*_):
        raise AssertionError("the reference was read again")

    points = replace(make_points(), pixels=make_points().pixels * (400 / SIZE["width"]))
    _, placed, _ = georeference_reference_frame(
        points, replace(video, read_at=refuse), reference, None, None
    )
    np.testing.assert_array_equal(placed.pixels, points.pixels)


def test_a_given_georeference_refers_to_the_first_frame_unless_it_gives_a_scale_alone():
    scale = make_local_georeference(resolution=0.1, size=(4, 4))
    video = open_video(np.zeros((3, 4, 6, 3), np.uint8))
    assert choose_reference_time(scale, video) is None
    placed = replace(scale, world=World("EPSG:32635", (0.0, 0.0)))
    assert choose_reference_time(placed, video) == 0.0
    assert choose_reference_time(None, video) is None


def open_with_telemetry(**stated):
    """Three photos a second apart; position in the first only, other fields as given."""
    values = {name: np.full(3, np.nan) for name in PLAUSIBLE}
    values["latitude"][0], values["longitude"][0], values["focal_length"][:] = 48.1, 11.5, 24.0
    values |= {name: np.full(3, value) for name, value in stated.items()}
    telemetry = Telemetry(np.arange(3.0), **values)
    video = open_video(np.zeros((3, 60, 80, 3), np.uint8))
    return replace(
        video, source="photos", names=("a.jpg", "b.jpg", "c.jpg"), read_telemetry=lambda: telemetry
    )


def reference_at(index):
    return SimpleNamespace(index=index, time=float(index), height=60, width=80)


@pytest.mark.parametrize(
    ("stated", "missing"),
    [
        ({}, "no height, no yaw, no pitch"),
        ({"height": 80.0, "pitch": -1.5}, "no yaw"),
        ({"yaw": 0.0, "pitch": -1.5}, "no height"),
        ({"height": 80.0, "yaw": 0.0}, "no pitch"),
        ({"height": 80.0, "yaw": 0.0, "pitch": -1.5, "focal_length": np.nan}, "no focal length"),
    ],
)
def test_what_telemetry_lacks_is_named_with_the_file_and_given_by_the_caller(
    stated, missing, unchecked
):
    video = open_with_telemetry(**stated)
    names = {name.replace(" ", "_") for name in re.findall("no (focal length|[a-z]+)", missing)}
    asked = {f"{name}=" for name in names - {"pitch"} or {"yaw"}}
    with pytest.raises(GeoreferenceError, match=rf"photos, a\.jpg.*states {missing}\. ") as caught:
        _georeference_by_telemetry(video.telemetry, video.listed, reference_at(0))
    assert set(re.findall(r"\((\w+=)\.\.\.", str(caught.value))) == asked
    # the image's top points east
    given = override_telemetry(video, height=80.0, yaw=90.0, focal_length=24.0)
    place = _georeference_by_telemetry(
        given.telemetry, given.listed, reference_at(0)
    ).world_from_image
    up = -place[:2, 1]
    np.testing.assert_allclose(up / np.linalg.norm(up), [1.0, 0.0], atol=0.06)  # grid north


def test_a_position_of_another_time_is_used_with_a_warning(unchecked):
    video = open_with_telemetry(height=80.0, yaw=0.0, pitch=-1.5)
    with pytest.warns(GeoaimWarning, match=r"no position at 2\.00 s.*that of 0\.00 s"):
        assert _georeference_by_telemetry(
            video.telemetry, video.listed, reference_at(2)
        ).approximate


def test_the_message_says_why_a_field_is_not_read(unchecked):
    video = open_with_telemetry(yaw=0.0, pitch=-1.5)
    telemetry = replace(video.telemetry, remarks={"height": "its altitude is of an unknown kind"})
    video = replace(video, read_telemetry=lambda: telemetry)
    with pytest.raises(
        GeoreferenceError, match=r"no height \(its altitude is of an unknown kind\)"
    ):
        _georeference_by_telemetry(video.telemetry, video.listed, reference_at(0))


@pytest.mark.parametrize("given", [{"height": 0.0}, {"yaw": np.nan}, {"focal_length": -24.0}])
def test_an_impossible_height_or_heading_is_refused(given):
    with pytest.raises(ValueError, match="positive height"):
        override_telemetry(open_with_telemetry(), **given)
