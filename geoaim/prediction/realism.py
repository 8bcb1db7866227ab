"""Realism of sampled futures: the likelihoods and the meta-metric of the WOSAC challenge.

The Waymo Open Sim Agents Challenge (Montali et al. 2023, arXiv 2305.12032) asks how likely the
recorded traffic is under the distribution of simulated traffic, for each of nine features.
"""

from collections.abc import Mapping

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from geoaim.prediction.likelihood import CONFIG_2024, Estimator, estimate_log_likelihood
from geoaim.prediction.metrics import Metric, check_futures, select_agents_to_judge
from geoaim.prediction.realism_features import compute_features
from geoaim.prediction.segments import Segments, mark_steps_until_leaving, pick
from geoaim.simulation.road_rules import NO_ROAD_RULES, RoadRules, move_rules_to_any

MIN_HISTORY_STEPS = 2  # steps before the first simulated one, whose acceleration needs them


GROUPS = {
    "kinematic": ("linear speed", "linear acceleration", "angular speed", "angular acceleration"),
    "interactive": ("distance to nearest object", "collision", "time to collision"),
    "map-based": ("distance to road edge", "off-road"),
}
BINARY_FEATURES = {  # binary features: 1 if the feature times this sign is positive at any step
    "collision": ("distance to nearest object", -1.0),
    "off-road": ("distance to road edge", 1.0),
}


def compute_realism(
    futures: Float[Tensor, "B K N T 4"],
    segments: Segments,
    history: int,
    rules: RoadRules = NO_ROAD_RULES,
    config: Mapping[str, Estimator] = CONFIG_2024,
) -> dict[str, Metric]:
    """Compute the realism of the controlled agents' futures, from 0 to 1 for each segment.

    Judged are the agents whose displacements `compute_metrics` judges, until they leave.

    The definitions are those of the challenge's code of 2024; the challenge has 32 samples of 8 s
    at 10 Hz, and results with other numbers are not comparable with its own. Positions are planar.

    Args:
        futures: states of all agents, observed steps included.
        segments: the ground truth.
        history: observed steps, at least 2.
        rules: the drivable area, without which there are no map-based likelihoods.
        config: `CONFIG_2024` or `CONFIG_2023`.

    Returns:
        Likelihoods by the names of the features in `config`, their weighted means by the names in
        `GROUPS`, and "realism", the weighted sum of all: the challenge's meta-metric.

    Raises:
        ValueError: the history is too short, or a controlled agent has a state that is not finite.
    """
    if history < MIN_HISTORY_STEPS:
        raise ValueError(f"history={history}; {MIN_HISTORY_STEPS} or more steps are needed")
    check_futures(futures, segments, history)
    rules = move_rules_to_any(rules, segments.worlds)
    scores: dict[str, list[Tensor]] = {}
    for number in range(len(segments)):
        segment = pick(segments, slice(number, number + 1))
        found = _score_segment(futures[number], segment, history, rules, config)
        for name, score in {**found, **summarise_groups(found, config)}.items():
            scores.setdefault(name, []).append(score)
    metrics = {name: torch.stack(values).double().cpu().numpy() for name, values in scores.items()}
    return {name: Metric(values, 0 * values + 1) for name, values in metrics.items()}


def summarise_groups(
    scores: Mapping[str, Tensor], config: Mapping[str, Estimator]
) -> dict[str, Tensor]:
    """Average likelihoods by `GROUPS`, and add all of them up; groups without one are left out."""
    summary = {}
    for group, names in GROUPS.items():
        if all(name in scores for name in names):
            weights = sum(config[name].weight for name in names)
            summary[group] = _add_up(scores, names, config) / weights
    if len(summary) == len(GROUPS):
        summary["realism"] = _add_up(scores, tuple(config), config)
    return summary


def _score_segment(
    futures: Float[Tensor, "K N T 4"],
    segment: Segments,
    history: int,
    rules: RoadRules,
    config: Mapping[str, Estimator],
) -> dict[str, Tensor]:
    """The likelihood of each feature, averaged over agents and steps."""
    judged = select_agents_to_judge(segment, history)[0]  # (N,)
    present = segment.present[0]  # (N, T)
    log, samples = (
        compute_features(
            states[..., :3],
            present.expand(len(states), -1, -1),
            segment.sizes[0],
            judged,
            dt=segment.dt,
            drivable=rules.drivable,
        )
        for states in (segment.states, futures)
    )
    valid = mark_steps_until_leaving(segment, history)[0, judged]
    scores = {}
    for name, estimator in config.items():
        feature, sign = BINARY_FEATURES.get(name, (name, 0.0))
        if feature in log:
            values = log[feature][0, :, history:], samples[feature][..., history:]
            if sign:
                values = _indicate(values[0], valid, sign), _indicate(values[1], valid, sign)
            steps = None if sign else valid
            likelihoods = estimate_log_likelihood(*values, estimator, steps)
            scores[name] = likelihoods[_select_steps(name, valid)].mean().exp()
    return scores


def _indicate(
    values: Float[Tensor, "*n T"], valid: Bool[Tensor, "E T"], sign: float
) -> Float[Tensor, "*n 1"]:
    """1 for agents of which a value has the sign at any valid step, else 0."""
    return ((values * sign > 0) & valid).any(dim=-1, keepdim=True).to(values)


def _select_steps(name: str, valid: Bool[Tensor, "E T"]) -> Bool[Tensor, "E _"]:
    """The steps at which a feature is judged: all its states are valid."""
    if name in BINARY_FEATURES:
        return torch.ones_like(valid[:, :1])
    if name in GROUPS["kinematic"]:
        valid = _mark_central(valid)
    return _mark_central(valid) if "acceleration" in name else valid


def _mark_central(valid: Bool[Tensor, "E T"]) -> Bool[Tensor, "E T"]:
    """Mark steps between two valid ones; the first and the last step are between none."""
    end = torch.zeros_like(valid[:, :1])
    return torch.cat([end, valid[:, 2:] & valid[:, :-2], end], dim=1)


def _add_up(
    scores: Mapping[str, Tensor], names: tuple[str, ...], config: Mapping[str, Estimator]
) -> Tensor:
    return torch.stack([config[name].weight * scores[name] for name in names]).sum()
