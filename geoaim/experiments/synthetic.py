"""The paper's tables on made places: HD map against AIM, lights, degraded and other imagery."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from geoaim.experiments.figures import write_futures_on_maps
from geoaim.experiments.learning import PEOPLE, VEHICLES, judge
from geoaim.experiments.models import RECIPES, all_trained
from geoaim.experiments.places import TEST, TRAIN, make_places
from geoaim.experiments.results import Measures, differences, means, write_results
from geoaim.prediction.baselines import BASELINES
from geoaim.prediction.itra import ITRA, Config
from geoaim.prediction.lessons import HELD_OUT
from geoaim.prediction.metrics import Measure, pooled
from geoaim.progress import Progress
from geoaim.synthetic.roads.layouts import ALONG_ROADS, KINDS, Kind

# of the paper's tables: minADE_6 (m), minFDE_6, then MFD or off-road and collision rates
PAPER = {
    "people, HD map": {"joint minADE": 0.90, "joint minFDE": 2.01, "MFD": 0.29},
    "people, AIM": {"joint minADE": 0.74, "joint minFDE": 1.56, "MFD": 0.51},
    "vehicles, HD map": {
        "joint minADE": 0.50,
        "joint minFDE": 1.04,
        "off-road rate": 0.006,
        "collision rate": 0.012,
    },
    "vehicles, AIM": {
        "joint minADE": 0.45,
        "joint minFDE": 0.93,
        "off-road rate": 0.008,
        "collision rate": 0.012,
    },
    "vehicles, blurred and noisy AIM": {
        "joint minADE": 0.49,
        "joint minFDE": 1.04,
        "off-road rate": 0.015,
        "collision rate": 0.015,
    },
}
PAIRS = (
    ("people, AIM", "people, HD map"),
    ("people, AIM", "people, HD map of roads alone"),
    ("people, AIM", "people, HD map with walkways"),
    ("people, HD map of roads alone", "people, HD map"),
    ("people, AIM", "people, no map"),
    ("people in parks, AIM", "people in parks, HD map"),
    ("people in parks, AIM", "people in parks, HD map with walkways"),
    ("people in parks, AIM", "people in parks, no map"),
    ("people along roads, AIM", "people along roads, HD map"),
    ("vehicles, AIM", "vehicles, HD map"),
    ("vehicles, AIM", "vehicles, HD map of roads alone"),
    ("vehicles, HD map of roads alone", "vehicles, HD map"),
    ("vehicles, AIM", "vehicles, AIM in colours alone"),
    ("vehicles, AIM", "vehicles, no map"),
    ("vehicles at lights, AIM", "vehicles at lights, AIM, lights not shown"),
    ("vehicles, blurred and noisy AIM", "vehicles, AIM"),
    ("vehicles, imagery of another day", "vehicles, AIM"),
)
SHOWN = (  # each at the first of its places
    "people in parks, AIM",
    "people in parks, HD map",
    "vehicles, AIM",
    "vehicles, HD map",
)
WHERE: Mapping[str, Sequence[Kind]] = {
    "new": KINDS,
    "learnt": KINDS,
    "lights": ("junction",),
    "roads": ALONG_ROADS,
    "parks": ("park",),
}


@dataclass(frozen=True)
class Case:
    """Who is judged, and on what.

    Attributes:
        model: one of `RECIPES` or of `BASELINES`.
        map: one of `MAPS`.
        config: whose segments.
        where: one of `WHERE`: new places, or the ends of recordings "learnt" from.
    """

    model: str
    map: str
    config: Config
    where: str = "new"


CASES = {
    "people, HD map of roads alone": Case("pedestrian_roads", "roads", PEOPLE),
    "people, HD map": Case("pedestrian_hdm", "hdm", PEOPLE),
    "people, HD map with walkways": Case("pedestrian_full", "full", PEOPLE),
    "people, AIM": Case("pedestrian_aim", "aim", PEOPLE),
    "people, no map": Case("pedestrian_no_map", "none", PEOPLE),
    "people in parks, HD map": Case("pedestrian_hdm", "hdm", PEOPLE, "parks"),
    "people in parks, HD map with walkways": Case("pedestrian_full", "full", PEOPLE, "parks"),
    "people in parks, AIM": Case("pedestrian_aim", "aim", PEOPLE, "parks"),
    "people in parks, no map": Case("pedestrian_no_map", "none", PEOPLE, "parks"),
    "people along roads, HD map": Case("pedestrian_hdm", "hdm", PEOPLE, "roads"),
    "people along roads, AIM": Case("pedestrian_aim", "aim", PEOPLE, "roads"),
    "vehicles, HD map of roads alone": Case("vehicle_roads", "roads", VEHICLES),
    "vehicles, HD map": Case("vehicle_hdm", "hdm", VEHICLES),
    "vehicles, AIM": Case("vehicle_aim", "aim", VEHICLES),
    "vehicles, AIM in colours alone": Case("vehicle_aim_colours", "aim", VEHICLES),
    "vehicles, no map": Case("vehicle_no_map", "none", VEHICLES),
    "vehicles, blurred and noisy AIM": Case("vehicle_aim", "degraded", VEHICLES),
    "vehicles, imagery of another day": Case("vehicle_aim", "another day", VEHICLES),
    "vehicles at lights, AIM": Case("vehicle_aim", "aim", VEHICLES, "lights"),
    "vehicles at lights, AIM, lights not shown": Case(
        "vehicle_aim_no_lights", "aim", VEHICLES, "lights"
    ),
    **{f"people, {name}": Case(name, "none", PEOPLE) for name in BASELINES},
    **{f"vehicles, {name}": Case(name, "none", VEHICLES) for name in BASELINES},
    "people, HD map, last 5 %": Case("pedestrian_hdm", "hdm", PEOPLE, "learnt"),
    "people, AIM, last 5 %": Case("pedestrian_aim", "aim", PEOPLE, "learnt"),
    "vehicles, HD map, last 5 %": Case("vehicle_hdm", "hdm", VEHICLES, "learnt"),
    "vehicles, AIM, last 5 %": Case("vehicle_aim", "aim", VEHICLES, "learnt"),
}


def run(folder: Path, report: Progress) -> list[Path]:
    """the paper's tables on made places that no model has seen, and on recordings' last 5 %."""
    every = (*TRAIN["pedestrian"], *TEST["pedestrian"])  # vehicles' places are among them
    make_places(folder / "places", every, report=report)
    models = {name: all_trained(name, folder, report=report) for name in RECIPES}
    tables: dict[str, Measures] = {}
    single: dict[str, list[dict[str, float]]] = {}
    for number, (name, case) in enumerate(CASES.items()):
        report("judge", number, len(CASES))
        found = [_judged(case, model, folder) for model in models.get(case.model, [case.model])]
        tables[name] = pooled(found)
        if len(found) > 1:
            single[name] = means(found)
    about = {
        "places to learn from": TRAIN,
        "places to be judged on": TEST,
        "differences": {
            f"{one}, less {two}": differences(tables[one], tables[two]) for one, two in PAIRS
        },
        "each training, where there are more than one": single,
        "paper": PAPER,
    }
    written = write_results("synthetic", tables, about)
    shown = [CASES[name] for name in SHOWN]
    panels = {case.model: (models[case.model][0], _places(folder, case)[0]) for case in shown}
    write_futures_on_maps(panels, written[0].with_suffix(".png"))
    return [*written, written[0].with_suffix(".png")]


def _judged(case: Case, model: ITRA | str, folder: Path) -> dict[str, Measure]:
    """A case by one of its model's trainings, or by a baseline."""
    return judge(
        model,
        _places(folder, case),
        case.config,
        case.map,
        end=HELD_OUT if case.where == "learnt" else 1.0,
        lights=case.model not in RECIPES or RECIPES[case.model].lights,
    )


def _places(folder: Path, case: Case) -> list[Path]:
    """The places of a case, which are there already."""
    kinds = WHERE[case.where]
    places = (TRAIN if case.where == "learnt" else TEST)[case.config.kind]
    return make_places(folder / "places", [place for place in places if place[1] in kinds])
