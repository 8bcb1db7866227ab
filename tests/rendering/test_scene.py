from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from shapely import MultiPolygon, box

from geoaim.aim.aim import AIM
from geoaim.base.errors import GeoaimWarning, MapError, TracksError
from geoaim.base.geometry import to_opencv
from geoaim.base.world import World, crs_from_world
from geoaim.hdmap.lanelet2 import HDMap, Lanelet
from geoaim.rendering import (
    View,
    make_agent_boxes,
    make_layers,
    make_light_boxes,
    make_scene,
    make_trail_boxes,
    prefilter_ground,
    render,
    render_coverage,
    render_layers,
)
from geoaim.rendering.layers import EGO_COLOUR
from geoaim.rendering.pictures import render_agent_video
from geoaim.rendering.scene import find_agent, find_agent_step, make_ground_from_aim
from geoaim.simulation.road_rules import make_drivable, make_lanes
from geoaim.tracks.formats import read_tracks
from geoaim.tracks.lights import GREEN, RED, STATES, UNKNOWN, Lights
from geoaim.tracks.tracks import Tracks

MAP = World("EPSG:32635", (583200.0, 6062200.0))
OTHER = World("EPSG:32635", (583000.0, 6062000.0))


def _aim(world=MAP):
    image = np.full((200, 300, 3), 60, np.uint8)
    coverage = np.ones((200, 300), np.uint16)
    coverage[:, :30] = 0
    world_from_image = np.array([[0.2, 0, 0], [0, -0.2, 40.0], [0, 0, 1.0]])
    return AIM(image, world_from_image, world, coverage, np.zeros((200, 300), bool))


def _tracks(world=OTHER, first=(230.0, 220.0)):
    """A car that drives north-east, and an agent that appears later."""
    states = np.full((2, 3, 4), np.nan)
    states[0] = [[first[0] + k, first[1] + k, np.pi / 4, 14.1] for k in range(3)]
    states[1, 1:] = [first[0] - 5, first[1], 0.0, 1.0]
    present = np.isfinite(states).all(-1)
    sizes = np.array([[4.5, 1.8], [0.5, 0.6]])
    times = np.array([0.0, 0.1, 0.2])
    return Tracks(times, states, present, sizes, ("car", "pedestrian"), ("7", "b"), world)


def _lights(world=OTHER):
    """A stop line 4 m ahead of the car's second place, red from 0.1 s on; another one green."""
    lines = np.array([[[232.0, 225.0], [236.0, 221.0]], [[200.0, 210.0], [204.0, 210.0]]])
    states = np.array([[UNKNOWN, GREEN], [RED, GREEN]], np.int8)
    return Lights(("a", "b"), lines, np.array([0.0, 0.1]), states, world)


def test_tracks_that_lie_mostly_beside_the_map_are_warned_of():
    tracks = read_tracks("samples/tracks.csv")
    corner = tracks.states[..., :2][tracks.present].mean(axis=0)
    matrix = np.array([[0.5, 0, corner[0]], [0, -0.5, corner[1]], [0, 0, 1.0]])
    aim = AIM.from_image(np.zeros((40, 40, 3), np.uint8), matrix, tracks.world, "a part")
    with pytest.warns(GeoaimWarning, match=r"only \d+% of the agents' positions lie on the map"):
        make_scene(aim, tracks)


def test_tracks_are_transformed_to_the_maps_world():
    scene = make_scene(_aim(), _tracks())
    torch.testing.assert_close(scene.poses[0, 0], torch.tensor([30.0, 20.0, np.pi / 4]))
    assert scene.present.tolist() == [[True] * 3, [False, True, True]]


def test_tracks_in_another_crs_lie_at_the_same_place():
    there = "EPSG:3035"
    origin = crs_from_world(OTHER, np.array([[200.0, 200.0]]), there)[0]
    other = World(there, tuple(origin))
    turned = make_scene(_aim(), _tracks(world=other, first=(30.0, 20.0)))
    straight = make_scene(_aim(), _tracks())
    apart = (turned.poses[0, 0] - straight.poses[0, 0]).numpy()
    assert np.hypot(*apart[:2]) < 12  # both grids turn about the origin, by their convergence
    assert 0.1 < abs(apart[2]) < 0.4


def test_ego_is_in_the_centre_and_heads_up():
    scene, view = make_scene(_aim(), _tracks()), View(60, 60, 0.25)
    step, ego = torch.tensor([1]), torch.tensor([0])
    picture = render(
        view, scene.poses[0, step], scene.ground, [make_agent_boxes(scene, step, ego)]
    )[0]
    torch.testing.assert_close(picture[:, 33, 30], torch.tensor(EGO_COLOUR))
    assert picture[:, 25, 30].min() > 0.99  # the nose, before the middle
    torch.testing.assert_close(picture[:, 5, 5], torch.full((3,), 60 / 255))


def test_pixels_without_coverage_are_grey():
    scene = make_scene(_aim(), _tracks())
    camera = torch.tensor([[2.0, 20.0, 0.0]])
    view = View(4, 4, 0.4)
    assert (render(view, camera, scene.ground) == 0.5).all()
    assert (render_coverage(view, camera, scene.ground) == 0).all()
    assert (render_coverage(view, camera + torch.tensor([20.0, 0, 0]), scene.ground) == 1).all()


def test_light_is_a_bar_of_its_states_colour():
    scene, view = make_scene(_aim(), _tracks(), _lights()), View(60, 60, 0.25)
    steps = torch.tensor([0, 1])
    cameras = scene.poses[0, 1].expand(2, 3)
    result = render(view, cameras, scene.ground, [make_light_boxes(scene, steps)])
    before, after = result[:, :, 16, 30]  # 3.5 m ahead
    torch.testing.assert_close(before, torch.full((3,), 60 / 255))
    torch.testing.assert_close(after, torch.tensor([0.9, 0.1, 0.1]))


