"""Draw by the compiled loops: tensors to arrays, views among threads, gradients to autograd."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise, repeat
from typing import Any, TypeVar

import numpy as np
import torch
from jaxtyping import Float
from numpy import ndarray as Array
from torch import Tensor

from geoaim.simulation.boxes import StackedBoxes
from geoaim.simulation.derivatives import forbid_second_derivatives, refuse_forward_derivatives
from geoaim.simulation.drawing import BAD_BOX, Drawing
from geoaim.simulation.kernel.arrays import Boxes, Gradients, PaintedFragments, Textures, Views
from geoaim.simulation.kernel.gradients import differentiate_views
from geoaim.simulation.kernel.painting import BOX_PROBLEM, CAMERA_PROBLEM, MAP_PROBLEM, paint_views
from geoaim.simulation.sampling import BAD_CAMERA

# pixels of a thread's pictures; for fewer, another thread costs more than it saves
MIN_THREAD_PIXELS = 100_000
Result = TypeVar("Result")
MESSAGES = {
    CAMERA_PROBLEM: BAD_CAMERA,
    BOX_PROBLEM: BAD_BOX,
    MAP_PROBLEM: (
        "the ground's image_from_world is not finite, or its regions lie beyond its image; make it "
        "by `make_ground`"
    ),
}
NONE = np.empty((1, 0), bool)


def draw_with_kernel(drawing: Drawing, boxes: StackedBoxes | None) -> Float[Tensor, "V C H W"]:
    """Draw all views, and the boxes of their scenes, by the compiled loops, on CPUs.

    Raises:
        ValueError: the pose of a camera or of a present box is not finite, or a box's size is not
            positive.
    """
    ground, cameras = drawing.ground, drawing.cameras.reshape(-1, 3)
    if boxes is None:
        boxes = _make_no_boxes(drawing)
    of_boxes = boxes.poses, boxes.sizes, boxes.colours, boxes.triangle_colours
    tensors = cameras, ground.image_from_world, ground.image, *of_boxes
    refuse_forward_derivatives(tensors)
    if torch.is_grad_enabled() and any(tensor.requires_grad for tensor in tensors):
        return _Draw.apply(drawing, boxes, *tensors)  # type: ignore[no-untyped-call]
    return _paint(_make_job(drawing, boxes, tensors), drawing, keep=False)[0]


def _make_no_boxes(drawing: Drawing) -> StackedBoxes:
    empty = drawing.cameras.new_zeros(len(drawing.cameras), 0, 3)
    return StackedBoxes(empty, empty[..., :2], empty, empty, None, (), ())


@dataclass(frozen=True, eq=False)
class _Job:
    """What the loops are given."""

    views: Views
    textures: Textures
    boxes: Boxes
    parts: tuple[tuple[int, int], ...]  # first and last view of each thread


class _Draw(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, drawing: Drawing, boxes: StackedBoxes, *tensors: Tensor) -> Tensor:
        job = _make_job(drawing, boxes, tensors)
        pictures, fragments = _paint(job, drawing, keep=True)
        ctx.job, ctx.fragments = job, fragments
        ctx.save_for_backward(*tensors)
        return pictures

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        job, tensors = ctx.job, ctx.saved_tensors
        pictures = grads[0].detach().contiguous().numpy()
        wanted = ctx.needs_input_grad[2:]
        by_camera, by_place, by_image, *_ = wanted
        ground = by_camera or by_place or by_image
        results = _make_gradients(job, pictures, ground=ground, image=by_image)

        def differentiate(part: tuple[int, int], fragments: PaintedFragments) -> None:
            given = job.views, job.textures, job.boxes, fragments
            differentiate_views(*given, results, part)

        if by_image:  # all views add to one array
            list(map(differentiate, job.parts, ctx.fragments))
        else:
            _run(differentiate, job.parts, ctx.fragments)
        sums: list[Tensor | None] = [
            _sum_views(grad, tensor) if needed and grad is not results.image else None
            for grad, tensor, needed in zip(results[1:], tensors, wanted, strict=True)
        ]
        if by_image:
            sums[2] = torch.from_numpy(results.image).permute(2, 0, 1)
        return None, None, *forbid_second_derivatives(tuple(sums), (grads[0], *tensors))


def _paint(job: _Job, drawing: Drawing, *, keep: bool) -> tuple[Tensor, list[PaintedFragments]]:
    """Paint all views; returns their pictures, and the fragments of each part if they are kept."""
    view, count = drawing.view, len(job.views.cameras)
    channels = job.textures.image.shape[2] + drawing.planes
    pictures = drawing.cameras.new_empty(count, channels, view.height, view.width)
    canvas = pictures.numpy()

    def paint(part: tuple[int, int]) -> PaintedFragments:
        return paint_views(job.views, job.textures, job.boxes, canvas, part, keep)

    fragments = _run(paint, job.parts)
    for painted in fragments:
        if painted.starts[0] < 0:
            raise ValueError(MESSAGES[int(painted.starts[0])])
    return pictures, fragments


def _make_job(drawing: Drawing, boxes: StackedBoxes, tensors: tuple[Tensor, ...]) -> _Job:
    """Convert what is drawn to arrays."""
    cameras, matrices, image, *of_boxes = (
        (x.detach() if x.requires_grad else x).numpy() for x in tensors
    )
    poses, sizes, colours, triangle_colours = map(np.ascontiguousarray, of_boxes)
    count, scenes = len(cameras), len(drawing.cameras)
    present = NONE if boxes.present is None else np.ascontiguousarray(boxes.present.numpy())
    planes = range(len(image), len(image) + drawing.planes) if drawing.planes else repeat(0)
    layers = np.array([*zip(boxes.counts, boxes.has_triangles, planes, strict=False)], np.int64)
    exists = NONE[0]
    if drawing.present is not None:  # copied, since the caller may change it before `backward`
        exists = drawing.present.reshape(-1).numpy().copy()
    threads = 1
    pixels = drawing.view.height * drawing.view.width * count
    if pixels >= 2 * MIN_THREAD_PIXELS:
        threads = min(torch.get_num_threads(), count, pixels // MIN_THREAD_PIXELS)
    ends = [count * k // threads for k in range(threads + 1)]
    return _Job(
        Views(np.ascontiguousarray(cameras), exists, scenes, float(drawing.view.resolution)),
        Textures(
            np.ascontiguousarray(image.transpose(1, 2, 0)),
            np.ascontiguousarray(matrices),
            drawing.ground.regions.numpy(),
        ),
        Boxes(poses, sizes, colours, triangle_colours, present, layers.reshape(-1, 3)),
        tuple(pairwise(ends)),
    )


def _run(function: Callable[..., Result], *parts: Sequence[Any]) -> list[Result]:
    """Call a function for each part, in a thread each; the loops free the interpreter's lock."""
    if len(parts[0]) == 1:
        return [function(*(part[0] for part in parts))]
    with ThreadPoolExecutor(len(parts[0])) as pool:
        return list(pool.map(function, *parts))


def _make_gradients(job: _Job, pictures: Array, *, ground: bool, image: bool) -> Gradients:
    """Make zeros to add gradients to; arrays for the ground are empty if they are not needed."""
    views, count = len(job.views.cameras), job.boxes.poses.shape[1]
    channels, texture = job.boxes.colours.shape[2], job.textures.image
    return Gradients(
        pictures,
        np.zeros((views, 3)),
        np.zeros((views if ground else 0, 2, 3)),
        np.zeros(texture.shape if image else (0, *texture.shape[1:]), texture.dtype),
        np.zeros((views, count, 3)),
        np.zeros((views, count, 2)),
        np.zeros((views, count, channels)),
        np.zeros((views, count, channels)),
    )


def _sum_views(grad: Array, tensor: Tensor) -> Tensor:
    """Sum a gradient (V, ...) over the views that share each row of a tensor."""
    result = torch.from_numpy(grad)
    if len(tensor) != len(grad):
        views = len(grad) // len(tensor)
        result = result.view(len(tensor), views, *tensor.shape[1:]).sum(dim=1)
    return result.to(tensor.dtype)
