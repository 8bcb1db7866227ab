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
    OpenCV: centre origin; `to_opencv` and `from_opencv` stand beside each cv2 call.
    transforms: destination first, so that chains cancel:
    `world_from_frame = world_from_image @ image_from_frame`.
    points: last axis has 2 entries; row arrays, column-vector matrices.
    angles: radians, counter-clockwise from +x, in [-pi, pi).
    agent axes: x forward, y left; a state is x, y, heading, speed.
    sizes: (height, width).
    images: numpy uint8 RGB, H W 3; torch float in [0, 1], C H W.
    shape letters: B batch, K samples, N agents, T time, H W rows and columns, C channels, M points.
    absence: a boolean mask; numbers that do not exist are NaN.
    precision: float64 for geography, float32 for learning, after the origin is subtracted.
    randomness: an argument named `generator`; nothing seeds globally.

Failure never looks like success: bad data raises a `GeoaimError`, a bad call a `ValueError` or
`TypeError`, and the message says what was found, what was needed and what to do.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from geoaim import mapping as mapping
    from geoaim.aim import AIM as AIM
    from geoaim.aim_files import read_aim as read_aim
    from geoaim.aim_files import write_aim as write_aim
    from geoaim.errors import GeoaimError as GeoaimError
    from geoaim.errors import GeoaimWarning as GeoaimWarning
    from geoaim.imagery.alignment.pipeline import align_tiles as align_tiles
    from geoaim.mapping.pipeline import build_aim as build_aim
    from geoaim.mapping.texture import export_texture as export_texture
    from geoaim.rectify import rectify as rectify
    from geoaim.track_files import read_tracks as read_tracks
    from geoaim.track_files import write_tracks as write_tracks
    from geoaim.tracks import Tracks as Tracks
    from geoaim.world import World as World

# where each public name lives; loaded on first use, so that `import geoaim` costs nothing
_HOMES = {
    "AIM": "geoaim.aim",
    "GeoaimError": "geoaim.errors",
    "GeoaimWarning": "geoaim.errors",
    "Tracks": "geoaim.tracks",
    "World": "geoaim.world",
    "align_tiles": "geoaim.imagery.alignment.pipeline",
    "build_aim": "geoaim.mapping.pipeline",
    "export_texture": "geoaim.mapping.texture",
    "read_aim": "geoaim.aim_files",
    "read_tracks": "geoaim.track_files",
    "rectify": "geoaim.rectify",
    "write_aim": "geoaim.aim_files",
    "write_tracks": "geoaim.track_files",
}
_MODULES = ("mapping",)
__all__ = [*_HOMES, *_MODULES]


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    if name in _MODULES:
        return import_module(f"geoaim.{name}")
    raise AttributeError(f"module 'geoaim' has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
