"""Vehicles of made places: HD maps against AIM, lights, degraded maps, imagery of another day."""

from pathlib import Path

from geoaim.experiments.cases import Case, Table, run_table
from geoaim.experiments.learning import VEHICLES
from geoaim.prediction.baselines import BASELINES
from geoaim.progress import Progress

TABLE = Table(
    config=VEHICLES,
    cases={
        "HD map of roads alone": Case("vehicle_roads", "roads"),
        "HD map": Case("vehicle_hdm", "hdm"),
        "AIM": Case("vehicle_aim", "aim"),
        "AIM in colours alone": Case("vehicle_aim_colours", "aim"),
        "no map": Case("vehicle_no_map", "none"),
        "past parked cars, HD map": Case("vehicle_hdm", "hdm", "kerbside"),
        "past parked cars, AIM": Case("vehicle_aim", "aim", "kerbside"),
        "past parked cars, no map": Case("vehicle_no_map", "none", "kerbside"),
        "in the middle of lanes, HD map": Case("vehicle_hdm", "hdm", "plain"),
        "in the middle of lanes, AIM": Case("vehicle_aim", "aim", "plain"),
        "in the middle of lanes, no map": Case("vehicle_no_map", "none", "plain"),
        "blurred and noisy AIM": Case("vehicle_aim", "degraded"),
        "imagery of another day": Case("vehicle_aim", "another day"),
        "at lights, AIM": Case("vehicle_aim", "aim", "lights"),
        "at lights, AIM, lights not shown": Case("vehicle_aim_no_lights", "aim", "lights"),
        **{name: Case(name, "none") for name in BASELINES},
        "HD map, last 5 %": Case("vehicle_hdm", "hdm", "learnt"),
        "AIM, last 5 %": Case("vehicle_aim", "aim", "learnt"),
    },
    pairs=(
        ("AIM", "HD map"),
        ("AIM", "HD map of roads alone"),
        ("HD map of roads alone", "HD map"),
        ("AIM", "AIM in colours alone"),
        ("AIM", "no map"),
        ("past parked cars, AIM", "past parked cars, HD map"),
        ("past parked cars, AIM", "past parked cars, no map"),
        ("in the middle of lanes, AIM", "in the middle of lanes, HD map"),
        ("at lights, AIM", "at lights, AIM, lights not shown"),
        ("blurred and noisy AIM", "AIM"),
        ("imagery of another day", "AIM"),
    ),
    shown=("past parked cars, AIM", "past parked cars, HD map"),
    # minADE_6 and minFDE_6 (m), rates
    paper={
        "HD map": {
            "joint minADE": 0.50,
            "joint minFDE": 1.04,
            "off-road rate": 0.006,
            "collision rate": 0.012,
        },
        "AIM": {
            "joint minADE": 0.45,
            "joint minFDE": 0.93,
            "off-road rate": 0.008,
            "collision rate": 0.012,
        },
        "blurred and noisy AIM": {
            "joint minADE": 0.49,
            "joint minFDE": 1.04,
            "off-road rate": 0.015,
            "collision rate": 0.015,
        },
    },
)


def run(folder: Path, report: Progress) -> list[Path]:
    """the paper's tables of vehicles, on made places that no model has seen and on last 5 %."""
    return run_table("vehicles", TABLE, folder, report)
