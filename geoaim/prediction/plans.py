"""Plans: paths in time that agents follow by the actions of their motion model.

An agent steers for a point of its plan a little ahead, and keeps the plan's speed. Who had to brake
goes on along the path later, without making up for the time.
"""

from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from geoaim.simulation.kinematics import WHEELBASE_PER_LENGTH, agent_from_world

AHEAD_S = 0.5  # of the point that agents steer for
CATCH_UP_S = 0.5  # in which a lag behind the plan is made up for
MAX_SPEEDING_UP = 4.0  # m/s²
MIN_AHEAD_M = 1.0  # of that point; nearer ones give no direction


@dataclass(frozen=True, eq=False)
class Plan:
    """Plans of E agents.

    Attributes:
        states: (E, t, 4) states, the first ones at the last observed step.
        planned: which agents have one.
        done: steps of the plan that each agent has taken.
    """

    states: Float[Tensor, "E t 4"]
    planned: Bool[Tensor, "E"]
    done: Int[Tensor, "E"]

    @property
    def goes_on(self) -> Bool[Tensor, "E"]:
        """Agents whose plans have not ended."""
        return self.planned & (self.done < self.states.shape[1] - 1)

    def follow(
        self, pose: Float[Tensor, "E 4"], sizes: Float[Tensor, "E 2"], dt: float, *, bicycle: bool
    ) -> Float[Tensor, "E 2"]:
        """Actions of the bicycle or the unicycle, not normalised, that follow the plans."""
        now, after = self._look_up(self.done), self._look_up(self.done + 1)
        lag = agent_from_world(pose, now[:, :2])[:, 0]
        speed = after[:, 3] + lag / CATCH_UP_S
        acceleration = ((speed - pose[:, 3]) / dt).clamp_max(MAX_SPEEDING_UP)
        aim = self._look_up(self.done + max(1, round(AHEAD_S / dt)))
        x, y = agent_from_world(pose, aim[:, :2]).unbind(1)
        distance = x.square() + y.square()
        curvature = torch.where(distance > MIN_AHEAD_M**2, 2 * y / distance.clamp_min(1e-6), 0.0)
        if not bicycle:
            return torch.stack([acceleration, curvature * speed], dim=1)
        sine = (curvature * WHEELBASE_PER_LENGTH / 2 * sizes[:, 0]).clamp(-0.9, 0.9)
        return torch.stack([acceleration, torch.atan(2 * torch.tan(torch.asin(sine)))], dim=1)

    def advance(self, pose: Float[Tensor, "E 4"], braked: Bool[Tensor, "E"]) -> "Plan":
        """Count a step; of who braked, only as many steps as it has gone of the path."""
        nearest = (self.states[..., :2] - pose[:, None, :2]).norm(dim=2).argmin(dim=1)
        done = torch.where(braked, torch.minimum(nearest, self.done + 1), self.done + 1)
        return replace(self, done=torch.maximum(done, self.done))

    def _look_up(self, index: Int[Tensor, "E"]) -> Float[Tensor, "E 4"]:
        """States at a step of each plan; beyond its end the last one."""
        rows = torch.arange(len(index), device=index.device)
        return self.states[rows, index.clamp_max(self.states.shape[1] - 1)]
