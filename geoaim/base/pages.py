"""The style that all pages share."""

from importlib.resources import files


def read_page_style() -> str:
    """Read the CSS of type, spacing and colours, for elements of class geoaim or geoaim-report."""
    return (files("geoaim.base") / "page.css").read_text(encoding="utf-8")
