"""Car following by the intelligent driver model (Treiber, Hennecke, Helbing 2000).

    dv/dt = a [1 - (v / v0)^4 - (s* / s)^2],    s* = s0 + max(0, v T + v dv / (2 sqrt(a b)))

v is the speed, v0 the desired one, s the gap to the leader and dv the speed at which it closes.
This file computes s* / s, for numpy arrays and torch tensors alike; `simulation/idm.py` computes
the acceleration from it.
"""

import math
from dataclasses import dataclass
from typing import Any

MIN_GAP_M = 0.1  # smaller gaps count as this one, so that no driver divides by zero
ArrayOrTensor = Any  # numpy.ndarray or torch.Tensor; torch must not be imported here


@dataclass(frozen=True)
class DriverParameters:
    """How a driver follows others.

    The simulator's values are `DRIVER` in `simulation/idm.py`.
    """

    acceleration: float  # a, the maximum, m/s²
    deceleration: float  # b, the comfortable one, m/s²
    standstill_gap: float  # s0, metres
    headway: ArrayOrTensor | float  # T, seconds; of all drivers, or (...) of each


def compute_gap_ratio(
    driver: DriverParameters, speed: ArrayOrTensor, closing_speed: ArrayOrTensor, gap: ArrayOrTensor
) -> ArrayOrTensor:
    """Compute the ratio of the gap that a driver desires to the actual gap, s* / s.

    Args:
        driver: its parameters.
        speed: (...) the driver's speed, m/s.
        closing_speed: (...) its speed minus that of the leader, m/s.
        gap: (...) gap to the leader, metres; infinite where there is none. Gaps below `MIN_GAP_M`
            count as `MIN_GAP_M`.

    Returns:
        (...) the ratio; its square times the maximum acceleration is the braking term. Arguments
        are broadcast.
    """
    approach = speed * closing_speed / (2 * math.sqrt(driver.acceleration * driver.deceleration))
    desired = driver.standstill_gap + (speed * driver.headway + approach).clip(0)
    return desired / gap.clip(MIN_GAP_M)
