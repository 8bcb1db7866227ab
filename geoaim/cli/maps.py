"""Commands that draw and export maps."""

from pathlib import Path
from typing import Annotated

import typer

from geoaim.cli import options
from geoaim.cli.console import console, report_errors
from geoaim.cli.outputs import GEOTIFF, check_output


def draw(
    hdmap: Annotated[Path, typer.Argument(help="lanelet2 map, .osm")],
    output: Annotated[Path, options.output("GeoTIFF to write")],
    resolution: Annotated[float, options.resolution()] = 0.2,
    aim: Annotated[Path | None, typer.Option(help="AIM whose world is used")] = None,
) -> None:
    """Draw an HD map as an AIM, for use with every command and model.

    Maps in metres around (0, 0), such as those of INTERACTION and SinD, need no --aim.

    Example: geoaim draw samples/map.osm -o map.tif
    """
    from geoaim.aim.files import read_aim, write_aim
    from geoaim.hdmap.lanelet2 import read_hdmap
    from geoaim.hdmap.rasterize import draw_hdmap

    with report_errors():
        check_output(output, GEOTIFF, [hdmap, aim])
        world = None if aim is None else read_aim(aim).world
        drawn = draw_hdmap(read_hdmap(hdmap, world), resolution=resolution)
        write_aim(drawn, output)
    height, width = drawn.image.shape[:2]
    console.print(f"{output}: {width} x {height} px, {resolution} m per pixel")


def texture(
    aim: options.AimFile,
    folder: Annotated[Path, typer.Argument(help="folder for texture.png and texture.json")],
    resolution: Annotated[float | None, options.resolution()] = None,
) -> None:
    """Export an AIM as a texture and its corner frame, for a renderer.

    Example: geoaim texture map.tif texture
    """
    from geoaim.aim.texture_files import read_map
    from geoaim.mapping.texture import export_texture

    with report_errors():
        check_output(folder / "texture.json", inputs=[aim])
        export_texture(read_map(aim), folder, resolution=resolution)
    console.print(f"{folder / 'texture.png'}, {folder / 'texture.json'}")
