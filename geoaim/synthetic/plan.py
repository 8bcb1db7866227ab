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
MAIN_STOP = SIDE_HALF + 11.4  # m from the middle, along the main road
SIDE_STOP = MAIN_HALF + 11.4  # m
CROSSING = 4.0  # m, length of a stripe
END = 75.0  # m, where markings end

Polygon = Float[Array, "_ 2"]


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
        strips += _cycle_dashes(SIDE_HALF + 3.8, 2 * LANE)
        main += [sign * rectangle(s0, o0, s1, o1) for s0, s1, o0, o1 in strips]
        b, half = SIDE_STOP, LANE / 2
        strips = [(b, b + 0.45, -3 * half - 0.1, half - 0.15), (b, END, half - 0.06, half + 0.06)]
        strips += [(b, END, o, o + 0.12) for o in (-3 * half - 0.15, 3 * half + 0.03)]
        strips += [(b + 0.45, b + 14, -half - 0.06, 0.06 - half)]
        strips += [(s, s + 3, -half - 0.06, 0.06 - half) for s in np.arange(b + 17, END, 7.5)]
        strips += _crossing(MAIN_HALF + 3.8, 3 * half)
        strips += _cycle_dashes(MAIN_HALF + 3.8, 3 * half)
        side += [sign * rectangle(s0, o0, s1, o1) for s0, s1, o0, o1 in strips]
        for back in (5.5, 26.0):
            main += [_arrow(sign, a + back, (k + 0.5) * LANE, turn=0) for k in (0, 1)]
            side += [_arrow(sign, b + back, -LANE, turn=0), _arrow(sign, b + back, 0.0, turn=-1)]
    paint = [on_main(polygon) for polygon in main] + [on_side(polygon) for polygon in side]
    return paint + _turning_guides()


def _crossing(start: float, half: float) -> list[tuple[float, float, float, float]]:
    middles = np.arange(-half + 0.5, half, 1.0)
    return [(start, start + CROSSING, o - 0.26, o + 0.26) for o in middles.tolist()]


def _cycle_dashes(start: float, half: float) -> list[tuple[float, float, float, float]]:
    places = np.arange(-half, half, 1.2).tolist()
    edges = (start + CROSSING + 0.55, start + CROSSING + 2.35)
    return [(edge, edge + 0.15, o, o + 0.6) for edge in edges for o in places]


def _turning_guides() -> list[Polygon]:
    """Dashed arcs that lead from the side road's left lanes into the main road."""
    dashes = []
    turn = np.linspace(0.12, np.pi / 2 - 0.12, 13)
    for start, end in zip(turn[:-1:2], turn[1::2], strict=True):
        angle = np.linspace(start, end, 5)
        ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        dash = np.concatenate([9.06 * ring, 8.94 * ring[::-1]]) - [9.0 - LANE / 2, MAIN_HALF + 1.5]
        dashes += [on_main(dash), on_main(-dash)]
    return dashes


def cycle_crossings() -> list[Polygon]:
    """The coloured strips on which cycles cross, between the stripes and the stop lines."""
    strips = []
    for sign in (-1, 1):
        at, half = SIDE_HALF + 3.8 + CROSSING + 0.6, MAIN_HALF + 1.0
        strips.append(on_main(sign * rectangle(at, -half, at + 1.8, half)))
        at, half = MAIN_HALF + 3.8 + CROSSING + 0.6, SIDE_HALF + 1.0
        strips.append(on_side(sign * rectangle(at, -half, at + 1.8, half)))
    return strips


def tactile_strips() -> list[Polygon]:
    """Ribbed slabs on the pavement at both ends of the crossings."""
    strips = []
    for sign in (-1, 1):
        for side in (-1, 1):
            at, edge = sign * (SIDE_HALF + 3.9), side * (MAIN_HALF + 0.3)
            strips.append(on_main(rectangle(at, edge, at + sign * 3.8, edge + side * 1.5)))
            at, edge = sign * (MAIN_HALF + 3.9), side * (SIDE_HALF + 0.35)
            strips.append(on_side(rectangle(at, edge, at + sign * 3.8, edge + side * 1.5)))
    return strips


def _arrow(sign: int, along: float, across: float, *, turn: int) -> Polygon:
    """An arrow that points to the junction; with `turn`, its head bends to that side."""
    straight = [(3.6, 0.08), (1.4, 0.08), (1.4, 0.42), (0, 0), (1.4, -0.42), (1.4, -0.08)]
    bent = [(3.6, 0.08), (0.5, 0.08), (0.5, -0.5), (0.9, -0.5), (0.3, -1.15), (-0.3, -0.5)]
    bent += [(0.2, -0.5), (0.2, -0.08), (3.6, -0.08)]
    shape = np.array(bent) if turn else np.array([*straight, (3.6, -0.08)])
    return sign * (shape * [1, turn or 1] + [along, across])


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


MANHOLES = [
    (-42.0, 5.1),
    (44.5, -4.9),
    (21.6, -1.6),
    (-31.0, -4.7),
    (2.5, 2.1),
    (16.5, -12.0),
]  # along and left of the main


def routes() -> dict[str, tuple[Float[Array, "L 2"], float]]:
    """Ways through the junction: a point each quarter of a metre, and where their stop line is.

    Names are the arm that a vehicle comes from, then its way: "west 0" keeps the inner lane of
    the main road, "south right" turns right. The stop line is metres along the way.
    """
    along = np.arange(-END - 45, END + 45, 0.25)
    ways = {}
    for name, sign in (("west", 1), ("east", -1)):
        for k in (0, 1):
            lane = np.stack([along, np.full_like(along, -(k + 0.5) * LANE)], axis=1)
            ways[f"{name} {k}"] = on_main(sign * lane)
    for name, sign in (("south", 1), ("north", -1)):
        lane = np.stack([along, np.full_like(along, LANE)], axis=1)
        ways[f"{name} straight"] = on_side(sign * lane)
        before, after = along[along < -MAIN_HALF - 5], along[along > SIDE_HALF + 5]
        approach = on_side(sign * lane[: len(before)])
        leave = on_main(sign * np.stack([after, np.full_like(after, -1.5 * LANE)], axis=1))
        ways[f"{name} right"] = np.concatenate([approach, _curve(approach, leave), leave])
    stops = {"west": MAIN_STOP, "east": MAIN_STOP, "south": SIDE_STOP, "north": SIDE_STOP}
    return {name: _measured(way, stops[name.split()[0]]) for name, way in ways.items()}


def _curve(approach: Polygon, leave: Polygon) -> Polygon:
    """A quadratic Bézier curve from the end of one way to the start of another."""
    start, end = approach[-1], leave[0]
    ahead, back = approach[-1] - approach[-2], leave[0] - leave[1]
    reach = np.linalg.solve(np.stack([ahead, -back], axis=1), end - start)[0]
    corner, t = start + reach * ahead, np.linspace(0, 1, 60)[1:-1, None]
    return (1 - t) ** 2 * start + 2 * t * (1 - t) * corner + t**2 * end


def _measured(way: Polygon, stop: float) -> tuple[Float[Array, "L 2"], float]:
    """The way with points at equal distances, and the metres to its stop line."""
    run = np.concatenate([[0], np.cumsum(np.hypot(*np.diff(way, axis=0).T))])
    steps = np.arange(0, run[-1], 0.25)
    even = np.stack([np.interp(steps, run, way[:, k]) for k in (0, 1)], axis=1)
    near = np.argmin(np.abs(np.hypot(*way.T) - stop)[: len(way) // 2])
    return even, float(run[near])
