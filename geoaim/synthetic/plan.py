"""The plan of a four-way signalised junction: where kerbs, markings, lanes and marks lie.

The plan has its origin at the crossing of the two roads, x right and y up along the drawn image,
in metres. The main road runs along y = bend(x), the side road along x = slant(y); traffic keeps
to the right.
"""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

LANE = 3.3  # m
MAIN_HALF = 2 * LANE + 0.5  # m, two lanes each way
SIDE_HALF = 1.5 * LANE + 0.4  # m, one lane each way and one to turn left
CORNER = 7.0  # m, radius of the kerbs
PAVEMENT = 4.4  # m, from the kerb to the plots
MAIN_STOP = SIDE_HALF + 9.3  # m from the middle, along the main road
SIDE_STOP = MAIN_HALF + 9.3  # m
CROSSING = 4.0  # m, length of a stripe
END = 75.0  # m, where markings end

Polygon = Float[Array, "n 2"]


def bend(x: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """The main road's middle: y at x."""
    return np.asarray(0.0011 * x**2 + 0.02 * x)


def slant(y: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """The side road's middle: x at y."""
    return np.asarray(0.07 * y - 0.0016 * y**2)


def on_main(points: Polygon) -> Polygon:
    """Plan coordinates of points given along and left of the main road's middle."""
    return np.stack([points[:, 0], bend(points[:, 0]) + points[:, 1]], axis=1)


def on_side(points: Polygon) -> Polygon:
    """Plan coordinates of points given along (up) and right of the side road's middle."""
    return np.stack([slant(points[:, 0]) + points[:, 1], points[:, 0]], axis=1)


def distance_to_kerb(x: Array, y: Array) -> Array:
    """Signed metres to the kerb, negative on the road: two strips joined by round corners."""
    main, side = np.abs(y - bend(x)) - MAIN_HALF, np.abs(x - slant(y)) - SIDE_HALF
    inside = CORNER - np.hypot((CORNER - main).clip(0), (CORNER - side).clip(0))
    return np.where((main < 0) | (side < 0), np.minimum(np.minimum(main, side), inside), inside)


def rectangle(x0: float, y0: float, x1: float, y1: float) -> Polygon:
    """Corners and points along the sides, so that a strip can bend with its road."""
    t = np.linspace(0, 1, 25)
    x, y = x0 + (x1 - x0) * t, y0 + (y1 - y0) * t
    sides = [(x, 0 * t + y0), (0 * t + x1, y), (x[::-1], 0 * t + y1), (0 * t + x0, y[::-1])]
    return np.concatenate([np.stack(side, axis=1) for side in sides])


def markings() -> list[Polygon]:
    """All paint on the roads, as polygons."""
    main, side = [], []
    for sign in (-1, 1):
        # Strips as (from, to along the road; from, to across it), mirrored through the middle.
        a = MAIN_STOP
        strips = [(a, a + 0.45, 0.15, 2 * LANE + 0.1), (a, END, -0.06, 0.06)]
        strips += [(a, END, o, o + 0.12) for o in (-2 * LANE - 0.15, 2 * LANE + 0.03)]
        strips += [(a + 0.45, a + 16, LANE - 0.06, LANE + 0.06)]
        strips += [(s, s + 3, LANE - 0.06, LANE + 0.06) for s in np.arange(a + 19, END, 7.5)]
        strips += [(s, s + 3, -LANE - 0.06, 0.06 - LANE) for s in np.arange(a, END, 7.5)]
        strips += _crossing(SIDE_HALF + 3.8, 2 * LANE)
        main += [sign * rectangle(s0, o0, s1, o1) for s0, s1, o0, o1 in strips]
        b, half = SIDE_STOP, LANE / 2
        strips = [(b, b + 0.45, -3 * half - 0.1, half - 0.15), (b, END, half - 0.06, half + 0.06)]
        strips += [(b, END, o, o + 0.12) for o in (-3 * half - 0.15, 3 * half + 0.03)]
        strips += [(b + 0.45, b + 14, -half - 0.06, 0.06 - half)]
        strips += [(s, s + 3, -half - 0.06, 0.06 - half) for s in np.arange(b + 17, END, 7.5)]
        strips += _crossing(MAIN_HALF + 3.8, 3 * half)
        side += [sign * rectangle(s0, o0, s1, o1) for s0, s1, o0, o1 in strips]
        for back in (5.5, 26.0):
            main += [_arrow(sign, a + back, (k + 0.5) * LANE, turn=0) for k in (0, 1)]
            side += [_arrow(sign, b + back, -LANE, turn=0), _arrow(sign, b + back, 0.0, turn=-1)]
    return [on_main(polygon) for polygon in main] + [on_side(polygon) for polygon in side]


def _crossing(start: float, half: float) -> list[tuple[float, float, float, float]]:
    middles = np.arange(-half + 0.5, half, 1.0)
    return [(start, start + CROSSING, o - 0.26, o + 0.26) for o in middles.tolist()]


def _arrow(sign: int, along: float, across: float, *, turn: int) -> Polygon:
    """An arrow that points to the junction; with `turn`, its head bends to that side."""
    straight = [(3.6, 0.08), (1.4, 0.08), (1.4, 0.42), (0, 0), (1.4, -0.42), (1.4, -0.08)]
    bent = [(3.6, 0.08), (0.5, 0.08), (0.5, -0.5), (0.9, -0.5), (0.3, -1.15), (-0.3, -0.5)]
    bent += [(0.2, -0.5), (0.2, -0.08), (3.6, -0.08)]
    shape = np.array(bent) if turn else np.array([*straight, (3.6, -0.08)])
    return sign * (shape * [1, -turn or 1] + [along, across])


def landmarks() -> tuple[tuple[str, ...], Float[Array, "8 2"]]:
    """Points that a surveyor would choose: corners of stop lines and crossings, manholes."""
    a, b, half = MAIN_STOP, SIDE_STOP, LANE / 2
    places = {
        "stop line east": on_main(np.array([[a + 0.45, 2 * LANE + 0.1]])),
        "stop line west": on_main(np.array([[-a - 0.45, -2 * LANE - 0.1]])),
        "stop line north": on_side(np.array([[b + 0.45, -3 * half - 0.1]])),
        "stop line south": on_side(np.array([[-b - 0.45, 3 * half + 0.1]])),
        "arrow west": on_main(np.array([[-a - 26.0, -1.5 * LANE]])),
        "arrow east": on_main(np.array([[a + 26.0, 1.5 * LANE]])),
        "manhole west": on_main(np.array([MANHOLES[0]])),
        "manhole east": on_main(np.array([MANHOLES[1]])),
    }
    return tuple(places), np.concatenate(list(places.values()))


MANHOLES = [(-42.0, 5.1), (44.5, -4.9), (16.6, -4.6), (-27.0, -1.7)]  # along and left of the main
