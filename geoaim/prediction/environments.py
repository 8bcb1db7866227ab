"""The gymnasium environment with traffic by a model: what `gymnasium.make` calls."""

from pathlib import Path
from typing import Any

from geoaim.hdmap.lanelet2 import read_hdmap
from geoaim.hdmap.rasterize import draw_hdmap
from geoaim.prediction.policies import make_traffic
from geoaim.rendering.scene import Scene, make_scene
from geoaim.simulation.environment import DrivingEnv
from geoaim.simulation.road_rules import NO_ROAD_RULES, RoadRules, make_road_rules
from geoaim.simulation.simulator import Traffic
from geoaim.tracks.files import read_plain_tracks
from geoaim.tracks.lights import read_lights

SAMPLE = Path(__file__).parents[1] / "samples"
RESOLUTION = 0.5  # metres per pixel of the sample's map, drawn from its HD map


def make_environment(
    scene: Scene | None = None,
    rules: RoadRules | None = None,
    *,
    traffic: Traffic | str | None = None,
    **options: Any,
) -> DrivingEnv:
    """Make a `DrivingEnv`.

    Args:
        scene: the recording, on the CPU; None: the sample that comes with geoaim.
        rules: the drivable area; None: that of the sample, or none for a scene of one's own.
        traffic: moves the other agents; "itra": the vehicle model of the package; None: they
            replay.
        options: others of `DrivingEnv`.

    Returns:
        The environment.

    Raises:
        ValueError: there is no such traffic, or rules are given without a scene.
    """
    if isinstance(traffic, str):
        if traffic != "itra":
            raise ValueError(f"there is no traffic {traffic!r}; give 'itra', or `make_traffic`")
        traffic = make_traffic()
    if scene is None:
        if rules is not None:
            raise ValueError("rules are given without the scene that they are of; give both")
        scene, rules = _make_sample()
    return DrivingEnv(scene, rules or NO_ROAD_RULES, traffic=traffic, **options)


def _make_sample() -> tuple[Scene, RoadRules]:
    """The sample's traffic and lights on a map that is drawn from its HD map."""
    tracks = read_plain_tracks(SAMPLE / "tracks.csv")
    hdmap = read_hdmap(SAMPLE / "map.osm", tracks.world)
    lights = read_lights(SAMPLE / "lights.csv", hdmap.stop_lines, tracks.world)
    aim = draw_hdmap(hdmap, resolution=RESOLUTION)
    return make_scene(aim, tracks, lights), make_road_rules(hdmap)
