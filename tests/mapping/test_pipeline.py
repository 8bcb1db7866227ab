from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from benchmarks.synthetic.camera import reference_from_frames, render_background, render_frame
from geoaim.base.encode import write_video
from geoaim.base.errors import GeoaimWarning, GeoreferenceError, RegistrationError
from geoaim.base.geometry import image_corners, transform_points
from geoaim.base.progress import no_progress
from geoaim.mapping import pipeline
from geoaim.mapping.georeference.from_telemetry import make_local_georeference
from geoaim.mapping.pipeline import build_aim
from geoaim.mapping.video.video import open_video
from tests.conftest import textured

# a plane of its own: 5 cm a pixel, y up
TRUTH = np.array([[0.05, 0, 100], [0, -0.05, 300], [0, 0, 1]])
PICKED = np.array([[40.0, 30], [600, 50], [580, 320], [60, 330], [300, 180], [450, 100]])


@pytest.fixture(scope="module")
def frames(clip):
    return [render_frame(clip, index) for index in range(len(clip.times))]


def points_on(frame, pixels=PICKED):
    """Control points picked on a frame of a number, in metres of the truth on frame 0."""
    return [
        {"u": u, "v": v, "x": x, "y": y, "frame": frame, "name": f"p{i}", "crs": "local"}
        for i, ((u, v), (x, y)) in enumerate(
            zip(pixels, transform_points(TRUTH, PICKED), strict=True)
        )
    ]


@pytest.fixture(scope="module")
def aim(frames):
    return build_aim(frames, points_on(0))


def test_the_map_lies_where_the_points_say(aim):
    expected = transform_points(TRUTH, image_corners(360, 640))
    np.testing.assert_allclose(aim.corners, expected, atol=0.01)


def test_the_background_is_the_clean_ground(aim, clip):
    truth = render_background(clip, 0).astype(float)
    inner = (slice(30, -30), slice(30, -30))
    assert np.abs(aim.image[inner] - truth[inner]).mean() < 2


def test_points_picked_on_a_later_frame_give_the_same_place(frames, clip, aim):
    frame_from_first = np.linalg.inv(reference_from_frames(clip, 0)[7])
    moved = build_aim(frames, points_on(7, transform_points(frame_from_first, PICKED)))
    assert aim.report["registration"]["reference_index"] == 0
    middle = np.array([[320.0, 180.0]])
    reference = moved.report["registration"]["reference_index"]
    here = transform_points(reference_from_frames(clip, reference)[0], middle)
    np.testing.assert_allclose(
        transform_points(moved.world_from_image, here),
        transform_points(aim.world_from_image, middle),
        atol=0.02,
    )


def test_the_report_describes_every_stage(aim):
    report = aim.report
    assert report["registration"]["valid"] == 12
    assert report["background"]["frames_used"] == 12
    assert [point["name"] for point in report["georeference"]["points"]][:2] == ["p0", "p1"]
    assert len(report["georeference"]["corner_uncertainty_m"]) == 4


def test_points_on_a_frame_that_shows_something_else_are_refused(frames):
    spoilt = [*frames[:5], np.random.default_rng(0).integers(0, 256, frames[0].shape, np.uint8)]
    with pytest.raises(RegistrationError, match=r"1 of 6 frames .* to the reference at 5\.0 s"):
        build_aim(spoilt, points_on(5))


def test_points_that_cannot_be_placed_are_left_out_by_name(frames):
    spoilt = [*frames, np.random.default_rng(0).integers(0, 256, frames[0].shape, np.uint8)]
    points = [*points_on(0), {**points_on(12)[0], "x": 101.0, "name": "lost"}]
    with pytest.warns(GeoaimWarning, match=r"left out: lost on frame 12 "):
        aim = build_aim(spoilt, points)
    assert [point["name"] for point in aim.report["georeference"]["points"]] == [
        *(f"p{i}" for i in range(6))
    ]


def test_points_on_an_unknown_frame_are_refused(frames):
    with pytest.raises(GeoreferenceError, match=r"'other\.jpg', which is not among"):
        build_aim(frames, points_on("other.jpg"))


def test_without_points_and_telemetry_the_message_says_what_to_give(frames):
    with pytest.raises(
        GeoreferenceError,
        match=r"four or more control points \(gcps=\), or for a map in a local plane",
    ):
        build_aim(frames)


