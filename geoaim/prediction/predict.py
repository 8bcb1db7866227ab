"""Predict the future of a scene."""

from collections.abc import Mapping
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from geoaim.base.defaults import SAMPLES
from geoaim.base.errors import warn
from geoaim.base.limits import MAX_GB_VARIABLE, read_memory_limit
from geoaim.prediction.config import MAX_HISTORY_STEPS
from geoaim.prediction.cutting import cut_future
from geoaim.prediction.familiarity import measure_strangeness
from geoaim.prediction.futures import Futures
from geoaim.prediction.itra import ITRA
from geoaim.prediction.plans import Goal
from geoaim.prediction.rollouts import DT_TOLERANCE_S
from geoaim.prediction.sureness import list_left_out
from geoaim.rendering.prefiltering import prefilter_ground
from geoaim.rendering.scene import Scene

# futures that are drawn at least, of which those that are asked for are chosen: minADE of six at
# Karlsruhe k729 1.5 instead of 1.7 m, joint 1.5 instead of 1.8
DRAWS = 24
MAX_STRANGE_SHARE = 0.5  # of the agents whose views are strange; with more, `predict` warns


def predict(  # noqa: PLR0913  (what is predicted, and how)
    model: ITRA,
    scene: Scene,
    *,
    samples: int = SAMPLES,
    horizon: int = 40,
    start: int | None = None,
    goals: Mapping[str, Goal] | None = None,
    generator: torch.Generator,
) -> Futures:
    """Sample joint futures of all agents of the model's group.

    `DRAWS` are drawn, and those are given that cover them: by which the expected error of the best
    one is least. The first one is the best single guess. `ITRA.sample` gives plain draws.

    Args:
        model: a model from `read_model` or `train`.
        scene: map, agents and lights, at the model's dt.
        samples: K futures.
        horizon: T steps to predict; a model with proposals takes only its config's horizon.
        start: index of the last observed step; None: the scene's last step.
        goals: way points and target speeds of agents, by their names; after its way points an agent
            goes on as the model has it. It brakes for others on the way, if the model does.
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
    draws = max(samples, DRAWS)
    _check_size(draws, len(scene.ids), history + horizon)
    segment = cut_future(scene, config.kind, config.dt, steps=steps, start=start)
    ground = prefilter_ground(scene.ground, config.resolution)
    _warn_of_strange_views(measure_strangeness(model, segment, ground, step=history - 1))
    given: dict[str, Any] = {"history": history, "samples": draws, "goals": goals}
    futures = model.sample(segment, ground, generator=generator, **given)[0, :, :, history:]
    if samples < draws:
        paths = futures[:, segment.controlled[0], :, :2].flatten(1, 2)
        futures = futures[choose_covering(paths, samples)]
    present = segment.present[0, :, history:, None]
    states = torch.where(present, futures, torch.nan)
    left_out = list_left_out(scene, config.kind, start)
    return Futures(states, scene, start, config.dt, segment.controlled[0], left_out)


def choose_covering(paths: Float[Tensor, "P t 2"], count: int) -> list[int]:
    """Choose the paths by which the expected error of the best one is least, one after the other.

    Args:
        paths: P equally likely paths, metres.
        count: number of paths to choose.

    Returns:
        Their indices; the first one is the best single guess.

    >>> places = torch.tensor([0.0, 1.0, 2.0, 9.0])
    >>> choose_covering(places.view(4, 1, 1).expand(4, 1, 2), 2)
    [1, 3]
    """
    apart = torch.stack([(paths - path).norm(dim=-1).mean(dim=1) for path in paths])  # (P, P)
    nearest, chosen = torch.full_like(apart[0], torch.inf), []
    for _ in range(count):
        chosen.append(int(torch.minimum(nearest, apart).sum(dim=1).argmin()))
        nearest = torch.minimum(nearest, apart[chosen[-1]])
    return chosen


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
