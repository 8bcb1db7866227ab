"""The viewer's page: served beside its data, or with the data in one HTML file."""

import json
import os
from base64 import b64encode
from html import escape
from importlib.resources import files

from geoaim.base.files import atomic_write
from geoaim.web.map_view import MapView, read_embedded

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