def test_a_resolution_gives_a_local_map_marked_as_approximate(frames):
    place = make_local_georeference(resolution=0.1, size=(360, 640))
    aim = build_aim(frames, place)
    assert aim.world.crs is None
    assert aim.report["georeference"]["approximate"]
    np.testing.assert_allclose(aim.corners[[0, 2]], [[0, 0], [64, -36]], atol=1e-6)


def test_without_points_a_first_frame_of_another_place_is_not_the_reference(frames):
    other = textured(np.random.default_rng(3), 360, 640)
    aim = build_aim([other, *frames], make_local_georeference(resolution=0.1, size=(360, 640)))
    assert aim.report["registration"]["reference_index"] > 0
    assert aim.report["registration"]["valid"] == len(frames)


def test_without_points_a_first_frame_that_fits_is_the_reference(frames):
    aim = build_aim(frames, make_local_georeference(resolution=0.1, size=(360, 640)))
    assert aim.report["registration"]["reference_index"] == 0


def test_progress_reports_each_stage(frames):
    calls = []
    build_aim(frames, points_on(0), progress=lambda *call: calls.append(call))
    assert {stage for stage, _, _ in calls} == {"register", "average"}
    assert calls[-1] == ("average", 12, 12)


def test_progress_is_ignored_by_default():
    assert no_progress("average", 3, None) is None


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:the ground is uncertain")  # at the ends few frames see it
def test_a_flight_past_the_reference_is_warned_of():
    ground = textured(np.random.default_rng(8), 360, 1400)
    frames = [ground[:, left : left + 500] for left in range(0, 800, 50)]
    with pytest.warns(GeoaimWarning, match="the view leaves the reference"):
        build_aim(frames, make_local_georeference(resolution=0.1, size=(360, 500)))


def write_photos(folder, images):
    for number, image in enumerate(images):
        cv2.imwrite(str(folder / f"{number}.png"), image)
    return folder


def test_photos_of_several_places_are_refused(tmp_path):
    places = [textured(np.random.default_rng(seed), 360, 500) for seed in range(4)]
    with pytest.raises(RegistrationError, match=r"none of the other 3 photos .* OpenDroneMap"):
        build_aim(
            write_photos(tmp_path, places), make_local_georeference(resolution=0.1, size=(360, 500))
        )


@pytest.mark.slow
def test_a_survey_flight_is_recognised(tmp_path):
    ground = textured(np.random.default_rng(8), 360, 2000)
    photos = [ground[:, left : left + 500] for left in range(0, 1500, 220)]
    with pytest.warns(GeoaimWarning, match=r"photos show the ground of photo .*survey flight"):
        build_aim(
            write_photos(tmp_path, photos), make_local_georeference(resolution=0.1, size=(360, 500))
        )


def test_a_georeference_of_another_size_is_refused(frames):
    with pytest.raises(ValueError, match="2000 x 1000 px, the frames have 640 x 360"):
        build_aim(frames, make_local_georeference(resolution=0.1, size=(1000, 2000)))


def test_a_frame_number_past_the_end_is_refused(frames):
    with pytest.raises(GeoreferenceError, match=r"frame 99, but .* has 12 frames"):
        build_aim(frames, points_on(99))


@pytest.mark.parametrize("wanted", ["lots", 0, 2.5])
def test_a_wrong_number_of_frames_is_refused_before_the_work(frames, wanted, unchecked):
    with pytest.raises(ValueError, match="'auto', 'all' or a number"):
        build_aim(frames, points_on(0), frames=wanted)


def test_a_world_without_control_points_is_refused(frames):
    with pytest.raises(ValueError, match="no control points to transform to it"):
        build_aim(frames, crs="EPSG:32635")


def test_frames_that_fit_nothing_are_counted_in_the_refusal(frames):
    other = textured(np.random.default_rng(3), 360, 640)
    noise = [np.roll(other, 97 * i, axis=(i % 2)) for i in range(5)]
    with pytest.raises(RegistrationError, match="1 of 6 frames could be registered") as caught:
        build_aim([frames[0], *noise], points_on(0))
    assert "needed to tell traffic from ground. Use more frames" in str(caught.value)


@pytest.fixture(scope="module")
def flight():
    """Take-off, a hover, a transit of 1.5 image widths, a longer hover, landing; 1 frame/s."""
    ground = textured(np.random.default_rng(5), 720, 1920)
    path = [(480, 16.0), (480, 4.0), *[(480, 1.0)] * 5, (800, 1.0), (1120, 1.0)]
    path += [*[(1440, 1.0)] * 7, (1440, 4.0)]
    images = []
    for middle, scale in path:
        matrix = np.array([[scale, 0, 320 - middle * scale], [0, scale, 180 - 360 * scale]])
        images.append(cv2.warpAffine(ground, matrix, (640, 360)))
    return open_video(images, rate=1.0)


