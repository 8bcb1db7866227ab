"""A gymnasium environment: drive one vehicle of a scene to the place that it reached.

All other agents replay the recording, and enter and leave as recorded. It needs the extra `gym`:

    env = DrivingEnv(scene, make_road_rules(hdmap))
    observation, info = env.reset(seed=0)
    observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
import torch
from jaxtyping import Float, Float32
from numpy import ndarray as Array

from geoaim.base.errors import TracksError
from geoaim.rendering.scene import Scene, find_agent, find_step
from geoaim.simulation.infractions import detect_offroad, sample_distance
from geoaim.simulation.kinematics import bicycle, world_from_agent
from geoaim.simulation.overlap import compute_box_distance
from geoaim.simulation.road_rules import NO_ROAD_RULES, RoadRules, check_rules
from geoaim.simulation.simulator import check_even_steps
from geoaim.tracks.agent_types import select_group

NEIGHBOURS = 8  # nearest agents that are observed
NEIGHBOUR_VALUES = 7  # x, y, cosine, sine, speed, length, width; all 0 where there is none
EGO_VALUES = 5  # speed, goal x and y, its distance, time left
# metres forward and left of the ego at which the distance to the road's edge is observed
ROAD_POINTS = tuple((x, y) for x in (0.0, 5.0, 10.0, 20.0, 40.0) for y in (-4.0, 0.0, 4.0))
EGO_POINT = ROAD_POINTS.index((0.0, 0.0))
MAX_OBSERVED = 1000.0  # metres, m/s and seconds; observations are clipped to it


@dataclass(frozen=True)
class EnvConfig:
    """Options of an environment, all positive.

    Raises:
        ValueError: an option is not positive or not finite.
    """

    duration: float = 20.0  # longest duration of an episode, s
    min_duration: float = 3.0  # the ego is recorded for at least this time, s
    min_travel: float = 10.0  # shortest distance from the ego's start to its goal, m
    goal_radius: float = 2.0  # the goal is reached within this distance, m
    max_acceleration: float = 4.0  # m/s², of the action 1
    max_steering: float = 0.5  # rad, of the action 1

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not 0 < value < math.inf:
                raise ValueError(f"{name} of the environment is {value}; give a positive number")


@dataclass(frozen=True, eq=False)
class Transition:
    """A step of the ego, of which a reward is computed."""

    state: Float[Array, "4"]  # x, y (m), heading (rad) and speed (m/s) before it
    next_state: Float[Array, "4"]  # the state after the step
    action: Float[Array, "2"]  # acceleration, m/s², and steering angle, rad
    goal: Float[Array, "2"]  # m
    progress: float  # decrease of the distance to the goal, m
    reached: bool  # whether the goal was reached
    collided: bool  # whether the ego overlaps another agent
    left_road: bool  # whether it is off the road


def reward_progress(transition: Transition) -> float:
    """Reward metres towards the goal; 10 for reaching it, -10 for a collision or leaving the road.

    >>> still, place = np.zeros(4), np.zeros(2)
    >>> reward_progress(Transition(still, still, place, place, 0.5, True, False, False))
    10.5
    """
    failed = transition.collided or transition.left_road
    return transition.progress + 10.0 * transition.reached - 10.0 * failed


class DrivingEnv(gymnasium.Env[Float32[Array, "O"], Float32[Array, "2"]]):
    """Drive one vehicle of a scene; an episode ends at the goal, at a collision or off the road.

    Actions are acceleration and steering angle, from -1 to 1 of the limits in the config, without
    driving backwards. An observation has the ego's speed, goal and time left, the distances of
    `ROAD_POINTS` from the road's edge (m, negative on the road; 0 without rules), and the nearest
    agents (`NEIGHBOUR_VALUES`), all in the ego's frame.

    Attributes:
        action_space: `Box` of 2 numbers.
        observation_space: `Box` of `EGO_VALUES`, `ROAD_POINTS` and `NEIGHBOURS`.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 (the name is gymnasium's)

    def __init__(
        self,
        scene: Scene,
        rules: RoadRules = NO_ROAD_RULES,
        *,
        reward: Callable[[Transition], float] = reward_progress,
        config: EnvConfig = EnvConfig(),
    ) -> None:
        """Make an environment.

        Args:
            scene: the recording, on the CPU.
            rules: the drivable area; without it, the ego cannot leave the road.
            reward: computes the reward of each step.
            config: options.

        Raises:
            ValueError: the scene's steps are not evenly spaced.
            TracksError: no vehicle is present and moves for long enough, or the rules are of
                another place.
        """
        check_even_steps(scene, len(scene.times))
        rules = check_rules(scene, rules)
        self.scene, self.rules, self.reward, self.config = scene, rules, reward, config
        # shape (T, N, ...); in NumPy, which is faster than torch for few numbers
        self._states = scene.states.nan_to_num().transpose(0, 1).contiguous().numpy()
        self._present = scene.present.t().contiguous().numpy()
        self._sizes, self._dt = scene.sizes.numpy(), scene.dt
        self._road_points = torch.tensor(ROAD_POINTS)
        self._is_running = False
        self._starts = _find_starts(scene, config)
        if not self._starts:
            raise TracksError(
                f"no vehicle is present for {config.min_duration:g} s and moves "
                f"{config.min_travel:g} m; lower these limits, or give a longer recording"
            )
        size = EGO_VALUES + len(ROAD_POINTS) + NEIGHBOURS * NEIGHBOUR_VALUES
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)
        self.observation_space = gymnasium.spaces.Box(
            -MAX_OBSERVED, MAX_OBSERVED, (size,), np.float32
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Float32[Array, "O"], dict[str, Any]]:
        """Start an episode with a random vehicle at a random time.

        Args:
            seed: seed of the generator that chooses this episode and the next ones.
            options: "ego", the id of the vehicle, and "start", a time in seconds; each is chosen
                if it is not given, and there are no others.

        Returns:
            The first observation, and a dict with the id of the ego, the time and the goal.

        Raises:
            ValueError: an option is unknown, or the scene has no such time.
            TracksError: the ego is unknown, or cannot start then.
        """
        super().reset(seed=seed)
        self._agent, self._step = self._choose(options or {})
        steps = round(self.config.duration / self._dt)
        recorded = self.scene.present[self._agent, self._step : self._step + steps + 1]
        self._end = self._step + int(recorded.cumprod(0).sum()) - 1
        self._goal = self._states[self._end, self._agent, :2]
        self._state = self._states[self._step, self._agent]
        self._is_running = True
        self._look()
        return self._observe(), self._describe()

    @torch.inference_mode()
    def step(
        self, action: Float32[Array, "2"]
    ) -> tuple[Float32[Array, "O"], float, bool, bool, dict[str, Any]]:
        """Move the ego, and all others as recorded.

        Args:
            action: acceleration and steering angle, from -1 to 1.

        Returns:
            The observation, the reward, whether the episode ended at the goal or by an infraction,
            whether its time is over, and a dict with what happened.

        Raises:
            ValueError: the action is not two finite numbers.
            gymnasium.error.ResetNeeded: no episode has begun, or it has ended.
        """
        if not self._is_running:
            raise gymnasium.error.ResetNeeded("no episode is running; call reset before step")
        if np.shape(action) != (2,) or not np.isfinite(action).all():
            raise ValueError(f"the action is {action}; two finite numbers from -1 to 1 are needed")
        last, dt = self._state, self._dt
        limits = self.config.max_acceleration, self.config.max_steering
        pair = (np.clip(action, -1.0, 1.0) * limits).astype(np.float32)
        pair[0] = max(pair[0], -last[3] / dt)  # stops, and does not reverse
        length = self.scene.sizes[self._agent, 0]
        moved = bicycle.step(torch.from_numpy(last), torch.from_numpy(pair), length, dt)
        self._state = moved.numpy()
        self._step += 1
        self._look()
        before, after = (np.linalg.norm(self._goal - x[:2]) for x in (last, self._state))
        transition = Transition(
            state=last,
            next_state=self._state,
            action=pair,
            goal=self._goal,
            progress=float(before - after),
            reached=bool(after < self.config.goal_radius),
            collided=self._collides(),
            left_road=self._leaves_road(),
        )
        ended = transition.reached or transition.collided or transition.left_road
        out_of_time = self._step >= self._end and not ended
        self._is_running = not (ended or out_of_time)
        happened = {
            "reached": transition.reached,
            "collided": transition.collided,
            "left_road": transition.left_road,
        }
        info = self._describe() | happened
        reward = float(self.reward(transition))
        return self._observe(), reward, ended, out_of_time, info

    def _choose(self, options: dict[str, Any]) -> tuple[int, int]:
        """The row of the ego and its first step."""
        starts = self._starts
        if unknown := sorted(options.keys() - {"ego", "start"}):
            raise ValueError(f"unknown options {', '.join(unknown)}; there are ego and start")
        if (ego := options.get("ego")) is not None:
            agent = find_agent(self.scene, str(ego))
            starts = {agent: starts[agent]} if agent in starts else {}
        if (time := options.get("start")) is not None:
            step = find_step(self.scene, time)
            starts = {agent: [step] for agent, steps in starts.items() if step in steps}
        if not starts:
            raise TracksError(
                f"no vehicle can start with {options}: it must be present for "
                f"{self.config.min_duration:g} s and move {self.config.min_travel:g} m"
            )
        agents = sorted(starts)
        agent = agents[int(self.np_random.integers(len(agents)))]
        steps = starts[agent]
        return agent, steps[int(self.np_random.integers(len(steps)))]

    def _look(self) -> None:
        """Find the agents that are present, nearest first, and the distances from the road."""
        present = self._present[self._step].copy()
        present[self._agent] = False
        rows = np.flatnonzero(present)
        offsets = self._states[self._step, rows, :2] - self._state[:2]
        distances = np.hypot(*offsets.T)
        order = distances.argsort()
        rows = rows[order]
        self._others = self._states[self._step, rows], self._sizes[rows], distances[order]
        self._road = np.zeros(len(ROAD_POINTS), np.float32)
        if self.rules.drivable is not None:
            points = world_from_agent(torch.from_numpy(self._state), self._road_points)
            self._road = sample_distance(self.rules.drivable, points).numpy()

    def _collides(self) -> bool:
        states, sizes, distances = self._others
        own = self._sizes[self._agent]
        near = distances < (np.hypot(*sizes.T) + np.hypot(*own)) / 2
        if not near.any():
            return False
        boxes = (self._state[:3], own, states[near, :3], sizes[near])
        return bool((compute_box_distance(*map(torch.from_numpy, boxes)) < 0).any())

    def _leaves_road(self) -> bool:
        own = self._sizes[self._agent]
        # no corner is further off the road than the middle plus half a diagonal
        if self.rules.drivable is None or self._road[EGO_POINT] + np.hypot(*own) / 2 < 0:
            return False
        pose = torch.from_numpy(self._state[None, :3])
        ego = pose, self.scene.sizes[self._agent][None], torch.ones(1, dtype=torch.bool)
        offroad, _ = detect_offroad(self.rules.drivable, *ego)
        return bool(offroad)

    def _observe(self) -> Float32[Array, "O"]:
        goal = self._locate(self._goal)
        left = (self._end - self._step) * self._dt
        ego = [self._state[3], *goal, np.hypot(*goal), left]
        states, sizes = (values[:NEIGHBOURS] for values in self._others[:2])
        angles = states[:, 2] - self._state[2]
        others = np.zeros((NEIGHBOURS, NEIGHBOUR_VALUES))
        others[: len(states), :2] = self._locate(states[:, :2])
        others[: len(states), 2:] = np.column_stack(
            [np.cos(angles), np.sin(angles), states[:, 3], sizes]
        )
        values = np.concatenate([ego, self._road, others.ravel()])
        return values.clip(-MAX_OBSERVED, MAX_OBSERVED).astype(np.float32)

    def _locate(self, points: Float[Array, "*m 2"]) -> Float[Array, "*m 2"]:
        """Express points in the frame of the ego: metres forward and left."""
        x, y = (points - self._state[:2]).T
        cosine, sine = np.cos(self._state[2]), np.sin(self._state[2])
        return np.stack([x * cosine + y * sine, y * cosine - x * sine], axis=-1)

    def _describe(self) -> dict[str, Any]:
        time = float(self.scene.times[self._step])
        return {"ego": self.scene.ids[self._agent], "time": time, "goal": self._goal.tolist()}


def _find_starts(scene: Scene, config: EnvConfig) -> dict[int, list[int]]:
    """The steps at which each vehicle may start: it is present and moves for long enough."""
    least, most = (round(s / scene.dt) for s in (config.min_duration, config.duration))
    starts = {}
    for agent in np.flatnonzero(select_group(scene.types, "vehicle")).tolist():
        present, positions = scene.present[agent].numpy(), scene.poses[agent, :, :2].numpy()
        leaves = np.append(np.flatnonzero(~present), len(present))
        steps = np.flatnonzero(present)
        last = np.minimum(leaves[np.searchsorted(leaves, steps)] - 1, steps + most)
        travel = np.linalg.norm(positions[last] - positions[steps], axis=1)
        chosen = steps[(last - steps >= least) & (travel >= config.min_travel)]
        if len(chosen):
            starts[agent] = chosen.tolist()
    return starts
