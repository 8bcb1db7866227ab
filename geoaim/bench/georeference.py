"""How far to trust a georeference: Monte Carlo over layouts, truths and numbers of points.

`python -m geoaim.bench.georeference [--trials 200] [--json PATH]`
"""

import argparse
import json
import warnings
from collections import Counter
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.errors import GeoaimWarning, GeoreferenceError
from geoaim.geometry import image_corners, transform_points
from geoaim.mapping.georeference.control_points import ControlPoints
from geoaim.mapping.georeference.estimate import (
    Georeference,
    compose,
    georeference,
    predict_covariance,
    undistort_points,
    world_points,
)
from geoaim.mapping.georeference.point_checks import fit_similarity, plane_points
from geoaim.mapping.georeference.transform_models import (
    MODELS,
    PRIOR,
    apply,
    ellipse_factor,
    fit_terms,
)

HEIGHT, WIDTH = 1080, 1920
GROUND = 0.05  # metres per pixel
NOISE = 1.5  # px, one sigma per axis, of picking
MARGIN = 0.06  # points are not picked closer to the edge than this share of the side
# Boxes that the points lie in, shares of the sides: left, top, right, bottom.
LAYOUTS = {
    "spread": (MARGIN, MARGIN, 1 - MARGIN, 1 - MARGIN),
    "one-sided": (MARGIN, MARGIN, 0.35, 1 - MARGIN),
    "clustered": (0.42, 0.35, 0.67, 0.65),
}
COUNTS = (4, 5, 6, 8, 12, 20)


@dataclass(frozen=True)
class Truth:
    """A true transform: terms of `transform_models`, with random signs and directions."""

    stretch: float = 0.0
    perspective: float = 0.0
    lens: float = 0.0
    drawn: bool = False  # from the prior, in place of the fixed sizes


TRUTHS = {
    "similarity": Truth(),
    "affine 2 %": Truth(stretch=0.02),
    "tilt 1 deg": Truth(perspective=0.015),
    "tilt 4 deg": Truth(perspective=0.06),
    "lens 0.5 %": Truth(lens=0.005),
    "as expected": Truth(drawn=True),
    "tilt 20 deg": Truth(perspective=0.3),
    "lens 6 %": Truth(lens=0.06),
}


def draw_terms(truth: Truth, generator: np.random.Generator) -> Float[Array, "9"]:
    """The nine terms of one true transform."""
    terms = np.zeros(9)
    if truth.drawn:
        terms[4:] = PRIOR * generator.normal(size=5)
        return terms
    for at, length in ((4, truth.stretch), (6, truth.perspective)):
        angle = generator.uniform(0.0, 2.0 * np.pi)
        terms[at : at + 2] = length * np.cos(angle), length * np.sin(angle)
    terms[8] = truth.lens * generator.choice([-1.0, 1.0])
    return terms


def draw_points(
    layout: str,
    count: int,
    terms: Float[Array, "9"],
    generator: np.random.Generator,
    noise: float = NOISE,
) -> tuple[ControlPoints, Float[Array, "3 3"]]:
    """Control points with picking noise, and the true world_from_image of straightened pixels."""
    left, top, right, bottom = LAYOUTS[layout]
    box = np.array([[left * WIDTH, top * HEIGHT], [right * WIDTH, bottom * HEIGHT]])
    pixels = generator.uniform(box[0], box[1], size=(count, 2))
    angle = generator.uniform(0.0, 2.0 * np.pi)
    unit = GROUND * np.hypot(HEIGHT, WIDTH) / 2.0
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) * unit
    placed = np.block([[turn, np.zeros((2, 1))], [np.zeros((1, 2)), np.ones((1, 1))]])
    truth = compose(placed, terms, (HEIGHT, WIDTH))
    places = _places(truth, terms, pixels)
    picked = pixels + generator.normal(scale=noise, size=pixels.shape)
    picked = picked.clip(0.0, (WIDTH, HEIGHT))
    names = tuple(f"p{i}" for i in range(count))
    return ControlPoints(picked, places, None, names, (None,) * count), truth


