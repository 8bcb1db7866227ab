"""Vehicles at synthetic places: HD maps and AIM, lights, degraded maps, imagery of another day."""

from pathlib import Path

from benchmarks.prediction.protocol import VEHICLES
from benchmarks.prediction.results import Workspace
from benchmarks.prediction.tables import Case, Table, run_table
from geoaim.prediction.baselines import BASELINES

TABLE = Table(
    config=VEHICLES,
    cases={
        "HD map": Case("vehicle_hdm", "hdm"),
        "AIM": Case("vehicle_aim", "aim"),
        "no map": Case("vehicle_no_map", "none"),
        "with private roads, HD map": Case("vehicle_hdm", "hdm", "campus"),
        "with private roads, AIM": Case("vehicle_aim", "aim", "campus"),
        "with private roads, no map": Case("vehicle_no_map", "none", "campus"),
        "along public roads, HD map": Case("vehicle_hdm", "hdm", "plain"),
        "along public roads, AIM": Case("vehicle_aim", "aim", "plain"),
        "along public roads, no map": Case("vehicle_no_map", "none", "plain"),
        "blurred and noisy AIM": Case("vehicle_aim", "degraded"),
        "imagery of another day": Case("vehicle_aim", "another day"),
        "at lights, AIM": Case("vehicle_aim", "aim", "lights"),
        "at lights, AIM, lights not shown": Case("vehicle_aim_no_lights", "aim", "lights"),
        **{name: Case(name, "none") for name in BASELINES},
        "HD map, last 5 %": Case("vehicle_hdm", "hdm", "validation"),
        "AIM, last 5 %": Case("vehicle_aim", "aim", "validation"),
    },
    pairs=(
        ("AIM", "HD map"),
        ("AIM", "no map"),
        ("with private roads, AIM", "with private roads, HD map"),
        ("with private roads, AIM", "with private roads, no map"),
        ("along public roads, AIM", "along public roads, HD map"),
        ("at lights, AIM", "at lights, AIM, lights not shown"),
        ("blurred and noisy AIM", "AIM"),
        ("imagery of another day", "AIM"),
    ),
    shown=("with private roads, AIM", "with private roads, HD map"),
    time=90.0,
)


def run(workspace: Workspace) -> list[Path]:
    """Write the paper's tables of vehicles, at synthetic places; return the files."""
    return run_table("vehicles", TABLE, workspace)
