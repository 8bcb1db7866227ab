"""Refuse what would give a wrong picture: shapes, dtypes and masks that do not match."""

from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from geoaim.base.errors import warn
from geoaim.simulation.boxes import OrientedBoxes
from geoaim.simulation.ground import Ground, View

DTYPES = (torch.float32, torch.float64)
MAX_FINENESS = 2.0  # a view with pixels so many times as large as the ground's aliases


def check_cameras(
    cameras: Float[Tensor, "*B 3"], ground: Ground, present: Bool[Tensor, "*B"] | None
) -> None:
    """Check cameras, the ground that they see, and the mask of those that exist.

    Args:
        cameras: (B, 3) or (B, A, 3) x and y, metres, and heading, radians.
        ground: one map for all views, or one for each of the B views or scenes.
        present: (B,) or (B, A); None: all exist.

    Raises:
        ValueError: shapes or dtypes do not match, or they are in half precision.
    """
    _check_dtypes(cameras.dtype, ground.image.dtype, ground.image_from_world.dtype)
    if cameras.dtype not in DTYPES:
        raise ValueError(
            f"tensors of {cameras.dtype}, in which positions are off by decimetres; give float32 "
            "or float64, and convert the pictures"
        )
    if cameras.ndim not in (2, 3) or cameras.shape[-1] != 3:
        raise ValueError(
            f"cameras have shape {tuple(cameras.shape)}; (B, 3), or (B, A, 3) of A views of each "
            "scene, of x, y and heading is needed"
        )
    views, maps = len(cameras), len(ground.regions)
    if maps not in (1, views):
        raise ValueError(
            f"the ground has {maps} maps for {views} views; choose one a view by `Ground.select`"
        )
    if present is not None:
        _check_mask(present)
        if present.shape != cameras.shape[:-1]:
            raise ValueError(
                f"present has shape {tuple(present.shape)} and cameras {tuple(cameras.shape)}; "
                "give one truth value for each camera"
            )


def warn_of_aliasing(view: View, ground: Ground) -> None:
    """Warn of a ground much finer than the view that was not averaged for it."""
    pixel = max(ground.finest, ground.averaged_over)
    if pixel < view.resolution / MAX_FINENESS:
        warn(
            f"the ground has pixels of {pixel:.3g} m and the view of {view.resolution:.3g} m, so "
            "that markings are hit or missed by chance; call prefilter_ground(ground, "
            "view.resolution) before"
        )


def check_layers(layers: Sequence[OrientedBoxes], cameras: Float[Tensor, "*B 3"]) -> None:
    """Check the layers of boxes that cameras see.

    Raises:
        ValueError: as by `check_cameras`.
    """
    for layer in layers:
        tensors = (layer.poses, layer.sizes, layer.colours, layer.heading_colours)
        _check_dtypes(cameras.dtype, *(tensor.dtype for tensor in tensors if tensor is not None))
        if len(layer.poses) != len(cameras):
            raise ValueError(
                f"boxes are given for {len(layer.poses)} views and {len(cameras)} cameras; one each"
            )
        shapes = tuple(layer.poses.shape), tuple(layer.sizes.shape)
        if layer.poses.ndim != 3 or (layer.poses.shape[-1], layer.sizes.shape[-1]) != (3, 2):
            raise ValueError(
                f"boxes have poses of shape {shapes[0]} and sizes of shape {shapes[1]}; (B, A, 3) "
                "of x, y and heading and (..., 2) of length and width are needed"
            )
        if layer.present is not None:
            _check_mask(layer.present)


def _check_dtypes(*dtypes: torch.dtype) -> None:
    if len(set(dtypes)) > 1:
        names = ", ".join(sorted(set(map(str, dtypes))))
        raise ValueError(f"tensors have dtypes {names}; convert them to one dtype")


def _check_mask(present: Tensor) -> None:
    if present.dtype != torch.bool:
        raise ValueError(f"present is a tensor of {present.dtype}; convert the mask by `.bool()`")


def check_traffic(
    states: Float[Tensor, "B N T 4"], **rest: tuple[Tensor, Sequence[str | int]]
) -> None:
    """Check tensors of agents against their states.

    Args:
        states: (B, N, T, 4).
        rest: each tensor, and its axes: "B", "N" and "T" as in the states, or numbers.

    Raises:
        ValueError: a tensor has another shape; the message names the argument.
    """
    if states.ndim != 4 or states.shape[-1] != 4:
        raise ValueError(
            f"states have the shape {tuple(states.shape)}; (B, N, T, 4) of segments, agents, steps "
            "and x, y, heading, speed is needed"
        )
    sides = dict(zip("BNT", states.shape[:3], strict=True))
    for name, (tensor, axes) in rest.items():
        shape = [axis if isinstance(axis, int) else sides[axis] for axis in axes]
        if tuple(tensor.shape) != tuple(shape):
            stated = ", ".join(map(str, axes))
            raise ValueError(
                f"{name} has the shape {tuple(tensor.shape)} and states {tuple(states.shape)}; "
                f"({stated}) = {tuple(shape)} is needed"
            )


def check_shape(name: str, tensor: Tensor, shape: Sequence[int]) -> None:
    """Check the shape of an argument.

    Args:
        name: the argument's name.
        tensor: the argument.
        shape: what is needed.

    Raises:
        ValueError: the tensor has another shape.
    """
    if tuple(tensor.shape) != tuple(shape):
        raise ValueError(f"{name} has the shape {tuple(tensor.shape)}; {tuple(shape)} is needed")
