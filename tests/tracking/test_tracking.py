"""Tracking of made boxes: what is found, bridged, refused and stated."""

import numpy as np
import pytest

from benchmarks.tracking.benchmark import measure_case
from benchmarks.tracking.cases import DetectorErrors, make_case_of
from benchmarks.tracking.lanes import make_lanes_case
from geoaim.base.errors import TracksError
from geoaim.base.geometry import transform_points, wrap_angle
from geoaim.base.world import World
from geoaim.mapping.video.detections import DetectedBoxes
from geoaim.mapping.video.telemetry import make_telemetry
from geoaim.tracking import track_boxes
from geoaim.tracking.ground_detections import place_boxes
from geoaim.tracking.noise import estimate_noise
from geoaim.tracking.roofs import describe_roofs
from geoaim.tracking.standing import Directions
from geoaim.tracks.changes import cut_tracks
from tests.tracking.paths import (
    ERRORS,
    RATE,
    SIZE,
    WORLD_FROM_FRAME,
    detect,
    drive_straight,
    make_truth,
    turn_left,
)

EXACT = DetectorErrors(0.0, 0.0, 0.0)


def track(truth, errors=ERRORS, lanes=None, change=lambda frames: frames):
    frames, matrices = detect(truth, errors)
    return track_boxes(change(frames), matrices, truth.times, truth.world, SIZE, lanes=lanes)


def pair(truth, found):
    """The track of each agent, by the nearest position at the middle of the time."""
    step = len(truth.times) // 2
    places = found.states[:, step, :2]
    return [int(np.nanargmin(np.hypot(*(places - p).T))) for p in truth.states[:, step, :2]]


@pytest.fixture(scope="module")
def junction():
    """Two cars that turn and pass one that stands, and a pedestrian."""
    return make_truth(
        turn_left(10, 20, 6.0, 12.0),
        drive_straight(70, 42, np.pi, 8.0),
        drive_straight(40, 46, np.pi, 0.0),
        drive_straight(20, 10, 1.0, 1.3),
        kinds=("car", "van", "car", "pedestrian"),
        sizes=[(4.6, 1.9), (5.6, 2.1), (4.3, 1.8), (0.5, 0.5)],
    )


def test_agents_are_found_with_their_states(junction):
    found = track(junction)
    order = pair(junction, found)
    assert sorted(order) == list(range(len(found.ids)))
    error = found.states[order] - junction.states
    assert np.nanmedian(np.hypot(error[..., 0], error[..., 1])) < 0.05
    moving = [0, 1]
    assert np.degrees(np.nanmedian(np.abs(wrap_angle(error[moving, :, 2])))) < 1.5
    assert np.nanmedian(np.abs(error[..., 3])) < 0.15
    np.testing.assert_allclose(found.sizes[order], junction.sizes, atol=0.2)
    assert [found.types[row] for row in order] == list(junction.types)


@pytest.mark.parametrize("stride", [3, 5])
def test_boxes_of_one_frame_in_some_give_the_same_tracks(junction, stride):
    def thin_out(frames):
        return [f if n % stride == 0 else None for n, f in enumerate(frames)]

    found = track(junction, change=thin_out)
    order = pair(junction, found)
    assert sorted(order) == list(range(len(found.ids)))
    error = found.states[order] - junction.states
    assert np.nanmedian(np.hypot(error[..., 0], error[..., 1])) < 0.1


def test_states_that_bridge_misses_are_marked_and_less_certain(junction):
    def leave_out(frames):
        gap = range(40, 65)  # a second
        return [DetectedBoxes(np.empty((0, 4))) if n in gap else f for n, f in enumerate(frames)]

    found = track(junction, EXACT, change=leave_out)
    assert len(found.ids) == 4
    assert found.present[:, 40:65].all()
    assert not found.seen[:, 40:65].any()
    assert found.seen[:, :40].all()
    assert (found.uncertainty[:, 52, 0] > 2 * found.uncertainty[:, 20, 0]).all()
    error = found.states[pair(junction, found), 52, :2] - junction.states[:, 52, :2]
    assert np.hypot(*error.T).max() < 0.4


