"""Make the view of a map and its traffic that a page, a widget or an HTML file shows."""

import json
import os
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from shapely import MultiPolygon

from geoaim.aim.aim import AIM
from geoaim.aim.files import open_aim, read_aim
from geoaim.aim.texture_files import is_texture, read_map, read_texture
from geoaim.base.errors import AimError
from geoaim.base.grid import Grid
from geoaim.base.world import World
from geoaim.hdmap.drivable import find_drivable_area
from geoaim.hdmap.lanelet2 import HDMap, read_hdmap
from geoaim.imagery.mosaic import read_imagery
from geoaim.prediction.futures import Futures
from geoaim.rendering.scene import Scene, make_scene
from geoaim.simulation.road_rules import make_road_rules
from geoaim.tracks.changes import to_world
from geoaim.tracks.formats.formats import read_tracks
from geoaim.tracks.lights import Lights, read_lights
from geoaim.tracks.tracks import Tracks
from geoaim.web import map_layers, moving_layers
from geoaim.web.map_view import MapView
from geoaim.web.tiles import TiledRaster

FilePath = str | os.PathLike[str]
MapSource = AIM | FilePath
TracksSource = Tracks | FilePath
LightsSource = Lights | FilePath
HDMapSource = HDMap | FilePath
ImagerySource = AIM | FilePath | Sequence[FilePath]
FuturesSource = Futures | FilePath


@dataclass(frozen=True, eq=False)
class Contents:
    """What is shown on a map.

    Attributes:
        tracks: agents, in any world that can be brought into the map's.
        lights: traffic lights.
        hdmap: lanes, borders and markings, in the map's world.
        drivable: area that counts as road; None: the HD map's drivable area.
        imagery: shown beneath the map, with a swipe between the two: an AIM, or what
            `geoaim.read_imagery` reads.
        futures: the result of `predict`, or a file that `geoaim predict -o futures.csv` wrote; in
            the map's world.
        video: of which the tracks are, beside the map and in step; only a served page shows it.
    """

    tracks: Tracks | None = None
    lights: Lights | None = None
    hdmap: HDMap | None = None
    drivable: MultiPolygon | None = None
    imagery: ImagerySource | None = None
    futures: FuturesSource | None = None
    video: Path | None = None


def read_contents(
    aim: MapSource,
    *,
    tracks: TracksSource | None = None,
    lights: LightsSource | None = None,
    hdmap: HDMapSource | None = None,
    imagery: ImagerySource | None = None,
    futures: FuturesSource | None = None,
) -> Contents:
    """Read what is shown on a map; each part may be given as an object or as the path of its file.

    Raises:
        ValueError: lights are a file, and no HD map says where their stop lines are.
        GeoaimError: something cannot be read.
    """
    world = aim.world if isinstance(aim, AIM) else read_map_world(aim)
    if isinstance(hdmap, str | os.PathLike):
        hdmap = read_hdmap(hdmap, world)
    if isinstance(lights, str | os.PathLike):
        if hdmap is None:
            raise ValueError(f"{lights} has no places of its lights: give hdmap= as well")
        lights = read_lights(lights, hdmap.stop_lines, world)
    return Contents(
        tracks=read_tracks(tracks) if isinstance(tracks, str | os.PathLike) else tracks,
        lights=lights,
        hdmap=hdmap,
        imagery=imagery,
        futures=futures,
    )


def make_map_view(aim: MapSource, contents: Contents, stack: ExitStack) -> MapView:
    """Make the view of a map, of whose file only the parts that are shown are read, from overviews.

    Raises:
        GeoaimError: something cannot be read, or lies at another place than the map.
    """
    grid, rasters, title, most = _open_map(aim, stack)
    world = grid.world
    assert world is not None
    items = _describe_aim(rasters, most)
    if contents.imagery is not None:
        beneath = _read_beneath(contents.imagery, grid)
        rasters["imagery"] = map_layers.tile_aim(beneath)["aim_image"]
        items[0]["swipe"] = True
        items.insert(0, map_layers.describe_raster("imagery", "imagery", rasters["imagery"]))
    view = MapView(
        description={
            "kind": "view",
            "title": title,
            "extent": [*grid.corners.min(axis=0).tolist(), *grid.corners.max(axis=0).tolist()],
            "lonlat": map_layers.describe_lonlat(world, grid.corners),
            "pixels_from_world": grid.grid_from_world.tolist(),
            "rasters": items,
            "shapes": _describe_shapes(contents),
            "video": None if contents.video is None else contents.video.name,
            "moving": {},
        },
        rasters=rasters,
        video=contents.video,
    )
    return _add_moving(view, aim, contents, world)


