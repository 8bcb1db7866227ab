import numpy as np
import pytest
import shapely
from shapely.affinity import affine_transform

from benchmarks.synthetic import Hover, make_sample, tracks_of
from benchmarks.synthetic.roads.paving import outline_crossing
from benchmarks.synthetic.traffic.signals import compute_light_states
from geoaim.tracks.lights import RED
from tests.sizes import keep_quick

VEHICLES = ("car", "van", "truck", "bus")
WHEELBASE = 0.6  # share of the length


def _bodies(tracks, chosen, *, grow=0.0):
    """Boxes of the chosen agents at every time: (n, T, 4, 2)."""
    x, y, heading, _ = np.moveaxis(tracks.states[chosen], -1, 0)
    half = tracks.sizes[chosen, None] / 2 + grow
    ahead = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    left = np.stack([-ahead[..., 1], ahead[..., 0]], axis=-1)
    middle = np.stack([x, y], axis=-1)
    sides = [(1, 1), (1, -1), (-1, -1), (-1, 1)]
    corners = [middle + a * half[..., :1] * ahead + b * half[..., 1:] * left for a, b in sides]
    return np.stack(corners, axis=-2)


def _in_world(sample, geometry):
    m = sample.place.world_from_plan
    return affine_transform(geometry, [m[0, 0], m[0, 1], m[1, 0], m[1, 1], m[0, 2], m[1, 2]])


def _is(tracks, *types):
    return np.array([kind in types for kind in tracks.types])


def test_vehicles_never_overlap(recorded):
    _, tracks = recorded
    vehicle = _is(tracks, *VEHICLES)
    bodies, present = _bodies(tracks, vehicle), tracks.present[vehicle]
    for step in range(0, len(tracks.times), 2):
        shapes = shapely.polygons(bodies[present[:, step], step])
        pairs = shapely.STRtree(shapes).query(shapes, predicate="intersects")
        for a, b in pairs.T[pairs[0] < pairs[1]]:
            assert shapely.area(shapely.intersection(shapes[a], shapes[b])) < 1e-3


def test_no_vehicle_hits_a_pedestrian(recorded):
    _, tracks = recorded
    vehicle = _is(tracks, *VEHICLES)
    bodies = _bodies(tracks, vehicle)
    for step in range(0, len(tracks.times), 5):
        shapes = shapely.polygons(bodies[tracks.present[vehicle, step], step])
        pedestrians = tracks.states[~vehicle & tracks.present[:, step], step, :2]
        hit = shapely.STRtree(shapes).query(shapely.points(pedestrians), predicate="within")
        assert hit.shape[1] == 0


def test_vehicles_stay_on_the_asphalt(recorded):
    sample, tracks = recorded
    paving = sample.place.roads.paving
    asphalt = shapely.union_all([paving.carriageway, paving.driveway, paving.parking_lot]).buffer(
        0.3
    )
    asphalt = _in_world(sample, asphalt)
    shapely.prepare(asphalt)
    corners = _bodies(tracks, _is(tracks, *VEHICLES))[tracks.present[_is(tracks, *VEHICLES)]]
    assert shapely.contains_xy(asphalt, *corners.reshape(-1, 2).T).mean() > 0.998


def test_pedestrians_stay_on_pavements_and_crossings(recorded):
    sample, tracks = recorded
    roads = sample.place.roads
    allowed = [roads.paving.pavement, roads.footpaths.surface, roads.paving.driveway]
    allowed += [outline_crossing(crossing).buffer(0.6) for crossing in roads.crossings]
    ground = _in_world(sample, shapely.union_all(allowed).buffer(0.1))
    pedestrians = _is(tracks, "pedestrian", "cyclist")
    places = tracks.states[pedestrians][tracks.present[pedestrians]][:, :2]
    assert shapely.contains_xy(ground, *places.T).mean() > 0.99


def test_motion_of_vehicles_is_that_of_a_kinematic_bicycle(recorded):
    """The acceleration and steering of the states are feasible, and the rear axle does not slip."""
    _, tracks = recorded
    for agent in np.flatnonzero(_is(tracks, "car", "van")):
        steps = np.flatnonzero(tracks.present[agent])
        if len(steps) < 20 or len(steps) != np.ptp(steps) + 1:
            continue
        x, y, heading, speed = tracks.states[agent, steps].T
        length = tracks.sizes[agent, 0]
        rear = np.stack([x - 0.3 * length * np.cos(heading), y - 0.3 * length * np.sin(heading)], 1)
        turn = (np.diff(heading) + np.pi) % (2 * np.pi) - np.pi
        middle = heading[:-1] + turn / 2
        run = (np.diff(rear, axis=0) * np.stack([np.cos(middle), np.sin(middle)], 1)).sum(axis=1)
        slip = (np.diff(rear, axis=0) * np.stack([-np.sin(middle), np.cos(middle)], 1)).sum(axis=1)
        assert np.abs(slip).max() < 0.02  # m
        moves = np.abs(run) > 0.02
        steering = np.arctan(WHEELBASE * length * turn[moves] / run[moves])
        assert np.abs(steering).max(initial=0) < 0.75
        assert np.abs(np.diff(speed) / 0.1).max() < 10.0


