"""What `python -m benchmarks.detection evaluate` measures, on stills of others and drawn scenes."""

import time
from collections.abc import Iterator, Mapping
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Polygon
from numpy import ndarray as Array

from benchmarks.data import find_data
from benchmarks.detection.examples import HIDDEN, degrade
from benchmarks.detection.judging import Judged, join, judge_stills
from benchmarks.detection.scenes import draw_scene
from benchmarks.detection.stills import BORDER, JUDGING, Still, read_stills
from benchmarks.detection.vehicles import get_corners
from benchmarks.results import Results, Row
from geoaim.base.errors import GeoaimError
from geoaim.detection.network import MODEL, RESOLUTION
from geoaim.detection.scale import propose_scale
from geoaim.detection.vehicles import detect_vehicles
from geoaim.mapping.video.video import open_video

EDGES = (0.1, 0.3, 0.5, 0.7, 0.9, 1.0)  # of the bins of probability
SCALES = (0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3, 1.5)  # told over true
FRAMES = 4  # by which a scale is proposed
REPEATS = 6
TEST_SCENES, PIXELS = 60, 224  # drawn scenes that no network was trained on, and their side
KHARKIV = 0.42  # metres per pixel, by the corners that come with the video, 0.41 to 0.43
MODELS = "with stills", "drawings alone"
COARSER = RESOLUTION / 0.28  # of the network of drawings alone, which saw 0.28 m a pixel


def measure_detection(drawn: Path) -> Results:
    """Measure the shipped network, and the one of drawings alone where it exists."""
    models = {MODELS[0]: MODEL} | ({MODELS[1]: drawn} if drawn.exists() else {})
    stills = {kind.name: list(read_stills(kind)) for kind in JUDGING}
    judged = {
        (title, name): judge_stills(own, model, scale=1.0 if model == MODEL else COARSER)
        for title, model in models.items()
        for name, own in stills.items()
    }
    scales = measure_scales(stills)
    tables: dict[str, list[Row]] = {
        "stills": [summarize(*names, found) for names, found in judged.items()],
        "reliability": list(bin_by_probability(judged)),
        "wrong_scale": scales,
        "proposed_scale": list(measure_proposals(stills)),
        "time": [measure_time()],
    }
    charts = {
        "detection-curves": draw_curves(judged),
        "detection-reliability": draw_reliability(tables["reliability"]),
        "detection-scales": draw_scales(scales),
        "detection-failures": draw_failures(),
    }
    return Results("Detection of vehicles in single frames", tables, charts)


def summarize(model: str, name: str, judged: Judged) -> Row:
    """Summarise what was found in a place."""
    recall, precision = judged.get_rates(0.5)
    probabilities = np.linspace(0.02, 0.98, 97)
    rates = np.array([judged.get_rates(p) for p in probabilities])
    best = int(np.argmax(rates.min(axis=1)))
    return {
        "model": model,
        "place": name,
        "vehicles": judged.labelled,
        "recall": round(recall, 3),
        "precision": round(precision, 3),
        "both at best": round(float(rates[best].min()), 3),
        "at probability": round(float(probabilities[best]), 2),
        "overlap": round(float(np.nanmedian(judged.overlaps)), 2),
    }


def bin_by_probability(judged: Mapping[tuple[str, str], Judged]) -> Iterator[Row]:
    """Compare stated probabilities with the share that is right, bin by bin, per model."""
    for model in dict.fromkeys(model for model, _ in judged):
        found = join([own for (title, _), own in judged.items() if title == model])
        for low, high in pairwise(EDGES):
            own = (found.probabilities >= low) & (found.probabilities < high)
            if own.any():
                yield {
                    "model": model,
                    "boxes": int(own.sum()),
                    "stated": round(float(found.probabilities[own].mean()), 3),
                    "right": round(float(found.right[own].mean()), 3),
                }


def measure_scales(stills: Mapping[str, list[Still]]) -> list[Row]:
    """Measure accuracy and time where the network is told a wrong scale.

    A coarser one makes its picture smaller: it is faster, and finds less.
    """
    rows: list[Row] = []
    for scale in SCALES:
        judged = join([judge_stills(own[::4], scale=scale) for own in stills.values()])
        recall, precision = judged.get_rates(0.5)
        rows.append(
            {
                "told over true": scale,
                "recall": round(recall, 3),
                "precision": round(precision, 3),
                "seconds a frame of 0.15 m": measure_time(scale)["seconds"],
            }
        )
    return rows


def measure_proposals(stills: Mapping[str, list[Still]]) -> Iterator[Row]:
    """Propose the scale of each place, of itself and of pictures that are reduced."""
    cases: list[tuple[str, list[Array], float]] = []
    for name, own in stills.items():
        images = [
            own[k].image for k in np.linspace(0, len(own) - 1, min(FRAMES, len(own))).astype(int)
        ]
        for factor in (1.0, 0.5):
            small = [
                cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
                for image in images
            ]
            cases.append((name, small, own[0].resolution / factor))
    data = find_data()
    if data is not None:
        video = open_video(data / "hover/kharkiv/drone.mp4")
        cases.append(("Kharkiv", [frame.image for frame in video.sample(FRAMES)], KHARKIV))
    for name, images, true in cases:
        row = {"place": name, "metres a pixel": round(true, 3)}
        try:
            scale = propose_scale(images)
        except GeoaimError:
            yield row | {"proposed": None, "error": None, "stated": None, "vehicles": 0}
        else:
            yield row | {
                "proposed": round(scale.resolution, 4),
                "error": round(scale.resolution / true - 1, 3),
                "stated": round(scale.sigma, 3),
                "vehicles": scale.vehicles,
            }


