"""First derivatives that raise an error when they are differentiated again."""

from typing import Any

import torch
from torch import Tensor
from torch.autograd.forward_ad import unpack_dual


def refuse_forward_derivatives(tensors: tuple[Tensor, ...]) -> None:
    """Refuse tensors with tangents, which code outside of autograd would drop.

    Raises:
        RuntimeError: there are some.
    """
    if any(unpack_dual(tensor).tangent is not None for tensor in tensors):  # type: ignore[no-untyped-call]
        raise RuntimeError(
            "the renderer has no forward-mode derivatives, and some were asked for; take them by "
            "`backward`"
        )


def forbid_second_derivatives(
    grads: tuple[Tensor | None, ...], inputs: tuple[Tensor, ...]
) -> tuple[Tensor | None, ...]:
    """Make gradients that were computed outside of autograd raise if they are differentiated.

    Args:
        grads: gradients that a `backward` returns.
        inputs: tensors on which they depend.

    Returns:
        The same gradients.
    """
    if not torch.is_grad_enabled():  # they have no graph without `create_graph`
        return grads
    return tuple(None if grad is None else _FirstDerivative.apply(grad, *inputs) for grad in grads)  # type: ignore[no-untyped-call]


class _FirstDerivative(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, grad: Tensor, *inputs: Tensor) -> Tensor:
        return grad.view_as(grad)

    @staticmethod
    def backward(ctx: Any, *grads: Tensor) -> None:
        raise RuntimeError(
            "the renderer has first derivatives only, and a second one was asked for; take it by "
            "finite differences of the first"
        )