def test_speed_is_that_of_the_box_centre(recorded):
    _, tracks = recorded
    moved = np.diff(tracks.states[..., :2], axis=1)
    along = np.hypot(moved[..., 0], moved[..., 1]) / 0.1
    mean = np.abs(tracks.states[:, 1:, 3] + tracks.states[:, :-1, 3]) / 2
    known = np.isfinite(along) & np.isfinite(mean)
    assert np.percentile(np.abs(along - mean)[known], 99) < 0.15


def test_no_vehicle_passes_a_red_light(recorded):
    sample, _ = recorded
    recording, tables = sample.recordings[0], sample.traffic_model.tables
    if not recording.signals.names:
        return
    lights = compute_light_states(recording.signals, recording.times)
    rows, paths = recording.vehicle_rows, recording.vehicle_paths
    lengths = np.array([trip.size[0] for trip in recording.vehicle_trips])
    front = recording.vehicle_motion[:, 0] + 0.8 * lengths[rows[:, 1]]
    to_line = tables.stop[paths] - front
    order = np.lexsort((rows[:, 0], rows[:, 1]))
    rows, paths, to_line = rows[order], paths[order], to_line[order]
    same = (rows[1:, 1] == rows[:-1, 1]) & (paths[1:] == paths[:-1])
    passed = same & (to_line[:-1] > 0) & (to_line[1:] <= 0)
    index = np.flatnonzero(passed & (tables.signal[paths[:-1]] >= 0))
    assert len(index) > 5
    state = lights[rows[index, 0], tables.signal[paths[index]]]
    assert (state != RED).all()


def test_agents_of_several_types_move_and_wait(recorded):
    _, tracks = recorded
    speed = np.abs(tracks.states[..., 3])
    assert (speed[tracks.present] < 0.1).mean() > 0.005
    assert {"car", "pedestrian"} <= set(tracks.types)
    assert 10 < tracks.present.sum(axis=0).mean() < 90


@pytest.mark.slow
def test_cars_enter_and_leave_the_car_park():
    sample = make_sample(2, kind="street", minutes=5.0, video=None)
    recording, tables = sample.recordings[0], sample.traffic_model.tables
    path, (at, speed) = recording.vehicle_paths, recording.vehicle_motion.T
    of_bay, moves, into_bay = tables.bay[path] >= 0, speed > 1.0, tables.into_bay[path]
    near_end = at > tables.length[path] - 20
    assert (of_bay & into_bay & moves & near_end).any()
    assert (of_bay & ~into_bay & moves).any()
    tracks = tracks_of(sample)
    assert np.nanmin(tracks.states[..., 3]) < -0.5  # a vehicle reverses


@pytest.mark.parametrize("kind", keep_quick(["junction", "roundabout"], "junction"))
def test_same_seed_gives_the_same_tracks(kind):
    one, again = (tracks_of(make_sample(9, kind=kind, minutes=0.2, video=None)) for _ in range(2))
    np.testing.assert_array_equal(one.states, again.states)
    assert one.ids == again.ids


@pytest.mark.slow
def test_long_traffic_is_split_into_different_recordings():
    sample = make_sample(1, kind="street", minutes=6.0, video=None)
    assert [round(float(r.times[-1])) for r in sample.recordings] == [300, 60]
    assert tracks_of(sample, 1).times[-1] == pytest.approx(60.0)
    assert sample.recordings[0].vehicle_trips[5] != sample.recordings[1].vehicle_trips[5]


def test_traffic_shorter_than_its_video_is_refused():
    with pytest.raises(ValueError, match="minutes of traffic"):
        make_sample(1, minutes=0.05)


@pytest.mark.parametrize("minutes", [0.21, 0.26, 0.3])
def test_tracks_end_within_a_recording_of_any_length(minutes):
    tracks = tracks_of(make_sample(1, kind="t", minutes=minutes, video=None))
    assert 60 * minutes - 0.11 < tracks.times[-1] <= 60 * minutes + 0.25


def test_more_video_than_a_recording_is_refused():
    with pytest.raises(ValueError, match="at most 300 s"):
        make_sample(1, minutes=10.0, hover=Hover(count=400, frame_rate=1.0))