def test_trail_shows_past_positions_of_present_agents():
    scene, view = make_scene(_aim(), _tracks()), View(60, 60, 0.25)
    steps = torch.tensor([0, 2])
    cameras = scene.poses[0, 2].expand(2, 3)
    result = render(view, cameras, scene.ground, [make_trail_boxes(scene, steps, duration=0.2)])
    ground = torch.full((3,), 60 / 255)
    torch.testing.assert_close(result[0, :, 37, 30], ground)  # nothing before the first step
    assert result[1, 2, 37, 30] > 0.7
    torch.testing.assert_close(result[1, :, 20, 30], ground)


def test_each_layer_shows_one_agent_type():
    scene, view = make_scene(_aim(), _tracks(), _lights()), View(60, 60, 0.25)
    step, ego = torch.tensor([1]), torch.tensor([0])
    layers = make_layers(scene, step, ego)
    names = list(layers)
    planes = render_layers(view, scene.poses[0, step], scene.ground, list(layers.values()))[0]
    areas = dict(zip(names, planes[3:].sum((1, 2)) * view.resolution**2, strict=True))
    assert names == ["ego", *("vehicle", "pedestrian", "cyclist", "other"), *STATES]
    assert float(areas["ego"]) == pytest.approx(4.5 * 1.8 * (1 - 0.35 / 4), rel=1e-3)
    assert float(areas["pedestrian"]) == pytest.approx(0.5 * 0.6 * (1 - 0.35 / 4), rel=0.08)  # 2 px
    assert float(areas["red"]) == pytest.approx(np.hypot(4, 4) * 1.0, rel=1e-3)
    assert not any(areas[name] for name in ("vehicle", "cyclist", "other", "yellow"))
    plain = render(view, scene.poses[0, step], scene.ground)[0]
    torch.testing.assert_close(planes[:3], plain)


def test_video_has_a_picture_for_each_step():
    scene = make_scene(_aim(), _tracks())
    agent = find_agent(scene, "b")
    pictures = list(render_agent_video(scene, agent, View(32, 40, 0.5), torch.tensor([1, 2])))
    assert [picture.shape for picture in pictures] == [(32, 40, 3)] * 2
    assert pictures[0].dtype == np.uint8
    assert int(find_agent_step(scene, agent, None)) == 1
    assert int(find_agent_step(scene, agent, 0.19)) == 2


def test_absent_agents_are_refused():
    scene = make_scene(_aim(), _tracks())
    with pytest.raises(TracksError, match="no agent 'c' among 2: 7, b"):
        find_agent(scene, "c")
    with pytest.raises(TracksError, match=r"from 0 to 0\.2 s, not at 9 s"):
        find_agent_step(scene, 0, 9.0)


def test_tracks_of_another_place_are_refused():
    with pytest.raises(TracksError, match="no track touches the map"):
        make_scene(_aim(), _tracks(first=(900.0, 0.0)))
    with pytest.raises(TracksError, match="in a local plane without a CRS"):
        make_scene(_aim(), _tracks(world=World(None)))
    with pytest.raises(TracksError, match="the lights in a local plane"):
        make_scene(_aim(), _tracks(), _lights(World(None)))


def test_lights_of_another_place_or_time_are_refused():
    far = replace(_lights(), lines=_lights().lines + 900)
    with pytest.raises(TracksError, match="no stop line touches the map"):
        make_scene(_aim(), _tracks(), far)
    late = replace(_lights(), times=np.array([100.0, 101.0]))
    with pytest.raises(TracksError, match=r"begin at 100 s, the tracks end at 0\.2 s"):
        make_scene(_aim(), _tracks(), late)


def test_maps_far_from_their_worlds_origin_are_refused():
    """There float32 would move poses by up to a quarter of a metre."""
    place = np.eye(3)
    place[:2, 2] = MAP.origin
    aim = replace(_aim(World(MAP.crs)), world_from_image=place @ _aim().world_from_image)
    with pytest.raises(MapError, match=r"6,062 km from its world's origin.*choose_world"):
        make_scene(aim, _tracks())
    with pytest.raises(MapError, match="the drivable area lies 6,062 km"):
        make_drivable(MultiPolygon([box(583200, 6062200, 583230, 6062206)]))
    lane = Lanelet("road", True, *(np.array([[0, y], [30, y]]) + MAP.origin for y in (3.0, 0)))
    with pytest.raises(MapError, match="the HD map lies 6,062 km"):
        make_lanes(HDMap((), (lane,), (), (), World(MAP.crs)))


def test_tilted_map_shows_the_same_place():
    aim, rng = _aim(), np.random.default_rng(0)
    image = rng.integers(0, 255, (200, 300, 3), np.uint8)
    image = cv2.normalize(cv2.GaussianBlur(image, (0, 0), 4), None, 0, 255, cv2.NORM_MINMAX)
    straight = replace(aim, image=image)
    tilt = np.array([[1.0, 0, 0], [0, 1, 0], [1e-4, 5e-5, 1]])
    warped = cv2.warpPerspective(image, to_opencv(np.linalg.inv(tilt)), (300, 200))
    tilted = replace(aim, image=warped, world_from_image=aim.world_from_image @ tilt)
    view, camera = View(40, 40, 0.3), torch.tensor([[35.0, 22.0, 0.4]])
    grounds = [
        prefilter_ground(make_ground_from_aim(a), view.resolution) for a in (straight, tilted)
    ]
    one, two = (render(view, camera, ground) for ground in grounds)
    assert (one - two).abs().mean() < 0.1 * one.std()
