"""Training in closed loop: a vehicle goes on from where the model itself has brought it.

The last stage of the shipped vehicle model. All vehicles of a place are driven for
`CHUNKS * CHUNK_STEPS` steps by latents of the prior, as when they are sampled, from starts that are
disturbed. They learn to come back to their recorded path and pace, with the rules outside the
network: who is late for having yielded is not to make up for it. Gradients pass through the
kinematics over `CHUNK_STEPS`. Views are encoded as before: the network that sees is kept.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from benchmarks.prediction.places import Places, make_drawn_scene
from geoaim.base.progress import Progress
from geoaim.prediction.checkpoints import read_model, write_model
from geoaim.prediction.config import MAX_HISTORY_STEPS, Config
from geoaim.prediction.cutting import cut_scene
from geoaim.prediction.dataset import cut_moving_and_parked
from geoaim.prediction.itra import ITRA
from geoaim.prediction.rollouts import Rollout
from geoaim.prediction.segments import Segments, pick, repeat
from geoaim.rendering.ground import Ground
from geoaim.rendering.prefiltering import prefilter_ground
from geoaim.rendering.scene import Scene, slice_scene
from geoaim.simulation.kinematics import agent_from_world, wrap_angle

# in neither the training, validation nor test places of other experiments
CLOSED_LOOP: Places = (
    *((851, "junction"), (852, "t"), (853, "street"), (854, "roundabout")),
    *((855, "junction"), (856, "roundabout"), (857, "campus"), (858, "t")),
    *((861, "street"), (862, "roundabout"), (863, "campus"), (864, "junction")),
    *((865, "roundabout"), (866, "roundabout")),
)
STEPS, LEARNING_RATE, WARMUP_STEPS = 1800, 5e-4, 20
HISTORY, CHUNK_STEPS, CHUNKS, SAMPLES = MAX_HISTORY_STEPS, 40, 4, 2
SEGMENT_STEPS, SEGMENTS = 50, 12  # of the bound, which is trained beside it
BOUND_WEIGHT, KL_WEIGHT, MAX_NLL = 1.0, 3.0, 50.0
BEST_WEIGHT = 0.7  # of the best of the samples; the rest is their mean
MAX_GRADIENT_NORM = 1.0
# standard deviations of starts: m aside, rad, share of the speed
ASIDE_M, TURNED_RAD, SPEED_SHARE = 0.5, 0.06, 0.12
# errors that count as one: m aside, rad, m/s, and m/s of who waits, so that it does not creep
ASIDE_SCALE_M, HEADING_SCALE_RAD, SPEED_SCALE_MPS, WAITING_SCALE_MPS = 0.3, 0.1, 0.7, 0.2
# who waits is recorded below this speed from so many steps before to so many after
WAITING_MPS, WAITED_STEPS, WAITING_STEPS = 0.3, 10, 30
CATCH_UP_S, MAX_CATCH_UP_MPS = 4.0, 3.0  # how pace makes up for a lag
FAR_M, LATE_M = 8.0, 25.0  # who is farther from its path, or from where it should be, is lost
BEYOND_M = 4.0  # past an end of its path; farther on there is nothing to come back to
MIN_MOVING_MPS = 1.0


@dataclass(frozen=True, eq=False)
class _Place:
    scene: Scene
    ground: Ground
    segments: Segments


@dataclass(frozen=True, eq=False)
class _Paths:
    """Recorded states of E agents, when they are there and wait, and their way on the path, m."""

    states: Float[Tensor, "E T 4"]
    present: Bool[Tensor, "E T"]
    waits: Bool[Tensor, "E T"]
    way: Float[Tensor, "E T"]


def make_closed_loop(model: ITRA, folder: Path, progress: Progress, seed: int = 0) -> ITRA:
    """Train a model in closed loop, or read it from its folder.

    Args:
        model: a trained model of vehicles; it is not changed.
        folder: keeps the result.
        progress: takes stage, done and total.
        seed: seed of the training.

    Returns:
        The model.
    """
    path = folder / "model.pt"
    if not path.exists():
        places = []
        for number, (place, kind) in enumerate(CLOSED_LOOP):
            progress("closed loop, places", number, len(CLOSED_LOOP))
            scene, _ = make_drawn_scene(kind, place)
            segments = cut_moving_and_parked(scene, model.config, SEGMENT_STEPS)
            ground = prefilter_ground(scene.ground, model.config.resolution)
            places.append(_Place(scene, ground, segments))
        folder.mkdir(parents=True, exist_ok=True)
        write_model(_train(model, places, progress, seed), path)
    return read_model(path)


def _train(model: ITRA, places: Sequence[_Place], progress: Progress, seed: int) -> ITRA:
    """Train all but the network that sees, with the rules outside it."""
    trained = _copy(model, replace(model.config, brakes=True))
    trained.encoder.requires_grad_(False)
    generator = torch.Generator().manual_seed(seed)
    rollouts = _roll_out(trained, places, generator)

    def compute_loss() -> Float[Tensor, ""]:
        place, loss = next(rollouts)
        index = torch.randint(len(place.segments), (SEGMENTS,), generator=generator)
        history = int(torch.randint(1, HISTORY + 1, (), generator=generator))
        bound = trained(pick(place.segments, index), place.ground, history, generator)
        return loss + BOUND_WEIGHT * (bound.nll.clamp(max=MAX_NLL) + KL_WEIGHT * bound.kl)

    _optimise(trained, compute_loss, LEARNING_RATE, STEPS, partial(progress, "closed loop"))
    return trained


def _copy(model: ITRA, config: Config) -> "_Blind":
    copy = _Blind(config)
    copy.load_state_dict(model.state_dict())
    copy.known_views = model.known_views
    return copy


def _optimise(
    model: ITRA,
    compute_loss: Callable[[], Float[Tensor, ""]],
    rate: float,
    steps: int,
    report: Callable[[int, int], None],
) -> None:
    """Train the parameters that are not frozen."""
    parameters = [one for one in model.parameters() if one.requires_grad]
    optimiser = torch.optim.AdamW(parameters, rate, weight_decay=0.01)
    for step in range(steps):
        report(step, steps)
        loss = compute_loss()
        optimiser.param_groups[0]["lr"] = rate * min(1.0, step / WARMUP_STEPS) * (1 - step / steps)
        optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        nn.utils.clip_grad_norm_(parameters, MAX_GRADIENT_NORM)
        optimiser.step()


class _Blind(ITRA):
    """A model whose views pass no gradients."""

    def _render_and_encode(self, batch, states, step, controlled):  # type: ignore[no-untyped-def]
        with torch.no_grad():
            return super()._render_and_encode(batch, states, step, controlled)


def _roll_out(
    model: ITRA, places: Sequence[_Place], generator: torch.Generator
) -> Iterator[tuple[_Place, Float[Tensor, ""]]]:
    """Roll out all vehicles of random pieces of places; gives the loss of each chunk."""
    length = HISTORY + CHUNK_STEPS * CHUNKS
    while True:
        place = places[int(torch.randint(len(places), (), generator=generator))]
        spare = len(place.scene.times) - length
        first = int(torch.randint(spare, (), generator=generator))
        segment = cut_scene(slice_scene(place.scene, slice(first, first + length)), "vehicle")
        if not (segment.controlled & segment.present[:, :, HISTORY - 1]).any():
            continue
        rollout = model.start(
            _disturb(segment, generator), place.ground, history=HISTORY, samples=SAMPLES
        )
        paths = _find_paths(segment, rollout)
        for _ in range(CHUNKS):
            rollout, errors, number = _drive(model, rollout, paths, generator)
            means = (errors / number.clamp_min(1)).view(SAMPLES, -1)
            there = (number > 0).view(SAMPLES, -1)[0].float()
            mixed = BEST_WEIGHT * means.amin(dim=0) + (1 - BEST_WEIGHT) * means.mean(dim=0)
            yield place, (mixed * there).sum() / there.sum().clamp_min(1)
            rollout = _detach(rollout)


def _disturb(segment: Segments, generator: torch.Generator) -> Segments:
    """Move the observed states of moving agents aside, turn them, and change their speeds."""
    states = segment.states.clone()
    past = states[:, :, :HISTORY]
    moves = (past[:, :, -1, 3].abs() > MIN_MOVING_MPS) & segment.controlled
    aside, turned, speed = (
        scale * torch.randn(moves.shape, generator=generator)[..., None] * moves[..., None]
        for scale in (ASIDE_M, TURNED_RAD, SPEED_SHARE)
    )
    heading = past[..., 2].clone()
    past[..., 0] -= aside * heading.sin()
    past[..., 1] += aside * heading.cos()
    past[..., 2] += turned
    past[..., 3] *= 1 + speed
    return replace(segment, states=states)


def _find_paths(segment: Segments, rollout: Rollout) -> _Paths:
    states = repeat(segment, SAMPLES).states[rollout.batch.controlled.index]
    present = rollout.batch.present
    moved = states[..., :2].diff(dim=1).norm(dim=2) * (present[:, 1:] & present[:, :-1])
    speeds = F.pad(states[..., 3].abs() * present, (WAITED_STEPS, WAITING_STEPS), "replicate")
    fastest = speeds.unfold(1, WAITED_STEPS + 1 + WAITING_STEPS, 1).amax(dim=2)
    return _Paths(states, present, fastest < WAITING_MPS, F.pad(moved, (1, 0)).cumsum(dim=1))


def _drive(
    model: ITRA, rollout: Rollout, paths: _Paths, generator: torch.Generator
) -> tuple[Rollout, Float[Tensor, "E"], Int[Tensor, "E"]]:
    """Drive on by latents of the prior; also gives errors, summed, and how many steps counted."""
    errors, counts = [], []
    for _ in range(CHUNK_STEPS):
        rollout = model.step(rollout, model.draw_latent(rollout, generator))
        error, counted = _compare(rollout, paths)
        errors.append(error)
        counts.append(counted)
    return rollout, torch.stack(errors).sum(dim=0), torch.stack(counts).sum(dim=0)


def _compare(rollout: Rollout, paths: _Paths) -> tuple[Float[Tensor, "E"], Bool[Tensor, "E"]]:
    """How far agents are from their paths and paces; and who counts: who is there and not lost."""
    pose, step = rollout.pose, rollout.index
    away = (pose[:, None, :2].detach() - paths.states[..., :2]).norm(dim=2)
    nearest = away.masked_fill(~paths.present, torch.inf).argmin(dim=1)
    row = torch.arange(len(pose))
    path = paths.states[row, nearest]
    along, aside = agent_from_world(path[:, None], pose[:, None, :2])[:, 0].unbind(1)
    turned = wrap_angle(pose[:, 2] - path[:, 2])
    lag = (paths.way[row, nearest] + along - paths.way[:, step]).detach()
    catching_up = (lag / CATCH_UP_S).clamp(-MAX_CATCH_UP_MPS, MAX_CATCH_UP_MPS)
    pace = (paths.states[:, step, 3] - catching_up).clamp_min(0)
    counted = paths.present[:, step] & (aside.detach().abs() < FAR_M) & (lag.abs() < LATE_M)
    beside = along.detach().abs() < BEYOND_M
    error = beside * (_huber(aside / ASIDE_SCALE_M) + _huber(turned / HEADING_SCALE_RAD))
    scale = torch.where(paths.waits[:, step], WAITING_SCALE_MPS, SPEED_SCALE_MPS)
    return (error + _huber((pose[:, 3] - pace) / scale)) * counted, counted


def _huber(error: Tensor) -> Tensor:
    return F.huber_loss(error, torch.zeros_like(error), reduction="none")


def _detach(rollout: Rollout) -> Rollout:
    """Cut the gradients between two chunks."""
    return replace(
        rollout,
        states=rollout.states.detach(),
        hidden=rollout.hidden.detach(),
        features=rollout.features.detach(),
        curvature=None if rollout.curvature is None else rollout.curvature.detach(),
    )
