"""Scores of tracks: HOTA and IDF1 as TrackEval has them, and errors of states in metres."""

from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from scipy.optimize import linear_sum_assignment

from benchmarks.tracking.cases import project_boxes
from geoaim.base.geometry import wrap_angle
from geoaim.tracking.association import find_max_gap
from geoaim.tracks.tracks import Tracks

MIN_IOU = 0.3  # of boxes whose states are compared
IDENTITY_IOU, HOTA_IOUS = 0.5, np.arange(0.05, 0.99, 0.05)
NEAR_IOU = 0.05  # of boxes of an agent that nobody saw for a while: identities alone
MIN_MOVING_SPEED = 0.5  # m/s
MAX_HEADING_SIGMA_RAD = 1.5  # of a heading that counts as known
CHI_SQUARED_95, NORMAL_95 = 5.991, 1.96  # of two coordinates; of one
SENSE_TOLERANCE_RAD = np.pi / 2  # a heading that is off by more has the wrong sense


@dataclass(frozen=True, eq=False)
class BoxView:
    """Agents as the frames show them."""

    tracks: Tracks
    boxes: Float[Array, "N T 4"]  # pixels
    visible: Bool[Array, "N T"]


def make_view(
    tracks: Tracks, frame_from_world: Float[Array, "T 3 3"], size: tuple[int, int], kept: Array
) -> BoxView:
    """Make the view of some agents.

    Args:
        tracks: agents at the times of the frames.
        frame_from_world: transforms from metres to pixels.
        size: (height, width) of the frames, pixels.
        kept: (N,) which agents are visible at all.

    Returns:
        The view.
    """
    boxes, visible = project_boxes(tracks, frame_from_world, size)
    return BoxView(tracks, boxes, visible & np.asarray(kept)[:, None])


def score_tracks(truth: BoxView, found: BoxView) -> dict[str, Any]:
    """Score tracks: HOTA and IDF1 of boxes in frames, and errors of their states.

    Args:
        truth: the agents.
        found: the tracks, at the same times.

    Returns:
        HOTA and IDF1 (0 to 1) by TrackEval; medians of the errors of position (m), heading
        (degrees), speed (m/s), acceleration (m/s²), length and width (m), with 90 % quantiles.
    """
    pairs, data = match_frames(truth, found)
    scores = _judge_identities(data) | measure_errors(truth.tracks, found.tracks, pairs)
    return scores | judge_gaps(found.tracks, pairs, np.asarray(found.visible.any(axis=1)))


def judge_gaps(found: Tracks, pairs: Array, kept: Bool[Array, "N"]) -> dict[str, int]:
    """Judge the gaps that are bridged for longer than tracks are kept as the frames come.

    Args:
        found: the tracks, at the times of the frames.
        pairs: (m, 3) agent, track and step of each state that agrees.
        kept: which tracks are judged.

    Returns:
        How many gaps there are, and how many have the same agent before and after: that of most
        states until the next gap. A false box is no agent, so that its gaps are not right.
    """
    if found.seen is None:
        return {}
    agent = np.full(found.present.shape, -1)
    agent[pairs[:, 1], pairs[:, 2]] = pairs[:, 0]
    longest = find_max_gap(float(found.times[1] - found.times[0]))
    gaps = right = 0
    for own, seen in zip(agent[kept], found.seen[kept], strict=True):
        steps = np.flatnonzero(seen)
        breaks = np.flatnonzero(np.diff(found.times[steps]) > longest) + 1
        most = [np.bincount(part + 1).argmax() for part in np.split(own[steps], breaks)]
        gaps += len(breaks)
        right += sum(one == other > 0 for one, other in pairwise(most))
    return {"bridged gaps": gaps, "of one agent": right}


