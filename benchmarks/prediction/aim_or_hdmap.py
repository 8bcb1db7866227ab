"""AIM and HD map, which differ in the picture and in nothing else: vehicles at synthetic places.

Same channels, steps, seeds and schedule; the best validated step of each training; intervals over
places and trainings. The test places have seeds of their own, in proportions that were fixed
before: four junctions, two T-junctions, two roundabouts, two streets and two campuses.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from benchmarks.prediction.models import train_once
from benchmarks.prediction.places import CAMPUS, ROADS, Places, make_places
from benchmarks.prediction.protocol import VEHICLES_ON_AIM, evaluate_place, make_places_dataset
from benchmarks.prediction.results import Workspace
from geoaim.base.files import atomic_files
from geoaim.mapping.bench.report import describe_machine, write_json
from geoaim.prediction.config import configure_training
from geoaim.prediction.dataset import Dataset
from geoaim.prediction.itra import ITRA
from geoaim.prediction.metrics import Metric, bootstrap_trainings, concat
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
PICTURES = {"AIM": "aim", "HD map": "hdm"}
SEEDS, STEPS, BATCH_SIZE = 3, 2500, 48
METRICS = ("minADE", "joint minADE", "minFDE", "collision rate", "off-road rate", "red-light rate")
# expected before any test place was judged: AIM minus HD map, as a share of the HD map's value
EXPECTED = {
    "joint minADE, all places": "-8 to 0 %",
    "joint minADE, campus": "-35 to -10 %",
    "joint minADE, public roads": "-3 to +3 %",
}
ByPlace = list[Mapping[str, Metric]]


def run(workspace: Workspace) -> list[Path]:
    """Compare vehicles on AIM and HD map, over places and trainings; return the files."""
    make_places(workspace.places, (*TRAIN, *TEST), progress=workspace.progress)
    found = {name: _evaluate(name, workspace) for name in PICTURES}
    kinds = {"all places": [kind for _, kind in TEST]} | {kind: [kind] for _, kind in TEST}
    rows = {
        (where, metric): row
        for where, some in kinds.items()
        for metric in METRICS
        if (row := _compare(found, metric, some))
    }
    paths = [workspace.results / f"aim_or_hdmap{suffix}" for suffix in (".json", ".md")]
    content = {
        "command": "python -m benchmarks.prediction aim_or_hdmap",
        "machine": describe_machine(),
        "training": {"steps": STEPS, "batch": BATCH_SIZE, "trainings": SEEDS, "places": TRAIN},
        "test places": TEST,
        "expected": EXPECTED,
        "results": [
            {"places": where, "metric": metric, **row} for (where, metric), row in rows.items()
        ],
    }
    with atomic_files(*paths) as parts:
        write_json(content, parts[0])
        parts[1].write_text(_format(rows), encoding="utf-8")
    return paths


def _evaluate(name: str, workspace: Workspace) -> list[ByPlace]:
    """Metrics of each training at each test place."""
    found: list[ByPlace] = []
    for seed in range(SEEDS):
        model = _train(name, seed, workspace)
        places = make_places(workspace.places, TEST, progress=workspace.progress)
        found.append(
            [
                concat(evaluate_place(model.sample, place, VEHICLES_ON_AIM, PICTURES[name]))
                for place in places
            ]
        )
    return found


def _train(name: str, seed: int, workspace: Workspace) -> ITRA:
    training = replace(configure_training("vehicle", steps=STEPS, batch_size=BATCH_SIZE), seed=seed)

    def load_dataset() -> Dataset:
        places = make_places(workspace.places, TRAIN, progress=workspace.progress)
        return make_places_dataset(
            places, VEHICLES_ON_AIM, PICTURES[name], progress=workspace.progress
        )

    model = init_model(VEHICLES_ON_AIM, seed=seed)
    return train_once(model, training, load_dataset, f"compared_{PICTURES[name]}", workspace)


def _compare(
    found: Mapping[str, list[ByPlace]], metric: str, kinds: Sequence[str]
) -> dict[str, Any]:
    """Compare one metric at the places of some kinds; empty where it does not exist."""
    chosen = [number for number, (_, kind) in enumerate(TEST) if kind in kinds]
    by_name = {
        name: [
            [places[number][metric] for number in chosen if metric in places[number]]
            for places in trainings
        ]
        for name, trainings in found.items()
    }
    first = next(iter(by_name.values()))[0]
    if not first:
        return {}
    row: dict[str, Any] = {
        "agents": sum(float(one.counts.sum()) for one in first),
        "segments": sum(len(one.sums) for one in first),
        "places": len(first),
    }
    row |= {name: _average(trainings) for name, trainings in by_name.items()}
    aim, hdm = by_name.values()
    row["difference"] = row["AIM"] - row["HD map"]
    if len(first) > 1:
        row["low"], row["high"] = bootstrap_trainings(aim, hdm)
    return row


def _average(trainings: Sequence[Sequence[Metric]]) -> float:
    """The mean over all summands of all trainings."""
    metrics = [metric for places in trainings for metric in places]
    return sum(m.sums.sum() for m in metrics) / sum(m.counts.sum() for m in metrics)


def _format(rows: Mapping[tuple[str, str], Mapping[str, Any]]) -> str:
    """Format the rows as a Markdown table."""
    lines = [
        "`python -m benchmarks.prediction aim_or_hdmap`",
        "",
        "| places | metric | places | segments | AIM | HD map | AIM minus HD map |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for (where, metric), row in rows.items():
        interval = f" ({row['low']:.3g} to {row['high']:.3g})" if "low" in row else ""
        lines.append(
            f"| {where} | {metric} | {row['places']} | {row['segments']} | {row['AIM']:.3g} | "
            f"{row['HD map']:.3g} | {row['difference']:.3g}{interval} |"
        )
    return "\n".join(lines) + "\n"