def _places(
    truth: Float[Array, "3 3"], terms: Float[Array, "9"], pixels: Float[Array, "m 2"]
) -> Float[Array, "m 2"]:
    return transform_points(truth, undistort_points(pixels, float(terms[8]), HEIGHT, WIDTH))


def judge(
    result: Georeference, truth: Float[Array, "3 3"], terms: Float[Array, "9"], where: Array
) -> tuple[Array, Array]:
    """Error in pixels on the ground, and whether the 95 % ellipse holds the truth."""
    offset = world_points(result, where) - _places(truth, terms, where)
    inside = np.einsum(
        "mi,mi->m",
        offset,
        np.linalg.solve(predict_covariance(result, where), offset[:, :, None])[:, :, 0],
    )
    return np.linalg.norm(offset, axis=1) / GROUND, inside <= ellipse_factor(result.dof) ** 2


def rivals(points: ControlPoints) -> dict[str, Float[Array, "3 3"]]:
    """Maximum likelihood fits of the plain models, and the choices of AICc and of GRIC.

    Torr 1998 for GRIC with the true noise; Burnham and Anderson 2002 for AICc.
    """
    plane = plane_points(points.pixels, HEIGHT, WIDTH)
    matrix = fit_similarity(plane, points.coordinates)[0]
    placed = transform_points(np.linalg.inv(matrix), points.coordinates)
    fits, aicc, gric, n = {}, {}, {}, 2 * len(plane)
    for model, size in MODELS.items():
        fits[model] = fit_terms(plane, placed, list(range(size)), np.zeros(9))
        error = np.sum((apply(fits[model], plane) - placed) ** 2, axis=1)
        spare = n - size - 2
        penalty = 2 * (size + 1) * (1 + (size + 2) / spare) if spare > 0 else np.inf
        aicc[model] = n * np.log(max(error.sum(), 1e-30) / n) + penalty
        scaled = error * (np.hypot(HEIGHT, WIDTH) / 2.0 / NOISE) ** 2
        gric[model] = np.minimum(scaled, 4.0).sum() + n * np.log(4.0) + size * np.log(2.0 * n)
    best = {"AICc": min(aicc, key=aicc.__getitem__), "GRIC": min(gric, key=gric.__getitem__)}
    chosen = {**fits, **{name: fits[model] for name, model in best.items()}}
    return {name: compose(matrix, theta, (HEIGHT, WIDTH)) for name, theta in chosen.items()}


def run_cell(
    layout: str, truth: str, count: int, *, trials: int, stated: bool, noise: float = NOISE
) -> dict[str, Any]:
    """One cell of the table: coverage of the 95 % region, errors at the corners, choices."""
    generator = np.random.default_rng([count, *map(ord, layout + truth)])
    corners = image_corners(HEIGHT, WIDTH)
    hits: dict[str, list[bool]] = {"corners": [], "centre": [], "anywhere": []}
    errors: dict[str, list[float]] = {}
    models: Counter[str] = Counter()
    for _ in range(trials):
        terms = draw_terms(TRUTHS[truth], generator)
        points, matrix = draw_points(layout, count, terms, generator, noise)
        anywhere = generator.uniform(0.0, (WIDTH, HEIGHT), size=(1, 2))
        where = np.concatenate([corners, [[WIDTH / 2.0, HEIGHT / 2.0]], anywhere])
        try:
            result = georeference(
                points, height=HEIGHT, width=WIDTH, accuracy=noise if stated else None
            )
        except GeoreferenceError as refusal:
            models["on a line" if "lie " in str(refusal) else "refused"] += 1
            continue
        models[result.model + (" + lens" if result.radial else "")] += 1
        models["dropped"] += int((~result.used).sum())
        off, inside = judge(result, matrix, terms, where)
        hits["corners"] += inside[:4].tolist()
        hits["centre"].append(bool(inside[4]))
        hits["anywhere"].append(bool(inside[5]))
        errors.setdefault("chosen", []).append(_rms(off[:4]))
        for name, rival in rivals(points).items():
            gap = transform_points(rival, corners) - _places(matrix, terms, corners)
            errors.setdefault(name, []).append(_rms(np.linalg.norm(gap, axis=1) / GROUND))
    return {
        "layout": layout, "truth": truth, "points": count, "trials": trials, "stated": stated,
        "noise_px": noise,
        "coverage": {where: round(100.0 * float(np.mean(hit)), 1) for where, hit in hits.items()},
        "error_px": {name: round(_rms(np.array(e)), 1) for name, e in errors.items()},
        "models": dict(models),
    }  # fmt: skip


