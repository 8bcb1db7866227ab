"""geoaim: aerial image-based maps (AIM) from drone video and third-party imagery.

    aim = geoaim.build_aim("hover.mp4", "control_points.csv")
    geoaim.write_aim(aim, "aim.tif")

Words:
    frame: one video image. reference: the frame that the others are registered to.
    image: a raster of the ground. AIM: an image, plus where it lies in the world.
    texture: the AIM's image as the renderer consumes it. corner frame: its four corners in
    the world: top-left, top-right, bottom-right, bottom-left.
    view: a picture centred on one agent, heading up.
    world: the local metric plane of the tracks: a projected CRS and an origin.
    tracks: agent states over time.

Numbers:
    world axes: x east, y north, metres from `World.origin` in a projected CRS.
    image axes: u right, v down.
    pixels: corner origin; pixel (row i, col j) has its centre at (j + 0.5, i + 0.5).
    OpenCV: origin at the first pixel's centre; `to_opencv` and `from_opencv` convert transforms.
    transforms: destination first, so that chains cancel:
    `world_from_frame = world_from_image @ image_from_frame`.
    points: last axis has 2 entries; row arrays, column-vector matrices.
    angles: radians, counter-clockwise from +x, in [-pi, pi).
    agent axes: x forward, y left; a state is x, y, heading, speed.
    sizes: (height, width).
    images: numpy uint8 RGB, H W 3; torch float in [0, 1], C H W.
    shape letters: B batch, K samples, N agents, E controlled agents, T time, H W rows and columns,
    C channels, M points.
    absence: a boolean mask; numbers that do not exist are NaN.
    precision: float64 for geography, float32 for learning, after the origin is subtracted.
    randomness: an argument named `generator`; nothing seeds globally.

Failure never looks like success: bad data raises a `GeoaimError`, a bad call a `ValueError` or
`TypeError`. The message states what was found, what was needed and what to do.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from geoaim import catalog as catalog
    from geoaim import detection as detection
    from geoaim import hdmap as hdmap
    from geoaim import imagery as imagery
    from geoaim import mapping as mapping
    from geoaim import prediction as prediction
    from geoaim import rendering as rendering
    from geoaim import simulation as simulation
    from geoaim import tracking as tracking
    from geoaim import tracks as tracks
    from geoaim.aim.aim import AIM as AIM
    from geoaim.aim.files import read_aim as read_aim
    from geoaim.aim.files import write_aim as write_aim
    from geoaim.aim.quicklook import draw_quicklook as draw_quicklook
    from geoaim.aim.rectification import rectify as rectify
    from geoaim.aim.texture_files import read_texture as read_texture
    from geoaim.base.errors import GeoaimError as GeoaimError
    from geoaim.base.errors import GeoaimWarning as GeoaimWarning
    from geoaim.base.world import World as World
    from geoaim.detection.detect import detect as detect
    from geoaim.hdmap.lanelet2 import HDMap as HDMap
    from geoaim.hdmap.lanelet2 import read_hdmap as read_hdmap
    from geoaim.hdmap.rasterize import draw_hdmap as draw_hdmap
    from geoaim.imagery.alignment.before_after import draw_alignment as draw_alignment
    from geoaim.imagery.alignment.pipeline import align_tiles as align_tiles
    from geoaim.imagery.alignment.place_by_imagery import place_by_imagery as place_by_imagery
    from geoaim.imagery.mosaic import read_imagery as read_imagery
    from geoaim.mapping.georeference.control_points import (
        read_control_points as read_control_points,
    )
    from geoaim.mapping.pipeline import build_aim as build_aim
    from geoaim.mapping.registration.register import register as register
    from geoaim.mapping.texture import export_texture as export_texture
    from geoaim.mapping.video.detections import read_detections as read_detections
    from geoaim.mapping.video.video import Video as Video
    from geoaim.mapping.video.video import open_video as open_video
    from geoaim.pipeline import Evidence as Evidence
    from geoaim.pipeline import place_video as place_video
    from geoaim.rendering.scene import Scene as Scene
    from geoaim.rendering.scene import make_scene as make_scene
    from geoaim.tracking.find_vehicles import find_vehicles as find_vehicles
    from geoaim.tracking.pipeline import track_video as track_video
    from geoaim.tracks.files import write_tracks as write_tracks
    from geoaim.tracks.formats.formats import read_tracks as read_tracks
    from geoaim.tracks.lights import Lights as Lights
    from geoaim.tracks.lights import read_lights as read_lights
    from geoaim.tracks.tracks import Tracks as Tracks
    from geoaim.web.widget import explore as explore
    from geoaim.web.widget import pick as pick

# the module of each public name; imported on first use, so that `import geoaim` stays fast
_MODULE_OF_NAME = {
    "AIM": "geoaim.aim.aim",
    "GeoaimError": "geoaim.base.errors",
    "GeoaimWarning": "geoaim.base.errors",
    "HDMap": "geoaim.hdmap.lanelet2",
    "Lights": "geoaim.tracks.lights",
    "Scene": "geoaim.rendering.scene",
    "Tracks": "geoaim.tracks.tracks",
    "Video": "geoaim.mapping.video.video",
    "World": "geoaim.base.world",
    "align_tiles": "geoaim.imagery.alignment.pipeline",
    "build_aim": "geoaim.mapping.pipeline",
    "detect": "geoaim.detection.detect",
    "draw_alignment": "geoaim.imagery.alignment.before_after",
    "draw_hdmap": "geoaim.hdmap.rasterize",
    "draw_quicklook": "geoaim.aim.quicklook",
    "explore": "geoaim.web.widget",
    "pick": "geoaim.web.widget",
    "export_texture": "geoaim.mapping.texture",
    "find_vehicles": "geoaim.tracking.find_vehicles",
    "make_scene": "geoaim.rendering.scene",
    "open_video": "geoaim.mapping.video.video",
    "read_aim": "geoaim.aim.files",
    "read_texture": "geoaim.aim.texture_files",
    "read_control_points": "geoaim.mapping.georeference.control_points",
    "read_detections": "geoaim.mapping.video.detections",
    "read_hdmap": "geoaim.hdmap.lanelet2",
    "read_imagery": "geoaim.imagery.mosaic",
    "read_lights": "geoaim.tracks.lights",
    "read_tracks": "geoaim.tracks.formats.formats",
    "Evidence": "geoaim.pipeline",
    "place_by_imagery": "geoaim.imagery.alignment.place_by_imagery",
    "place_video": "geoaim.pipeline",
    "rectify": "geoaim.aim.rectification",
    "register": "geoaim.mapping.registration.register",
    "track_video": "geoaim.tracking.pipeline",
    "write_aim": "geoaim.aim.files",
    "write_tracks": "geoaim.tracks.files",
}
_ROOMS = [
    *("catalog", "detection", "hdmap", "imagery", "mapping", "prediction", "rendering"),
    *("simulation", "tracking", "tracks"),
]
__all__ = [*_MODULE_OF_NAME, *_ROOMS]


def __getattr__(name: str) -> Any:
    if name in _MODULE_OF_NAME:
        return getattr(import_module(_MODULE_OF_NAME[name]), name)
    if name in _ROOMS:
        return import_module(f"geoaim.{name}")
    raise AttributeError(f"module 'geoaim' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
