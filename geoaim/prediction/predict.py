"""Predict the future of a scene."""

from collections.abc import Mapping
from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from geoaim.base.defaults import SAMPLES
from geoaim.base.errors import warn
from geoaim.base.limits import MAX_GB_VARIABLE, read_memory_limit
from geoaim.prediction.baselines import BASELINES, NOISY
from geoaim.prediction.config import MAX_HISTORY_STEPS
from geoaim.prediction.cutting import cut_future
from geoaim.prediction.familiarity import measure_strangeness
from geoaim.prediction.futures import Futures
from geoaim.prediction.itra import ITRA
from geoaim.prediction.plain import extend
from geoaim.prediction.plans import Goal
from geoaim.prediction.rollouts import DT_TOLERANCE_S
from geoaim.prediction.segments import Segments
from geoaim.prediction.sureness import list_left_out
from geoaim.rendering.ground import Ground
from geoaim.rendering.prefiltering import prefilter_ground
from geoaim.rendering.scene import Scene

# futures that are drawn at least, of which those that are asked for are chosen: minADE of six at
# Karlsruhe k729 1.5 instead of 1.7 m, joint 1.5 instead of 1.8
DRAWS = 24
# of the probability that the network of a place has beside draws: 0.3, 0.5, 0.7 and 0.9 gave minADE
# of 0.98, 0.99, 0.89, 0.86 m at Karlsruhe k733 on another day, 1.27, 1.25, 1.27, 1.25 at Zhengzhou
# 0592, and joint minADE of 1.20, 1.09, 1.20, 1.09 and 1.79, 1.84, 1.58, 1.62
PLACE_SHARE = 0.9
MAX_STRANGE_SHARE = 0.5  # of the agents whose views are strange; with more, `predict` warns


def predict(  # noqa: PLR0913  (what is predicted, and how)
    model: ITRA,
    scene: Scene,
    *,
    samples: int = SAMPLES,
    horizon: int = 40,
    start: int | None = None,
    goals: Mapping[str, Goal] | None = None,
    noise: float = 0.0,
    generator: torch.Generator,
) -> Futures:
    """Sample joint futures of all agents of the model's group.

    They are those of `draw_covering`.

    Args:
        model: a model from `read_model` or `train`.
        scene: map, agents and lights, at the model's dt.
        samples: K futures.
        horizon: T steps to predict; a model with proposals takes only its config's horizon.
        start: index of the last observed step; None: the scene's last step.
        goals: way points and target speeds of agents, by their names; after its way points an agent
            goes on as the model has it. It brakes for others on the way, if the model does.
        noise: probability that agents keep their speed and heading, known with noise, beside what
            the model expects: `choose_noise` of what `judge_before` found.
        generator: source of the noise, on the scene's device.

    Returns:
        The futures: `states` (K, N, T, 4) holds x, y, heading and speed of all agents at the T
        steps after `start`; NaN for those that are absent at `start`. Nothing that agents do later
        is used: those of other kinds move straight on, and those of the group whose speed is too
        unsure (`MAX_SPEED_SIGMA`), which `left_out` lists. Lights change as recorded and, beyond
        the scene's end, keep their last states.

    Raises:
        TracksError: no agent of the group is present at that step, or surely known.
        ValueError: the scene's dt is not the model's, there is no such step, a model with
            proposals needs a longer history or another horizon, a goal's agent is not predicted,
            or the futures need too much memory.
    """
    config, total = model.config, len(scene.times)
    start = total - 1 if start is None else start
    if not 0 <= start < total:
        raise ValueError(f"start={start}, but the scene has steps 0 to {total - 1}")
    if total > 1 and abs(scene.dt - config.dt) > DT_TOLERANCE_S:
        raise ValueError(
            f"the scene's dt is {scene.dt:g} s and the model's {config.dt:g} s; resample the tracks"
        )
    first = max(0, start + 1 - (config.history or MAX_HISTORY_STEPS))
    history = start + 1 - first
    steps = slice(first, start + 1 + horizon)
    _check_size(max(samples, DRAWS), len(scene.ids), history + horizon)
    segment = cut_future(scene, config.kind, config.dt, steps=steps, start=start)
    ground = prefilter_ground(scene.ground, config.resolution)
    _warn_of_strange_views(measure_strangeness(model, segment, ground, step=history - 1))
    given: dict[str, Any] = {"history": history, "samples": samples, "goals": goals, "noise": noise}
    futures = draw_covering(model, segment, ground, generator=generator, **given)
    futures = futures[0, :, :, history:]
    present = segment.present[0, :, history:, None]
    states = torch.where(present, futures, torch.nan)
    left_out = list_left_out(scene, config.kind, start)
    return Futures(states, scene, start, config.dt, segment.controlled[0], left_out)


