"""Routes: the recorded paths of agents, and how far along them agents are."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from geoaim.simulation.simulator import Scenario

ROUTE_SPACING_M = 1.0  # above the noise of the recorded positions of waiting agents
COARSE_STRIDE = 4  # points, of which the nearest one is searched first
MIN_LEAVING_SPEED_MPS = 0.5  # an agent whose last speed is lower stands rather than leaves
MIN_SEGMENT_M = 1e-6


@dataclass(frozen=True, eq=False)
class Routes:
    """The routes of all agents, as points every `ROUTE_SPACING_M`."""

    points: Float[Tensor, "B A P 2"]  # metres in the world
    lengths: Float[Tensor, "B A"]  # metres to the recorded end, before the extension
    stops: Bool[Tensor, "B A"]  # whether the agent stands there at the end


def extract_routes(scenario: Scenario) -> Routes:
    """Extract the recorded routes of all agents of a scenario."""
    states = scenario.states  # (B, A, T, 4)
    keep = _select_spaced(states[..., :2], scenario.present)
    order = keep.int().argsort(dim=2, descending=True, stable=True)
    count = keep.sum(dim=2, keepdim=True)  # (B, A, 1)
    slot = torch.arange(int(count.max()) + 1, device=keep.device)
    step = order.gather(2, slot.minimum(count - 1))  # (B, A, P), the last one repeated
    route = states.gather(2, step[..., None].expand(*step.shape, 4))
    second_last = route.gather(2, (count - 2).clamp_min(0)[..., None].expand(-1, -1, 1, 4))
    last_segment = route[:, :, -1:, :2] - second_last[..., :2]
    heading = torch.stack([second_last[..., 2].cos(), second_last[..., 2].sin()], dim=-1)
    forward = torch.where(count[..., None] > 1, last_segment, heading)
    forward = forward / forward.norm(dim=-1, keepdim=True)
    extension = forward * ROUTE_SPACING_M * (slot - count + 1).clamp_min(0)[..., None]
    lengths = route[..., :2].diff(dim=2).norm(dim=-1).sum(dim=-1)
    steps = torch.arange(states.shape[2], device=keep.device)
    last = torch.where(scenario.present, steps, 0).amax(dim=2)[..., None]
    stops = states[..., 3].gather(2, last)[..., 0].abs() < MIN_LEAVING_SPEED_MPS
    return Routes(resample_points(route[..., :2] + extension), lengths, stops)


def resample_points(points: Float[Tensor, "B A P 2"]) -> Float[Tensor, "B A Q 2"]:
    """Resample polylines to points every `ROUTE_SPACING_M`, straight on beyond their ends."""
    segments = points.diff(dim=2)
    lengths = segments.norm(dim=-1).clamp_min(MIN_SEGMENT_M)
    ends = lengths.cumsum(-1)
    count = int(ends[..., -1].max() / ROUTE_SPACING_M) + 2
    along = torch.arange(count).to(ends) * ROUTE_SPACING_M
    along = along.expand(*ends.shape[:2], -1).contiguous()
    index = torch.searchsorted(ends, along).clamp_max(lengths.shape[-1] - 1)
    pick = index[..., None].expand(*index.shape, 2)
    share = (along - (ends - lengths).gather(-1, index)) / lengths.gather(-1, index)
    resampled = points.gather(2, pick) + share[..., None] * segments.gather(2, pick)
    return torch.stack(resampled.unbind(-1)).movedim(0, -1)  # x and y apart in memory, for `locate`


def _select_spaced(
    points: Float[Tensor, "B A T 2"], present: Bool[Tensor, "B A T"]
) -> Bool[Tensor, "B A T"]:
    """Mark each agent's first point, and each one far enough from the last marked one."""
    first = present.int().argmax(dim=2, keepdim=True)
    last = points.gather(2, first[..., None].expand(-1, -1, 1, 2))[:, :, 0]
    keep = torch.zeros_like(present).scatter(2, first, True)
    for step, point in enumerate(points.unbind(2)):
        far = present[..., step] & ((point - last).norm(dim=-1) >= ROUTE_SPACING_M)
        last = torch.where(far[..., None], point, last)
        keep[..., step] |= far
    return keep


def locate(
    points: Float[Tensor, "B A P 2"], positions: Float[Tensor, "B A 2"]
) -> Float[Tensor, "B A"]:
    """Find how far along its own route each agent is: the place nearest to it, metres."""
    with torch.no_grad():
        coarse = _find_nearest(points[:, :, ::COARSE_STRIDE], positions)[..., None]
        window = coarse * COARSE_STRIDE + torch.arange(
            1 - COARSE_STRIDE, COARSE_STRIDE, device=points.device
        )
        window = window.clamp(0, points.shape[2] - 1)
        fine = points.gather(2, window[..., None].expand(*window.shape, 2))
        nearest = window.gather(2, _find_nearest(fine, positions)[..., None])[..., 0]
        nearest = nearest.clamp_max(points.shape[2] - 2)
    return _project(points, positions, nearest)


def _find_nearest(
    points: Float[Tensor, "B A Q 2"], positions: Float[Tensor, "B A 2"]
) -> Int[Tensor, "B A"]:
    right, up = (points[..., axis] - positions[..., axis, None] for axis in (0, 1))
    return right.square_().addcmul_(up, up).argmin(dim=-1)


def _project(
    points: Float[Tensor, "B A P 2"], positions: Float[Tensor, "B A 2"], index: Int[Tensor, "B A"]
) -> Float[Tensor, "B A"]:
    """Find how far along its route each agent is, on the segment after a point of it."""
    first, along = _pick_segments(points, index)
    share = ((positions - first) * along).sum(-1) / along.square().sum(-1).clamp_min(MIN_SEGMENT_M)
    return (index + share) * ROUTE_SPACING_M


def interpolate(
    points: Float[Tensor, "B A P 2"], along: Float[Tensor, "B A"]
) -> Float[Tensor, "B A 2"]:
    """Interpolate the places at `along` metres of the routes; straight on beyond their ends."""
    place = along / ROUTE_SPACING_M
    index = place.detach().long().clamp(0, points.shape[2] - 2)
    first, segment = _pick_segments(points, index)
    return first + (place - index)[..., None] * segment


def _pick_segments(
    points: Float[Tensor, "B A P 2"], index: Int[Tensor, "B A"]
) -> tuple[Float[Tensor, "B A 2"], Float[Tensor, "B A 2"]]:
    """Pick the points of an index, and the ways from there to the next ones."""
    both = torch.stack([index, index + 1], dim=-1)[..., None].expand(-1, -1, -1, 2)
    first, second = points.gather(2, both).unbind(2)
    return first, second - first
