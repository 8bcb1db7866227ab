"""What bad maps cost the models that come with the package: blur and noise, shift and scale."""

from collections.abc import Callable, Mapping
from pathlib import Path

from benchmarks.prediction.places import TEST, make_places, misplace_map, read_map
from benchmarks.prediction.protocol import evaluate_on_map
from benchmarks.prediction.results import Metrics, Workspace, compute_differences, write_results
from geoaim.aim.aim import AIM
from geoaim.prediction.checkpoints import read_pretrained
from geoaim.prediction.metrics import concat

CLEAN = "clean map"
CHANGES: Mapping[str, Callable[[Path], AIM]] = {
    CLEAN: lambda place: read_map(place, "aim"),
    "blurred and noisy": lambda place: read_map(place, "degraded"),
    "another day": lambda place: read_map(place, "another day"),
    "shifted by 1 m": lambda place: misplace_map(read_map(place, "aim"), shift=1.0),
    "3 % too large": lambda place: misplace_map(read_map(place, "aim"), scale=1.03),
}
TEST_FRACTION = 0.25  # of each recording, at its end: two and a half minutes
COSTS = ("minADE", "joint minADE")


def run(workspace: Workspace) -> list[Path]:
    """Evaluate the pretrained models on changed maps of the test places; return the files."""
    metrics: dict[str, Metrics] = {}
    costs: dict[str, dict[str, list[float]]] = {}
    for kind in TEST:
        places = make_places(workspace.places, TEST[kind], progress=workspace.progress)
        found = {}
        for number, (name, change) in enumerate(CHANGES.items()):
            workspace.progress(f"evaluate {kind}s", number, len(CHANGES))
            found[name] = _evaluate(kind, places, change)
            metrics[f"{kind}s, {name}"] = found[name]
            costs[f"{kind}s, {name}"] = _compute_costs(found[name], found[CLEAN])
    settings = {"test places": TEST, "cost as a share of the clean map's error": costs}
    return write_results("robust", metrics, settings, workspace.results)


def _evaluate(kind: str, places: list[Path], change: Callable[[Path], AIM]) -> Metrics:
    """Evaluate a model on changed maps."""
    model, parts = read_pretrained(kind), []
    for place in places:
        given = model.sample, place, model.config, change(place)
        parts += evaluate_on_map(*given, fraction=TEST_FRACTION)
    return concat(parts)


def _compute_costs(changed: Metrics, clean: Metrics) -> dict[str, list[float]]:
    """Share by which each error grows, and its 95 % interval over segments."""
    costs = {}
    for name in COSTS:
        before, interval = clean[name].mean, compute_differences(changed, clean)[name]
        costs[name] = [
            round(value / before, 4) for value in (changed[name].mean - before, *interval)
        ]
    return costs
