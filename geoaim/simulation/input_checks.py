"""Refuse tensors of agents whose shapes do not match."""

from collections.abc import Sequence

from jaxtyping import Float
from torch import Tensor


def check_traffic(
    states: Float[Tensor, "B N T 4"], **rest: tuple[Tensor, Sequence[str | int]]
) -> None:
    """Check tensors of agents, each with its axes: "B", "N", "T" as in the states, or numbers.

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
    """Raise a ValueError that names an argument whose shape is another one than is needed."""
    if tuple(tensor.shape) != tuple(shape):
        raise ValueError(f"{name} has the shape {tuple(tensor.shape)}; {tuple(shape)} is needed")
