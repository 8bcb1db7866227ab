"""Agents over time: tracks, traffic lights, their tables, files and formats."""

from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from geoaim.tracks import formats as formats

__all__ = ["formats"]


def __getattr__(name: str) -> ModuleType:
    if name == "formats":  # imported on first use
        return import_module("geoaim.tracks.formats")
    raise AttributeError(f"module 'geoaim.tracks' has no attribute {name!r}")
