"""Tracks from the files of public data sets; `read_any` tells the form from the columns."""

from geoaim.track_formats.geotrax import read_geotrax
from geoaim.track_formats.interaction import read_interaction
from geoaim.track_formats.levelx import read_highd, read_ind
from geoaim.track_formats.motion import with_motion
from geoaim.track_formats.recognition import read_any
from geoaim.track_formats.sind import read_sind
from geoaim.track_formats.stanford import read_sdd, read_trajnet

__all__ = [
    "read_any",
    "read_geotrax",
    "read_highd",
    "read_ind",
    "read_interaction",
    "read_sdd",
    "read_sind",
    "read_trajnet",
    "with_motion",
]
