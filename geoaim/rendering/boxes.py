"""Layers of oriented boxes: their stack in paint order, and batches of several scenes."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor


@dataclass(frozen=True, eq=False)
class OrientedBoxes:
    """Oriented boxes in B scenes; where they overlap, they are mixed by their shares of a pixel.

    Poses may have more axes of scenes, or none, as the cameras of `render`.
    Sizes, colours and presence broadcast: colours may be (C,), (1, C), (A, C) or (B, A, C).
    """

    poses: Float[Tensor, "*B A 3"]  # x and y of the centre, metres, and heading, radians
    sizes: Float[Tensor, "... 2"]  # (B, A, 2), (A, 2) or (2,) length and width, metres
    colours: Float[Tensor, "... C"]  # (B, A, C), (A, C) or (C,)
    present: Bool[Tensor, "... A"] | None = None  # (B, A) or (A,); None: all are present
    # colours of the triangle on each box that shows its heading, in the shapes of `colours`; None:
    # no triangles
    heading_colours: Float[Tensor, "... C"] | None = None

    def to(
        self, device: torch.device | str | None = None, dtype: torch.dtype | None = None
    ) -> "OrientedBoxes":
        """Move the boxes to a device, or convert all but presence to a dtype."""
        tensors = {field.name: getattr(self, field.name) for field in fields(self)}
        moved = {
            name: tensor.to(device=device, dtype=None if name == "present" else dtype)
            for name, tensor in tensors.items()
            if tensor is not None
        }
        return replace(self, **moved)


@dataclass(frozen=True, eq=False)
class StackedBoxes:
    """The N boxes of all layers of B scenes, in paint order; shared values are given once."""

    poses: Float[Tensor, "B N 3"]
    sizes: Float[Tensor, "_ N 2"]  # (1, N, 2) where all scenes share them, else (B, N, 2)
    colours: Float[Tensor, "_ N K"]  # values in the K channels that a box is painted in
    triangle_colours: Float[Tensor, "_ N K"]  # any where it has no triangle
    present: Bool[Tensor, "B N"] | None  # None: all are present
    counts: tuple[int, ...]  # number of boxes in each layer
    has_triangles: tuple[bool, ...]  # whether the boxes of each layer have triangles


def stack_layers(layers: Sequence[OrientedBoxes]) -> StackedBoxes:
    """Stack one layer or more of the same scenes, the later over the earlier."""
    poses, sizes, colours, triangle_colours = (
        _stack([_broadcast(name, layer) for layer in layers])
        for name in ("poses", "sizes", "colours", "heading_colours")
    )
    present = None
    if any(layer.present is not None for layer in layers):
        present = _stack([_get_present(layer) for layer in layers])
    return StackedBoxes(
        poses,
        sizes,
        colours,
        triangle_colours,
        present,
        counts=tuple(layer.poses.shape[1] for layer in layers),
        has_triangles=tuple(layer.heading_colours is not None for layer in layers),
    )


def _stack(parts: list[Tensor]) -> Tensor:
    """Concatenate along the boxes; parts that all scenes share are expanded if others are not."""
    if len(parts) == 1:
        return parts[0]
    scenes = next((len(part) for part in parts if len(part) != 1), 1)
    if any(len(part) not in (1, scenes) or part.shape[2:] != parts[0].shape[2:] for part in parts):
        shapes = ", ".join(str(tuple(part.shape)) for part in parts)
        raise ValueError(
            f"layers have the shapes {shapes}; give all of them for the same views, with colours "
            "of the same channels"
        )
    return torch.cat([part.expand(scenes, *part.shape[1:]) for part in parts], dim=1)


def _get_present(layer: OrientedBoxes) -> Bool[Tensor, "B A"]:
    shape = layer.poses.shape[:2]
    if layer.present is None:
        return layer.poses.new_ones(shape, dtype=torch.bool)
    if layer.present.shape[-1:] != shape[1:] or layer.present.shape[:-1] not in ((), shape[:1]):
        raise ValueError(
            f"present has shape {tuple(layer.present.shape)}; expected (views, boxes) = "
            f"{tuple(shape)}"
        )
    return layer.present.expand(shape)


def _broadcast(name: str, layer: OrientedBoxes) -> Tensor:
    """Bring a tensor of a layer to (1 or B, A, channels)."""
    value: Tensor | None = getattr(layer, name)
    value = layer.colours if value is None else value
    scenes, count, _ = layer.poses.shape
    *leading, channels = value.shape
    if leading == [scenes, count]:
        return value
    rows = leading[0] if len(leading) == 2 else 1
    try:
        if rows in (1, scenes):
            return value.expand(rows, count, channels)
    except RuntimeError:
        pass
    raise ValueError(
        f"{name} has shape {tuple(value.shape)}; expected (views, boxes, {channels}) = "
        f"{(scenes, count, channels)}, or what broadcasts to it"
    )


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
    full = [_expand(layer) for layer in layers]
    tensors = {name: torch.cat([_pad(part[name], count) for part in full]) for name in full[0]}
    return OrientedBoxes(**tensors)


def _expand(layer: OrientedBoxes) -> dict[str, Tensor]:
    """Expand all tensors of a layer to (B, A, ...)."""
    names = [field.name for field in fields(layer) if getattr(layer, field.name) is not None]
    shape = layer.poses.shape[:2]
    expanded = {name: _broadcast(name, layer) for name in names if name != "present"}
    tensors = {name: value.expand(*shape, value.shape[-1]) for name, value in expanded.items()}
    return {**tensors, "present": _get_present(layer)}


def _pad(values: Tensor, count: int) -> Tensor:
    """Pad (B, A, ...) to `count` boxes, with zeros."""
    return F.pad(values, (0, 0) * (values.ndim - 2) + (0, count - values.shape[1]))
