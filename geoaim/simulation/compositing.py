"""Paint fragments over pictures by the over operator (Porter and Duff 1984), with gradients."""

from collections.abc import Iterator

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.autograd.function import once_differentiable

from geoaim.simulation.rasterization import Fragments


def composite(
    pixels: Float[Tensor, "C P"], fragments: Fragments, planes: int = 0
) -> Float[Tensor, "K P"]:
    """Paint fragments over pictures, one after the other.

    Args:
        pixels: (C, P) of all pictures, from `sample_ground`; changed in place if `planes` is 0.
        fragments: in paint order. Without planes their colours have C channels. With planes they
            have one, and pixel p of plane k has the index k P + p.
        planes: number of empty planes that are painted instead of the C channels.

    Returns:
        (C + planes, P): the given pixels, then the planes.
    """
    pixel, colour, alpha = fragments.pixel, fragments.colour, fragments.alpha
    return _Composite.apply(pixels, colour, alpha, pixel, planes)  # type: ignore[no-untyped-call]


class _Composite(torch.autograd.Function):
    """Paint in passes in which no pixel occurs twice; saves what each fragment is painted over."""

    @staticmethod
    def forward(ctx, pixels, colour, alpha, pixel, planes):  # type: ignore[no-untyped-def]
        if planes:
            ground, channels = pixels, len(pixels)
            pixels = ground.new_empty(channels + planes, ground.shape[1])
            pixels[:channels], pixels[channels:] = ground, 0
        else:
            ctx.mark_dirty(pixels)
        # a slice from -0 is the whole
        below, canvas = torch.empty_like(colour), pixels[-planes:].view(len(colour), -1)
        passes = list(_split_into_passes(pixel, canvas.shape[1]))
        for some in passes:
            index = pixel[some]
            below[:, some] = last = canvas[:, index]
            canvas[:, index] = colour[:, some] + (1 - alpha[some]) * last
        ctx.planes = planes
        ctx.save_for_backward(alpha, pixel, below, *passes)
        return pixels

    @staticmethod
    @once_differentiable
    def backward(ctx, *grads):  # type: ignore[no-untyped-def]
        alpha, pixel, below, *passes = ctx.saved_tensors
        painted = grads[0][-ctx.planes :].clone(memory_format=torch.contiguous_format)
        canvas, grad_colour = painted.view(len(below), -1), torch.empty_like(below)
        for some in reversed(passes):
            index = pixel[some]
            grad_colour[:, some] = grad = canvas[:, index]
            canvas[:, index] = (1 - alpha[some]) * grad
        grad_pixels = grads[0][: -ctx.planes] if ctx.planes else painted
        return grad_pixels, grad_colour, -(grad_colour * below).sum(0), None, None


def _split_into_passes(pixel: Int[Tensor, "n"], count: int) -> Iterator[Int[Tensor, "m"]]:
    """Split fragments, in paint order, into passes in which no pixel occurs twice."""
    left = torch.arange(len(pixel), device=pixel.device)
    first = torch.full((count,), len(pixel), device=pixel.device, dtype=torch.int32)
    while len(left):
        index = pixel[left]
        first.scatter_reduce_(0, index, left.int(), "amin")
        is_first = first[index] == left
        yield left[is_first]
        left = left[~is_first]
        first[pixel[left]] = len(pixel)
