"""AIM and HD map, which differ in the picture and in nothing else: vehicles at synthetic places.

AIMs are what `build_aim` makes of a video of each place. Same channels, steps, seeds and schedule;
the best validated step of each training; intervals over places and trainings. The test places have
seeds of their own, in proportions that were fixed before: four junctions, two T-junctions, two
roundabouts, two streets and two campuses.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.figure import Figure

from benchmarks.prediction.averages import bootstrap_trainings
from benchmarks.prediction.models import name_training, train_once
from benchmarks.prediction.places import CAMPUS, ROADS, Places, make_places
from benchmarks.prediction.pretrained import VAL
from benchmarks.prediction.protocol import VEHICLES_ON_AIM, evaluate_place, make_places_dataset
from benchmarks.prediction.results import Workspace
from benchmarks.results import describe_machine, write_json
from geoaim.base.files import atomic_files, write_figure
from geoaim.prediction.baselines import Predictor, replay
from geoaim.prediction.config import configure_training
from geoaim.prediction.dataset import Dataset
from geoaim.prediction.itra import ITRA
from geoaim.prediction.metrics import Metric, concat, keep_rates
from geoaim.prediction.training import init_model

TRAIN: Places = (*ROADS, *CAMPUS)
TEST: Places = tuple(
    enumerate(
        (
            *("junction", "junction", "junction", "junction", "t", "t"),
            *("roundabout", "roundabout", "street", "street", "campus", "campus"),
        ),
        501,
    )
)
PICTURES = {"AIM": "video", "HD map": "hdm"}  # that models are trained on
# columns: pictures that models were trained on, and that they are judged on
CASES = {"AIM": ("AIM", "video"), "HD map": ("HD map", "hdm")}
SEEDS, STEPS, BATCH_SIZE = 3, 2500, 48
COLOURS = {"AIM": "tab:blue", "HD map": "tab:orange"}
METRICS = ("minADE", "joint minADE", "minFDE", "collision rate", "off-road rate", "red-light rate")
TEST_FRACTION = 0.25  # of each recording, at its end: two and a half minutes
# expected before any test place was judged: AIM minus HD map, as a share of the HD map's value
EXPECTED = {
    "joint minADE, all places": "-6 to +3 %",
    "joint minADE, campus": "-30 to -5 %",
    "joint minADE, public roads": "-3 to +5 %",
    "red-light rate, all places": "0 to +30 %",
}
ByPlace = list[Mapping[str, Metric]]


def run(workspace: Workspace) -> list[Path]:
    """Compare vehicles on AIM and HD map, over places and trainings; return the files."""
    places = make_places(workspace.places, TEST, progress=workspace.progress)
    models = {name: [_train(name, seed, workspace) for seed in range(SEEDS)] for name in PICTURES}
    found = {
        column: [_evaluate(model.sample, places, picture) for model in models[name]]
        for column, (name, picture) in CASES.items()
    }
    found["recording"] = [[keep_rates(one) for one in _evaluate(replay, places, "aim")]]
    kinds = {"all places": [kind for _, kind in TEST]} | {kind: [kind] for _, kind in TEST}
    rows = {
        (where, metric): row
        for where, some in kinds.items()
        for metric in METRICS
        if (row := _compare(found, metric, some))
    }
    paths = [workspace.results / f"aim_or_hdmap{suffix}" for suffix in (".json", ".md", ".png")]
    content = {
        "command": "python -m benchmarks.prediction aim_or_hdmap",
        "machine": describe_machine(),
        "training": {"steps": STEPS, "batch": BATCH_SIZE, "trainings": SEEDS, "places": TRAIN},
        "validation places": VAL["vehicle"],
        "test places": TEST,
        "expected": EXPECTED,
        "results": [
            {"places": where, "metric": metric, **row} for (where, metric), row in rows.items()
        ],
    }
    with atomic_files(*paths) as parts:
        write_json(content, parts[0])
        parts[1].write_text(_format(rows), encoding="utf-8")
        write_figure(_draw_learning(workspace), parts[2])
    return paths


def _evaluate(predictor: Predictor, places: Sequence[Path], picture: str) -> ByPlace:
    """Metrics at each test place."""
    return [
        concat(
            evaluate_place(
                predictor,  # type: ignore[arg-type] # a function, which can be hashed
                place,
                VEHICLES_ON_AIM,
                picture,
                fraction=TEST_FRACTION,
            )
        )
        for place in places
    ]


def _train(name: str, seed: int, workspace: Workspace) -> ITRA:
    training = replace(configure_training("vehicle", steps=STEPS, batch_size=BATCH_SIZE), seed=seed)

    def load_dataset() -> Dataset:
        train, val = (
            make_places(workspace.places, some, progress=workspace.progress)
            for some in (TRAIN, VAL["vehicle"])
        )
        return make_places_dataset(
            train, VEHICLES_ON_AIM, PICTURES[name], val=val, progress=workspace.progress
        )

    model = init_model(VEHICLES_ON_AIM, seed=seed)
    return train_once(model, training, load_dataset, f"compared_{PICTURES[name]}", workspace)


def _compare(
    found: Mapping[str, list[ByPlace]], metric: str, kinds: Sequence[str]
) -> dict[str, Any]:
    """Compare one metric at the places of some kinds; empty where it does not exist."""
    chosen = [number for number, (_, kind) in enumerate(TEST) if kind in kinds]
    by_column = {
        column: [
            [places[number][metric] for number in chosen if metric in places[number]]
            for places in trainings
        ]
        for column, trainings in found.items()
    }
    first = by_column["AIM"][0]
    if not first:
        return {}
    row: dict[str, Any] = {
        "agents": sum(float(one.counts.sum()) for one in first),
        "segments": sum(len(one.sums) for one in first),
        "number of places": len(first),
    }
    row |= {column: _average(some) for column, some in by_column.items() if some[0]}
    row["difference"] = row["AIM"] - row["HD map"]
    if len(first) > 1:
        row["low"], row["high"] = bootstrap_trainings(by_column["AIM"], by_column["HD map"])
    return row


def _average(trainings: Sequence[Sequence[Metric]]) -> float:
    """The mean over all summands of all trainings."""
    metrics = [metric for places in trainings for metric in places]
    return sum(m.sums.sum() for m in metrics) / sum(m.counts.sum() for m in metrics)


def _format(rows: Mapping[tuple[str, str], Mapping[str, Any]]) -> str:
    """Format the rows as a Markdown table."""
    columns = (*CASES, "recording")
    head = ("places", "metric", "number of places", "segments", *columns, "AIM minus HD map")
    lines = [
        "`python -m benchmarks.prediction aim_or_hdmap`",
        "",
        f"| {' | '.join(head)} |",
        "|" + " --- |" * len(head),
    ]
    for (where, metric), row in rows.items():
        interval = f" ({row['low']:.3g} to {row['high']:.3g})" if "low" in row else ""
        values = [f"{row[column]:.3g}" if column in row else "" for column in columns]
        lines.append(
            f"| {where} | {metric} | {row['number of places']} | {row['segments']} | "
            f"{' | '.join(values)} | {row['difference']:.3g}{interval} |"
        )
    return "\n".join(lines) + "\n"


def _draw_learning(workspace: Workspace) -> Figure:
    """Draw the errors at the validation places during the trainings."""
    figure = Figure(figsize=(6.4, 3.6), layout="constrained")
    axes = figure.subplots()
    for name, picture in PICTURES.items():
        for seed in range(SEEDS):
            folder = name_training(f"compared_{picture}", seed, workspace)
            log = pd.read_csv(folder / "log.csv")
            label = None if seed else f"{name}, {SEEDS} trainings"
            axes.plot(log["step"], log["minADE"], color=COLOURS[name], label=label)
    axes.set(xlabel="step", ylabel="minADE at validation places, m", ylim=(0, None))
    axes.legend()
    return figure
