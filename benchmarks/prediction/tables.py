"""Tables of results: each row is a model or baseline, on a map, at some synthetic places."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.prediction import results
from benchmarks.prediction.averages import average_seeds
from benchmarks.prediction.figures import draw_futures_on_maps
from benchmarks.prediction.models import MODELS, train_all_seeds
from benchmarks.prediction.places import TEST, TRAIN, make_places
from benchmarks.prediction.protocol import evaluate_place
from benchmarks.synthetic.roads.layouts import PLACE_KINDS, STANDARD_KINDS, PlaceKind
from geoaim.base.errors import TracksError
from geoaim.prediction.baselines import BASELINES, Predictor
from geoaim.prediction.config import Config
from geoaim.prediction.dataset import VAL_FRACTION
from geoaim.prediction.metrics import Metric, concat

SUBSETS: Mapping[str, Sequence[PlaceKind]] = {
    "test": PLACE_KINDS,
    "validation": PLACE_KINDS,
    "lights": ("junction",),
    "plain": STANDARD_KINDS,
    "parks": ("park",),
    "campus": ("campus",),
}


@dataclass(frozen=True)
class Case:
    """A row of a table."""

    model: str  # one of `MODELS` or of `BASELINES`
    map_name: str  # one of `MAPS`
    # one of `SUBSETS`: test places of some kinds, or the ends of the recordings of training places
    # ("validation")
    subset: str = "test"


@dataclass(frozen=True)
class Table:
    """The rows of a table, and what is shown beside them."""

    config: Config  # agent group, dt and resolution of the segments
    cases: Mapping[str, Case]  # cases by name
    pairs: Sequence[tuple[str, str]]  # names of cases whose difference is reported
    # names of cases of different models, drawn on the maps that they are trained on, at the first
    # place of the first case
    shown: Sequence[str]
    time: float  # s of the recording after which the drawn futures begin


def run_table(name: str, table: Table, workspace: results.Workspace) -> list[Path]:
    """Make places, train models, evaluate all cases, and write the table with a figure.

    Args:
        name: name of the experiment.
        table: its rows.
        workspace: the folder to read from and to write to.

    Returns:
        Paths of the written files.
    """
    kind, progress = table.config.kind, workspace.progress
    make_places(workspace.places, (*TRAIN[kind], *TEST[kind]), progress=progress)
    names = dict.fromkeys(case.model for case in table.cases.values() if case.model in MODELS)
    models = {one: train_all_seeds(one, workspace) for one in names}
    predictors: dict[str, list[Predictor]] = {name: [one] for name, one in BASELINES.items()}
    predictors |= {name: [model.sample for model in trained] for name, trained in models.items()}
    metrics: dict[str, results.Metrics] = {}
    by_seed: dict[str, list[dict[str, float]]] = {}
    for number, (title, case) in enumerate(table.cases.items()):
        progress("evaluate", number, len(table.cases))
        places = _find_places(case, kind, workspace.places)
        parts = [evaluate_case(one, case, table.config, places) for one in predictors[case.model]]
        metrics[title] = average_seeds(parts)
        if len(parts) > 1:
            by_seed[title] = results.compute_seed_means(parts)
    settings = {
        "training places": TRAIN[kind],
        "test places": TEST[kind],
        "differences": {
            f"{one} minus {other}": results.compute_differences(metrics[one], metrics[other])
            for one, other in table.pairs
        },
        "by seed": by_seed,
    }
    shown = [table.cases[title] for title in table.shown]
    place = _find_places(shown[0], kind, workspace.places)[0]
    figure = draw_futures_on_maps(
        {case.model: models[case.model][0] for case in shown}, place, table.time
    )
    return results.write_results(name, metrics, settings, workspace.results, figure=figure)


def _find_places(case: Case, kind: str, folder: Path) -> list[Path]:
    """Find the folders of a case's places; those that are missing are made."""
    places = (TRAIN if case.subset == "validation" else TEST)[kind]
    kinds = SUBSETS[case.subset]
    return make_places(folder, [place for place in places if place[1] in kinds])


def evaluate_case(
    predictor: Predictor, case: Case, config: Config, places: Sequence[Path]
) -> dict[str, Metric]:
    """Evaluate a predictor on the recordings of several places.

    Args:
        predictor: a model's `sample`, or one of `BASELINES`.
        case: its map, and whether it is shown lights and whole recordings.
        config: agent group, dt and resolution.
        places: folders of the places.

    Returns:
        Metrics by name.

    Raises:
        TracksError: no agent of the group is present for long enough.
    """
    fraction = VAL_FRACTION if case.subset == "validation" else 1.0
    lights = case.model not in MODELS or MODELS[case.model].lights
    parts = [
        part
        for place in places
        for part in evaluate_place(
            predictor,  # type: ignore[arg-type] # a function, which can be hashed
            place,
            config,
            case.map_name,
            fraction=fraction,
            lights=lights,
        )
    ]
    if not parts:
        raise TracksError(
            f"{case}: no {config.kind} is present for long enough at {len(places)} places"
        )
    return concat(parts)
