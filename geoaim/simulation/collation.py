"""Batches of boxes and scenarios of several scenes, padded with absent agents."""

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor

from geoaim.simulation.boxes import OrientedBoxes
from geoaim.simulation.simulator import Scenario


def collate_boxes(layers: Sequence[OrientedBoxes]) -> OrientedBoxes:
    """Collate one layer of several scenes to one layer of all of them.

    Args:
        layers: layers of one scene or more each, with any number of boxes; either all have
            triangles or none has.

    Returns:
        (B, A) boxes, where B is the number of all scenes and A the largest number of boxes in a
        scene; boxes that a scene lacks are absent.

    Raises:
        ValueError: there is no layer, or only some of them have triangles.

    >>> size, white = torch.ones(2), torch.ones(3)
    >>> scenes = [OrientedBoxes(torch.zeros(1, count, 3), size, white) for count in (1, 2)]
    >>> collate_boxes(scenes).present
    tensor([[ True, False],
            [ True,  True]])
    """
    with_triangles = {layer.heading_colours is not None for layer in layers}
    if len(with_triangles) != 1:
        raise ValueError("layers are needed, all of them with heading_colours or none")
    count = max(layer.poses.shape[1] for layer in layers)
    full = [_broadcast(layer) for layer in layers]
    tensors = {name: torch.cat([_pad(part[name], count) for part in full]) for name in full[0]}
    return OrientedBoxes(**tensors)


def collate_scenarios(scenarios: Sequence[Scenario]) -> Scenario:
    """Collate pieces of recordings of several places, padded to the most agents.

    Args:
        scenarios: the scenarios, all with the same number of steps and the same dt.

    Returns:
        The pieces as one batch; agents that a piece lacks are absent.

    Raises:
        ValueError: there are none, or steps or dt differ.
    """
    kinds = {(scenario.states.shape[2], scenario.dt) for scenario in scenarios}
    if len(kinds) != 1:
        stated = ", ".join(f"{steps} steps of {dt:g} s" for steps, dt in sorted(kinds)) or "none"
        raise ValueError(f"scenarios of {stated}; one or more with the same steps are needed")
    most = max(scenario.states.shape[1] for scenario in scenarios)
    parts = []
    for scenario in scenarios:
        more = most - scenario.states.shape[1]
        parts.append(
            (
                F.pad(scenario.states, (0, 0, 0, 0, 0, more)),
                F.pad(scenario.present, (0, 0, 0, more)),
                F.pad(scenario.sizes, (0, 0, 0, more), value=1.0),
                F.pad(scenario.pedestrian, (0, more)),
            )
        )
    states, present, sizes, pedestrian = map(torch.cat, zip(*parts, strict=True))
    return Scenario(states, present, sizes, pedestrian, scenarios[0].dt)


def _broadcast(layer: OrientedBoxes) -> dict[str, Tensor]:
    """Expand all tensors of a layer to (B, A, ...)."""
    shape = layer.poses.shape[:2]
    tensors = {"poses": layer.poses, "sizes": layer.sizes, "colours": layer.colours}
    if layer.heading_colours is not None:
        tensors["heading_colours"] = layer.heading_colours
    expanded = {name: value.expand(*shape, value.shape[-1]) for name, value in tensors.items()}
    present = layer.present
    if present is None:
        present = torch.ones(shape, dtype=torch.bool, device=layer.poses.device)
    return {**expanded, "present": present.expand(shape)}


def _pad(values: Tensor, count: int) -> Tensor:
    """Pad (B, A, ...) to `count` boxes, with zeros."""
    return F.pad(values, (0, 0) * (values.ndim - 2) + (0, count - values.shape[1]))