def compute_iou(one: Float[Array, "n 4"], other: Float[Array, "m 4"]) -> Float[Array, "n m"]:
    """Compute the intersection over union of boxes left, top, right, bottom.

    >>> compute_iou(np.array([[0.0, 0, 2, 2]]), np.array([[1.0, 0, 3, 2]])).round(3)
    array([[0.333]])
    """
    low = np.maximum(one[:, None, :2], other[None, :, :2])
    high = np.minimum(one[:, None, 2:], other[None, :, 2:])
    shared = (high - low).clip(0).prod(axis=2)
    areas = [(boxes[:, 2:] - boxes[:, :2]).prod(axis=1) for boxes in (one, other)]
    union = areas[0][:, None] + areas[1][None] - shared
    return np.asarray(shared / np.maximum(union, 1e-9))


def match_frames(truth: BoxView, found: BoxView) -> tuple[Array, dict[str, Any]]:
    """Match boxes frame by frame; with what TrackEval's metrics take."""
    steps = truth.boxes.shape[1]
    pairs, agents, tracks, similarities = [], [], [], []
    for step in range(steps):
        one, other = np.flatnonzero(truth.visible[:, step]), np.flatnonzero(found.visible[:, step])
        iou = compute_iou(truth.boxes[one, step], found.boxes[other, step])
        rows, columns = linear_sum_assignment(-iou)
        kept = iou[rows, columns] > MIN_IOU
        chosen = one[rows[kept]], other[columns[kept]]
        pairs.append(np.column_stack([*chosen, np.full(kept.sum(), step)]))
        agents.append(one)
        tracks.append(other)
        similarities.append(iou)
    names = [np.unique(np.concatenate(part)) for part in (agents, tracks)]
    data = {
        "num_timesteps": steps,
        "num_gt_ids": len(names[0]),
        "num_tracker_ids": len(names[1]),
        "num_gt_dets": sum(map(len, agents)),
        "num_tracker_dets": sum(map(len, tracks)),
        "gt_ids": [np.searchsorted(names[0], part) for part in agents],
        "tracker_ids": [np.searchsorted(names[1], part) for part in tracks],
        "similarity_scores": similarities,
    }
    return np.concatenate(pairs), data


def _judge_identities(data: dict[str, Any]) -> dict[str, float]:
    """Judge identities by TrackEval (Luiten et al. 2021), or by the same definitions without it."""
    try:
        from trackeval.metrics import HOTA, Identity
    except ImportError:
        hota, idf1 = _compute_hota(data), _judge_idf1(data)
    else:
        hota = float(HOTA().eval_sequence(data)["HOTA"].mean())
        idf1 = float(Identity({"PRINT_CONFIG": False}).eval_sequence(data)["IDF1"])
    return {
        "HOTA": hota,
        "IDF1": idf1,
        "IDF1 near": _judge_idf1(data, NEAR_IOU),
        "agents": data["num_gt_ids"],
        "tracks": data["num_tracker_ids"],
    }


def _list_frames(data: dict[str, Any]) -> list[tuple[Array, Array, Array]]:
    return list(zip(data["gt_ids"], data["tracker_ids"], data["similarity_scores"], strict=True))


def _judge_idf1(data: dict[str, Any], least: float = IDENTITY_IOU) -> float:
    """Compute IDF1 (Ristani et al. 2016): each agent has one track, so that most boxes agree."""
    shared = np.zeros((data["num_gt_ids"], data["num_tracker_ids"]))
    for agents, tracks, similarity in _list_frames(data):
        rows, columns = np.nonzero(similarity >= least)
        shared[agents[rows], tracks[columns]] += 1
    return compute_idf1(shared, data["num_gt_dets"] + data["num_tracker_dets"])


def compute_idf1(shared: Float[Array, "N M"], boxes: int) -> float:
    """Compute IDF1 from how often each agent and track agree, and all boxes of both."""
    return float(2 * shared[linear_sum_assignment(-shared)].sum() / boxes)