@pytest.mark.slow
def test_hovers_of_a_flight_are_named_where_the_first_frame_is_of_the_take_off(flight):
    with pytest.raises(
        RegistrationError, match=r"The view stays in 'arrays#t=2\.0,6\.0' and 'arrays#t=9\.0,15\.0'"
    ):
        build_aim(flight, points_on(0))


@pytest.mark.slow
def test_more_frames_are_no_advice_where_hovers_are_named(flight):
    with pytest.raises(RegistrationError, match=r"to tell traffic from ground\. The view stays in"):
        build_aim(flight, points_on(1))


@pytest.mark.slow
@pytest.mark.parametrize("frame", [4, 12])
def test_points_on_a_frame_of_a_hover_choose_it(flight, frame):
    with pytest.warns(GeoaimWarning, match=r"the map ends there\. The view stays in 'arrays#t=2"):
        aim = build_aim(flight, points_on(frame))
    assert aim.report["registration"]["reference_index"] == frame
    expected = transform_points(TRUTH, image_corners(360, 640))
    np.testing.assert_allclose(aim.corners, expected, atol=0.01)


@pytest.mark.slow
def test_without_points_the_longest_hover_is_the_map(flight):
    with pytest.warns(GeoaimWarning, match="The view stays in"):
        aim = build_aim(flight, make_local_georeference(resolution=0.1, size=(360, 640)))
    assert 9 <= aim.report["registration"]["reference_index"] <= 15


@pytest.mark.slow
def test_a_view_that_moves_by_a_third_is_warned_of(frames):
    moved = [np.roll(frame, -220, axis=1) for frame in frames]
    with pytest.warns(GeoaimWarning, match=r"leaves the reference at 0\.0 s in 12 of 24 frames"):
        build_aim([*frames, *moved], points_on(0))


def test_detections_of_few_frames_are_warned_of(frames):
    none = np.empty((0, 4))
    with pytest.warns(GeoaimWarning, match="detections are known of 3 of 12 frames"):
        build_aim(frames, points_on(0), detections=lambda f: none if f.index < 3 else None)


def test_a_detector_is_asked_once_for_each_frame(frames):
    asked = []

    def detect(frame):
        asked.append(frame.index)
        return np.empty((0, 4))

    build_aim(frames, points_on(0), detections=detect)
    assert sorted(asked) == list(range(len(frames)))


def test_frames_of_unknown_number_are_sampled(frames):
    class Stream:
        def __iter__(self):
            return iter(frames)

    aim = build_aim(Stream(), points_on(0))
    assert aim.report["background"]["frames_used"] == 12


def test_the_mean_of_all_frames_uses_them_all(frames):
    aim = build_aim(frames, points_on(0), frames="all")
    assert (
        aim.report["background"] | {"method": "mean", "frames_used": 12}
        == (aim.report["background"])
    )


@pytest.mark.slow
def test_a_clip_with_one_keyframe_is_decoded_once(frames, tmp_path, decoded_packets):
    many = [frames[i % len(frames)] for i in range(40)]
    path = write_video(many, tmp_path / "clip.mp4", keyframe_interval=1000)
    build_aim(path, points_on(0))
    assert (
        len(decoded_packets) < 40 + 16
    )  # and the first frame when the file is opened, and for the points


def test_uncertain_registration_is_warned_of(frames, monkeypatch):
    monkeypatch.setattr(pipeline, "MAX_TYPICAL_UNCERTAINTY_PX", 1e-3)
    with pytest.warns(GeoaimWarning, match="markings may be doubled"):
        build_aim(frames, points_on(0))


@pytest.mark.parametrize(("has_boxes", "advice"), [(True, "without a box"), (False, "give boxes")])
def test_boxes_are_not_asked_of_who_gave_them(has_boxes, advice, unchecked):
    size = {"width": 8, "height": 8}
    registration = SimpleNamespace(
        valid=np.ones(2, bool),
        uncertainty=np.zeros(2),
        time=np.zeros(2),
        reference_from_frame=np.tile(np.eye(3), (2, 1, 1)),
        reference=SimpleNamespace(index=0, time=0.0, **size),
    )
    background = SimpleNamespace(contested=np.ones((8, 8), bool), frames_used=2)
    with pytest.warns(GeoaimWarning, match=advice):
        pipeline._warn_of_limits(registration, background, photos=False, has_boxes=has_boxes)