def run_outliers(
    layout: str, truth: str, count: int, size: float, *, trials: int
) -> dict[str, Any]:
    """How often one point that is `size` pixels wrong is found, missed, or the set refused."""
    generator = np.random.default_rng([count, int(size), *map(ord, layout + truth)])
    outcomes: Counter[str] = Counter()
    hits: list[bool] = []
    for _ in range(trials):
        terms = draw_terms(TRUTHS[truth], generator)
        points, matrix = draw_points(layout, count, terms, generator)
        angle = generator.uniform(0.0, 2.0 * np.pi)
        points.coordinates[0] += size * GROUND * np.array([np.cos(angle), np.sin(angle)])
        try:
            result = georeference(points, height=HEIGHT, width=WIDTH)
        except GeoreferenceError as refusal:
            named = "contradict" in str(refusal) and "p0" in str(refusal)
            outcomes["refused, named" if named else "refused, other"] += 1
            continue
        found = "missed" if result.used.all() else "wrong one"
        outcomes[found if result.used[0] else "found"] += 1
        hits += judge(result, matrix, terms, image_corners(HEIGHT, WIDTH))[1].tolist()
    coverage = round(100.0 * float(np.mean(hits)), 1) if hits else None
    return {"layout": layout, "truth": truth, "points": count, "size_px": size,
            "outcomes": dict(outcomes), "coverage": coverage}  # fmt: skip


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def main() -> None:
    """Run every cell, print Markdown tables, and write JSON when asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=200)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--stated", action="store_true", help="tell georeference the true noise")
    arguments = parser.parse_args()
    warnings.simplefilter("ignore", GeoaimWarning)
    print(
        "| layout | truth | points | 95 % covers: corners, centre, anywhere | error px | choices |"
    )
    print("|---|---|---|---|---|---|")
    cells = []
    for layout, truth, count in product(LAYOUTS, TRUTHS, COUNTS):
        cell = run_cell(layout, truth, count, trials=arguments.trials, stated=arguments.stated)
        cells.append(cell)
        shown = ", ".join(f"{name} {error}" for name, error in cell["error_px"].items())
        covered = ", ".join(str(share) for share in cell["coverage"].values())
        print(
            f"| {layout} | {truth} | {count} | {covered} | {shown} | {cell['models']} |", flush=True
        )
    print("\nNoise not stated, truth as expected: corners covered")
    noises = []
    for layout, count, noise in product(LAYOUTS, COUNTS, (0.75, 1.5, 3.0, 5.0)):
        cell = run_cell(
            layout, "as expected", count, trials=arguments.trials, stated=False, noise=noise
        )
        noises.append(cell)
        print(f"| {layout} | {count} | {noise} px | {cell['coverage']['corners']} |", flush=True)
    print("\n| layout | truth | points | one wrong by px | outcomes | corners covered |")
    print("|---|---|---|---|---|---|")
    outliers = []
    for layout, truth, count, size in product(
        ("spread", "one-sided"), ("similarity", "as expected"), (4, 5, 6, 8, 12), (15.0, 60.0, 1e4)
    ):
        found = run_outliers(layout, truth, count, size, trials=max(arguments.trials // 2, 10))
        outliers.append(found)
        print("| " + " | ".join(str(value) for value in found.values()) + " |", flush=True)
    if arguments.json:
        arguments.json.write_text(
            json.dumps({"cells": cells, "noises": noises, "outliers": outliers}, indent=1)
        )


if __name__ == "__main__":
    main()