def _compute_hota(data: dict[str, Any]) -> float:
    """Compute HOTA (Luiten et al. 2021), the mean over its thresholds."""
    shape = data["num_gt_ids"], data["num_tracker_ids"]
    together, counts = np.zeros(shape), (np.zeros(shape[0]), np.zeros(shape[1]))
    for agents, tracks, similarity in _list_frames(data):
        union = similarity.sum(axis=0)[None] + similarity.sum(axis=1)[:, None] - similarity
        together[np.ix_(agents, tracks)] += similarity / np.maximum(union, 1e-9)
        counts[0][agents] += 1
        counts[1][tracks] += 1
    total = counts[0][:, None] + counts[1][None]
    alike = together / np.maximum(total - together, 1e-9)
    found = np.zeros((len(HOTA_IOUS), *shape))
    for agents, tracks, similarity in _list_frames(data):
        rows, columns = linear_sum_assignment(-alike[np.ix_(agents, tracks)] * similarity)
        good = similarity[rows, columns] >= HOTA_IOUS[:, None] - 1e-9
        found[:, agents[rows], tracks[columns]] += good
    right = found.sum(axis=(1, 2))
    association = (found**2 / np.maximum(total - found, 1)).sum(axis=(1, 2)) / np.maximum(right, 1)
    detection = right / (data["num_gt_dets"] + data["num_tracker_dets"] - right)
    return float(np.sqrt(detection * association).mean())


def measure_errors(truth: Tracks, found: Tracks, pairs: Array) -> dict[str, float]:
    """Measure the errors of states, in the units of their names.

    Args:
        truth: the agents.
        found: the tracks, at the same times.
        pairs: (m, 3) agent, track and step of each state that is compared.

    Returns:
        Medians and 90 % quantiles by name.
    """
    agent, track, step = pairs.T
    if not len(pairs):
        return {}
    one, other = truth.states[agent, step], found.states[track, step]
    unknown = np.zeros(len(pairs), bool)
    if found.uncertainty is not None:
        unknown = found.uncertainty[track, step, 1] > MAX_HEADING_SIGMA_RAD
    heading = np.abs(wrap_angle(other[:, 2] - one[:, 2]))
    heading[unknown] = np.nan
    moving = np.abs(one[:, 3]) > MIN_MOVING_SPEED
    values = {
        "position m": np.hypot(*(other - one)[:, :2].T),
        "heading °": np.degrees(heading),
        "heading moving °": np.degrees(heading[moving]),
        "heading standing °": np.degrees(heading[~moving]),
        "speed m/s": np.abs(other[:, 3] - one[:, 3]),
    }
    slopes = [np.gradient(tracks.states[..., 3], tracks.times, axis=1) for tracks in (truth, found)]
    values["acceleration m/s²"] = np.abs(slopes[1][track, step] - slopes[0][agent, step])
    sizes = _match_sizes(truth, found, agent, track)
    values |= {"length m": sizes[:, 0], "width m": sizes[:, 1]}
    errors = {}
    for name, value in values.items():
        known = value[np.isfinite(value)]
        errors[name] = float(np.median(known)) if len(known) else np.nan
        errors[f"{name} 90 %"] = float(np.quantile(known, 0.9)) if len(known) else np.nan
    if found.uncertainty is not None:
        # what the 95 % regions that are stated hold: a circle of the position, a range of headings
        stated = found.uncertainty[track, step]
        inside = values["position m"] < np.sqrt(CHI_SQUARED_95) * stated[:, 0]
        errors["in position's 95 % region"] = 100 * float(inside.mean())
        inside = heading[~unknown] < NORMAL_95 * stated[~unknown, 1]
        errors["in heading's 95 % range"] = 100 * float(inside.mean())
    errors["wrong sense %"] = 100 * float((heading > SENSE_TOLERANCE_RAD).mean())
    errors["heading unknown %"] = 100 * float(unknown.mean())
    return errors


def _match_sizes(truth: Tracks, found: Tracks, agent: Array, track: Array) -> Float[Array, "n 2"]:
    """Errors of the sizes of agents, each by the track that it is most often matched to."""
    errors = []
    for one in np.unique(agent):
        numbers, counts = np.unique(track[agent == one], return_counts=True)
        errors.append(np.abs(found.sizes[numbers[counts.argmax()]] - truth.sizes[one]))
    return np.array(errors).reshape(-1, 2)