@pytest.mark.parametrize(
    "errors",
    [
        DetectorErrors(misses=0.1, false=0.1, lost_s=1.0),
        DetectorErrors(noise_px=1.0, lasting_px=3.0),
        DetectorErrors(misses=0.15, burst=4.0, false=0.15, noise_px=3.0),
    ],
    ids=["lost", "lasting", "bursts"],
)
def test_observed_states_are_the_same_to_the_digit_for_a_part_of_the_video(junction, errors):
    frames, matrices = detect(junction, errors)
    rest = junction.times, junction.world, SIZE
    whole = track_boxes(frames, matrices, *rest)
    cut = track_boxes(frames[:60], matrices[:60], junction.times[:60], junction.world, SIZE)
    observed = [tracks.observed[:, :60].reshape(-1, 4) for tracks in (cut, whole)]
    known = [np.nan_to_num(part[np.isfinite(part[:, 0])]) for part in observed]
    rows = [set(map(tuple, part.tolist())) for part in known]
    assert len(rows[0]) > 80
    assert rows[0] <= rows[1]  # the whole also has those of misses that end later
    assert len(rows[1] - rows[0]) <= 0.1 * len(rows[0])


def test_an_oncoming_vehicle_at_the_border_is_another_one():
    truth = make_truth(
        np.concatenate([drive_straight(60, 30, 0.0, 9.0, steps=60), np.full((60, 4), np.nan)]),
        np.concatenate([np.full((70, 4), np.nan), drive_straight(83, 33.3, np.pi, 7.0, steps=50)]),
    )
    assert len(track(truth, EXACT).ids) == 2


def test_a_fast_vehicle_is_tracked_in_few_frames_per_second():
    truth = make_truth(drive_straight(4, 30, 0.0, 14.0, steps=125))
    few = slice(None, None, 12)
    frames, matrices = detect(truth, EXACT)
    found = track_boxes(frames[few], matrices[few], truth.times[few], truth.world, SIZE)
    assert len(found.ids) == 1
    assert found.seen[0].sum() >= 9


@pytest.mark.parametrize("speed", [0.0, 9.0])
def test_what_is_lost_for_long_stays_one_agent(speed):
    truth = make_truth(
        drive_straight(5, 30, 0.0, speed, steps=200), drive_straight(75, 40, np.pi, 8.0, steps=200)
    )

    def hide(frames):
        empty = DetectedBoxes(np.empty((0, 4)))
        return [empty if 50 <= step < 150 else frame for step, frame in enumerate(frames)]

    found = track(truth, EXACT, change=hide)
    assert len(found.ids) == 2
    assert not found.seen[:, 60:140].any()
    assert np.isnan(found.observed[:, 120:140]).all()


@pytest.mark.parametrize(("y", "heading", "count"), [(30.0, 0.0, 1), (21.0, np.pi, 2)])
def test_a_lost_pedestrian_walks_on_and_one_who_comes_back_elsewhere_is_another(y, heading, count):
    hidden = np.full((90, 4), np.nan)
    walk, rest = drive_straight(30, 30, 0.0, 1.4), np.full((100, 4), np.nan)
    later = drive_straight(30 + 1.4 * 190 / RATE, y, heading, 1.4)
    truth = make_truth(
        np.concatenate([walk, hidden, rest]),
        np.concatenate([rest, hidden, later]),
        kinds=("pedestrian",) * 2,
        sizes=[(0.8, 0.8)] * 2,
    )
    assert len(track(truth, EXACT).ids) == count


@pytest.mark.slow
@pytest.mark.parametrize("seed", [609, 626, 2900])  # of turns, lengths and opposite directions
def test_vehicles_that_are_lost_on_lanes_are_not_swapped(seed):
    case = make_lanes_case(seed, errors=DetectorErrors(lost_s=4.0))
    row = next(iter(measure_case(case, track_boxes)))
    assert row["IDF1 near"] > 0.99
    assert row["wrong sense %"] == 0


def test_two_that_stood_on_opposite_lanes_are_not_swapped():
    def start_at_green(x, y, heading, acceleration):
        states = drive_straight(x, y, heading, 0.0, steps=200)
        states[:, 3] = acceleration * np.maximum(np.arange(200) / RATE - 3.3, 0)
        states[:, 0] += np.cos(heading) * np.cumsum(states[:, 3]) / RATE
        return states

    def hide(frames):
        lost = (range(36, 136), range(50, 150))  # of the westbound car, and the eastbound one
        kept = []
        for step, frame in enumerate(frames):
            eastbound = (frame.boxes[:, 1] > 520).astype(int)
            seen = np.array([step not in lost[lane] for lane in eastbound], bool)
            kept.append(DetectedBoxes(frame.boxes[seen], types=("car",) * seen.sum()))
        return kept

    truth = make_truth(start_at_green(30, 30, 0.0, 3.4), start_at_green(23.4, 36.6, np.pi, 3.0))
    found = track(truth, DetectorErrors(0.0, 0.0, 1.0), change=hide)
    assert len(found.ids) == 2
    assert np.nanmax(np.nanmax(found.states[..., 1], 1) - np.nanmin(found.states[..., 1], 1)) < 0.5


