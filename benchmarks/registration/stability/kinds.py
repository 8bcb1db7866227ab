"""Kinds of disturbance, each with levels from harmless to hopeless.

Lengths in pixels are for frames 960 px wide, and grow with the width.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

Pattern = Literal["", "parking", "panels", "tiles"]


@dataclass(frozen=True)
class Disturbance:
    """What makes a clip hard; the defaults are an easy clip."""

    # share of the ground under vehicles that move together, each in its own place
    traffic: float = 0.03
    flow: float = 0.0  # share of the ground that is road, on which vehicles enter and leave
    pattern: Pattern = ""  # periodic texture
    pattern_step: float = 0.0  # periods that the camera moves along it in a frame
    pattern_share: float = 1.0  # share of the frame's height that it covers
    water: float = 0.0  # share of the frame's height that is water with moving waves
    roofs: float = 0.0  # share of the ground under roofs, which show parallax
    trees: float = 0.0  # share of the ground under swaying trees
    contrast: float = 1.0  # relative contrast of the ground
    is_still: bool = False  # whether the camera stands on a mast
    drift: float = 12.0  # drift of the camera over the clip, px
    shake: float = 0.3  # motion of the camera from frame to frame, px
    rotation: float = 0.0  # rotation of the frames after the first third, degrees
    scale: float = 1.0  # magnification of these frames
    shift: float = 0.0  # shift of these frames, as a share of the width
    tilt: float = 0.0  # tilt of these frames: displacement of the corners, px
    # whether these frames come at once, not over the first third of the clip
    is_abrupt: bool = False
    lens: float = 0.0  # radial distortion k1, radius relative to half the diagonal
    # amplitude of the rows' displacement by vibration under a rolling shutter, px
    rolling: float = 0.0
    torn: float = 0.0  # displacement of the lower part of every second frame, px
    interlaced: float = 0.0  # displacement between even and odd rows, px
    split: float = 0.0  # share of the width that shows another camera's view
    # names and levels of effects on the finished images (see `effects.py`)
    effects: tuple[tuple[str, float], ...] = ()


@dataclass(frozen=True)
class Kind:
    """A kind of disturbance."""

    unit: str  # unit of its levels
    levels: tuple[float, ...]  # levels from harmless to hopeless
    make: Callable[[float], Disturbance]  # makes the disturbance of a level


def _affect(name: str, unit: str, *levels: float) -> Kind:
    """Kind of an effect on the images."""
    return Kind(unit, levels, lambda level: Disturbance(effects=((name, level),)))


def _combine(one: str, other: str, share: float) -> Kind:
    """Kind that adds a fixed level of one kind, at a share of its levels, to the other."""
    levels = KINDS[one].levels
    fixed = KINDS[one].make(levels[round(share * (len(levels) - 1))])
    plain = Disturbance()
    extra = {k: v for k, v in vars(fixed).items() if v != getattr(plain, k) and k != "effects"}

    def make(level: float) -> Disturbance:
        hard = KINDS[other].make(level)
        return replace(hard, **extra, effects=hard.effects + fixed.effects)

    return Kind(KINDS[other].unit, KINDS[other].levels, make)


def _pattern(pattern: Pattern, share: float) -> Kind:
    return Kind(
        "periods a frame",
        (0.02, 0.1, 0.3, 0.6, 1.0, 1.6),
        lambda level: Disturbance(
            pattern=pattern, pattern_step=level, pattern_share=share, traffic=0, drift=3
        ),
    )


KINDS: dict[str, Kind] = {
    "plain": Kind("drift, px", (2, 6, 12, 24, 48), lambda x: Disturbance(drift=x)),
    "coherent traffic": Kind(
        "share", (0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8), lambda x: Disturbance(traffic=x)
    ),
    "flowing traffic": Kind(
        "share", (0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8), lambda x: Disturbance(flow=x)
    ),
    "still camera": Kind(
        "share", (0.02, 0.05, 0.1, 0.2, 0.3, 0.4), lambda x: Disturbance(traffic=x, is_still=True)
    ),
    "still camera, flowing traffic": Kind(
        "share",
        (0.05, 0.1, 0.2, 0.3, 0.4, 0.5),
        lambda x: Disturbance(traffic=0, flow=x, is_still=True),
    ),
    "parking lines": _pattern("parking", 1.0),
    "solar panels": _pattern("panels", 1.0),
    "solar panels on 70 %": _pattern("panels", 0.7),
    "tiles": _pattern("tiles", 0.9),
    "water": Kind(
        "share of land", (0.6, 0.4, 0.3, 0.2, 0.1, 0.0), lambda x: Disturbance(water=1 - x)
    ),
    "parallax": Kind(
        "share", (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7), lambda x: Disturbance(roofs=x, drift=30)
    ),
    "swaying trees": Kind("share", (0.1, 0.3, 0.5, 0.7, 0.9), lambda x: Disturbance(trees=x)),
    "defocus": _affect("blur", "sigma, px", 0.5, 1, 2, 3, 4.5, 6, 8),
    "motion blur": _affect("motion blur", "px", 2, 5, 10, 15, 20, 30),
    "rolling shutter": Kind("px", (0.2, 0.5, 1, 2, 4, 8), lambda x: Disturbance(rolling=x)),
    "lens": Kind(
        "k1", (0.002, 0.01, 0.03, 0.06, 0.12), lambda x: Disturbance(lens=x, shift=0.1, rotation=4)
    ),
    "compression": _affect("compression", "Mbit/s at 1080p", 20, 5, 2, 1, 0.5, 0.25, 0.1),
    "overlay text": _affect("overlay", "share", 0.05, 0.15, 0.3, 0.45, 0.6),
    "split screen": Kind("share", (0.1, 0.2, 0.3, 0.4, 0.5, 0.6), lambda x: Disturbance(split=x)),
    "frozen part": Kind(
        "share",
        (0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 0.9),
        lambda x: Disturbance(drift=4, effects=(("freeze", x),)),
    ),
    "still inset": Kind(
        "share",
        (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8),
        lambda x: Disturbance(drift=4, effects=(("inset", x),)),
    ),
    "calm split screen": Kind(
        "share", (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8), lambda x: Disturbance(split=x, drift=4)
    ),
    "torn frame": Kind("px", (1, 3, 8, 20, 60), lambda x: Disturbance(torn=x)),
    "interlacing": Kind("px", (0.2, 0.5, 1, 2, 4, 8), lambda x: Disturbance(interlaced=x)),
    "rotation": Kind("degrees", (2, 8, 20, 45, 90, 180), lambda x: Disturbance(rotation=x)),
    "scale up": Kind("factor", (1.05, 1.2, 1.5, 2.0, 2.6), lambda x: Disturbance(scale=x)),
    "scale down": Kind("factor", (0.97, 0.9, 0.8, 0.7, 0.6), lambda x: Disturbance(scale=x)),
    "camera zoom": Kind(
        "factor a frame", (1.002, 1.01, 1.03, 1.06, 1.1), lambda x: Disturbance(scale=x**8)
    ),
    "overlap": Kind("share", (0.9, 0.7, 0.5, 0.35, 0.25, 0.15), lambda x: Disturbance(shift=1 - x)),
    "tilt": Kind("px", (3, 10, 30, 60, 120), lambda x: Disturbance(tilt=x)),
    "jump": Kind(
        "share of width",
        (0.01, 0.05, 0.1, 0.2, 0.4, 0.6),
        lambda x: Disturbance(shift=x, is_abrupt=True),
    ),
    "shake": Kind("px", (1, 3, 8, 20, 50), lambda x: Disturbance(shake=x)),
    "low contrast": Kind(
        "contrast",
        (0.5, 0.2, 0.1, 0.05, 0.02, 0.0),
        lambda x: Disturbance(contrast=x, traffic=0.0, effects=(("noise", 2.0),)),
    ),
    "low contrast and vehicles": Kind(
        "contrast",
        (0.5, 0.2, 0.1, 0.05, 0.02, 0.0),
        lambda x: Disturbance(contrast=x, traffic=0.15, effects=(("noise", 2.0),)),
    ),
    "night": _affect("night", "gain", 0.5, 0.2, 0.1, 0.05, 0.02),
    "gain": _affect("gain", "factor", 1.2, 1.6, 2.2, 3, 5),
    "noise": _affect("noise", "sigma, grey levels", 2, 8, 20, 40, 80),
    "fog": _affect("fog", "share", 0.3, 0.6, 0.8, 0.9, 0.97),
    "jpeg": _affect("jpeg", "quality", 80, 40, 20, 10, 5, 2),
    "dropped frames": Kind(
        "drift, px", (12, 40, 90, 180), lambda x: Disturbance(drift=x, effects=(("drop", 0.5),))
    ),
    "doubled frames": _affect("double", "share", 0.1, 0.3, 0.5, 0.8),
    "letterbox": _affect("letterbox", "share", 0.1, 0.25, 0.4, 0.6, 0.8),
    "hard shadow": _affect("shadow", "share", 0.1, 0.3, 0.5, 0.7, 0.9),
    "dark shadows": _affect("dark shadows", "share of light", 0.6, 0.4, 0.3, 0.2, 0.1, 0.05),
    "negative": _affect("negative", "share of frames", 0.2, 0.5, 1.0),
    "dust": _affect("dust", "specks", 5, 20, 80, 200, 500),
    "saturated": _affect("saturated", "share", 0.1, 0.3, 0.5, 0.7, 0.9),
    "flicker bands": _affect("flicker", "amplitude", 0.05, 0.15, 0.3, 0.6),
    "colour cast": _affect("cast", "strength", 0.1, 0.3, 0.6, 0.9),
    "chromatic": _affect("chromatic", "px", 0.2, 0.5, 1, 2, 5),
}
KINDS |= {
    f"{other}, and {one}": _combine(one, other, share)
    for other, one, share in (
        ("coherent traffic", "compression", 0.4),
        ("coherent traffic", "jump", 0.6),
        ("water", "defocus", 0.3),
        ("solar panels", "defocus", 0.3),
        ("solar panels on 70 %", "coherent traffic", 0.0),
        ("parallax", "motion blur", 0.3),
        ("motion blur", "noise", 0.5),
        ("night", "motion blur", 0.3),
        ("overlay text", "low contrast", 0.3),
        ("overlay text", "jump", 0.5),
        ("rotation", "scale down", 0.6),
        ("fog", "rolling shutter", 0.4),
        ("letterbox", "coherent traffic", 0.3),
        ("compression", "low contrast", 0.4),
    )
}
