"""Arguments and options that several commands share."""

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

AimFile = Annotated[
    Path,
    typer.Argument(
        help="AIM: a .tif that build, align or draw wrote, or a folder of place or texture"
    ),
]
VideoSource = Annotated[
    str,
    typer.Argument(help="video file, or folder or glob of images; a part: hover.mp4#t=8.5,24 (s)"),
]
VideoSources = Annotated[
    list[str],
    typer.Argument(
        metavar="VIDEO...",
        help="video file or the files of one recording, or folder or glob of images; a part: "
        "hover.mp4#t=8.5,24 (s)",
        show_default=False,
    ),
]
ControlPoints = Annotated[
    Path | None,
    typer.Option(help="control points: .csv, OpenDroneMap gcp_list.txt or QGIS .points"),
]
DetectionsFolder = Annotated[
    Path | None, typer.Option(help="detected boxes: a folder of YOLO .txt, or a file of all frames")
]
ImageRate = Annotated[
    float | None, typer.Option(help="images per second of a folder of images", min=0.01)
]
Near = Annotated[
    str | None,
    typer.Option(help="latitude,longitude of the frame's middle to 35 m, if telemetry lacks it"),
]
ImageryAccuracy = Annotated[
    float | None,
    typer.Option(
        help="standard deviation of the imagery's place, m; 0 takes it as right; if omitted, "
        "2.5 m, of web tiles 4.8 m",
        min=0.0,
    ),
]

TRACKS_HELP = "tracks: .csv or .parquet of geoaim, or a file of a public dataset"
OptionalTracks = Annotated[Path | None, typer.Option(help=TRACKS_HELP)]
SceneTracks = Annotated[
    Path | None, typer.Option(help=f"{TRACKS_HELP}; those of the AIM's folder of place if omitted")
]
TracksWorld = Annotated[
    str | None,
    typer.Option(
        help="CRS and origin of tracks whose file does not state them, such as "
        "'EPSG:32632 459000 5428000'"
    ),
]
TracksResolution = Annotated[
    float | None, typer.Option(help="metres per pixel of tracks in image pixels")
]
TracksFrameRate = Annotated[
    float | None, typer.Option(help="frames per second of tracks that have frames and no times")
]

HDMapFile = Annotated[
    Path | None, typer.Option(help="lanelet2 map, .osm: stop lines, lanes and road area")
]
LightsFile = Annotated[Path | None, typer.Option(help="states of traffic lights, .csv")]
StopLinesFile = Annotated[
    Path | None,
    typer.Option(help="hand-drawn stop lines: GeoJSON lines with the property 'signal'"),
]
DrivableFile = Annotated[
    Path | None, typer.Option(help="hand-drawn drivable area: GeoJSON polygons")
]

AgentKind = Literal["vehicles", "pedestrians", "cyclists"]
Kind = Annotated[AgentKind, typer.Option(help="agents that the model predicts")]
WeightsFile = Annotated[
    Path | None, typer.Option("--weights", help="model.pt; the pretrained model if omitted")
]
Samples = Annotated[int, typer.Option(help="number of sampled futures", min=1)]
Seed = Annotated[int, typer.Option(help="random seed", min=0)]
FixedCamera = Annotated[
    bool, typer.Option("--fixed-camera", help="the camera stands still, on a mast or a tripod")
]
AsJson = Annotated[bool, typer.Option("--json", help="print JSON instead of a table")]


def output(help: str) -> Any:
    """Make the option -o with a command's own help."""
    return typer.Option("--output", "-o", help=help)


def resolution(help: str = "metres per pixel of the map") -> Any:
    """Make the option --resolution with a command's own help."""
    return typer.Option("--resolution", help=help, min=0.001)