def read_map_world(path: str | os.PathLike[str]) -> World:
    """Read the world of an AIM file, or of a texture."""
    if is_texture(path):
        return read_texture(path).world
    with open_aim(path) as file:
        assert file.grid.world is not None
        return file.grid.world


class _OpenMap(NamedTuple):
    """An open map: its grid, its tiles by path, a title, and the most frames of a pixel."""

    grid: Grid
    rasters: dict[str, TiledRaster]
    title: str
    most: float


def _open_map(aim: MapSource, stack: ExitStack) -> _OpenMap:
    if isinstance(aim, AIM):
        return _OpenMap(aim.grid, map_layers.tile_aim(aim), "AIM", float(aim.coverage.max()))
    if is_texture(aim):
        return _open_map(read_texture(aim), stack)
    file = stack.enter_context(open_aim(aim))
    if not map_layers.is_north_up(file.grid):
        stack.close()
        return _open_map(read_aim(aim), stack)
    most = file.report.get("background", {}).get("frames_used", 1)
    return _OpenMap(file.grid, map_layers.tile_aim_file(file, most), Path(aim).name, most)


def _describe_aim(rasters: dict[str, TiledRaster], most: float) -> list[dict[str, Any]]:
    layers: tuple[tuple[str, str, dict[str, Any]], ...] = (
        ("AIM", "aim_image", {}),
        ("frames per pixel", "aim_coverage", {"legend": map_layers.describe_legend(most)}),
        ("contested", "aim_contested", {"colour": map_layers.CONTESTED_HEX}),
    )
    return [
        map_layers.describe_raster(name, path, rasters[path], visible=not options, **options)
        for name, path, options in layers
    ]


def _describe_shapes(contents: Contents) -> list[dict[str, Any]]:
    """Describe the drivable area, given or of the HD map, and the lines of the HD map."""
    area, hdmap = contents.drivable, contents.hdmap
    if area is None and hdmap is not None:
        area = find_drivable_area(hdmap)
    shapes = [] if area is None else [map_layers.describe_area(area)]
    return shapes if hdmap is None else shapes + map_layers.describe_lines(hdmap)


def _read_beneath(imagery: ImagerySource, grid: Grid) -> AIM:
    if isinstance(imagery, AIM):
        if imagery.world != grid.world:
            raise AimError(
                f"the map's world is {grid.world} and that of the imagery {imagery.world}; read "
                "the imagery with world=aim.world"
            )
        return imagery
    return read_imagery(imagery, world=grid.world, corners=grid.corners)


def _add_moving(view: MapView, aim: MapSource, contents: Contents, world: World) -> MapView:
    """Add tracks, lights, futures, infractions and the views of agents."""
    moving: dict[str, Any] = {}
    description = dict(view.description, moving=moving)
    if contents.lights is not None:
        moving["lights"] = moving_layers.describe_lights(contents.lights, world)
    if contents.futures is not None:
        given = contents.futures
        moving["futures"] = (
            moving_layers.describe_futures(given)
            if isinstance(given, Futures)
            else moving_layers.describe_futures_file(given)
        )
    if contents.tracks is None:
        return replace(view, description=description)
    tracks = to_world(contents.tracks, world)
    moving["tracks"], data = moving_layers.describe_tracks(tracks)

    @cache
    def get_scene() -> Scene:
        whole = aim if isinstance(aim, AIM) else read_map(aim)
        return make_scene(whole, tracks, contents.lights)

    rules = make_road_rules(contents.hdmap, contents.drivable, world=world)

    def encode_infractions() -> bytes:
        return json.dumps(moving_layers.list_infractions(get_scene(), rules)).encode()

    description |= {"marks": "marks.json", "agent_views": True}
    return replace(
        view,
        description=description,
        data={**data, "marks.json": encode_infractions},
        agent_view=lambda agent, step: moving_layers.render_model_view(get_scene(), agent, step),
    )
