"""How far imagery is expected to be off."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Prior:
    """The largest expected error of the imagery's position.

    Raises:
        ValueError: the shift is not positive, the rotation is beyond pi, or the scaling beyond 0.5.
    """

    max_shift: float = 15.0  # metres
    max_rotation: float = float(np.radians(5))  # radians
    max_scaling: float = 0.05  # change of scale as a share: 0.05 is 5 %

    def __post_init__(self) -> None:
        if not (
            0 < self.max_shift < np.inf
            and 0 <= self.max_rotation <= np.pi
            and 0 <= self.max_scaling <= 0.5
        ):
            raise ValueError(
                f"{self}: a shift of some metres, a rotation of 0 to pi radians and a scaling of 0 "
                "to 0.5 are needed"
            )


DEFAULT_PRIOR = Prior()
