"""The transform models of a georeference: each by itself, and the automatic choice."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from unittest.mock import patch

import numpy as np
from scipy.stats import gmean

from benchmarks.georeference.methods import SEED, Placed, measure_sets, place_corners
from benchmarks.georeference.simulated_points import (
    HEIGHT,
    LAYOUTS,
    WIDTH,
    make_pinhole_camera,
    pick_points,
)
from benchmarks.results import Row
from geoaim.mapping.georeference import estimate
from geoaim.mapping.georeference.control_points import ControlPoints
from geoaim.mapping.georeference.georeference import Georeference
from geoaim.mapping.georeference.model_choice import Candidate, choose_model
from geoaim.mapping.georeference.transform_models import TERM_COUNTS, compose_world_from_image

# Tilt in degrees, OpenCV's first lens term, number of points, noise in px.
Case = tuple[float, float, int, float]


def fit_georeferences(points: ControlPoints) -> dict[str, Georeference]:
    """Estimate the georeference that each transform model gives, and the chosen one ("geoaim").

    The result has them by the name of the model.
    """
    fitted: list[list[Candidate]] = []

    def record(candidates: list[Candidate]) -> Candidate:
        fitted.append(candidates)
        return choose_model(candidates)

    with patch.object(estimate, "choose_model", record):  # no option for what only a test needs
        found = estimate.estimate_georeference(points, height=HEIGHT, width=WIDTH)
    plane = found.world_from_plane
    return {
        one.model: replace(
            found,
            model=one.model,
            terms=one.terms,
            radial=float(one.terms[8]),
            world_from_image=compose_world_from_image(plane, one.terms, (HEIGHT, WIDTH)),
        )
        for one in fitted[-1]
    } | {"geoaim": found}


def _place_models(points: ControlPoints) -> dict[str, Placed]:
    return {name: place_corners(one) for name, one in fit_georeferences(points).items()}


def measure_models(trials: int, cases: Sequence[Case]) -> Iterator[Row]:
    """Measure each transform model, and the automatic choice, in cases of a camera and points.

    The error of a case is the root mean square over its sets of points, of all layouts in turn.
    """
    generator = np.random.default_rng(SEED)
    for tilt, lens, count, sigma in cases:
        sets = [
            pick_points(
                make_pinhole_camera(tilt, np.array([lens, 0.0]), 1.0, generator),
                LAYOUTS[trial % len(LAYOUTS)],
                "normal",
                (count, sigma),
                generator,
            )
            for trial in range(trials)
        ]
        corners = measure_sets(sets, [_place_models])
        means = corners.assign(error=corners.error**2).groupby("method")[["error", "terms"]].mean()
        error, terms = np.sqrt(means.error), means.terms
        yield {
            "case": f"tilt {tilt:g} degrees, lens {lens:g}, {count} points, {sigma:g} px",
            "models": list(TERM_COUNTS),
            "errors": [float(error[model]) for model in TERM_COUNTS],
            "sizes": [float(terms[model]) for model in TERM_COUNTS],
            "error": float(error["geoaim"]),
            "size": float(terms["geoaim"]),
            "ms": 1e3 * float(corners.seconds.median()),
        }


def average_models(cases: Sequence[Row]) -> Iterator[Row]:
    """Average the cases of each fixed model and of the automatic choice; the cost is the terms."""
    errors = np.array([[*case["errors"], case["error"]] for case in cases])
    ms = float(np.mean([case["ms"] for case in cases]))  # all models are fitted in any case
    terms = np.array([[*case["sizes"], case["size"]] for case in cases]).mean(0).tolist()
    for number, (size, error) in enumerate(zip(terms, gmean(errors), strict=True)):
        automatic = number == len(TERM_COUNTS)
        row = {"setting": "terms", "size": size, "error": float(error), "cost": size}
        yield row | {"ms": ms, "default": automatic, "automatic": automatic}
