"""Georeferences from simulated control points: errors, and how often the stated bounds hold.

    python -m geoaim.bench.georeference --trials 50 --json docs/bench/georeference.json

Monte Carlo over layouts of the points, true transforms, and numbers of points.
"""

import warnings
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import Annotated, Any

import numpy as np
import typer
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from geoaim.bench.report import JsonFile, print_rows, write_json
from geoaim.errors import GeoaimWarning, GeoreferenceError
from geoaim.geometry import image_corners, make_similarity, transform_points
from geoaim.mapping.georeference.control_points import ControlPoints
from geoaim.mapping.georeference.estimate import estimate_georeference
from geoaim.mapping.georeference.georeference import Georeference, world_from_pixels
from geoaim.mapping.georeference.normalised_plane import half_diagonal, undistort_points
from geoaim.mapping.georeference.posterior import PRIOR_SIGMA, ellipse_factor
from geoaim.mapping.georeference.transform_models import compose_world_from_image
from geoaim.mapping.georeference.uncertainty import predict_covariance

HEIGHT, WIDTH = 1080, 1920
RESOLUTION = 0.05  # metres per pixel
PICKING_SIGMA_PX = 1.5  # per axis
MARGIN = 0.06  # of the side, in which no points are picked
# Boxes of the points, shares of the sides: left, top, right, bottom.
LAYOUTS = {
    "spread": (MARGIN, MARGIN, 1 - MARGIN, 1 - MARGIN),
    "one-sided": (MARGIN, MARGIN, 0.35, 1 - MARGIN),
    "clustered": (0.42, 0.35, 0.67, 0.65),
}
POINT_COUNTS = (4, 5, 6, 8, 12, 20)
OUTLIER_POINT_COUNTS = (4, 5, 6, 8, 12)
OUTLIER_SIZES_PX = (15.0, 60.0, 1e4)


@dataclass(frozen=True)
class TrueTransform:
    """Sizes of a true transform's terms (`transform_models`); signs and directions are random."""

    stretch: float = 0.0
    perspective: float = 0.0
    lens: float = 0.0
    from_prior: bool = False  # drawn from the prior, instead of the fixed sizes


TRUE_TRANSFORMS = {
    "similarity": TrueTransform(),
    "affine 2 %": TrueTransform(stretch=0.02),
    "tilt 1 deg": TrueTransform(perspective=0.015),
    "tilt 4 deg": TrueTransform(perspective=0.06),
    "lens 0.5 %": TrueTransform(lens=0.005),
    "as expected": TrueTransform(from_prior=True),
    "tilt 20 deg": TrueTransform(perspective=0.3),
    "lens 6 %": TrueTransform(lens=0.06),
}


@dataclass(frozen=True)
class Cell:
    """One cell of the benchmark's table."""

    layout: str  # key of LAYOUTS
    truth: str  # key of TRUE_TRANSFORMS
    count: int  # of control points


def _draw_terms(truth: TrueTransform, generator: np.random.Generator) -> Float[Array, "9"]:
    """The nine terms of one true transform."""
    terms = np.zeros(9)
    if truth.from_prior:
        terms[4:] = PRIOR_SIGMA * generator.normal(size=5)
        return terms
    for first, length in ((4, truth.stretch), (6, truth.perspective)):
        angle = generator.uniform(0.0, 2.0 * np.pi)
        terms[first : first + 2] = length * np.cos(angle), length * np.sin(angle)
    terms[8] = truth.lens * generator.choice([-1.0, 1.0])
    return terms


def _draw_points(
    cell: Cell, generator: np.random.Generator
) -> tuple[ControlPoints, Callable[[Float[Array, "m 2"]], Float[Array, "m 2"]]]:
    """Control points with picking noise, and the true transform from pixels to the ground."""
    terms = _draw_terms(TRUE_TRANSFORMS[cell.truth], generator)
    box = np.reshape(LAYOUTS[cell.layout], (2, 2)) * [WIDTH, HEIGHT]
    pixels = generator.uniform(box[0], box[1], size=(cell.count, 2))
    angle = generator.uniform(0.0, 2.0 * np.pi)
    unit = RESOLUTION * half_diagonal(HEIGHT, WIDTH)
    world_from_plane = make_similarity(np.zeros(2), angle, unit)
    world_from_image = compose_world_from_image(world_from_plane, terms, (HEIGHT, WIDTH))

    def transform(pixels: Float[Array, "m 2"]) -> Float[Array, "m 2"]:
        undistorted = undistort_points(pixels, float(terms[8]), HEIGHT, WIDTH)
        return transform_points(world_from_image, undistorted)

    picked = pixels + generator.normal(scale=PICKING_SIGMA_PX, size=pixels.shape)
    picked = picked.clip(0.0, (WIDTH, HEIGHT))
    names = tuple(f"p{i}" for i in range(cell.count))
    points = ControlPoints(picked, transform(pixels), None, names, (None,) * cell.count)
    return points, transform


