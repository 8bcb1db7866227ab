"""Plans: paths in time that agents follow by the actions of their motion model.

They come from the network of a place, or lead through somebody's way points (`Goal`). An agent
steers for a point of its plan a little ahead, and keeps the plan's speed. Who had to brake goes on
along the path later, without making up for the time.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor

from geoaim.simulation.kinematics import WHEELBASE_PER_LENGTH, agent_from_world

AHEAD_S = 0.5  # of the point that agents steer for
BRAKING_AHEAD_S = 2.0  # of the point on the arc on which they brake for others
CATCH_UP_S = 0.5  # in which a lag behind the plan is made up for
MIN_AHEAD_M = 1.0  # of that point; nearer ones give no direction
SPEED_CHANGE_S = 1.0  # in which an agent takes a target speed
MAX_CHANGE_MPS2 = 4.0  # most speeding up, and most braking for a target speed
MIN_GOAL_SPEED = 1.0  # m/s, with which an agent goes to way points without times


@dataclass(frozen=True)
class Goal:
    """What an agent is steered for: way points, a target speed, or both.

    Attributes:
        points: x, y of way points, metres in the scene's world.
        times: when it is to be there, s after the last observed step; empty: as its target speed
            has it, or the speed that it has.
        speed: target speed, m/s, without way points or after them; None: the model's.

    Raises:
        ValueError: there is neither, or times are not rising, one for each point.
    """

    points: Sequence[tuple[float, float]] = ()
    times: Sequence[float] = ()
    speed: float | None = None

    def __post_init__(self) -> None:
        rising = all(a < b for a, b in zip((0.0, *self.times), self.times, strict=False))
        if self.times and (len(self.times) != len(self.points) or not rising):
            raise ValueError(
                f"times={tuple(self.times)} of {len(self.points)} points: give one for each, "
                "rising from 0"
            )
        if not self.points and self.speed is None:
            raise ValueError("a goal needs points or a speed")


@dataclass(frozen=True, eq=False)
class Plan:
    """Plans of E agents.

    Attributes:
        states: (E, t, 4) states, the first ones at the last observed step.
        steps: of each agent's plan; 0: it has none.
        done: steps of the plan that each agent has taken.
        bicycle: whether agents move as bicycles rather than unicycles.
    """

    states: Float[Tensor, "E t 4"]
    steps: Int[Tensor, "E"]
    done: Int[Tensor, "E"]
    bicycle: bool

    @property
    def goes_on(self) -> Bool[Tensor, "E"]:
        """Agents whose plans have not ended."""
        return self.done < self.steps

    def follow(
        self, pose: Float[Tensor, "E 4"], sizes: Float[Tensor, "E 2"], dt: float
    ) -> Float[Tensor, "E 2"]:
        """Actions of the bicycle or the unicycle that follow the plans."""
        now, after = self._look_up(self.done), self._look_up(self.done + 1)
        lag = agent_from_world(pose, now[:, :2])[:, 0]
        speed = after[:, 3] + lag / CATCH_UP_S
        acceleration = ((speed - pose[:, 3]) / dt).clamp_max(MAX_CHANGE_MPS2)
        curvature = self.aim(pose, AHEAD_S, dt)
        if not self.bicycle:
            return torch.stack([acceleration, curvature * speed], dim=1)
        sine = (curvature * WHEELBASE_PER_LENGTH / 2 * sizes[:, 0]).clamp(-0.9, 0.9)
        return torch.stack([acceleration, torch.atan(2 * torch.tan(torch.asin(sine)))], dim=1)

    def aim(self, pose: Float[Tensor, "E 4"], ahead: float, dt: float) -> Float[Tensor, "E"]:
        """Curvatures, 1/m, of the arcs to the points of the plans `ahead` seconds later."""
        point = self._look_up(self.done + max(1, round(ahead / dt)))
        x, y = agent_from_world(pose, point[:, :2]).unbind(1)
        distance = x.square() + y.square()
        return torch.where(distance > MIN_AHEAD_M**2, 2 * y / distance.clamp_min(1e-6), 0.0)

    def advance(self) -> "Plan":
        """Count a step."""
        return replace(self, done=self.done + 1)

    def fall_back(self, pose: Float[Tensor, "E 4"], braked: Bool[Tensor, "E"]) -> "Plan":
        """Count of who braked only as many steps as it has gone of the path."""
        nearest = (self.states[..., :2] - pose[:, None, :2]).norm(dim=2).argmin(dim=1)
        gone = torch.maximum(torch.minimum(nearest, self.done), self.done - 1)
        return replace(self, done=torch.where(braked, gone, self.done))

    def _look_up(self, index: Int[Tensor, "E"]) -> Float[Tensor, "E 4"]:
        """States at a step of each plan; beyond its end the last one."""
        rows = torch.arange(len(index), device=index.device)
        return self.states[rows, index.clamp_max(self.states.shape[1] - 1)]


def plan_through(pose: Float[Tensor, "4"], goal: Goal, dt: float) -> Float[Tensor, "t 4"]:
    """Plan a smooth path through way points, from an agent's state on (cubic Hermite splines).

    Args:
        pose: x, y, heading, speed at the last observed step.
        goal: way points, with times or a speed.
        dt: time between steps, s.

    Returns:
        States at the steps until the last way point, `pose` first.
    """
    points = torch.cat([pose[None, :2], pose.new_tensor(goal.points)])
    if goal.times:
        times = pose.new_tensor([0.0, *goal.times])
    else:
        speed = max(MIN_GOAL_SPEED, float(pose[3]) if goal.speed is None else goal.speed)
        times = F.pad(points.diff(dim=0).norm(dim=1).cumsum(0) / speed, (1, 0))
    means = points.diff(dim=0) / times.diff()[:, None]  # velocities between points
    start = pose[3] * torch.stack([pose[2].cos(), pose[2].sin()])
    inner = (means[1:] + means[:-1]) / 2
    before = inner[-1] if len(inner) else start
    ends = torch.cat([start[None], inner, (2 * means[-1] - before)[None]])  # (n, 2)
    at = torch.arange(round(float(times[-1]) / dt) + 1, device=pose.device) * dt
    piece = (torch.searchsorted(times, at, right=True) - 1).clamp(0, len(means) - 1)
    span = times.diff()[piece, None]
    u = ((at - times[piece])[:, None] / span).clamp(0, 1)
    position = (
        (2 * u**3 - 3 * u**2 + 1) * points[piece]
        + (u**3 - 2 * u**2 + u) * span * ends[piece]
        + (3 * u**2 - 2 * u**3) * points[piece + 1]
        + (u**3 - u**2) * span * ends[piece + 1]
    )
    velocity = F.pad(position.diff(dim=0) / dt, (0, 0, 1, 0))
    velocity[0] = start
    heading = torch.atan2(velocity[:, 1], velocity[:, 0])
    heading[0] = pose[2]
    return torch.cat([position, heading[:, None], velocity.norm(dim=1)[:, None]], dim=1)


def approach_speed(pose: Float[Tensor, "E 4"], speed: Float[Tensor, "E"]) -> Float[Tensor, "E"]:
    """Accelerations, m/s², with which agents take a target speed."""
    return ((speed - pose[:, 3]) / SPEED_CHANGE_S).clamp(-MAX_CHANGE_MPS2, MAX_CHANGE_MPS2)
