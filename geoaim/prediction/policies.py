"""ITRA as a policy of the simulator, so that traffic reacts to somebody's planner."""

from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from geoaim.prediction.checkpoints import read_pretrained
from geoaim.prediction.cutting import cut_simulation
from geoaim.prediction.itra import ITRA
from geoaim.prediction.plans import Goal
from geoaim.prediction.segments import Segments, make_segment_scenario
from geoaim.rendering.ground import Ground
from geoaim.rendering.prefiltering import prefilter_ground
from geoaim.rendering.scene import Scene
from geoaim.simulation.simulator import Policy, Scenario, Traffic

MOTION = {"vehicle": "bicycle", "pedestrian": "unicycle"}  # motion models of the simulator


class ITRAPolicy:
    """A policy for `geoaim.simulation.simulator.rollout` by which agents drive as ITRA samples.

    It sees all agents where the simulation has them, whoever moves them. What the model remembers
    is kept between the steps of a simulation; the next simulation starts anew, and goes on with
    the generator.

        policy = ITRAPolicy(model, segments, ground, history=10, samples=6, generator=generator)

        def drive(scenario, path):
            actions = policy(scenario, path)
            actions[:, 0] = plan(path[:, 0])  # agent 0 is not in segments.controlled
            return actions

        states = rollout(policy.scenario, drive, moved, history=10)

    Args:
        model: a model of vehicles by the bicycle or of pedestrians by the unicycle model.
        segments: the recording; the policy moves its controlled agents.
        ground: the map.
        history: observed steps, as given to `rollout`.
        samples: K simulations of each segment, which are rows next to each other.
        generator: source of the noise; None: latents are the prior's mean.
        goals: way points and target speeds of agents, by the names in `segments.ids`.

    Attributes:
        scenario: the scenario to roll out, B K rows.

    Raises:
        ValueError: the model's agents move otherwise than those of the simulator, or the segments
            do not fit it.
    """

    def __init__(  # noqa: PLR0913  (what is driven, and how)
        self,
        model: ITRA,
        segments: Segments,
        ground: Ground,
        *,
        history: int,
        samples: int = 1,
        generator: torch.Generator | None = None,
        goals: Mapping[str, Goal] | None = None,
    ) -> None:
        if model.config.motion != MOTION[model.config.kind]:
            raise ValueError(
                f"the model moves a {model.config.kind} by the {model.config.motion!r} model, the "
                f"simulator by {MOTION[model.config.kind]!r}; use `ITRA.step` in a loop"
            )
        self.model, self.generator = model, generator
        with torch.no_grad():
            given: dict[str, Any] = {"history": history, "samples": samples, "goals": goals}
            self._start = model.start(segments, ground, **given)
        self._rollout = self._start
        self.scenario = make_segment_scenario(self._start.batch.segments)

    def __call__(
        self, scenario: Scenario, path: Float[Tensor, "B A t 4"]
    ) -> Float[Tensor, "B A 2"]:
        """Give the actions of the model's agents, and 0 for all others.

        Raises:
            ValueError: the path does not begin at the last observed step, or leaves a step out.
        """
        index = path.shape[2] - 1
        rollout = self._start if index == self._start.index else self._rollout
        if index != rollout.index:
            raise ValueError(
                f"the policy is at step {rollout.index} and was asked for step {index}; give "
                f"history={self._start.index + 1} to rollout, and call the policy once a step"
            )
        rollout = replace(rollout, states=path[:, :, -1])
        latent = None
        if self.generator is not None:
            latent = self.model.draw_latent(rollout, self.generator)
        action, acted = self.model.act(rollout, latent)
        self._rollout = replace(acted, index=index + 1)
        controlled = rollout.batch.controlled
        actions = path.new_zeros(*path.shape[:2], 2)
        row = controlled.segment, controlled.agent
        return actions.index_put(row, self.model.scale_action(action))


def make_traffic(model: ITRA | None = None) -> Traffic:
    """Make traffic that drives as ITRA samples, for `simulate_scene` and `DrivingEnv`.

    Args:
        model: a model without trajectory proposals; None: the vehicle model of the package.

    Returns:
        The traffic; scenes need the model's dt.

    Raises:
        ValueError: the model has trajectory proposals, which end with their horizon.

    >>> make_traffic().group
    'vehicle'
    """
    driver = read_pretrained("vehicle") if model is None else model
    if driver.config.num_anchors:
        raise ValueError(
            "the model has trajectory proposals, which end with their horizon; give one without"
        )

    @lru_cache(maxsize=1)  # episodes of one scene share the map
    def prefilter(ground: Ground) -> Ground:
        return prefilter_ground(ground, driver.config.resolution)

    def make_policy(
        piece: Scene, controlled: Bool[Tensor, "A"], history: int, generator: torch.Generator
    ) -> Policy:
        given: dict[str, Any] = {"history": history, "generator": generator}
        segments = cut_simulation(piece, controlled)
        policy = ITRAPolicy(driver, segments, prefilter(piece.ground), **given)
        return torch.no_grad()(policy.__call__)

    return Traffic(driver.config.kind, make_policy)
