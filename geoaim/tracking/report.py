"""What tracking found, in a few lines."""

import numpy as np
from jaxtyping import Bool
from numpy import ndarray as Array

from geoaim.aim.aim import AIM
from geoaim.base.geometry import transform_points
from geoaim.tracking.standing import LINE_SIGMA_RAD
from geoaim.tracks.tracks import Tracks

WITHOUT_DETECTOR = (
    "found by geoaim's own network; vehicles that stand all the time are in the map as well"
)


def summarize_tracking(tracks: Tracks, aim: AIM) -> dict[str, str]:
    """Summarize tracks of `track_video`, and how many of their states lie on the AIM."""
    lines = tracks.summarize()
    states, uncertainty = tracks.get_rows("states"), tracks.get_rows("uncertainty")
    if (seen := tracks.get_rows("seen")) is not None and len(seen):
        lines["bridged states"] = f"{1 - seen.mean():.1%}, between two detections"
    if uncertainty is not None and len(uncertainty):
        sigma = np.median(uncertainty[:, 0])
        lines["position noise"] = f"{sigma:.2g} m (1 sigma of the smoothed states, median)"
        lines["headings unknown"] = f"{find_unknown_headings(tracks).sum()} agents"
    height, width = aim.coverage.shape
    pixels = transform_points(np.linalg.inv(aim.world_from_image), states[:, :2])
    inside = ((pixels >= 0) & (pixels < [width, height])).all(axis=1)
    return lines | {"on the map": f"{inside.mean():.0%} of the states"}


def find_unknown_headings(tracks: Tracks) -> Bool[Array, " N"]:
    """Find agents whose heading may at some time be any, or its opposite."""
    unknown = np.zeros(len(tracks.ids), bool)
    if (uncertainty := tracks.get_rows("uncertainty")) is not None:
        agent = np.nonzero(tracks.present)[0]
        unknown[agent[uncertainty[:, 1] >= LINE_SIGMA_RAD]] = True
    return unknown