def _measure_errors(
    georeference: Georeference, pixels: Float[Array, "m 2"], truth: Float[Array, "m 2"]
) -> tuple[Float[Array, "m"], Bool[Array, "m"]]:
    """Errors on the ground, in pixels, and whether the 95 % ellipses hold the truth."""
    offset = world_from_pixels(georeference, pixels) - truth
    weighted = np.linalg.solve(predict_covariance(georeference, pixels), offset[:, :, None])
    squares = np.sum(offset * weighted[:, :, 0], axis=1)
    inside = squares <= ellipse_factor(georeference.posterior.dof) ** 2
    return np.linalg.norm(offset, axis=1) / RESOLUTION, inside


def run_cell(cell: Cell, trials: int) -> dict[str, Any]:
    """Measure one cell: coverage of the 95 % ellipse, errors at the corners, models chosen."""
    generator = np.random.default_rng([cell.count, *map(ord, cell.layout + cell.truth)])
    corners = image_corners(HEIGHT, WIDTH)
    covered: dict[str, list[bool]] = {"corners": [], "centre": [], "anywhere": []}
    errors: list[float] = []
    models: Counter[str] = Counter()
    for _ in range(trials):
        points, transform = _draw_points(cell, generator)
        anywhere = generator.uniform(0.0, (WIDTH, HEIGHT), size=(1, 2))
        pixels = np.concatenate([corners, [[WIDTH / 2.0, HEIGHT / 2.0]], anywhere])
        truth = transform(pixels)
        try:
            result = estimate_georeference(points, height=HEIGHT, width=WIDTH)
        except GeoreferenceError as refusal:
            models["on a line" if "lie " in str(refusal) else "refused"] += 1
            continue
        models[result.model + (" + lens" if result.radial else "")] += 1
        models["dropped"] += int((~result.used).sum())
        distance, inside = _measure_errors(result, pixels, truth)
        covered["corners"] += inside[:4].tolist()
        covered["centre"].append(bool(inside[4]))
        covered["anywhere"].append(bool(inside[5]))
        errors.append(_rms(distance[:4]))
    return {
        "layout": cell.layout,
        "truth": cell.truth,
        "points": cell.count,
        "trials": trials,
        "coverage": {place: _share(inside) for place, inside in covered.items()},
        "error_px": round(_rms(errors), 1) if errors else None,
        "models": dict(models),
    }


def _run_outliers(cell: Cell, size: float, trials: int) -> dict[str, Any]:
    """Measure how often one point that is `size` pixels off is found, missed, or refused."""
    generator = np.random.default_rng([cell.count, int(size), *map(ord, cell.layout + cell.truth)])
    corners = image_corners(HEIGHT, WIDTH)
    outcomes: Counter[str] = Counter()
    covered: list[bool] = []
    for _ in range(trials):
        points, transform = _draw_points(cell, generator)
        angle = generator.uniform(0.0, 2.0 * np.pi)
        points.coordinates[0] += size * RESOLUTION * np.array([np.cos(angle), np.sin(angle)])
        try:
            result = estimate_georeference(points, height=HEIGHT, width=WIDTH)
        except GeoreferenceError as refusal:
            named = "contradict" in str(refusal) and "p0" in str(refusal)
            outcomes["refused, named" if named else "refused, other"] += 1
            continue
        missed = "missed" if result.used.all() else "wrong one"
        outcomes[missed if result.used[0] else "found"] += 1
        covered += _measure_errors(result, corners, transform(corners))[1].tolist()
    return {
        "layout": cell.layout,
        "truth": cell.truth,
        "points": cell.count,
        "size_px": size,
        "outcomes": dict(outcomes),
        "coverage": _share(covered) if covered else None,
    }


def _rms(values: Array | list[float]) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _share(values: list[bool]) -> float:
    """Percent of True; NaN of nothing."""
    return round(100.0 * float(np.mean(values)), 1) if values else float("nan")


def main(
    json: JsonFile = None,
    trials: Annotated[int, typer.Option(help="sets of points for each cell of the table")] = 200,
) -> None:
    """Measure how often stated regions hold the truth, and how often a wrong point is found."""
    warnings.simplefilter("ignore", GeoaimWarning)
    cells = product(LAYOUTS, TRUE_TRANSFORMS, POINT_COUNTS)
    measured = print_rows(run_cell(Cell(*cell), trials) for cell in cells)
    cases = product(
        ("spread", "one-sided"),
        ("similarity", "as expected"),
        OUTLIER_POINT_COUNTS,
        OUTLIER_SIZES_PX,
    )
    outliers = print_rows(
        _run_outliers(Cell(layout, truth, count), size, max(trials // 2, 10))
        for layout, truth, count, size in cases
    )
    if json is not None:
        command = f"python -m geoaim.bench.georeference --trials {trials}"
        write_json({"command": command, "cells": measured, "outliers": outliers}, json)


if __name__ == "__main__":
    typer.run(main)
