"""Made places to learn from and to be judged on: written once, then read as any recording is."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

from geoaim.aim import AIM
from geoaim.aim_files import read_aim, write_aim
from geoaim.hdmap.drivable import drivable_area
from geoaim.hdmap.lanelet2 import Area, HDMap, read_hdmap
from geoaim.hdmap.rasterize import draw_hdmap
from geoaim.imagery.alignment.pipeline import align_tiles
from geoaim.lights import Lights, read_lights
from geoaim.progress import Progress, no_progress
from geoaim.simulation.episodes import Rules, rules_of
from geoaim.simulation.scene import Scene, make_scene
from geoaim.synthetic import draw_place, make_place, make_sample, world_from_image, write_sample
from geoaim.synthetic.roads.layouts import PlaceKind
from geoaim.track_changes import resample_tracks
from geoaim.track_files import read_tracks
from geoaim.tracks import Tracks

Places = Sequence[tuple[int, PlaceKind]]
ROADS: Places = (
    (201, "junction"),
    (202, "junction"),
    (203, "t"),
    (204, "roundabout"),
    (205, "junction"),
    (206, "street"),
    (207, "junction"),
    (208, "t"),
    (209, "junction"),
    (210, "roundabout"),
)
NEW_ROADS: Places = (
    (301, "junction"),
    (302, "junction"),
    (303, "t"),
    (304, "roundabout"),
)
PARKS: Places = ((241, "park"), (242, "park"), (243, "park"), (244, "park"))
NEW_PARKS: Places = ((341, "park"), (342, "park"))
CAMPUS: Places = ((251, "campus"), (252, "campus"), (253, "campus"), (254, "campus"))
NEW_CAMPUS: Places = ((351, "campus"), (352, "campus"))
# where people, and vehicles, go where HD maps do not
TRAIN: Mapping[str, Places] = {"vehicle": (*ROADS, *CAMPUS), "pedestrian": (*ROADS, *PARKS)}
TEST: Mapping[str, Places] = {
    "vehicle": (*NEW_ROADS, *NEW_CAMPUS),
    "pedestrian": (*NEW_ROADS, *NEW_PARKS),
}
MINUTES = 10.0
RESOLUTION = 0.1  # m a pixel of drawn places
MAPS = ("aim", "roads", "hdm", "full", "degraded", "another day", "none")
# what is annotated: where vehicles may drive; lanes; walkways, car park, private roads as well
ANNOTATED = {"roads": "map.osm", "hdm": "map.osm", "full": "map_full.osm"}
COARSE = 1.0  # m a pixel of degraded maps, as vehicles see them: finer noise would average out
NOISE = 0.2  # of full brightness, as in the paper


@dataclass(frozen=True, eq=False)
class Recorded:
    """A recording at a place: who was there, the lights, and a map of all that may be driven on."""

    tracks: Tracks
    lights: Lights | None
    hdmap: HDMap

    @cached_property
    def rules(self) -> Rules:
        """What is off the road."""
        return rules_of(self.hdmap)


def make_places(folder: Path, places: Places, *, report: Progress = no_progress) -> list[Path]:
    """The folders of places; those that are not there yet are made."""
    found = []
    for number, (seed, kind) in enumerate(places):
        report("places", number, len(places))
        where = folder / f"{kind}_{seed}"
        if not (where / "README.md").exists():
            sample = make_sample(
                seed, kind=kind, minutes=MINUTES, video=None, resolution=RESOLUTION
            )
            write_sample(sample, where)
        found.append(where)
    report("places", len(places), len(places))
    return found


@lru_cache(maxsize=len(TRAIN["pedestrian"]) + len(TEST["pedestrian"]))
def read_recordings(folder: Path) -> tuple[Recorded, ...]:
    """All recordings of a made place; they stay in memory, since every case is judged on them."""
    found = []
    for path in sorted(folder.glob("tracks*.csv")):
        tracks = read_tracks(path)
        hdmap = read_hdmap(folder / ANNOTATED["full"], tracks.world)
        changes = path.with_name(path.name.replace("tracks", "lights"))
        lights = None
        if changes.exists():
            lights = read_lights(changes, hdmap.stop_lines, tracks.world)
        found.append(Recorded(tracks, lights, hdmap))
    return tuple(found)


def read_map(folder: Path, name: str) -> AIM:
    """A place's map by one of `MAPS`; what takes long is kept in the folder.

    Raises:
        ValueError: there is no such map.
    """
    if name not in MAPS:
        raise ValueError(f"there is no map {name!r}; there are {', '.join(MAPS)}")
    path = folder / "aim.tif"
    if not path.exists():
        write_aim(_drawn(folder), path)
    aim = read_aim(path)
    if name in ANNOTATED:
        hdmap = read_hdmap(folder / ANNOTATED[name], aim.world)
        return draw_hdmap(roads_only(hdmap) if name == "roads" else hdmap)
    if name == "degraded":
        return degraded(aim)
    if name == "none":
        return replace(aim, image=np.full_like(aim.image, 128))
    if name == "another day":
        path = folder / "another_day.tif"
        if not path.exists():
            write_aim(align_tiles(folder / "ortho.tif", aim=aim), path)
        return read_aim(path)
    return aim


def roads_only(hdmap: HDMap) -> HDMap:
    """To be drawn: where vehicles may drive and no more, as the plainest HD maps have it.

    Raises:
        MapError: the map has no lane for vehicles.
    """
    # lines stay without their kinds, by which they would be drawn: the picture's extent is theirs
    lines = tuple(replace(line, kind="", subtype="") for line in hdmap.lines)
    return replace(hdmap, lines=lines, lanelets=(), areas=(Area("", drivable_area(hdmap)),))


def degraded(aim: AIM) -> AIM:
    """A blurred and noisy map."""
    image = blurred_and_noisy(aim.image.astype(np.float32) / 255, COARSE / aim.resolution)
    return replace(aim, image=np.rint(image * 255).astype(np.uint8))


def blurred_and_noisy(image: Float32[Array, "H W 3"], coarse: float) -> Float32[Array, "H W 3"]:
    """Gaussian blur of so many pixels, then noise in squares as wide; 0 to 1.

    The paper degrades images so, without saying at which size of pixels.
    """
    soft = cv2.GaussianBlur(image, (0, 0), coarse)
    height, width = image.shape[:2]
    sides = round(height / coarse), round(width / coarse)
    noise = np.random.default_rng(0).normal(0, NOISE, (*sides, 3))
    spread = cv2.resize(noise, (width, height), interpolation=cv2.INTER_NEAREST)
    return np.clip(soft + spread, 0, 1).astype(np.float32)


def scene_of(recorded: Recorded, aim: AIM, *, rate: float, lights: bool = True) -> Scene:
    """A recording on a map of its place, at so many steps a second.

    Args:
        recorded: what happened.
        aim: from `read_map`.
        rate: in Hz.
        lights: whether they are shown.
    """
    shown = recorded.lights if lights else None
    return make_scene(aim, resample_tracks(recorded.tracks, rate), shown)


def _drawn(folder: Path) -> AIM:
    """The place from above without its traffic, as a drone's background would show it."""
    kind, seed = folder.name.rsplit("_", 1)
    place = make_place(int(seed), kind=kind)  # type: ignore[arg-type]
    image = draw_place(place, resolution=RESOLUTION)
    return AIM.from_image(image, world_from_image(place, RESOLUTION), place.world, "drawn")
