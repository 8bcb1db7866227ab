"""Catalogues: the maps of many recordings, built on one machine or many (extra `catalog`)."""

from importlib.util import find_spec

if missing := [
    name for name in ("distributed", "fsspec", "pystac", "stac_geoparquet") if not find_spec(name)
]:
    raise ImportError(f"catalogues need packages: pip install {' '.join(missing)}")

from geoaim.catalog.engine import Cluster
from geoaim.catalog.pipeline import Catalog, build_catalog, read_catalog
from geoaim.catalog.recordings import Recording, read_recordings
from geoaim.catalog.records import Record
from geoaim.catalog.verification import Problem, remove_changed_files, verify_catalog

__all__ = [
    "Catalog",
    "Cluster",
    "Problem",
    "Record",
    "Recording",
    "build_catalog",
    "read_catalog",
    "read_recordings",
    "remove_changed_files",
    "verify_catalog",
]
