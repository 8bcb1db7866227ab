"""Futures of a scene: what a model thinks that may happen next."""

import torch
from jaxtyping import Float
from torch import Tensor

from geoaim.errors import TracksError
from geoaim.prediction.itra import ITRA
from geoaim.prediction.segments import PERSON, VEHICLE, Segments
from geoaim.simulation.ground import fit_ground
from geoaim.simulation.kinematics import bicycle_step
from geoaim.simulation.layers import KINDS
from geoaim.simulation.scene import Scene, states_of, step_seconds

KNOWN = 10  # steps before the prediction that a model gets at most, as in training


def predict(
    model: ITRA,
    scene: Scene,
    *,
    samples: int = 6,
    steps: int = 40,
    start: int | None = None,
    generator: torch.Generator,
) -> Float[Tensor, "K N T 4"]:
    """Draw joint futures of all agents of the model's kind.

    Args:
        model: from `read_model` or `train`.
        scene: map, agents and lights, at the model's steps.
        samples: futures.
        steps: of each.
        start: step of the scene that is the last one known; its last if left out.
        generator: of the noise.

    Returns:
        x, y, heading and speed of everybody at the steps after `start`; NaN of who is not there.
        Others replay, and go straight on beyond the scene's end; lights stay as they were last.

    Raises:
        TracksError: nobody of the kind is there at that step.
        ValueError: the scene's steps are not the model's, or there is no such step.
    """
    total = len(scene.times)
    start = total - 1 if start is None else start
    if not 0 <= start < total:
        raise ValueError(f"step {start} is not among the scene's {total}")
    if total > 1 and abs(step_seconds(scene) - model.config.seconds) > 1e-3:
        raise ValueError(
            f"the scene's steps are {step_seconds(scene):g} s and the model's "
            f"{model.config.seconds:g} s; resample the tracks"
        )
    segment, observed = _ahead(scene, model, start, steps)
    ground = fit_ground(scene.ground, model.config.resolution)
    found = model.sample(segment, ground, observed=observed, samples=samples, generator=generator)[
        0, :, observed:
    ]
    there = segment.present[0, observed:, :, None]
    return torch.where(there, found, torch.nan).transpose(1, 2)


def _ahead(scene: Scene, model: ITRA, start: int, steps: int) -> tuple[Segments, int]:
    """The last known steps, and what others do after them; how many are known."""
    first = max(0, start + 1 - KNOWN)
    theirs = torch.tensor([kind in KINDS[model.config.kind] for kind in scene.types])
    controlled = theirs.to(scene.present.device) & scene.present[:, start]
    if not controlled.any():
        raise TracksError(
            f"no {model.config.kind} is there at {float(scene.times[start]):g} s; the model "
            "moves nobody else"
        )
    known = slice(first, min(len(scene.times), start + 1 + steps))
    states = torch.where(scene.present[..., None], states_of(scene), 0.0)[:, known]
    present = scene.present[:, known]
    lights = scene.light_states[known].long()
    while states.shape[1] < start + 1 - first + steps:  # beyond the recording
        last = states[:, -1]
        still = torch.zeros_like(last[:, :2])
        on = bicycle_step(last, still, scene.sizes[:, 0], model.config.seconds)
        states = torch.cat([states, on[:, None]], dim=1)
        present = torch.cat([present, present[:, -1:]], dim=1)
        lights = torch.cat([lights, lights[-1:]])
    present = present.clone()
    present[controlled, start + 1 - first :] = True
    on_foot = torch.tensor([kind not in KINDS["vehicle"] for kind in scene.types])
    segment = Segments(
        states=states.transpose(0, 1)[None],
        present=present.t()[None],
        sizes=scene.sizes[None],
        planes=torch.where(on_foot, PERSON, VEHICLE).to(scene.sizes.device)[None],
        controlled=controlled[None],
        lines=scene.stop_lines[None],
        lights=lights[None],
        seconds=model.config.seconds,
    )
    return segment, start + 1 - first
