"""A gymnasium environment: drive vehicles of a scene to the places that they reached.

All other agents replay the recording, or are moved by traffic that reacts; they enter and leave as
recorded. It needs the extra `gym`:

    env = DrivingEnv(scene, make_road_rules(hdmap))
    observation, info = env.reset(seed=0)
    observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
"""

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import chain
from typing import Any

import gymnasium
import numpy as np
import torch
from jaxtyping import Float, Float32, UInt8
from numpy import ndarray as Array

from geoaim.base.errors import TracksError
from geoaim.rendering.birdview import render
from geoaim.rendering.ground import View
from geoaim.rendering.layers import make_agent_boxes, make_light_boxes
from geoaim.rendering.pictures import convert_to_uint8
from geoaim.rendering.prefiltering import prefilter_ground
from geoaim.rendering.scene import Scene, find_agent, find_step, slice_scene
from geoaim.simulation import simulator
from geoaim.simulation.episodes import HISTORY_STEPS, select_movable
from geoaim.simulation.infractions import detect_offroad, sample_distance
from geoaim.simulation.kinematics import bicycle, world_from_agent
from geoaim.simulation.overlap import compute_box_distance
from geoaim.simulation.road_rules import NO_ROAD_RULES, RoadRules, check_rules
from geoaim.simulation.simulator import Traffic, check_even_steps
from geoaim.tracks.agent_types import select_group

NEIGHBOURS = 8  # nearest agents that are observed
NEIGHBOUR_VALUES = 7  # x, y, cosine, sine, speed, length, width; all 0 where there is none
EGO_VALUES = 5  # speed, goal x and y, its distance, time left
# metres forward and left of the ego at which the distance to the road's edge is observed
ROAD_POINTS = tuple((x, y) for x in (0.0, 5.0, 10.0, 20.0, 40.0) for y in (-4.0, 0.0, 4.0))
EGO_POINT = ROAD_POINTS.index((0.0, 0.0))
MAX_OBSERVED = 1000.0  # metres, m/s and seconds; observations are clipped to it
RENDERED = View(512, 512, 80 / 512)  # what `render` shows around the first ego


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


@dataclass(eq=False)
class _Ego:
    """A vehicle that is driven, and what is around it."""

    agent: int
    state: Float32[Array, "4"]
    goal: Float32[Array, "2"]
    reached: bool = False
    others: tuple[Array, Array, Array] = field(
        init=False
    )  # states, sizes, distances; nearest first
    road: Float32[Array, "_"] = field(init=False)  # distances of `ROAD_POINTS`


