"""Controllers: rules outside ITRA's networks, which change the actions that those decode.

    model.controllers = [follow, brake]  # by default follow, start and brake, one after the other

Each takes a rollout and the actions of its agents, in the units of the motion model: m/s², and the
bicycle's steering in rad. It gives both back, changed. Any can be left out;
`python -m benchmarks.prediction controllers` measures what each brings.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from geoaim.prediction.plans import BRAKING_AHEAD_S, Goal, Plan, approach_speed, plan_through
from geoaim.prediction.rollouts import Rollout, gather_others
from geoaim.prediction.safe_speeds import (
    MAX_BRAKING_MPS2,
    MIN_SPEED_MPS,
    compute_curvature,
    compute_safe_speed_before_red,
    compute_safe_speeds,
)
from geoaim.prediction.segments import Segments
from geoaim.tracks.lights import RED

Controller = Callable[[Rollout, Float[Tensor, "E 2"]], tuple[Rollout, Float[Tensor, "E 2"]]]
CURVATURE_SHARE = 0.3  # of a new action in the curvature of an agent's arc
# Who stands and is not free to go this fast waits: for somebody ahead, or for a light. In all of 75
# cases, at the sample and five made places, whose reason went away within 3 s the vehicle started
# within 5 s; in 15 of 362 whose reason stayed.
WAITING_MPS = 2.0
DRIVING_OFF_MPS2 = 1.3  # with which they reach `WAITING_MPS`: the median; 1 to 2.8 of 10 and 90 %
STANDING_MPS = 0.15  # slower stands
# Who has no reason to stand starts by more than this: the network ever wants it within 5 s in 73 %
# of the futures of those who start, and in 5 % of those who stay, such as parked vehicles (0.2
# m/s²: 94 and 15 %; the sample and two made places)
STARTING_MPS2 = 0.8


def follow(rollout: Rollout, action: Float[Tensor, "E 2"]) -> tuple[Rollout, Float[Tensor, "E 2"]]:
    """Replace the actions of agents that have a plan or a target speed."""
    if (plan := rollout.plan) is None:
        return rollout, action
    batch, pose = rollout.batch, rollout.pose
    if rollout.speeds is not None:
        steered = torch.where(
            rollout.speeds.isnan(), action[:, 0], approach_speed(pose, rollout.speeds)
        )
        action = torch.stack([steered, action[:, 1]], dim=1)
    given = plan.follow(pose, batch.sizes, batch.segments.dt)
    action = torch.where(plan.goes_on[:, None], given, action)
    return replace(rollout, plan=plan.advance()), action


def start(rollout: Rollout, action: Float[Tensor, "E 2"]) -> tuple[Rollout, Float[Tensor, "E 2"]]:
    """Let agents that wait stand until their reason goes, and then drive off.

    Who stands without such a reason, such as a parked vehicle, stays there until the network
    accelerates by more than `STARTING_MPS2`: with less, parked vehicles creep.
    """
    if rollout.waits is None:
        return rollout, action
    speed, blocked, stands = rollout.pose[:, 3], find_blocked(rollout), find_standing(rollout)
    waits = (rollout.waits | blocked & ~stands) & (speed < WAITING_MPS)
    wanted, free = action[:, 0], ~rollout.steered
    wanted = torch.where(free & waits & ~blocked, wanted.clamp_min(DRIVING_OFF_MPS2), wanted)
    stays = free & stands & torch.where(waits, blocked, wanted < STARTING_MPS2)
    # gradients still pass
    held = torch.where(stays, -speed / rollout.batch.segments.dt - wanted, 0.0).detach()
    return replace(rollout, waits=waits), torch.stack([wanted + held, action[:, 1]], dim=1)


def brake(rollout: Rollout, action: Float[Tensor, "E 2"]) -> tuple[Rollout, Float[Tensor, "E 2"]]:
    """Lower accelerations with which agents could not stop; nobody brakes into reverse."""
    if rollout.safe_speeds is None:
        return rollout, action
    speed, dt = rollout.pose[:, 3], rollout.batch.segments.dt
    most = (rollout.safe_speeds.amin(dim=1) - speed.clamp_min(0)) / dt
    lower = torch.minimum(action[:, 0], most.clamp_min(-MAX_BRAKING_MPS2))
    lower = torch.where(speed > -STANDING_MPS, torch.maximum(lower, -speed / dt), lower)
    if rollout.plan is not None:
        plan = rollout.plan.fall_back(rollout.pose, lower < action[:, 0])
        rollout = replace(rollout, plan=plan)
    return rollout, torch.stack([lower, action[:, 1]], dim=1)


def prepare(rollout: Rollout, actions: Float[Tensor, "E t 2"]) -> Rollout:
    """Find at the last observed step on which arcs agents drive, and who waits.

    Who waits had a reason at the first or at the last observed step.
    """
    batch = rollout.batch
    curvature = torch.zeros_like(batch.sizes[:, 0])
    for step in range(rollout.index):
        drives = batch.find_moving(step)[:, 0] & (batch.truth[:, step, 3] > MIN_SPEED_MPS)
        curvature = torch.where(drives, _bend(curvature, actions[:, step], batch.sizes), curvature)
    rollout = replace(rollout, curvature=curvature)
    waits = torch.zeros_like(rollout.moving[:, 0])
    for step in {0, rollout.index}:
        then = watch(replace(rollout, index=step, states=batch.segments.states[:, :, step]))
        waits |= batch.present[:, step] & find_blocked(then) & find_standing(then)
    return replace(rollout, waits=waits & find_standing(rollout))


def remember_arc(rollout: Rollout, action: Float[Tensor, "E 2"]) -> Rollout:
    """Follow the curvature of arcs by new actions."""
    if (curvature := rollout.curvature) is None:
        return rollout
    return replace(rollout, curvature=_bend(curvature, action, rollout.batch.sizes))


def _bend(
    curvature: Float[Tensor, "E"], action: Float[Tensor, "E 2"], sizes: Float[Tensor, "E 2"]
) -> Float[Tensor, "E"]:
    """Take over a share of the curvature of new actions, which jitter."""
    return torch.lerp(curvature, compute_curvature(action[:, 1], sizes[:, 0]), CURVATURE_SHARE)


def watch(rollout: Rollout) -> Rollout:
    """Find the speeds from which agents can stop for others, and before red lights."""
    if (curvature := rollout.curvature) is None:
        return rollout
    batch, pose = rollout.batch, rollout.pose
    if (plan := rollout.plan) is not None:
        arc = plan.aim(pose, BRAKING_AHEAD_S, batch.segments.dt)
        curvature = torch.where(plan.goes_on, arc, curvature)
    row, (others, sizes, there) = batch.controlled.segment, gather_others(rollout)
    turns = torch.zeros_like(rollout.states[..., 0])
    turns = turns.index_put(batch.controlled.index, curvature)[row]
    given = pose, batch.sizes, curvature
    safe = compute_safe_speeds(*given, others, sizes, turns, there)
    red = batch.segments.light_states[row, rollout.index] == RED
    stops = compute_safe_speed_before_red(*given, batch.segments.stop_lines[row], red)
    return replace(rollout, safe_speeds=torch.cat([safe, stops[:, None]], dim=1))


def find_blocked(rollout: Rollout) -> Bool[Tensor, "E"]:
    """Mark agents that are not free to go: somebody is ahead or crosses, or a light is red."""
    if rollout.safe_speeds is None:
        return torch.zeros_like(rollout.moving[:, 0])
    return rollout.safe_speeds.amin(dim=1) < WAITING_MPS


def find_standing(rollout: Rollout) -> Bool[Tensor, "E"]:
    """Mark agents that stand."""
    return rollout.pose[:, 3].abs() < STANDING_MPS


def make_plans(
    rollout: Rollout,
    segments: Segments,
    plans: Float[Tensor, "B K N t 4"] | None,
    goals: Mapping[str, Goal],
    *,
    bicycle: bool,
) -> Rollout:
    """Give agents the paths to their goals, and others their plans.

    Args:
        rollout: at the last observed step.
        segments: its segments, not repeated for each sample.
        plans: states of each sample after the last observed step, of agents that are there then.
        goals: way points and target speeds of agents, by the names in `segments.ids`.
        bicycle: whether agents move as bicycles rather than unicycles.

    Returns:
        The rollout with its plan and target speeds.

    Raises:
        ValueError: a goal's agent is not controlled.
    """
    if plans is None and not goals:
        return rollout
    controlled, samples, dt = rollout.batch.controlled, rollout.samples, segments.dt
    row, agent = controlled.segment // samples, controlled.agent
    rank = controlled.segment % samples
    states, steps = rollout.pose[:, None], torch.zeros_like(rank)
    if plans is not None:
        states = torch.cat([states, plans[row, rank, agent]], dim=1)
        there = rollout.batch.present[:, rollout.index]
        steps = torch.where(there, plans.shape[3], steps)
    speeds = torch.full_like(rollout.pose[:, 3], torch.nan)
    for name, goal in goals.items():
        found = [
            k
            for k, (i, j) in enumerate(zip(row.tolist(), agent.tolist(), strict=True))
            if segments.ids and j < len(segments.ids[i]) and segments.ids[i][j] == name
        ]
        if not found:
            raise ValueError(f"a goal is of agent {name}, which the model does not control")
        speeds[found] = torch.nan if goal.speed is None else goal.speed
        steps[found] = 0
        for k in found if goal.points else ():
            path = plan_through(rollout.pose[k], goal, dt)
            more = len(path) - states.shape[1]
            if more > 0:
                states = torch.cat([states, states[:, -1:].expand(-1, more, -1)], dim=1)
            states = states.clone()
            states[k, : len(path)] = path
            steps[k] = len(path) - 1
    plan = Plan(states, steps, torch.zeros_like(rank), bicycle=bicycle)
    return replace(rollout, plan=plan, speeds=speeds)
