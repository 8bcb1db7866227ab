"""The background: an image of the ground without traffic."""

from dataclasses import dataclass

from jaxtyping import Bool, Float, UInt8, UInt16
from numpy import ndarray as Array


@dataclass(frozen=True, eq=False)
class Background:
    """An image of the ground, and how many frames it rests on.

    Attributes:
        image: (H, W, 3) RGB at the first frame's exposure; 0 where no frame reaches.
        coverage: (H, W) number of frames averaged at each pixel; 0 where none shows the ground.
        contested: (H, W) the ground is in doubt: masked in every frame (the image then shows the
            mean with traffic, and coverage is 0), or two lasting states were seen.
        frames_used: frames that were read and averaged.
        change: grey levels by which the latter half of the frames changed the image: the 99.9 %
            quantile over blocks of 8 x 8 pixels. NaN with fewer than 32 frames, and from
            `remove_traffic` without a tolerance.
        gains: (frames_used,) factors that bring each frame to the exposure of the first.
    """

    image: UInt8[Array, "H W 3"]
    coverage: UInt16[Array, "H W"]
    contested: Bool[Array, "H W"]
    frames_used: int
    change: float
    gains: Float[Array, "frames_used"]
