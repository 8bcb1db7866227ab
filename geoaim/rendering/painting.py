"""Paint boxes over pictures, with gradients.

What boxes contribute is computed by numpy on the CPU, since a call of torch takes longer than the
sums over a few boxes; the pictures stay on their device. Boxes of a layer that share a pixel are
mixed by their shares, so that nothing is sorted; layers are painted one after the other.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Int
from numpy import ndarray as Array
from torch import Tensor
from torch.autograd.function import once_differentiable

from geoaim.rendering.boxes import StackedBoxes
from geoaim.rendering.coverage import differentiate_triangles, measure_triangles
from geoaim.rendering.fragments import (
    Canvas,
    differentiate_boxes,
    differentiate_shares,
    find_boxes,
    measure_boxes,
    sum_by,
)


@dataclass(frozen=True, eq=False)
class Layer:
    """What was painted at once: m of the fragments, in K channels."""

    some: Any  # which fragments
    index: Int[Tensor, "Km"]  # place in the flat pictures
    room: Float[Array, "m"]  # by what shares were divided: their sum in the pixel, or 1
    below: Float[Array, "K m"]  # what they were painted over
    change: Float[Array, "K m"]  # by what they changed it


def paint_boxes(
    canvas: Canvas,
    boxes: StackedBoxes,
    pictures: Float[Tensor, "V C H W"],
    cameras: Float[Tensor, "V 3"],
) -> Float[Tensor, "V C H W"]:
    """Paint boxes over contiguous pictures, in place.

    Raises:
        ValueError: the pose of a present box is not finite, or its size is not positive.
    """
    if torch.is_grad_enabled():
        leaves = (cameras, boxes.poses, boxes.sizes, boxes.colours, boxes.triangle_colours)
        return _Paint.apply(canvas, boxes, pictures, *leaves)  # type: ignore[no-untyped-call]
    _Painting(canvas, boxes, pictures)
    return pictures


class _Paint(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, canvas: Any, boxes: Any, pictures: Any, *leaves: Any) -> Any:
        ctx.mark_dirty(pictures)
        ctx.painting = _Painting(canvas, boxes, pictures)
        return pictures

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Any) -> Any:
        painted = grad.clone(memory_format=torch.contiguous_format)
        grads = ctx.painting.differentiate(painted, ctx.needs_input_grad[3:])
        tensors = [None if a is None else torch.from_numpy(a).to(painted) for a in grads]
        return None, None, painted, *tensors


class _Painting:
    """Paints boxes over pictures, and keeps what the gradients need."""

    def __init__(self, canvas: Canvas, boxes: StackedBoxes, pictures: Tensor) -> None:
        self.canvas, self.stacked = canvas, boxes
        self.boxes = found = find_boxes(canvas, boxes)
        self.size, channels = canvas.view.height * canvas.view.width, pictures.shape[1]
        # channels from one picture to the next, and those that a box is painted in
        self.channels, first, numbers = channels, found.view, None
        if len(boxes.counts) > 1:
            numbers = np.repeat(np.arange(len(boxes.counts)), boxes.counts).take(found.column)
        if canvas.planes:
            self.channels, first = 1, channels * found.view + (channels - canvas.planes)
            first = first if numbers is None else first + numbers
        self.fragments = measure_boxes(canvas.view, found, first * self.size)
        self.half = found.half.take(self.fragments.box, axis=1)
        self.colours = found.take(boxes.colours.numpy(force=True))
        self.tips = None
        if any(boxes.has_triangles):
            self.tips = measure_triangles(self.fragments.x, self.half)
            self.changes = found.take(boxes.triangle_colours.numpy(force=True)) - self.colours
        parts: list[Any] = [slice(None)]
        if numbers is not None and not canvas.planes:
            of_fragments = numbers.take(self.fragments.box)
            parts = [np.flatnonzero(of_fragments == k) for k in range(len(boxes.counts))]
        self.layers = [self._paint_layer(pictures.view(-1), some) for some in parts]

    def _paint_layer(self, pictures: Float[Tensor, "p"], some: Any) -> Layer:
        """Paint fragments at once: mixed by their shares, which are divided by their sum over 1."""
        box, pixel, share = (
            values[some]
            for values in (self.fragments.box, self.fragments.pixel, self.fragments.share)
        )
        room = np.bincount(pixel, share).take(pixel)
        room = np.maximum(room, 1).astype(share.dtype)
        change = self.colours.take(box, axis=1)
        change *= share
        if self.tips is not None:
            change += self.changes.take(box, axis=1) * self.tips.share[some]
        if self.channels > 1:
            pixel = pixel + pixel // self.size * (self.size * (self.channels - 1))
            pixel = pixel + self.size * np.arange(self.channels)[:, None]
        index = torch.from_numpy(pixel.ravel()).to(pictures.device)
        below = pictures.index_select(0, index).numpy(force=True).reshape(change.shape)
        change -= share * below
        change /= room
        pictures.index_add_(0, index, torch.from_numpy(change.ravel()).to(pictures.device))
        return Layer(some, index, room, below, change)

    def differentiate(self, painted: Tensor, needed: tuple[bool, ...]) -> list[Array | None]:
        """Turn the gradient by the pictures into that by what was below, in place.

        Args:
            painted: (V, C, H, W) gradient by the pictures.
            needed: which of the other gradients are needed.

        Returns:
            The gradients by cameras, poses, sizes, colours and colours of triangles.
        """
        boxes, stacked, fragments = self.boxes, self.stacked, self.fragments
        shares, tips = np.empty_like(fragments.share), np.empty_like(fragments.share)
        shape = 2, len(self.colours), len(boxes.view)
        colours = np.zeros(shape, fragments.share.dtype)
        for layer in reversed(self.layers):
            some = layer.some
            grad, shares[some] = self._differentiate_layer(painted.view(-1), layer)
            box = fragments.box[some]
            if any(needed[3:]):
                colours[0] += sum_by(box, grad * fragments.share[some], shape[2])
            if self.tips is not None:
                tips[some] = (grad * self.changes.take(box, axis=1)).sum(axis=0)
                if any(needed[3:]):
                    colours[1] += sum_by(box, grad * self.tips.share[some], shape[2])
        by_x, by_half = differentiate_shares(fragments, self.half, shares)
        if self.tips is not None:
            more = differentiate_triangles(fragments.x, self.half, self.tips, tips)
            by_x, by_half = by_x + more[0], by_half + more[1]
            colours[0] -= colours[1]
        grads: list[Any] = [None] * 5
        cameras, poses = differentiate_boxes(self.canvas, boxes, fragments, by_x)
        if needed[0]:
            grads[0] = sum_by(boxes.view, cameras, len(self.canvas.cameras)).T
        if needed[1]:
            grads[1] = boxes.scatter(poses, stacked.poses.shape)
        if needed[2]:
            sizes = sum_by(fragments.box, by_half, shape[2]) / (2 * self.canvas.view.resolution)
            grads[2] = boxes.scatter(sizes, stacked.sizes.shape)
        if needed[3]:
            grads[3] = boxes.scatter(colours[0], stacked.colours.shape)
        if needed[4]:
            grads[4] = boxes.scatter(colours[1], stacked.triangle_colours.shape)
        return grads

    def _differentiate_layer(
        self, painted: Float[Tensor, "p"], layer: Layer
    ) -> tuple[Float[Array, "K m"], Float[Array, "m"]]:
        """Compute the gradients by what fragments painted, over `room`, and by their shares."""
        box, pixel, share = (
            values[layer.some]
            for values in (self.fragments.box, self.fragments.pixel, self.fragments.share)
        )
        grad = painted.index_select(0, layer.index).numpy(force=True).reshape(layer.below.shape)
        grad = grad / layer.room
        shares = (grad * (self.colours.take(box, axis=1) - layer.below)).sum(axis=0)
        full = np.bincount(pixel, (grad * layer.change).sum(axis=0)).take(pixel)
        shares -= np.where(layer.room > 1, full, 0)
        below = torch.from_numpy((grad * -share).ravel()).to(painted.device)
        painted.index_add_(0, layer.index, below)
        return grad, shares