def test_false_boxes_that_last_for_half_a_second_are_not_joined():
    generator = np.random.default_rng(5100)
    steps, count = 200, 14
    truth = make_truth(drive_straight(5, 30, 0.0, 8.0, steps=steps))
    begin = generator.integers(0, steps - 15, count)
    place = generator.uniform([100, 100], [1500, 1100], (count, 2))

    def add_bursts(frames):
        shown = []
        for step, frame in enumerate(frames):
            middle = place[(begin <= step) & (step < begin + 15)]
            middle = middle + generator.normal(0, 2, middle.shape)
            half = np.array([45, 19])
            false = np.column_stack([middle - half, middle + half])
            boxes = np.concatenate([frame.boxes, false])
            shown.append(DetectedBoxes(boxes, types=("car",) * len(boxes)))
        return shown

    found = track(truth, DetectorErrors(0.0, 0.0, 1.0), change=add_bursts)
    assert len(found.ids) == 1 + count
    assert (found.present.sum(axis=1) <= 15).sum() == count


def test_a_false_box_does_not_bend_the_gap_after_it():
    truth = make_truth(drive_straight(5, 30, 0.0, 8.0, steps=200))

    def hide(frames):
        empty = DetectedBoxes(np.empty((0, 4)))
        shown = [empty if 50 <= step < 150 else frame for step, frame in enumerate(frames)]
        shown[52] = DetectedBoxes(np.add(frames[49].boxes, [11, 9, 11, 9]), types=("car",))
        return shown

    found = track(truth, DetectorErrors(0.0, 0.0, 1.0), change=hide)
    assert len(found.ids) == 1
    assert not found.seen[0, 50:150].any()
    error = found.states[0, 50:150, :2] - truth.states[0, 50:150, :2]
    assert np.hypot(*error.T).max() < 0.5


def test_a_car_that_drives_askew_is_a_car_without_a_detectors_types():
    for heading in (np.pi / 6, np.pi / 4):
        truth = make_truth(drive_straight(15, 10, heading, 9.0))
        found = track(truth, DetectorErrors(0.0, 0.0, 1.0, types=False))
        assert found.types == ("car",)
        np.testing.assert_allclose(found.sizes[0], (4.6, 1.9), atol=0.35)


def test_the_sense_of_a_vehicle_is_not_known_from_a_false_box_beside_it():
    truth = make_truth(drive_straight(40, 30, 0.0, 0.0))

    def disturb(frames):
        missed = range(40, 60)
        false = DetectedBoxes(frames[0].boxes + 60.0, types=("car",))
        changed = [None if step in missed else frame for step, frame in enumerate(frames)]
        return [false if step in (48, 52) else frame for step, frame in enumerate(changed)]

    found = track(truth, DetectorErrors(0.0, 0.0, 2.0), change=disturb)
    assert (found.uncertainty[found.present][:, 1] >= np.pi / 2).all()


def test_errors_of_boxes_that_last_are_stated():
    truth = make_truth(*[drive_straight(5, 6 + 5 * n, 0.0, 6.0, steps=200) for n in range(9)])
    for errors in (DetectorErrors(0.0, 0.0, 2.0), DetectorErrors(0.0, 0.0, 0.5, lasting_px=4.0)):
        found = track(truth, errors)
        error = found.states[pair(truth, found), :, :2] - truth.states[:, :, :2]
        inside = (error**2).sum(axis=2) < 5.99 * found.uncertainty[pair(truth, found), :, 0] ** 2
        assert 0.85 < inside.mean() <= 1.0


@pytest.mark.parametrize("box_shaped", [False, True])
def test_roofs_are_corrected_by_the_flying_height_and_what_is_left_is_stated(box_shaped):
    truth = make_truth(
        drive_straight(8, 8, 0.0, 6.0), drive_straight(70, 52, np.pi, 9.0), kinds=("car", "truck")
    )
    case = make_case_of(
        "",
        truth,
        np.tile(WORLD_FROM_FRAME, (100, 1, 1)),
        SIZE,
        DetectorErrors(0.0, 0.0, 1.0, flying_height=60.0, box_shaped=box_shaped),
        np.random.default_rng(0),
    )
    given = case.boxes, case.world_from_frame, truth.times, truth.world, SIZE
    errors, stated = [], []
    for height in (None, 60.0):
        found = track_boxes(*given, flying_height=height)
        error = found.states[pair(truth, found)] - truth.states
        errors.append(np.hypot(error[..., 0], error[..., 1]))
        stated.append(found.uncertainty[pair(truth, found), :, 0])
    before, after = (np.nanmean(part, axis=1) for part in errors)
    assert (after < 0.6 * before).all()
    inside = (errors[1] < 2.45 * stated[1])[np.isfinite(errors[1])]
    assert inside.mean() > 0.85
    assert (errors[0] < 2.45 * stated[0])[np.isfinite(errors[0])].mean() < 0.5


