"""The paper's tables on made places: HD map against AIM, lights, degraded and other imagery."""

from collections.abc import Mapping
from pathlib import Path

from geoaim.experiments.learning import PEOPLE, VEHICLES, judge
from geoaim.experiments.models import trained
from geoaim.experiments.places import TEST, TRAIN, Report, make_places
from geoaim.experiments.results import write_results
from geoaim.prediction.baselines import BASELINES
from geoaim.prediction.itra import ITRA, Config
from geoaim.prediction.metrics import Measure, interval, summary

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
    ("vehicles, AIM", "vehicles, HD map"),
    ("vehicles at lights, AIM", "vehicles at lights, AIM, lights not shown"),
    ("vehicles, blurred and noisy AIM", "vehicles, AIM"),
    ("vehicles, imagery of another day", "vehicles, AIM"),
)
Table = dict[str, dict[str, Measure]]


def run(folder: Path, report: Report) -> list[Path]:
    """the paper's tables on made places that no model has seen, and on recordings' last 5 %."""
    test = make_places(folder / "places", TEST, report=report)
    seen = make_places(folder / "places", TRAIN, report=report)
    lit = [place for place in test if place.name.startswith("junction")]
    models = {
        name: trained(name, folder, report=report)
        for name in (
            *("pedestrian_hdm", "pedestrian_aim", "vehicle_hdm", "vehicle_aim"),
            "vehicle_aim_no_lights",
        )
    }
    people, vehicles = models["pedestrian_aim"], models["vehicle_aim"]
    tables: Table = {}

    def add(name: str, model: ITRA | str, places: list[Path], config: Config, map_: str) -> None:
        shown = "not shown" not in name
        part = "last" if "last 5 %" in name else "all"
        tables[name] = judge(model, places, config, map_, part=part, lights=shown)

    add("people, HD map", models["pedestrian_hdm"], test, PEOPLE, "hdm")
    add("people, AIM", people, test, PEOPLE, "aim")
    add("vehicles, HD map", models["vehicle_hdm"], test, VEHICLES, "hdm")
    add("vehicles, AIM", vehicles, test, VEHICLES, "aim")
    add("vehicles, blurred and noisy AIM", vehicles, test, VEHICLES, "degraded")
    add("vehicles, imagery of another day", vehicles, test, VEHICLES, "another day")
    add("vehicles at lights, AIM", vehicles, lit, VEHICLES, "aim")
    blind = models["vehicle_aim_no_lights"]
    add("vehicles at lights, AIM, lights not shown", blind, lit, VEHICLES, "aim")
    for name in BASELINES:
        add(f"people, {name}", name, test, PEOPLE, "none")
        add(f"vehicles, {name}", name, test, VEHICLES, "none")
    for kind, config, shown in (("people", PEOPLE, people), ("vehicles", VEHICLES, vehicles)):
        model = models["pedestrian_hdm" if config is PEOPLE else "vehicle_hdm"]
        add(f"{kind}, AIM, last 5 %", shown, seen, config, "aim")
        add(f"{kind}, HD map, last 5 %", model, seen, config, "hdm")
    about = {
        "places to learn from": TRAIN,
        "places to be judged on": TEST,
        "differences": differences(tables),
        "paper": PAPER,
    }
    return write_results("synthetic", {name: summary(t) for name, t in tables.items()}, about)


def differences(tables: Table) -> dict[str, Mapping[str, tuple[float, float]]]:
    """Each pair's first less its second, as an interval of 95 % over the same segments."""
    found: dict[str, Mapping[str, tuple[float, float]]] = {}
    for one, two in PAIRS:
        names = [name for name in tables[one] if name in tables[two]]
        found[f"{one}, less {two}"] = {
            name: interval(tables[one][name], tables[two][name]) for name in names
        }
    return found