def measure_time(scale: float = 1.0) -> Row:
    """Measure the processor time of a frame of 1920 x 1080 at 0.15 m a pixel, on one core."""
    cv2.setNumThreads(1)
    scene, *_ = draw_scene(640, 0.15, np.random.default_rng(1))
    image, times = np.ascontiguousarray(np.tile(scene, (2, 3, 1))[:1080]), []
    for _ in range(REPEATS):
        start = time.process_time()
        found = detect_vehicles(image, 0.15 * scale)
        times.append(time.process_time() - start)
    return {"boxes": len(found.boxes), "seconds": round(float(np.median(times[1:])), 3)}


def draw_curves(judged: Mapping[tuple[str, str], Judged]) -> Figure:
    """Draw precision against recall, a panel for each model."""
    titles = list(dict.fromkeys(model for model, _ in judged))
    figure = Figure(figsize=(4.8 * len(titles), 4.2), layout="constrained")
    panels = figure.subplots(1, len(titles), squeeze=False)[0]
    for axes, title in zip(panels, titles, strict=True):
        for (model, name), found in judged.items():
            if model == title:
                rates = [found.get_rates(p) for p in np.linspace(0.02, 0.98, 97)]
                [line] = axes.plot(*zip(*rates, strict=True), label=name)
                axes.plot(*found.get_rates(0.5), "o", color=line.get_color())
        axes.set(title=title, xlabel="recall", ylabel="precision", xlim=(0.4, 1), ylim=(0.4, 1))
        axes.grid(alpha=0.3)
    panels[0].legend(title="dots: probability 0.5")
    return figure


def draw_reliability(rows: list[Row]) -> Figure:
    """Draw the share that is right against what is stated."""
    figure = Figure(figsize=(4.8, 4.2), layout="constrained")
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], color="0.6", linewidth=1)
    for model in dict.fromkeys(row["model"] for row in rows):
        own = [row for row in rows if row["model"] == model]
        axes.plot([r["stated"] for r in own], [r["right"] for r in own], "o-", label=model)
    axes.set(xlabel="stated probability", ylabel="share that is right", xlim=(0, 1), ylim=(0, 1))
    axes.legend()
    axes.grid(alpha=0.3)
    return figure


def draw_scales(rows: list[Row]) -> Figure:
    """Draw accuracy and time against the scale that is told."""
    figure = Figure(figsize=(9.2, 3.8), layout="constrained")
    left, right = figure.subplots(1, 2)
    told = [row["told over true"] for row in rows]
    seconds = [row["seconds a frame of 0.15 m"] for row in rows]
    for key in ("recall", "precision"):
        left.plot(told, [row[key] for row in rows], "o-", label=key)
        right.plot(seconds, [row[key] for row in rows], "o-", label=key)
    left.set(xlabel="scale that is told over the true one", ylim=(0, 1))
    right.set(xlabel="seconds of a core for 1920 x 1080 at 0.15 m", ylim=(0, 1))
    left.legend()
    for axes in (left, right):
        axes.grid(alpha=0.3)
    return figure


def draw_failures() -> Figure:
    """Draw the test scenes on which most went wrong: missed in red, false in orange."""
    cases = []
    for seed in range(TEST_SCENES):
        image, truth, hidden = draw_scene(PIXELS, RESOLUTION, np.random.default_rng(10_000 + seed))
        truth = truth[(hidden < HIDDEN) & _is_inner(truth[:, :2])]
        seen = degrade(image, np.random.default_rng(seed)).transpose(1, 2, 0)
        image = (seen * 255).astype(np.uint8)
        found = detect_vehicles(image, RESOLUTION).get_corners()
        middles = found.mean(axis=1)
        far = np.hypot(*(middles[:, None] - truth[:, :2]).transpose(2, 0, 1))
        near = far < np.maximum(1 / RESOLUTION, 0.25 * truth[:, 3])  # a metre, or a quarter
        missed, false = truth[~near.any(axis=0)], found[~near.any(axis=1) & _is_inner(middles)]
        cases.append((len(missed) + len(false), seed, image, missed, found, false))
    figure = Figure(figsize=(12, 8.2), layout="constrained")
    worst = sorted(cases, key=lambda case: (-case[0], case[1]))[:6]
    for axes, (_, _, image, missed, found, false) in zip(
        figure.subplots(2, 3).ravel(), worst, strict=True
    ):
        axes.imshow(image)
        for corners in found:
            axes.add_patch(Polygon(corners, fill=False, color="#56B4E9", linewidth=1))
        for corners in false:
            axes.add_patch(Polygon(corners, fill=False, color="#E69F00", linewidth=2))
        for row in missed:
            axes.add_patch(
                Polygon(get_corners(*row.tolist()), fill=False, color="red", linewidth=2)
            )
        axes.set(xticks=[], yticks=[], xlim=(0, PIXELS), ylim=(PIXELS, 0))
    return figure


def _is_inner(places: Array) -> Array:
    rim = BORDER / RESOLUTION
    return np.asarray(((places > rim) & (places < PIXELS - rim)).all(axis=1))
