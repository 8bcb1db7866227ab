"""What the viewer shows: a description, and the data that it names, served or in one HTML file."""

import json
import os
from base64 import b64encode
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from html import escape
from importlib.resources import files
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from geoaim.base.files import atomic_write
from geoaim.web.tiles import TiledRaster

PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<title>{title}</title>
<link rel="icon" href="data:,">
</head>
<body>
<main id="geoaim-page"></main>
{scripts}
</body>
</html>
"""
MAX_EMBEDDED_PIXELS = 16e6  # pixels of a raster in an HTML file
Reply = dict[str, Any]


@dataclass(frozen=True, eq=False)
class MapView:
    """What the viewer shows.

    Attributes:
        description: JSON as `geoaim/web/src/view.js` reads it; paths name what `read` gives.
        rasters: tiles by the first part of their path.
        data: functions that make the bytes at a path.
        agent_view: PNG or JPEG of what surrounds an agent, from its id and the index of a time;
            None: there is none.
        call: answers an action of the page; None: the page only shows.
        video: shown beside the map, by a server alone; None: there is none.
    """

    description: Mapping[str, Any]
    rasters: Mapping[str, TiledRaster] = field(default_factory=dict)
    data: Mapping[str, Callable[[], bytes]] = field(default_factory=dict)
    agent_view: Callable[[str, int], bytes] | None = None
    call: Callable[[Mapping[str, Any]], Reply] | None = None
    video: Path | None = None

    def read(self, path: str) -> bytes:
        """Read what the description names, or "description.json" itself.

        Raises:
            KeyError: nothing is at that path.
        """
        first, *rest = path.split("/")
        if path == "description.json":
            return json.dumps(self.description).encode()
        if path in self.data:
            return self.data[path]()
        if first in self.rasters and len(rest) == 3 and all(map(str.isdecimal, rest)):
            level, column, row = map(int, rest)
            return self.rasters[first].encode_tile(level, column, row)
        if first == "agent_views" and self.agent_view and len(rest) == 2 and rest[1].isdecimal():
            return self.agent_view(unquote(rest[0]), int(rest[1]))
        raise KeyError(f"there is nothing at {path}")


def read_embedded(view: MapView) -> dict[str, bytes]:
    """Read all that an HTML file holds: without views of agents, and with coarser tiles."""
    shown: dict[str, Any] = dict(view.description, agent_views=False, video=None)
    files = {path: make() for path, make in view.data.items()}
    shown["rasters"] = []
    for item in view.description["rasters"]:
        tiles = view.rasters[item["path"]].list_tiles(MAX_EMBEDDED_PIXELS)
        levels = 1 + max(level for level, _, _ in tiles)
        shown["rasters"].append(dict(item, resolutions=item["resolutions"][:levels]))
        paths = [f"{item['path']}/{level}/{column}/{row}" for level, column, row in tiles]
        files |= {path: view.read(path) for path in paths}
    return {"description.json": json.dumps(shown).encode(), **files}


def read_module() -> str:
    """Read the viewer's ES module: OpenLayers and `geoaim/web/src` in one file."""
    return (files("geoaim.web") / "geoaim.js").read_text(encoding="utf-8")


def make_page(title: str) -> str:
    """Make the page that a server shows beside "geoaim.js"."""
    script = '<script type="module" src="geoaim.js"></script>'
    return PAGE.format(title=escape(title), scripts=script)


def write_html(view: MapView, path: str | os.PathLike[str]) -> None:
    """Write one HTML file that shows a view without a server or a network."""
    data = {path: b64encode(content).decode() for path, content in read_embedded(view).items()}
    scripts = (
        f'<script type="application/json" id="geoaim-data">{json.dumps(data)}</script>\n'
        f'<script type="module">{read_module()}</script>'
    )
    page = PAGE.format(title=escape(str(view.description["title"])), scripts=scripts)
    with atomic_write(path) as temporary:
        temporary.write_text(page, encoding="utf-8")
