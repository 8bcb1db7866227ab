"""Where routes cross the stop lines of lights, and how far ahead the next red light is."""

import torch
from jaxtyping import Float
from torch import Tensor

from geoaim.simulation.overlap import cross
from geoaim.tracks.lights import RED, YELLOW

MAX_STOP_DECELERATION_MPS2 = 4.0  # vehicles that would have to brake harder pass the light
CROSSING_OVERLAP = 1e-4  # share by which segments are extended: no line falls between two
MAX_CROSSINGS = 3  # crossings of a route with a stop line at most; two segments may share one


def intersect_stop_lines(
    routes: Float[Tensor, "B A P 2"], lines: Float[Tensor, "L 2 2"]
) -> Float[Tensor, "B A C L"]:
    """Find where routes cross stop lines: metres along the route at up to C first crossings.

    Crossings that do not exist are infinite.
    """
    start, segment = routes[:, :, :-1, None], routes.diff(dim=2)[:, :, :, None]
    length, line = segment.norm(dim=-1), lines[:, 1] - lines[:, 0]
    offset, denominator = lines[:, 0] - start, cross(segment, line)
    safe = torch.where(denominator == 0, torch.nan, denominator)
    share, line_share = cross(offset, line) / safe, cross(offset, segment) / safe
    limits = routes.new_ones(routes.shape[2] - 1)
    limits[-1] = torch.inf
    crosses = share >= -CROSSING_OVERLAP
    crosses &= share <= limits[:, None] + CROSSING_OVERLAP
    crosses &= (line_share >= 0) & (line_share <= 1)
    along = torch.where(crosses, length.cumsum(2) - length + share * length, torch.inf)
    return along.sort(dim=2).values[:, :, :MAX_CROSSINGS]


def find_red_lights(
    lines: Tensor, fronts: Tensor, speed: Tensor, states: Tensor
) -> Float[Tensor, "B A"]:
    """Find the distance to the next line at which a vehicle must and can stop; infinite if none.

    Args:
        lines: (B, A, C, L) the result of `intersect_stop_lines`.
        fronts: (B, A) how far along their routes the vehicles' fronts are, metres.
        speed: (B, A) m/s.
        states: (B, L) states of the lights, as in `geoaim.tracks.lights`.

    Returns:
        (B, A) metres.
    """
    distance = lines - fronts[..., None, None]
    braking_distance = speed[..., None, None].square() / (2 * MAX_STOP_DECELERATION_MPS2)
    stops = ((states == RED) | (states == YELLOW))[:, None, None] & (distance > braking_distance)
    return torch.where(stops, distance, torch.inf).amin(dim=(2, 3))
