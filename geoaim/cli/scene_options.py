"""The options of a scene's files beside its map and tracks, which several commands share."""

import inspect
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import wraps
from pathlib import Path

from geoaim.cli import options
from geoaim.cli.inputs import SceneSource


@dataclass(frozen=True)
class SceneFiles:
    """The values of these options."""

    lights: options.LightsFile = None
    hdmap: options.HDMapFile = None
    stop_lines: options.StopLinesFile = None
    tracks_world: options.TracksWorld = None
    tracks_resolution: options.TracksResolution = None
    tracks_frame_rate: options.TracksFrameRate = None

    def make_source(self, aim: Path, tracks: Path | None) -> SceneSource:
        """Make the source of a scene on a map."""
        return SceneSource(aim, tracks, **vars(self))


def take_scene_files(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the options of `SceneFiles`, last, in place of its parameter `files`."""
    own = inspect.signature(command)
    names = [field.name for field in fields(SceneFiles)]
    shared = [
        inspect.Parameter(
            field.name, inspect.Parameter.KEYWORD_ONLY, default=None, annotation=field.type
        )
        for field in fields(SceneFiles)
    ]
    kept = [parameter for name, parameter in own.parameters.items() if name != "files"]
    signature = own.replace(parameters=[*kept, *shared])

    @wraps(command)
    def run(*args: object, **kwargs: object) -> None:
        bound = signature.bind(*args, **kwargs)
        bound.apply_defaults()
        given = {name: bound.arguments.pop(name) for name in names}
        command(**bound.arguments, files=SceneFiles(**given))

    run.__signature__ = signature  # type: ignore[attr-defined]  # typer reads both
    run.__annotations__ = {p.name: p.annotation for p in signature.parameters.values()}
    return run