@torch.no_grad()
def draw_covering(  # noqa: PLR0913  (what is drawn, and how)
    model: ITRA,
    segments: Segments,
    ground: Ground,
    *,
    history: int,
    samples: int,
    generator: torch.Generator,
    goals: Mapping[str, Goal] | None = None,
    noise: float = 0.0,
) -> Float[Tensor, "B K N T 4"]:
    """Draw joint futures in which each agent has paths that cover what is expected of it.

    `DRAWS` are drawn, as many at constant velocity with noise where this has a probability, and the
    proposals of the network of the place are added. Of each agent's paths those are chosen by which
    the expected error of the best one is least. Then all agents follow theirs, the first future of
    the best single guesses, and brake for each other as the model does.

    It takes and gives what `ITRA.sample` does; `DRAWS` samples and more without noise are plain
    draws.
    """
    given: dict[str, Any] = {"history": history, "goals": goals, "generator": generator}
    ground = prefilter_ground(ground, model.config.resolution)
    drawn = model.sample(segments, ground, samples=max(samples, DRAWS), **given)
    count = drawn.shape[1]
    if samples == count and not noise:
        return drawn
    pool, weights = drawn, drawn.new_full((*segments.controlled.shape, count), 1 / count)
    if noise:
        constant = BASELINES[NOISY](
            segments, ground, history=history, samples=count, generator=generator
        )
        pool = torch.cat([drawn, constant], dim=1)
        weights = torch.cat([(1 - noise) * weights, noise * weights], dim=2)
    if model.own_place is not None:
        plans, shares = model.own_place.plan(segments, history)
        shares = PLACE_SHARE * shares
        weights = torch.cat([weights * (1 - shares.sum(dim=2, keepdim=True)), shares], dim=2)
        plans = extend(plans, segments.steps - history, segments.dt).transpose(1, 2)
        observed = drawn[:, :1, :, :history].expand(-1, plans.shape[1], -1, -1, -1)
        pool = torch.cat([pool, torch.cat([observed, plans], dim=3)], dim=1)
    row, agent = (segments.controlled & segments.present[:, :, history - 1]).nonzero().unbind(1)
    chosen = choose_covering(pool[row, :, agent, history:, :2], weights[row, agent], samples)
    paths = drawn[:, :samples].clone()
    rank = torch.arange(samples, device=row.device)
    paths[row[:, None], rank, agent[:, None]] = pool[row[:, None], chosen, agent[:, None]]
    if not model.config.brakes:
        return paths
    return model.sample(segments, ground, samples=samples, plans=paths[..., history:, :], **given)


def choose_covering(
    paths: Float[Tensor, "E P t 2"], weights: Float[Tensor, "E P"], count: int
) -> Int[Tensor, "E K"]:
    """Choose paths by which the expected error of the best one is least, one after the other.

    Args:
        paths: P paths of E agents, metres.
        weights: their probabilities; those of 0 are not chosen.
        count: number of paths to choose, K.

    Returns:
        Their indices; the first one is the best single guess.

    >>> places, even = torch.tensor([0.0, 1.0, 2.0, 9.0]), torch.full((1, 4), 0.25)
    >>> choose_covering(places.view(1, 4, 1, 1).expand(1, 4, 1, 2), even, 2)
    tensor([[1, 3]])
    """
    rows, chosen = torch.arange(len(paths), device=paths.device), []
    offsets = [(paths - path[:, None]).norm(dim=-1).mean(dim=2) for path in paths.unbind(1)]
    apart = torch.stack(offsets, dim=1)  # (E, P, P)
    nearest = torch.full_like(apart[:, 0], torch.inf)
    for _ in range(count):
        errors = (torch.minimum(nearest[:, None], apart) * weights[:, None]).sum(dim=2)
        chosen.append(errors.masked_fill(weights == 0, torch.inf).argmin(dim=1))
        nearest = torch.minimum(nearest, apart[rows, chosen[-1]])
    return torch.stack(chosen, dim=1)


def _warn_of_strange_views(distances: Float[Tensor, "E"] | None) -> None:
    """Warn if most views are unlike those that the model was trained on."""
    if distances is None:
        return
    share = float((distances > 1).float().mean())
    if share > MAX_STRANGE_SHARE:
        warn(
            f"the views of {share:.0%} of the agents are unlike those that the model was trained "
            "on; on known ground 5 % are (median distance "
            f"{float(distances.median()):.1f} times the limit). Check map, scale and place, "
            "evaluate the model here, or train it on this map"
        )


def _check_size(samples: int, agents: int, steps: int) -> None:
    """Refuse futures that need more memory than the limit."""
    needed = 4 * 4 * samples * agents * steps  # bytes of float32
    if needed > read_memory_limit():
        raise ValueError(
            f"{samples} futures of {agents:,} agents over {steps:,} steps need "
            f"{needed / 1e9:,.1f} GB of memory; ask for a shorter duration, or for fewer samples "
            f"if more than {DRAWS}, or set the variable {MAX_GB_VARIABLE} to more"
        )
