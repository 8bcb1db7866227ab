"""What tracking found, in a few lines."""

import numpy as np
from jaxtyping import Bool
from numpy import ndarray as Array

from geoaim.aim.aim import AIM
from geoaim.base.geometry import transform_points
from geoaim.tracking.standing import UNKNOWN_SIGMA_RAD
from geoaim.tracks.tracks import Tracks

WITHOUT_DETECTOR = (
    "no detector was used: what stands all the time is in the map, and is not tracked"
)


def summarize_tracking(tracks: Tracks, aim: AIM) -> dict[str, str]:
    """Summarize tracks of `track_video`, and how many of their states lie on the AIM."""
    lines = tracks.summarize()
    present = tracks.present
    if tracks.seen is not None and present.any():
        bridged = 1 - tracks.seen[present].mean()
        lines["bridged states"] = f"{bridged:.1%}"
    if tracks.uncertainty is not None and present.any():
        sigma = np.median(tracks.uncertainty[present][:, 0])
        lines["position noise"] = f"{sigma:.2g} m (1 sigma of the smoothed states, median)"
        lines["headings unknown"] = f"{find_unknown_headings(tracks).sum()} agents"
    height, width = aim.coverage.shape
    pixels = transform_points(np.linalg.inv(aim.world_from_image), tracks.states[present][:, :2])
    inside = ((pixels >= 0) & (pixels < [width, height])).all(axis=1)
    return lines | {"on the map": f"{inside.mean():.0%} of the states"}


def find_unknown_headings(tracks: Tracks) -> Bool[Array, " N"]:
    """Find agents whose heading may at some time be any, or its opposite."""
    if tracks.uncertainty is None:
        return np.zeros(len(tracks.ids), bool)
    return np.nan_to_num(tracks.uncertainty[..., 1]).max(axis=1) >= UNKNOWN_SIGMA_RAD
