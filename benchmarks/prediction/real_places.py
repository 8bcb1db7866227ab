"""Recordings of real places, each on a map: an image, or an HD map where there is none."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd

from benchmarks.data import read_image, require_data
from benchmarks.realism.motion import read_sdd_resolutions
from geoaim.aim.aim import AIM
from geoaim.base.world import World
from geoaim.hdmap.lanelet2 import read_hdmap
from geoaim.hdmap.rasterize import draw_hdmap
from geoaim.mapping.georeference.from_telemetry import make_local_georeference
from geoaim.rendering.scene import Scene, make_scene
from geoaim.simulation.road_rules import NO_ROAD_RULES, RoadRules, make_road_rules
from geoaim.tracks.agent_types import TYPICAL_SIZES
from geoaim.tracks.changes import resample_tracks
from geoaim.tracks.formats import read_interaction, read_sdd
from geoaim.tracks.formats.motion import make_tracks_from_positions
from geoaim.tracks.tracks import Tracks

# folders of Stanford's raw annotations; the window of observed states was chosen on the first one
STANFORD_VAL, STANFORD_TEST = "hyang", ("gates", "nexus")
KARLSRUHE = ("k729_2022-03-16", "k733_2018-05-02")


# 98 % of the speeds there are below 15 m/s, and stopped vehicles 4 to 7 m apart, by this scale; the
# counters of its lights change every 30 frames
ZHENGZHOU_RESOLUTION, ZHENGZHOU_RATE, ZHENGZHOU_SIZE = 0.09, 30.0, (1080, 1920)
GREY = 110


@dataclass(frozen=True, eq=False)
class RealRecording:
    """A recording of a real place, and a map of the place."""

    tracks: Tracks  # the agents, at the rate of the file
    aim: AIM  # the map
    rules: RoadRules = NO_ROAD_RULES  # where vehicles may drive, where an HD map tells

    def make_scene(self, dt: float) -> Scene:
        """Make the scene of the recording at steps of `dt` seconds."""
        return make_scene(self.aim, resample_tracks(self.tracks, 1 / dt))


def read_stanford(place: str) -> Iterator[RealRecording]:
    """Read the raw annotations of a Stanford place, on the reference image of each video."""
    folder = require_data("tracks/sdd_raw")
    scales = read_sdd_resolutions(folder / "estimated_scales.yaml")
    for path in sorted((folder / place).glob("*/annotations.txt.gz")):
        resolution = scales[place, path.parent.name]
        image = read_image(path.with_name("reference.jpg"))
        fit = make_local_georeference(resolution=resolution, size=image.shape[:2])
        aim = AIM.from_image(image, fit.world_from_image, fit.world, "Stanford Drone Dataset")
        yield RealRecording(read_sdd(path, resolution=resolution), aim)


def read_karlsruhe(junction: str) -> Iterator[RealRecording]:
    """Read the vehicles of a junction in Karlsruhe, on its HD map, as there is no image."""
    folder = require_data("tracks/karlsruhe")
    for path in sorted((folder / "tracks" / junction).glob("vehicle_tracks*.csv")):
        tracks = read_interaction(path)
        hdmap = read_hdmap(folder / "maps" / f"{junction}.osm", tracks.world)
        yield RealRecording(tracks, draw_hdmap(hdmap), make_road_rules(hdmap))


def read_zhengzhou(name: str) -> RealRecording:
    """Read vehicles of a junction in Zhengzhou, in pixels of a video; its map is plain grey."""
    columns = ["frame", "id", "x", "y"]
    path = require_data("tracks/zhengzhou_signals") / f"{name}.txt"
    rows = pd.read_csv(path, sep="\t", header=None, usecols=range(4), names=columns)
    resolution = ZHENGZHOU_RESOLUTION
    rows = rows.drop_duplicates(["id", "frame"]).assign(
        id=lambda table: table["id"].astype(int).astype(str),
        time=lambda table: table["frame"] / ZHENGZHOU_RATE,
        x=lambda table: table["x"] * resolution,
        y=lambda table: -table["y"] * resolution,
        type="car",
        length=TYPICAL_SIZES["car"][0],
        width=TYPICAL_SIZES["car"][1],
    )
    tracks = make_tracks_from_positions(rows, World(None), half_window=0.5)
    fit = make_local_georeference(resolution=resolution, size=ZHENGZHOU_SIZE)
    image = np.full((*ZHENGZHOU_SIZE, 3), GREY, np.uint8)
    aim = AIM.from_image(image, fit.world_from_image, fit.world, "plain grey")
    return RealRecording(tracks, aim)
