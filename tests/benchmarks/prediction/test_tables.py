from dataclasses import dataclass, replace
from functools import cache
from types import SimpleNamespace

import numpy as np

from benchmarks.prediction import EXPERIMENTS, pedestrians, tables, vehicles
from benchmarks.prediction.models import MODELS
from benchmarks.prediction.places import MAPS, TRAIN
from benchmarks.prediction.results import Workspace
from geoaim.prediction.baselines import BASELINES
from geoaim.prediction.dataset import VAL_FRACTION
from geoaim.prediction.metrics import Metric


@dataclass(frozen=True)
class Fake:
    """A predictor with a given error."""

    error: float

    def __call__(self, segments, ground, **options):
        raise AssertionError


def test_every_experiment_has_a_description():
    assert all(run.__doc__ for run in EXPERIMENTS.values())


def test_cases_are_evaluated_at_their_places(monkeypatch, tmp_path):
    monkeypatch.setattr(
        tables, "make_places", lambda folder, places: [folder / kind for _, kind in places]
    )
    walking, driving = (
        {
            name: sorted(
                place.name for place in tables._find_places(case, table.config.kind, tmp_path)
            )
            for name, case in table.cases.items()
        }
        for table in (pedestrians.TABLE, vehicles.TABLE)
    )
    assert set(walking["in parks, AIM"]) == {"park"}
    assert walking["AIM"] == sorted(walking["in parks, AIM"] + walking["along roads, AIM"])
    assert len(walking["AIM, last 5 %"]) == len(TRAIN["pedestrian"])
    assert set(driving["with private roads, AIM"]) == {"campus"}
    parts = driving["with private roads, AIM"] + driving["along public roads, AIM"]
    assert driving["AIM"] == sorted(parts)
    assert set(driving["at lights, AIM"]) == {"junction"}
    for table in (pedestrians.TABLE, vehicles.TABLE):
        assert {*table.shown, *(name for pair in table.pairs for name in pair)} <= set(table.cases)
        for case in table.cases.values():
            assert case.model in {*MODELS, *BASELINES}
            assert case.map_name in MAPS


def test_seeds_of_a_model_are_averaged(monkeypatch, tmp_path):
    """Two trainings with errors of 1 m and 3 m have an average error of 2 m."""
    calls, written, drawn = [], {}, {}

    def evaluate_place(predictor, place, config, map_name, *, fraction, lights):
        calls.append((predictor.error, place.name, map_name, fraction, lights))
        return [{"minADE": Metric(np.full(4, predictor.error), np.ones(4))}]

    def write_results(name, metrics, settings, folder, *, figure):
        written.update(metrics=metrics, settings=settings)
        return [folder / f"{name}.json"]

    every = vehicles.TABLE.cases
    some = {name: every[name] for name in ("AIM", "at lights, AIM", "AIM, last 5 %")}
    unlit = {"no lights": every["at lights, AIM, lights not shown"]}
    table = replace(vehicles.TABLE, cases=some | unlit, pairs=(("AIM", "AIM"),), shown=("AIM",))
    models = [SimpleNamespace(sample=Fake(1.0)), SimpleNamespace(sample=Fake(3.0))]
    fakes = {
        "draw_futures_on_maps": lambda models, *_: drawn.update(models),
        "make_places": lambda folder, places, **_: [
            tmp_path / kind for kind in {k for _, k in places}
        ],
        "train_all_seeds": lambda name, workspace: models,
        "evaluate_place": cache(evaluate_place),
    }
    monkeypatch.setattr(tables.results, "write_results", write_results)
    for name, fake in fakes.items():
        monkeypatch.setattr(tables, name, fake)
    tables.run_table("vehicles", table, Workspace(tmp_path, tmp_path))
    assert written["metrics"]["AIM"]["minADE"].mean == 2
    assert (1.0, "junction", "aim", 1.0, True) in calls
    assert (3.0, "junction", "aim", 1.0, False) in calls
    assert (3.0, "street", "aim", VAL_FRACTION, True) in calls  # at training places only
    assert drawn == {"vehicle_aim": models[0]}
    each = written["settings"]["by seed"]["AIM"]
    assert [one["minADE"] for one in each] == [1, 3]
