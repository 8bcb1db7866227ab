"""Made detections of synthetic agents: boxes with misses, false ones and noise, and their truth."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from benchmarks.synthetic.roads.layouts import PlaceKind
from benchmarks.synthetic.sample import MARGIN, make_sample
from benchmarks.synthetic.traffic.interpolation import interpolate_tracks
from geoaim.base.geometry import transform_points
from geoaim.mapping.video.detections import DetectedBoxes
from geoaim.tracks.tracks import Tracks

FRAME_RATE = 25.0  # Hz
DRIFT_PX = 10.0  # of the camera
MIN_BOX_PX = 2.0  # a smaller part of an agent in the frame is not visible
MIN_SEEN = 35  # frames before and after an agent is hidden
# height of agents, m, and the length of their roofs as a share of their own, by type
ROOFS = {"car": (1.5, 0.6), "van": (2.0, 0.85), "truck": (3.4, 1.0), "bus": (3.1, 1.0)}
OTHER_ROOF = 1.7, 1.0
CORNERS = np.array([[1.0, 1.0], [1.0, -1.0], [-1.0, -1.0], [-1.0, 1.0]])


@dataclass(frozen=True)
class DetectorErrors:
    """What a made detector does wrong."""

    misses: float = 0.05  # share of boxes that are missed
    false: float = 0.05  # false boxes, as a share of the true ones
    noise_px: float = 2.0  # standard deviation of each side of a box
    types: bool = True  # whether boxes have types
    burst: float = 1.0  # mean length of misses, frames
    lasting_px: float = 0.0  # standard deviation of each side's error that lasts
    lasting_s: float = 1.5  # how long it does
    doubled: float = 0.0  # share of boxes that come twice
    lost_s: float = 0.0  # for how long each agent is hidden once
    flying_height: float | None = None  # m, from which agents with roofs are seen; None: flat ones
    box_shaped: bool = False  # whether roofs are as large as their agents
    false_s: float = 0.0  # for how long a false box stays at its place; 0: for a frame


@dataclass(frozen=True, eq=False)
class TrackingCase:
    """Agents with exact states, the boxes of a made detector and the poses of the frames."""

    name: str
    truth: Tracks
    frame_from_world: Float[Array, "T 3 3"]  # exact
    world_from_frame: Float[Array, "T 3 3"]  # by registration, or exact
    boxes: list[DetectedBoxes]
    size: tuple[int, int]  # height and width of the frames, pixels
    flying_height: float | None = None  # m; None: agents are flat, as seen from far above


def make_drawn_case(
    kind: PlaceKind, seed: int, size: tuple[int, int], *, seconds: float, errors: DetectorErrors
) -> TrackingCase:
    """Make the boxes of a synthetic place without its pictures, for exact poses.

    Args:
        kind: of the place.
        seed: of everything in it.
        size: (height, width) of the frames, pixels.
        seconds: of traffic.
        errors: of the detector.

    Returns:
        The case.
    """
    sample = make_sample(seed, kind=kind, minutes=max(seconds / 60, 0.2), video=None)
    times = np.arange(round(seconds * FRAME_RATE)) / FRAME_RATE
    place, recording = sample.place, sample.recordings[0]
    truth = interpolate_tracks(sample.traffic_model, recording, place, times=times, margin=MARGIN)
    left, bottom, right, top = place.roads.extent.bounds
    step = min((right - left) / size[1], (top - bottom) / size[0])
    drift = DRIFT_PX * np.sin(times)
    matrices = np.tile(np.diag([step, -step, 1.0]), (len(times), 1, 1))
    matrices[:, 0, 2] = (left + right - size[1] * step) / 2 + step * drift
    matrices[:, 1, 2] = (bottom + top + size[0] * step) / 2
    world_from_frame = place.world_from_plan @ matrices
    generator = np.random.default_rng(seed)
    name = f"{kind} {size[1]} px"
    return make_case_of(name, truth, world_from_frame, size, errors, generator)


def make_case_of(
    name: str,
    truth: Tracks,
    world_from_frame: Float[Array, "T 3 3"],
    size: tuple[int, int],
    errors: DetectorErrors,
    generator: np.random.Generator,
) -> TrackingCase:
    """Make the boxes of agents in frames whose poses are exact.

    Args:
        name: of the case.
        truth: the agents.
        world_from_frame: transforms from pixels to metres.
        size: (height, width) of the frames, pixels.
        errors: of the detector.
        generator: source of the errors.

    Returns:
        The case.
    """
    frame_from_world = np.linalg.inv(world_from_frame)
    boxes, visible = project_boxes(truth, frame_from_world, size)
    if errors.flying_height is not None:
        boxes = _add_roofs(boxes, truth, frame_from_world, size, errors, generator)
    found = detect_boxes(boxes, visible, truth.types, errors, size, generator)
    height = errors.flying_height
    return TrackingCase(name, truth, frame_from_world, world_from_frame, found, size, height)


def _add_roofs(
    boxes: Float[Array, "N T 4"],
    truth: Tracks,
    frame_from_world: Float[Array, "T 3 3"],
    size: tuple[int, int],
    errors: DetectorErrors,
    generator: np.random.Generator,
) -> Float[Array, "N T 4"]:
    """Add roofs to boxes, smaller than the agents' bases, as a camera above the middle sees them.

    Heights and the sizes of roofs differ from agent to agent.
    """
    kinds = [ROOFS.get(kind, OTHER_ROOF) for kind in truth.types]
    height = np.array([high for high, _ in kinds]) * generator.uniform(0.85, 1.15, len(kinds))
    share = np.array([part for _, part in kinds]) * generator.uniform(0.9, 1.0, len(kinds))
    shares = np.column_stack([share, np.full(len(share), 0.9)]) if not errors.box_shaped else 1.0
    smaller = replace(truth, sizes=truth.sizes * shares)
    roofs, _ = project_boxes(smaller, frame_from_world, size)
    middle = np.tile(np.array(size[::-1]) / 2, 2)
    assert errors.flying_height is not None
    scale = errors.flying_height / (errors.flying_height - height)
    leaning = middle + (roofs - middle) * scale[:, None, None]
    low = np.minimum(boxes[..., :2], leaning[..., :2])
    high = np.maximum(boxes[..., 2:], leaning[..., 2:])
    limits = np.tile(np.array(size[::-1], float), 2)
    return np.concatenate([low, high], axis=2).clip(0, limits)


def project_boxes(
    tracks: Tracks, frame_from_world: Float[Array, "T 3 3"], size: tuple[int, int]
) -> tuple[Float[Array, "N T 4"], Bool[Array, "N T"]]:
    """Project agents into frames: the upright boxes about them, and whether they are visible.

    Args:
        tracks: agents at the times of the frames.
        frame_from_world: transforms from metres to pixels.
        size: (height, width) of the frames, pixels.

    Returns:
        Left, top, right, bottom in pixels, clipped to the frame; NaN where an agent is absent.
    """
    heading = tracks.states[..., 2]
    forward = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    left = np.stack([-forward[..., 1], forward[..., 0]], axis=-1)
    half = tracks.sizes[:, None] / 2
    corners = np.stack(
        [
            tracks.states[..., :2] + a * half[..., :1] * forward + b * half[..., 1:] * left
            for a, b in CORNERS
        ],
        axis=2,
    )
    agents, steps = tracks.present.shape
    by_frame = corners.swapaxes(0, 1).reshape(steps, agents * 4, 2)
    pixels = transform_points(frame_from_world, by_frame).reshape(steps, agents, 4, 2)
    pixels = pixels.swapaxes(0, 1).clip(0, size[::-1])
    boxes = np.concatenate([pixels.min(axis=2), pixels.max(axis=2)], axis=-1)
    visible = tracks.present & ((boxes[..., 2:] - boxes[..., :2]) >= MIN_BOX_PX).all(axis=-1)
    return boxes, visible


def detect_boxes(
    boxes: Float[Array, "N T 4"],
    visible: Bool[Array, "N T"],
    types: Sequence[str],
    errors: DetectorErrors,
    size: tuple[int, int],
    generator: np.random.Generator,
) -> list[DetectedBoxes]:
    """Make the boxes of a detector with errors.

    Args:
        boxes: true boxes, pixels.
        visible: whether each agent is visible.
        types: agent types.
        errors: what the detector does wrong.
        size: (height, width) of the frames, pixels.
        generator: source of the errors.

    Returns:
        The boxes of each frame.
    """
    frames = []
    agents, steps = visible.shape
    hidden = _draw_misses((agents, steps), errors, generator) | _hide_once(
        visible, round(errors.lost_s * FRAME_RATE), generator
    )
    keep = np.exp(-1 / (FRAME_RATE * errors.lasting_s))
    lasting = errors.lasting_px * generator.standard_normal((agents, 4))
    limits = np.tile(np.array(size[::-1], float), 2)
    stays = max(1, round(errors.false_s * FRAME_RATE))
    standing: list[tuple[Float[Array, "n 4"], list[str]]] = []  # those of the last frames
    for step in range(steps):
        shown = np.flatnonzero(visible[:, step])
        hit = shown[~hidden[shown, step]]
        hit = np.concatenate([hit, hit[generator.uniform(size=len(hit)) < errors.doubled]])
        fresh = errors.lasting_px * generator.standard_normal((agents, 4))
        lasting = keep * lasting + np.sqrt(1 - keep**2) * fresh
        found = boxes[hit, step] + lasting[hit]
        found = found + errors.noise_px * generator.standard_normal((len(hit), 4))
        count = generator.binomial(max(len(shown), 1), errors.false / stays)
        source = boxes[generator.choice(shown, count), step] if len(shown) else np.empty((0, 4))
        extent = source[:, 2:] - source[:, :2]
        corner = generator.uniform(0, 1, (len(source), 2)) * (limits[:2] - extent)
        false = np.concatenate([corner, corner + extent], axis=1)
        kinds = [str(kind) for kind in generator.choice(types, len(false))]
        standing = [*standing, (false, kinds)][-stays:]
        false = np.concatenate([part for part, _ in standing])
        if stays > 1:
            false = false + errors.noise_px * generator.standard_normal(false.shape)
        rows = np.concatenate([found, false]).clip(0, limits)
        named = [types[agent] for agent in hit]
        named += [kind for _, part in standing for kind in part]
        rows[:, 2:] = np.maximum(rows[:, 2:], rows[:, :2] + 1)
        frames.append(DetectedBoxes(rows, types=tuple(named) if errors.types else ()))
    return frames


def _draw_misses(
    shape: tuple[int, int], errors: DetectorErrors, generator: np.random.Generator
) -> Bool[Array, "N T"]:
    """Draw which boxes are missed, in bursts of a mean length."""
    end = 1 / errors.burst
    begin = min(end * errors.misses / max(1 - errors.misses, 1e-9), 1.0)
    missed = np.empty(shape, bool)
    state = generator.uniform(size=shape[0]) < errors.misses
    for step in range(shape[1]):
        missed[:, step] = state
        draw = generator.uniform(size=shape[0])
        state = np.where(state, draw >= end, draw < begin)
    return missed


def _hide_once(
    visible: Bool[Array, "N T"], length: int, generator: np.random.Generator
) -> Bool[Array, "N T"]:
    """Choose one time of `length` frames within each agent's own in which it is hidden."""
    hidden = np.zeros(visible.shape, bool)
    for agent in range(len(visible)):
        steps = np.flatnonzero(visible[agent])
        if length and len(steps) > length + 2 * MIN_SEEN:
            begin = steps[0] + generator.integers(MIN_SEEN, len(steps) - length - MIN_SEEN)
            hidden[agent, begin : begin + length] = True
    return hidden
