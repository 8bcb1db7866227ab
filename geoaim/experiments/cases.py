"""Cases of the paper's tables: whose model, on which map, of which made places."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from geoaim.errors import TracksError
from geoaim.experiments.figures import write_futures_on_maps
from geoaim.experiments.learning import judge_at
from geoaim.experiments.models import RECIPES, all_trained
from geoaim.experiments.places import TEST, TRAIN, make_places
from geoaim.experiments.results import Measures, differences, means, write_results
from geoaim.prediction.itra import ITRA, Config
from geoaim.prediction.lessons import HELD_OUT
from geoaim.prediction.metrics import Measure, merged, pooled
from geoaim.progress import Progress
from geoaim.synthetic.roads.layouts import PLACE_KINDS, STANDARD_KINDS, PlaceKind

Judge = Callable[..., list[dict[str, Measure]]]
WHERE: Mapping[str, Sequence[PlaceKind]] = {
    "new": PLACE_KINDS,
    "learnt": PLACE_KINDS,
    "lights": ("junction",),
    "plain": STANDARD_KINDS,
    "parks": ("park",),
    "campus": ("campus",),
}


@dataclass(frozen=True)
class Case:
    """Who is judged, and on what.

    Attributes:
        model: one of `RECIPES` or of `BASELINES`.
        map: one of `MAPS`.
        where: one of `WHERE`: new places, or the ends of recordings "learnt" from.
    """

    model: str
    map: str
    where: str = "new"


@dataclass(frozen=True)
class Table:
    """Cases that stand side by side.

    Attributes:
        config: whose segments.
        cases: by name.
        pairs: names of cases whose difference is asked for.
        shown: names of cases to draw, of different models, on the maps that they learnt from, at
            the first place of the first of them.
        time: s of its recording after which futures are drawn.
        paper: figures of the paper's tables.
    """

    config: Config
    cases: Mapping[str, Case]
    pairs: Sequence[tuple[str, str]]
    shown: Sequence[str]
    time: float
    paper: Mapping[str, Mapping[str, float]]


def run_table(name: str, table: Table, folder: Path, report: Progress) -> list[Path]:
    """Make places, train models, judge all cases; the written files, with a picture."""
    kind = table.config.kind
    make_places(folder / "places", (*TRAIN[kind], *TEST[kind]), report=report)
    asked = dict.fromkeys(case.model for case in table.cases.values())
    models = {one: all_trained(one, folder, report=report) for one in asked if one in RECIPES}
    judge_once = cache(judge_at)  # places of some kinds are among all the new ones
    tables: dict[str, Measures] = {}
    single: dict[str, list[dict[str, float]]] = {}
    for number, (title, case) in enumerate(table.cases.items()):
        report("judge", number, len(table.cases))
        places = places_of(case, kind, folder)
        found = [
            _judged(judge_once, model, case, table.config, places)
            for model in models.get(case.model, [case.model])
        ]
        tables[title] = pooled(found)
        if len(found) > 1:
            single[title] = means(found)
    about = {
        "places to learn from": TRAIN[kind],
        "places to be judged on": TEST[kind],
        "differences": {
            f"{one}, less {two}": differences(tables[one], tables[two]) for one, two in table.pairs
        },
        "each training, where there are more than one": single,
        "paper": table.paper,
    }
    written = write_results(name, tables, about)
    picture = written[0].with_suffix(".png")
    shown = [table.cases[title] for title in table.shown]
    place = places_of(shown[0], kind, folder)[0]
    write_futures_on_maps({c.model: models[c.model][0] for c in shown}, place, table.time, picture)
    return [*written, picture]


def _judged(
    judge_once: Judge, model: ITRA | str, case: Case, config: Config, places: Sequence[Path]
) -> dict[str, Measure]:
    """A case by one of its model's trainings, or by a baseline."""
    end = HELD_OUT if case.where == "learnt" else 1.0
    lights = case.model not in RECIPES or RECIPES[case.model].lights
    parts = [judge_once(model, at, config, case.map, end=end, lights=lights) for at in places]
    if not any(parts):
        raise TracksError(
            f"{case}: no {config.kind} is there for long enough at {len(places)} places"
        )
    return merged([one for part in parts for one in part])


def places_of(case: Case, kind: str, folder: Path) -> list[Path]:
    """The places of a case, which are there already."""
    kinds = WHERE[case.where]
    places = (TRAIN if case.where == "learnt" else TEST)[kind]
    return make_places(folder / "places", [place for place in places if place[1] in kinds])
