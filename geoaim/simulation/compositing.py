"""Paint fragments over pictures by the over operator (Porter and Duff 1984), with gradients."""

from typing import Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from geoaim.simulation.derivatives import forbid_second_derivatives
from geoaim.simulation.rasterization import Fragments


def composite(pictures: Float[Tensor, "V C H W"], fragments: Fragments) -> Float[Tensor, "V C H W"]:
    """Paint fragments over pictures, one after the other.

    Args:
        pictures: (V, C, H, W), contiguous; changed in place.
        fragments: the fragments to paint, in paint order.

    Returns:
        The pictures.
    """
    stride = pictures.shape[2:].numel()
    channels = torch.arange(len(fragments.colour), device=pictures.device)[:, None]
    index = fragments.pixel + stride * channels  # (K, n) indices into the flat pictures
    return _Composite.apply(pictures, fragments.colour, fragments.alpha, index)  # type: ignore[no-untyped-call]


class _Composite(torch.autograd.Function):
    """Paint in passes in which no pixel occurs twice; saves what each fragment is painted over."""

    @staticmethod
    def forward(ctx: Any, pictures: Tensor, colour: Tensor, alpha: Tensor, index: Tensor) -> Tensor:
        ctx.mark_dirty(pictures)
        canvas, below = pictures.view(-1), torch.empty_like(colour)
        passes = _split_into_passes(index[0])
        for some in passes:
            place = index[:, some]
            below[:, some] = last = canvas[place]
            canvas[place] = colour[:, some] + (1 - alpha[some]) * last
        ctx.save_for_backward(colour, alpha, index, below, *passes)
        return pictures

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        colour, alpha, index, below, *passes = ctx.saved_tensors
        with torch.no_grad():
            painted = grads[0].clone(memory_format=torch.contiguous_format)
            canvas, grad_colour = painted.view(-1), torch.empty_like(below)
            for some in reversed(passes):
                place = index[:, some]
                grad_colour[:, some] = grad = canvas[place]
                canvas[place] = (1 - alpha[some]) * grad
            grad_alpha = -(grad_colour * below).sum(0)
        inputs = grads[0], colour, alpha
        return forbid_second_derivatives((painted, grad_colour, grad_alpha, None), inputs)


def _split_into_passes(pixel: Int[Tensor, "n"]) -> list[Int[Tensor, "m"]]:
    """Split fragments, in paint order, into passes in which no pixel occurs twice.

    >>> [some.tolist() for some in _split_into_passes(torch.tensor([7, 5, 7, 7, 5]))]
    [[1, 0], [4, 2], [3]]
    """
    if len(pixel) == 0:
        return []
    order = pixel.argsort(stable=True)
    _, counts = torch.unique_consecutive(pixel[order], return_counts=True)
    starts = torch.repeat_interleave(counts.cumsum(0) - counts, counts)
    depth = torch.arange(len(pixel), device=pixel.device) - starts
    by_depth = depth.argsort(stable=True)
    return list(torch.split(order[by_depth], depth.bincount().tolist()))