def test_roofs_that_are_not_corrected_are_told():
    row = {"latitude": 50.0, "longitude": 10.0, "height": 80.0}
    text = describe_roofs(None, make_telemetry([0.0], [row], ""))
    assert "not corrected" in text
    assert "80 m above take-off" in text


def test_standing_vehicles_have_the_heading_of_a_lane_or_none(junction):
    alone = make_truth(drive_straight(40, 30, 0.0, 0.0))
    found = track(alone, EXACT)
    assert abs(np.sin(found.states[0, 0, 2])) < 0.05  # along the box, in either sense
    assert found.uncertainty[0, 0, 1] == np.pi / 2  # the line is known, and not the sense
    assert np.isnan(found.observed[..., 3]).all()
    assert np.isfinite(found.observed[0, -1, :3]).all()
    lane = Directions(np.array([[40.0, 30.0]]), np.array([0.02]), np.array([2.0]))
    found = track(alone, EXACT, lanes=lane)
    np.testing.assert_allclose(found.states[0, :, 2], 0.02)
    assert np.isfinite(found.observed[0, -1]).all()


def test_boxes_at_the_border_are_completed():
    truth = make_truth(drive_straight(-8, 30, 0.0, 8.0))
    found = track(truth, EXACT)
    assert len(found.ids) == 1
    steps = np.flatnonzero(found.present[0])
    error = found.states[0, steps, 0] - truth.states[0, steps, 0]
    assert np.abs(error[5:]).max() < 0.3


def test_oriented_boxes_give_the_heading_of_what_stands():
    corners = np.array([[[100.0, 100], [180, 140], [162, 176], [82, 136]]])
    box = DetectedBoxes(np.array([[82.0, 100, 180, 176]]), corners, types=("car",))
    matrices = np.broadcast_to(WORLD_FROM_FRAME, (20, 3, 3))
    found = track_boxes([box] * 20, matrices, np.arange(20) / 25, World(None), SIZE)
    heading = found.states[0, 0, 2]
    assert abs(np.tan(heading) + 0.5) < 1e-6  # v points down
    np.testing.assert_allclose(found.sizes[0], [4.47, 2.01], atol=0.05)


def test_the_fronts_of_boxes_are_believed_as_far_as_those_of_what_drives():
    def place(points, front):
        ends = np.array([[-2.2, -0.9], [2.2, -0.9], [2.2, 0.9], [-2.2, 0.9]])
        corners = points[:, None] + ends * np.broadcast_to(front, (6, 1))[:, None]
        pixels = transform_points(np.linalg.inv(WORLD_FROM_FRAME), corners)
        return DetectedBoxes(np.hstack([pixels.min(1), pixels.max(1)]), pixels)

    times = np.arange(50) / 25
    matrices = np.broadcast_to(WORLD_FROM_FRAME, (50, 3, 3))
    for front, known in ((1, True), (-1, True), (np.array([[1], [-1]] * 3), False)):
        frames = []
        for step in range(50):
            points = np.array([[10 + 0.4 * step, 10 + 6 * row] for row in range(5)] + [[50, 10]])
            frames.append(place(points, front))
        tracks = track_boxes(frames, matrices, times, World(None), SIZE)
        parked = int(np.argmax(tracks.states[:, 0, 0]))
        sigma = tracks.uncertainty[parked, -1, 1]
        observed = tracks.observed[parked, -1]
        assert np.isfinite(observed[:3]).all()  # it stands in the way of others
        assert np.isfinite(observed[3]) == known
        assert abs(np.sin(tracks.states[parked, -1, 2])) < 0.01
        if known:
            assert np.cos(tracks.states[parked, -1, 2]) > 0.99
            np.testing.assert_allclose(sigma, np.hypot(0.05, np.pi * np.sqrt(1 / 7)), rtol=0.01)
        else:
            assert sigma == np.pi / 2
        part = track_boxes(frames[:30], matrices[:30], times[:30], World(None), SIZE)
        np.testing.assert_array_equal(part.observed[parked], tracks.observed[parked, :30])