class DrivingEnv(gymnasium.Env[Any, Float32[Array, "..."]]):
    """Drive vehicles of a scene; an episode ends at the goal, at a collision or off the road.

    Actions are acceleration and steering angle, from -1 to 1 of the limits in the config, without
    driving backwards. An observation has the ego's speed, goal and time left, the distances of
    `ROAD_POINTS` from the road's edge (m, negative on the road; 0 without rules), and the nearest
    agents (`NEIGHBOUR_VALUES`), all in the ego's frame.

    With M egos, actions are (M, 2), observations have a row for each, rewards are summed, and what
    `info` says is a list. An episode then ends when all have reached their goals, or at the first
    infraction.

    Attributes:
        action_space: `Box` of 2 numbers; (M, 2) for M egos.
        observation_space: `Box` of `EGO_VALUES`, `ROAD_POINTS` and `NEIGHBOURS`; with a view,
            `Dict` of that "state" and of the "image", (H, W, 3) bytes. M rows for M egos.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 10}  # noqa: RUF012 (gymnasium's)

    def __init__(  # noqa: PLR0913  (what is driven, seen and rewarded)
        self,
        scene: Scene,
        rules: RoadRules = NO_ROAD_RULES,
        *,
        egos: int = 1,
        traffic: Traffic | None = None,
        view: View | None = None,
        reward: Callable[[Transition], float] = reward_progress,
        config: EnvConfig = EnvConfig(),
        render_mode: str | None = None,
    ) -> None:
        """Make an environment.

        Args:
            scene: the recording, on the CPU.
            rules: the drivable area; without it, the egos cannot leave the road.
            egos: M, the number of vehicles that are driven.
            traffic: moves the other agents of its group, such as `geoaim.prediction.make_traffic`;
                None: they replay.
            view: view around each ego, heading up, that is observed as an image; None: none is.
            reward: computes the reward of each step and ego.
            config: options.
            render_mode: "rgb_array", by which `render` gives pictures; None: it gives none.

        Raises:
            ValueError: the scene's steps are not evenly spaced, or there is no such mode.
            TracksError: too few vehicles are present and move for long enough, or the rules are of
                another place.
        """
        check_even_steps(scene, len(scene.times))
        if egos < 1 or render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(
                f"egos={egos}, render_mode={render_mode!r}: 1 ego or more is needed, and None or "
                "'rgb_array'"
            )
        self.rules = check_rules(scene, rules)
        self.scene, self.egos, self.traffic, self.view = scene, egos, traffic, view
        self.reward, self.config, self.render_mode = reward, config, render_mode
        self.metadata = self.metadata | {"render_fps": round(1 / scene.dt)}
        # shape (T, N, ...); in NumPy, which is faster than torch for few numbers
        self._recorded = scene.states.nan_to_num().transpose(0, 1).contiguous().numpy()
        self._present = scene.present.t().contiguous().numpy()
        self._sizes, self._dt = scene.sizes.numpy(), scene.dt
        self._road_points = torch.tensor(ROAD_POINTS)
        self._is_running = False
        self._prefilter = lru_cache(lambda resolution: prefilter_ground(scene.ground, resolution))
        self._starts = _find_starts(scene, config, egos)
        if not self._starts:
            raise TracksError(
                f"no {f'{egos} vehicles are' if egos > 1 else 'vehicle is'} present for "
                f"{config.min_duration:g} s and moves {config.min_travel:g} m; lower these limits, "
                "or give a longer recording"
            )
        rows = (egos,) if egos > 1 else ()
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (*rows, 2), np.float32)
        size = EGO_VALUES + len(ROAD_POINTS) + NEIGHBOURS * NEIGHBOUR_VALUES
        state = gymnasium.spaces.Box(-MAX_OBSERVED, MAX_OBSERVED, (*rows, size), np.float32)
        self.observation_space: gymnasium.Space[Any] = state
        if view is not None:
            image = gymnasium.spaces.Box(0, 255, (*rows, view.height, view.width, 3), np.uint8)
            self.observation_space = gymnasium.spaces.Dict({"state": state, "image": image})

    @torch.no_grad()
    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Start an episode with random vehicles at a random time.

        Args:
            seed: seed of the generator that chooses this episode and the next ones.
            options: "ego", the id of the vehicle or a list of ids, and "start", a time in seconds;
                each is chosen if it is not given, and there are no others.

        Returns:
            The first observation, and a dict with the id of the ego, the time and the goal.

        Raises:
            ValueError: an option is unknown, or the scene has no such time.
            TracksError: the ego is unknown, or cannot start then.
        """
        super().reset(seed=seed)
        agents, self._step = self._choose(options or {})
        steps = round(self.config.duration / self._dt)
        recorded = self.scene.present[agents, self._step : self._step + steps + 1]
        self._end = self._step + int(recorded.int().cumprod(1).sum(dim=1).min()) - 1
        self._now = self._recorded[self._step].copy()
        goals = self._recorded[self._end]
        self._driven = [_Ego(k, self._now[k].copy(), goals[k, :2]) for k in agents]
        self._is_running = True
        self._start_traffic(agents)
        self._look()
        return self._observe(), self._describe()

    @torch.inference_mode()
    def step(self, action: Float32[Array, "..."]) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Move the egos by their actions, and all others as recorded or by the traffic.

        Args:
            action: acceleration and steering angle, from -1 to 1; of M egos, (M, 2).

        Returns:
            The observation, the reward, whether the episode ended at the goal or by an infraction,
            whether its time is over, and a dict with what happened.

        Raises:
            ValueError: the action is not two finite numbers.
            gymnasium.error.ResetNeeded: no episode is running.
        """
        if not self._is_running:
            raise gymnasium.error.ResetNeeded("no episode is running; call reset before step")
        shape = self.action_space.shape
        if np.shape(action) != shape or not np.isfinite(action).all():
            needed = "two finite numbers" if self.egos == 1 else f"{self.egos} pairs of numbers"
            raise ValueError(f"the action is {action}; {needed} from -1 to 1 are needed")
        egos = self._driven
        before, counts = [ego.state for ego in egos], [not ego.reached for ego in egos]
        actions = np.reshape(action, (-1, 2))
        pairs = [self._drive(ego, pair) for ego, pair in zip(egos, actions, strict=True)]
        self._move_others()
        self._look()
        found = [self._judge(*given) for given in zip(egos, before, pairs, strict=True)]
        rewards = [self.reward(one) for one, new in zip(found, counts, strict=True) if new]
        failed = any(one.collided or one.left_road for one in found)
        ended = failed or all(ego.reached for ego in egos)
        out_of_time = self._step >= self._end and not ended
        self._is_running = not (ended or out_of_time)
        happened = {
            "reached": self._pack([ego.reached for ego in egos]),
            "collided": self._pack([one.collided for one in found]),
            "left_road": self._pack([one.left_road for one in found]),
        }
        return self._observe(), float(sum(rewards)), ended, out_of_time, self._describe() | happened

    @torch.no_grad()
    def render(self) -> UInt8[Array, "H W 3"] | None:
        """Render the first ego's surroundings, its heading up; None without a render mode.

        Raises:
            gymnasium.error.ResetNeeded: no episode has begun.
        """
        if self.render_mode is None:
            return None
        if not hasattr(self, "_driven"):
            raise gymnasium.error.ResetNeeded("no episode has begun; call reset before render")
        return self._draw(RENDERED, self._driven[:1])[0]

    def _choose(self, options: dict[str, Any]) -> tuple[list[int], int]:
        """The rows of the egos and their first step."""
        if unknown := sorted(options.keys() - {"ego", "start"}):
            raise ValueError(f"unknown options {', '.join(unknown)}; there are ego and start")
        names = options.get("ego") or []
        names = [names] if isinstance(names, str) else list(names)
        if len(set(names)) != len(names) or len(names) > self.egos:
            raise ValueError(
                f"the egos {', '.join(names)}; up to {self.egos} are driven, each once"
            )
        agents = [find_agent(self.scene, str(name)) for name in names]
        starts, chosen = self._starts, options.get("start")
        steps = set(chain.from_iterable(starts.values()))
        for agent in agents:
            steps &= set(starts.get(agent, []))
        if chosen is not None:
            steps &= {find_step(self.scene, chosen)}
        if not steps:
            raise TracksError(
                f"no vehicle can start with {options}: it must be present for "
                f"{self.config.min_duration:g} s and move {self.config.min_travel:g} m"
            )
        if not agents:
            able = sorted(agent for agent, some in starts.items() if not steps.isdisjoint(some))
            agents = [able[int(self.np_random.integers(len(able)))]]
        begins = sorted(steps.intersection(starts[agents[0]]))
        step = begins[int(self.np_random.integers(len(begins)))]
        if len(agents) < self.egos:
            rest = [k for k in sorted(starts) if step in starts[k] and k not in agents]
            agents += self.np_random.permutation(rest)[: self.egos - len(agents)].tolist()
        return agents, step

    def _start_traffic(self, agents: list[int]) -> None:
        """Make the policy of the traffic in this episode, from a few steps before its start on."""
        self._path: torch.Tensor | None = None
        if self.traffic is None:
            return
        self._first = max(0, self._step + 1 - HISTORY_STEPS)
        history, steps = self._step + 1 - self._first, self._end + 1 - self._first
        moved = select_movable(self.scene, self._first, steps, self.traffic.group)
        moved[agents] = False
        if not moved.any() or steps <= history:
            return
        piece = slice_scene(self.scene, slice(self._first, self._end + 1))
        generator = torch.Generator().manual_seed(int(self.np_random.integers(2**31)))
        self._policy = self.traffic.make_policy(piece, moved, history, generator)
        self._scenario = simulator.make_scenario(self.scene, torch.tensor([self._first]), steps)
        self._moved, self._path = moved[None], self._scenario.states.clone()

    def _drive(self, ego: _Ego, action: Float[Array, "2"]) -> Float32[Array, "2"]:
        """Move an ego by an action, of -1 to 1; gives it in m/s² and rad."""
        limits = self.config.max_acceleration, self.config.max_steering
        pair = (np.clip(action, -1.0, 1.0) * limits).astype(np.float32)
        pair[0] = max(pair[0], -ego.state[3] / self._dt)  # stops, and does not reverse
        given = torch.from_numpy(ego.state), torch.from_numpy(pair)
        length = self.scene.sizes[ego.agent, 0]
        ego.state = bicycle.step(*given, length, self._dt).numpy()
        return pair

    def _move_others(self) -> None:
        """Move all others by a step; where the egos are now is what they see at the next one."""
        self._step += 1
        if self._path is None:
            self._now = self._recorded[self._step].copy()
        else:
            last = self._step - 1 - self._first
            actions = self._policy(self._scenario, self._path[:, :, : last + 1])
            given = self._scenario, last, self._path[:, :, last], actions, self._moved
            self._path[:, :, last + 1] = simulator.step(*given)
            for ego in self._driven:
                self._path[0, ego.agent, last + 1] = torch.from_numpy(ego.state)
            self._now = self._path[0, :, last + 1].numpy().copy()
        for ego in self._driven:
            self._now[ego.agent] = ego.state

    def _judge(
        self, ego: _Ego, before: Float32[Array, "4"], action: Float32[Array, "2"]
    ) -> Transition:
        """What came of a step; marks who has reached its goal."""
        far, near = (float(np.linalg.norm(ego.goal - x[:2])) for x in (before, ego.state))
        reached = near < self.config.goal_radius
        ego.reached |= reached
        return Transition(
            state=before,
            next_state=ego.state,
            action=action,
            goal=ego.goal,
            progress=far - near,
            reached=reached,
            collided=self._collides(ego),
            left_road=self._leaves_road(ego),
        )

    def _look(self) -> None:
        """Find who is around each ego, nearest first, and the distances from the road."""
        for ego in self._driven:
            rows = np.flatnonzero(self._present[self._step])
            rows = rows[rows != ego.agent]
            distances = np.hypot(*(self._now[rows, :2] - ego.state[:2]).T)
            order = distances.argsort()
            rows = rows[order]
            ego.others = self._now[rows], self._sizes[rows], distances[order]
            ego.road = np.zeros(len(ROAD_POINTS), np.float32)
            if self.rules.drivable is not None:
                points = world_from_agent(torch.from_numpy(ego.state), self._road_points)
                ego.road = sample_distance(self.rules.drivable, points).numpy()

    def _collides(self, ego: _Ego) -> bool:
        states, sizes, distances = ego.others
        own = self._sizes[ego.agent]
        near = distances < (np.hypot(*sizes.T) + np.hypot(*own)) / 2
        if not near.any():
            return False
        boxes = (ego.state[:3], own, states[near, :3], sizes[near])
        return bool((compute_box_distance(*map(torch.from_numpy, boxes)) < 0).any())

    def _leaves_road(self, ego: _Ego) -> bool:
        own = self._sizes[ego.agent]
        # no corner is further off the road than the middle plus half a diagonal
        if self.rules.drivable is None or ego.road[EGO_POINT] + np.hypot(*own) / 2 < 0:
            return False
        pose = torch.from_numpy(ego.state[None, :3])
        given = pose, self.scene.sizes[ego.agent][None], torch.ones(1, dtype=torch.bool)
        offroad, _ = detect_offroad(self.rules.drivable, *given)
        return bool(offroad)

    def _observe(self) -> Any:
        """The observation: numbers, and the view if there is one."""
        state = self._pack([self._list_values(ego) for ego in self._driven])
        if self.view is None:
            return state
        images = self._draw(self.view, self._driven)
        return {"state": state, "image": images[0] if self.egos == 1 else images}

    def _list_values(self, ego: _Ego) -> Float32[Array, "O"]:
        goal = _locate(ego, ego.goal)
        left = (self._end - self._step) * self._dt
        own = [ego.state[3], *goal, np.hypot(*goal), left]
        states, sizes = (values[:NEIGHBOURS] for values in ego.others[:2])
        angles = states[:, 2] - ego.state[2]
        others = np.zeros((NEIGHBOURS, NEIGHBOUR_VALUES))
        others[: len(states), :2] = _locate(ego, states[:, :2])
        others[: len(states), 2:] = np.column_stack(
            [np.cos(angles), np.sin(angles), states[:, 3], sizes]
        )
        values = np.concatenate([own, ego.road, others.ravel()])
        return values.clip(-MAX_OBSERVED, MAX_OBSERVED).astype(np.float32)

    def _draw(self, view: View, egos: list[_Ego]) -> UInt8[Array, "M H W 3"]:
        """Render views around egos, headings up, with all agents and lights."""
        now = slice_scene(self.scene, slice(self._step, self._step + 1))
        now = replace(now, poses=torch.from_numpy(self._now[:, None, :3]))
        step = torch.zeros(len(egos), dtype=torch.long)
        agents = torch.tensor([ego.agent for ego in egos])
        boxes = [make_light_boxes(now, step), make_agent_boxes(now, step, agents)]
        cameras = now.poses[agents, 0]
        return convert_to_uint8(render(view, cameras, self._prefilter(view.resolution), boxes))

    def _describe(self) -> dict[str, Any]:
        return {
            "ego": self._pack([self.scene.ids[ego.agent] for ego in self._driven]),
            "time": float(self.scene.times[self._step]),
            "goal": self._pack([ego.goal.tolist() for ego in self._driven]),
        }

    def _pack(self, values: list[Any]) -> Any:
        """The value of the only ego, or those of all."""
        if self.egos == 1:
            return values[0]
        return np.stack(values) if isinstance(values[0], np.ndarray) else values


def _locate(ego: _Ego, points: Float[Array, "*m 2"]) -> Float[Array, "*m 2"]:
    """Express points in the frame of an ego: metres forward and left."""
    x, y = (points - ego.state[:2]).T
    cosine, sine = np.cos(ego.state[2]), np.sin(ego.state[2])
    return np.stack([x * cosine + y * sine, y * cosine - x * sine], axis=-1)


def _find_starts(scene: Scene, config: EnvConfig, egos: int) -> dict[int, list[int]]:
    """The steps at which each vehicle may start: as many as wanted move for long enough."""
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
    counts = Counter(chain.from_iterable(starts.values()))
    able = {agent: [k for k in steps if counts[k] >= egos] for agent, steps in starts.items()}
    return {agent: steps for agent, steps in able.items() if steps}
