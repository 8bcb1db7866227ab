"""Refuse what would give a wrong picture: shapes, dtypes and masks that do not match."""

from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from geoaim.base.errors import warn
from geoaim.rendering.boxes import OrientedBoxes
from geoaim.rendering.ground import Ground, View

DTYPES = (torch.float32, torch.float64)
MAX_FINENESS = 2.0  # a view with pixels so many times as large as the ground's aliases


def check_cameras(
    cameras: Float[Tensor, "*B 3"], ground: Ground, present: Bool[Tensor, "*B"] | None
) -> None:
    """Refuse cameras, a ground and a mask that do not fit each other, and half precision."""
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
    views, maps = cameras.shape[0], ground.regions.shape[0]
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
    """Refuse layers of boxes that do not fit the cameras that see them."""
    for layer in layers:
        tensors = (layer.poses, layer.sizes, layer.colours, layer.heading_colours)
        _check_dtypes(cameras.dtype, *(tensor.dtype for tensor in tensors if tensor is not None))
        if layer.poses.shape[0] != cameras.shape[0]:
            raise ValueError(
                f"boxes are given for {layer.poses.shape[0]} views and {cameras.shape[0]} cameras; "
                "one each"
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
