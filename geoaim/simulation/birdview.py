"""Bird's-eye pictures of an image map with boxes on it, in batches, differentiable.

A top-down scene needs one textured plane and boxes in a fixed paint order: no depth, no lighting.
All views of one texture are one `grid_sample`. A box is evaluated only at the pixels that it
touches, whose coverage is exact, so that gradients by its pose and size are exact as well.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor
from torch.autograd.function import once_differentiable

from geoaim.simulation.coverage import pixel_coverage
from geoaim.simulation.ground import Ground, View, ground_seen, unfolded

RIM = 0.71  # px: further from all edges than half a pixel's diagonal, a pixel is in or out
NOSE = 0.35  # of the length that the direction's triangle takes


@dataclass(frozen=True, eq=False)
class Boxes:
    """Oriented boxes of B views; later ones are painted over earlier ones.

    Attributes:
        poses: (B, A, 3) middle x and y, metres, and heading, radians.
        sizes: (B, A, 2) or (A, 2) length and width, metres.
        colours: (B, A, C) or (A, C).
        present: (B, A); None: all are.
        noses: colours of triangles that show the direction; None: there are none.
    """

    poses: Float[Tensor, "B A 3"]
    sizes: Float[Tensor, "... A 2"]
    colours: Float[Tensor, "... A C"]
    present: Bool[Tensor, "B A"] | None = None
    noses: Float[Tensor, "... A C"] | None = None


def render(
    view: View, cameras: Float[Tensor, "B 3"], ground: Ground, boxes: Sequence[Boxes] = ()
) -> Float[Tensor, "B C H W"]:
    """Pictures of all cameras.

    Args:
        view: size and resolution of each picture.
        cameras: x and y, metres, and heading, radians, of each.
        ground: what lies below, from `make_ground`; by `fit_ground` where it is finer.
        boxes: agents, lights: painted in this order.

    Returns:
        Colours. Gradients exist by cameras, poses, sizes, colours and the ground's image.

    Raises:
        ValueError: shapes do not match, a pose that is present is not finite, or a size is not
            positive.

    >>> from geoaim.simulation.ground import make_ground
    >>> ground = make_ground(torch.zeros(1, 4, 4), torch.eye(3)[:2])
    >>> car = Boxes(torch.zeros(1, 1, 3), torch.tensor([[2.0, 1.0]]), torch.ones(1, 1))
    >>> picture = render(View(4, 4, 1.0), torch.zeros(1, 3), ground, [car])
    >>> picture[0, 0, :, 1].tolist()
    [0.0, 0.5, 0.75, 0.5]
    """
    _check(cameras, ground, boxes)
    for layer in boxes:
        for colours in (layer.colours, layer.noses):
            if colours is not None and colours.shape[-1] != len(ground.image):
                found = colours.shape[-1]
                raise ValueError(f"colours of {found} channels on a ground of {len(ground.image)}")
    flat = ground_seen(view, cameras, ground.image, ground.image_from_world)
    if boxes:
        flat = _paint(flat, view, _laid(view, cameras, boxes))
    return unfolded(flat, view, cameras)


def render_layers(
    view: View, cameras: Float[Tensor, "B 3"], ground: Ground, boxes: Sequence[Boxes] = ()
) -> Float[Tensor, "B K H W"]:
    """Channels for models: the ground's colours, then a plane for each layer of boxes.

    A plane is 1 where a box is, and one half in the triangles that show directions; colours of
    boxes play no part. Otherwise as `render`.

    >>> from geoaim.simulation.ground import make_ground
    >>> ground = make_ground(torch.zeros(3, 4, 4), torch.eye(3)[:2])
    >>> car = Boxes(torch.zeros(1, 1, 3), torch.tensor([[2.0, 1.0]]), torch.ones(1, 3))
    >>> render_layers(View(4, 4, 1.0), torch.zeros(1, 3), ground, [car, car]).shape
    torch.Size([1, 5, 4, 4])
    """
    _check(cameras, ground, boxes)
    flat = ground_seen(view, cameras, ground.image, ground.image_from_world)
    if boxes:
        planes = [_plain(layer) for layer in boxes]
        flat = _paint(flat, view, _laid(view, cameras, planes, apart=True), len(boxes))
    return unfolded(flat, view, cameras)


@dataclass(frozen=True, eq=False)
class _Flat:
    """Boxes that are there, of all pictures, in paint order and in pixels.

    Attributes:
        picture: whose each is.
        middle: columns and rows.
        axis: ahead, right and down.
        sizes: length and width.
        colours: of boxes.
        noses: of triangles; of the box itself where it has none.
        pointed: whether it has one.
    """

    picture: Int[Tensor, "N"]
    middle: Float[Tensor, "N 2"]
    axis: Float[Tensor, "N 2"]
    sizes: Float[Tensor, "N 2"]
    colours: Float[Tensor, "N C"]
    noses: Float[Tensor, "N C"]
    pointed: Bool[Tensor, "N"]


def _plain(layer: Boxes) -> Boxes:
    """For a plane: 1, and one half in triangles."""
    one = torch.ones_like(layer.poses[..., :1])
    return replace(layer, colours=one, noses=None if layer.noses is None else one / 2)


def _laid(
    view: View, cameras: Float[Tensor, "B 3"], layers: Sequence[Boxes], *, apart: bool = False
) -> _Flat:
    """All boxes that are there, picture by picture, in each layer over layer.

    What absent ones hold reaches no gradient.

    Args:
        view: its size and resolution.
        cameras: of the pictures.
        layers: in paint order.
        apart: whether each layer has pictures of its own, which come after the last one's.

    Raises:
        ValueError: a pose is not finite, or a size is not positive.
    """
    views = len(cameras)
    there = [
        layer.poses.new_ones(layer.poses.shape[:2], dtype=torch.bool)
        if layer.present is None
        else layer.present
        for layer in layers
    ]
    present = torch.cat(there, dim=1)
    camera, column = present.nonzero().unbind(1)
    where = camera * present.shape[1] + column

    def chosen(values: Iterable[Float[Tensor, "... A C"]]) -> Float[Tensor, "N C"]:
        every = torch.cat([value.expand(views, *value.shape[-2:]) for value in values], dim=1)
        return every.flatten(0, 1).index_select(0, where)

    poses, sizes = chosen(layer.poses for layer in layers), chosen(layer.sizes for layer in layers)
    if not (torch.isfinite(torch.cat([poses, sizes], dim=1)).all() and (sizes > 0).all()):
        raise ValueError(
            "a box that is present has a pose that is not finite, or a size that is not "
            "a positive number; mask absent ones by `present`"
        )
    middle, axis = _in_pixels(view, cameras.index_select(0, camera), poses)
    counts = torch.tensor([layer.poses.shape[1] for layer in layers], device=where.device)
    layer_of = torch.repeat_interleave(counts)[column]
    pointed = torch.tensor([layer.noses is not None for layer in layers], device=where.device)
    return _Flat(
        picture=camera + views * layer_of if apart else camera,
        middle=middle,
        axis=axis,
        sizes=sizes / view.resolution,
        colours=chosen(layer.colours for layer in layers),
        noses=chosen(layer.colours if layer.noses is None else layer.noses for layer in layers),
        pointed=pointed[layer_of],
    )


def _paint(
    flat: Float[Tensor, "C P"], view: View, boxes: _Flat, planes: int = 0
) -> Float[Tensor, "K P"]:
    """The pictures with boxes laid over them, in place; or over so many empty planes after them."""
    middle, axis, sizes = boxes.middle, boxes.axis, boxes.sizes
    with torch.no_grad():
        owner, place = _touched(view, middle, axis, sizes)
        rim, front = _near_edges(owner, place, middle, axis, sizes)
        front &= boxes.pointed[owner]
        column, row = place.unbind(1)
        pixel = (boxes.picture[owner] * view.height + row) * view.width + column
        place = place.to(middle)
    side = torch.stack([axis[:, 1], -axis[:, 0]], dim=1)
    ahead, aside = sizes[:, :1] / 2 * axis, sizes[:, 1:] / 2 * side
    ring = torch.stack([ahead + aside, ahead - aside, -ahead - aside, aside - ahead], 1)
    # triangles are squares with a corner twice, so that all polygons are measured in one go
    base = (1 - 2 * NOSE) * ahead
    tip = torch.stack([ahead, ahead, base - aside, base + aside], dim=1)
    edges, noses = rim.nonzero()[:, 0], front.nonzero()[:, 0]
    corners = (torch.cat([ring, tip]) + middle.repeat(2, 1)[:, None]).flatten(1)
    polygons = corners.index_select(0, torch.cat([owner[edges], owner[noses] + len(middle)]))
    polygons = polygons - place.index_select(0, torch.cat([edges, noses])).repeat(1, 4)
    shares = pixel_coverage(polygons.view(-1, 4, 2))
    alpha = place.new_ones(len(owner)).index_copy(0, edges, shares[: len(edges)])
    change = (boxes.noses - boxes.colours).t()[:, owner[noses]]
    light = (alpha * boxes.colours.t()[:, owner]).index_add(1, noses, shares[len(edges) :] * change)
    return _Over.apply(flat, light, alpha, pixel, planes)  # type: ignore[no-untyped-call]


class _Over(torch.autograd.Function):
    """Fragments laid over the pictures, in place, or over empty planes that come after them.

    The gradient needs one copy of what they are laid over.
    """

    @staticmethod
    def forward(ctx, flat, light, alpha, pixel, planes):  # type: ignore[no-untyped-def]
        if planes:
            ground, count = flat, len(flat)
            flat = ground.new_empty(count + planes, ground.shape[1])
            flat[:count], flat[count:] = ground, 0
        else:
            ctx.mark_dirty(flat)
        # from -0 on is all of it
        below, canvas = torch.empty_like(light), flat[-planes:].view(len(light), -1)
        turns = list(_turns(pixel, canvas.shape[1]))
        for turn in turns:
            here = pixel[turn]
            below[:, turn] = seen = canvas[:, here]
            canvas[:, here] = light[:, turn] + (1 - alpha[turn]) * seen
        ctx.planes = planes
        ctx.save_for_backward(alpha, pixel, below, *turns)
        return flat

    @staticmethod
    @once_differentiable
    def backward(ctx, *grads):  # type: ignore[no-untyped-def]
        alpha, pixel, below, *turns = ctx.saved_tensors
        changed = grads[0][-ctx.planes :].clone(memory_format=torch.contiguous_format)
        canvas, of_light = changed.view(len(below), -1), torch.empty_like(below)
        for turn in reversed(turns):
            here = pixel[turn]
            of_light[:, turn] = grad = canvas[:, here]
            canvas[:, here] = (1 - alpha[turn]) * grad
        of_flat = grads[0][: -ctx.planes] if ctx.planes else changed
        return of_flat, of_light, -(of_light * below).sum(0), None, None


def _in_pixels(
    view: View, cameras: Float[Tensor, "N 3"], poses: Float[Tensor, "N 3"]
) -> tuple[Float[Tensor, "N 2"], Float[Tensor, "N 2"]]:
    """Middles in pixels of the views, and directions there (right, down)."""
    x, y, turn = (poses - cameras).unbind(1)
    cosine, sine = cameras[:, 2].cos(), cameras[:, 2].sin()
    u = view.width / 2 + (x * sine - y * cosine) / view.resolution
    v = view.height / 2 - (x * cosine + y * sine) / view.resolution
    return torch.stack([u, v], dim=1), torch.stack([-turn.sin(), -turn.cos()], dim=1)


def _touched(
    view: View,
    middle: Float[Tensor, "N 2"],
    axis: Float[Tensor, "N 2"],
    sizes: Float[Tensor, "N 2"],
) -> tuple[Int[Tensor, "n"], Int[Tensor, "n 2"]]:
    """Pixels in or near each box, row by row: whose they are, and their columns and rows."""
    half = sizes / 2 + RIM
    v, reach = middle[:, 1], (axis.abs().flip(1) * half).sum(1)
    top, bottom = _span(v - reach, v + reach, view.height)
    box, row = _expanded((bottom - top).clamp_min(0), top)
    u, v, right, down, long, wide = torch.cat([middle, axis, half], dim=1)[box].unbind(1)
    y = row + 0.5 - v
    ends = []
    for slope, shift, most in ((right, y * down, long), (down, -y * right, wide)):
        safe = torch.where(slope.abs() < 1e-6, 1e-6, slope)  # |x * slope + shift| is at most `most`
        ends.append(torch.stack([(-most - shift) / safe, (most - shift) / safe]).sort(0).values)
    (low, high), (left, far) = ends
    first, last = _span(u + torch.maximum(low, left), u + torch.minimum(high, far), view.width)
    line, column = _expanded((last - first).clamp_min(0), first)
    return box[line], torch.stack([column, row[line]], dim=1)


def _span(low: Float[Tensor, "n"], high: Float[Tensor, "n"], count: int) -> tuple[Tensor, Tensor]:
    """The first pixel whose middle lies between, and the one after the last."""
    first, last = (low - 0.5).ceil().clamp(0, count), (high + 0.5).floor().clamp(0, count)
    return first.long(), last.long()


def _expanded(counts: Int[Tensor, "N"], first: Int[Tensor, "N"]) -> tuple[Tensor, Tensor]:
    """So many numbers for each, from its first on; and whose they are."""
    owner = torch.repeat_interleave(counts)
    start = first - (counts.cumsum(0) - counts)
    return owner, torch.arange(len(owner), device=owner.device) + start[owner]


def _near_edges(
    owner: Int[Tensor, "n"],
    place: Int[Tensor, "n 2"],
    middle: Float[Tensor, "N 2"],
    axis: Float[Tensor, "N 2"],
    sizes: Float[Tensor, "N 2"],
) -> tuple[Bool[Tensor, "n"], Bool[Tensor, "n"]]:
    """In which pixels an edge of the box may pass, and in which the triangle may lie."""
    table = torch.cat([middle - 0.5, axis, sizes / 2], dim=1)[owner]
    u, v, right, down, length, width = table.unbind(1)
    x, y = place[:, 0] - u, place[:, 1] - v
    along = x * right + y * down
    inside = torch.minimum(length - along.abs(), width - (x * down - y * right).abs())
    return inside < RIM, along > (1 - 2 * NOSE) * length - RIM


def _turns(pixel: Int[Tensor, "n"], pixels: int) -> Iterator[Int[Tensor, "m"]]:
    """Fragments in paint order, so many at once that no pixel comes twice in a turn."""
    left = torch.arange(len(pixel), device=pixel.device)
    first = torch.full((pixels,), len(pixel), device=pixel.device, dtype=torch.int32)
    while len(left):
        here = pixel[left]
        first.scatter_reduce_(0, here, left.int(), "amin")
        mine = first[here] == left
        yield left[mine]
        left = left[~mine]
        first[pixel[left]] = len(pixel)


def _check(cameras: Float[Tensor, "B 3"], ground: Ground, boxes: Sequence[Boxes]) -> None:
    """Refuse what would give a wrong picture."""
    kinds = {cameras.dtype, ground.image.dtype, ground.image_from_world.dtype}
    for layer in boxes:
        kinds |= {layer.poses.dtype, layer.sizes.dtype, layer.colours.dtype}
    if len(kinds) > 1:
        names = ", ".join(sorted(map(str, kinds)))
        raise ValueError(f"numbers of {names} in one picture; bring all to one of them")
    if not torch.isfinite(cameras).all():
        raise ValueError("a camera's pose is not finite")
    for layer in boxes:
        views, count = layer.poses.shape[:2]
        if views != len(cameras):
            raise ValueError(f"boxes of {views} views for {len(cameras)} cameras")
        shapes = {
            "sizes": layer.sizes.shape[:-1],
            "colours": layer.colours.shape[:-1],
            "present": (views, count) if layer.present is None else layer.present.shape,
            "noses": (count,) if layer.noses is None else layer.noses.shape[:-1],
        }
        for name, shape in shapes.items():
            if tuple(shape) not in ((views, count), (count,)[: name != "present"]):
                raise ValueError(
                    f"{name} for {tuple(shape)} boxes, where {views} views have {count} each"
                )