def test_noise_is_estimated_from_the_boxes(junction):
    frames, matrices = detect(junction, DetectorErrors(0.0, 0.0, 3.0))
    placed = place_boxes(frames, matrices, SIZE)
    assert estimate_noise(placed, np.full(len(placed.step), -1), junction.times) == 2.0
    agent = np.array([["car", "van", "pedestrian"].index(kind) for kind in placed.types])
    agent[(placed.types == "car") & (placed.position[:, 1] > 44)] = 3
    np.testing.assert_allclose(
        estimate_noise(placed, agent, junction.times), 3 / np.sqrt(2), rtol=0.1
    )


def test_frames_without_a_transform_are_bridged(junction):
    frames, matrices = detect(junction, EXACT)
    matrices = matrices.copy()
    matrices[30:40] = np.nan
    found = track_boxes(frames, matrices, junction.times, junction.world, SIZE)
    assert len(found.ids) == 4
    assert not found.seen[:, 30:40].any()


def test_detections_that_give_no_track_are_refused(junction):
    frames = [DetectedBoxes(np.empty((0, 4)))] * len(junction.times)
    matrices = np.broadcast_to(WORLD_FROM_FRAME, (len(frames), 3, 3))
    with pytest.raises(TracksError, match="0 detections in 100 of 100 frames give no track"):
        track_boxes(frames, matrices, junction.times, junction.world, SIZE)


def test_memory_grows_with_what_is_seen_and_not_with_its_square():
    boxes = np.array([[120.0, 100 * n, 180, 100 * n + 40] for n in range(1, 6)])
    frames = [
        DetectedBoxes(boxes + [6 * (step % 25), 0] * 2) if step % 25 > 2 else None
        for step in range(150)
    ]
    matrices = np.broadcast_to(WORLD_FROM_FRAME, (150, 3, 3))
    found = track_boxes(frames, matrices, np.arange(150) / 25, World(None), SIZE)
    assert len(found.ids) == 30
    assert len(found.to_dataframe()) == found.present.sum() == 30 * 22
    assert "states" not in vars(found)  # N times T values are not made unless they are asked for
    np.testing.assert_array_equal(found.states[found.present], found.get_rows("states"))


def test_turned_boxes_that_the_border_cuts_off_are_completed():
    length, width, speed, end = 5.0, 2.0, 10.0, 40.0
    times = np.arange(40) / 10
    frames: list[DetectedBoxes | None] = []
    for time in times.tolist():
        front = 15 + speed * time
        back, front = front - length, min(front, end)
        if back > end - 0.5:
            frames.append(DetectedBoxes(np.empty((0, 4)), np.empty((0, 4, 2))))
            continue
        box = np.array([[back, 9.0], [front, 9.0], [front, 9.0 + width], [back, 9.0 + width]])
        corners = 10.0 * box[None]  # ten pixels per metre
        bounds = np.concatenate([corners.min(axis=1), corners.max(axis=1)], axis=1)
        at_border = corners[..., 0] > 10 * end - 1
        frames.append(DetectedBoxes(bounds, corners, np.ones(1), at_border=at_border))
    matrices = np.repeat(np.diag([0.1, 0.1, 1.0])[None], len(times), axis=0)
    tracks = track_boxes(frames, matrices, times, World(None), (400, 800))
    present = tracks.present[0]
    middle = 15 + speed * times[present] - length / 2
    assert np.abs(tracks.states[0, present, 0] - middle).max() < 0.1
    assert np.abs(tracks.states[0, present, 3] - speed).max() < 0.5


def test_observed_speeds_are_stated_with_how_surely_they_are_known(junction):
    found = track(junction)
    order = pair(junction, found)[:2]  # those that drive
    known = np.isfinite(found.observed[order, :, 3])
    assert (np.isfinite(found.observed_sigma[order]) == known).all()
    first = found.observed_sigma[order, known.argmax(axis=1)]
    assert (first > 1.5 * found.observed_sigma[order, -1]).all()
    error = (found.observed[order] - junction.states[order])[..., 3][known]
    ratio = error / found.observed_sigma[order][known]
    assert 0.2 < np.sqrt((ratio**2).mean()) < 1.5


def test_fragments_are_dropped_unless_the_video_is_as_short(junction):
    def cut(frames, step):
        empty = DetectedBoxes(np.empty((0, 4)))
        return [frame if 20 <= n < step else empty for n, frame in enumerate(frames)]

    with pytest.raises(TracksError, match=r"last under 0\.5 s"):
        track(junction, EXACT, change=lambda frames: cut(frames, 30))
    assert len(track(junction, EXACT, change=lambda frames: cut(frames, 40)).ids) == 4
    short = cut_tracks(junction, 0.0, 0.4)
    assert len(track(short, EXACT).ids) == 4
