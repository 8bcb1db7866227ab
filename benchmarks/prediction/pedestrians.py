"""Pedestrians at synthetic places: HD maps and AIM, in parks and along roads."""

from pathlib import Path

from benchmarks.prediction.protocol import PEDESTRIANS
from benchmarks.prediction.results import Workspace
from benchmarks.prediction.tables import Case, Table, run_table
from geoaim.prediction.baselines import BASELINES

TABLE = Table(
    config=PEDESTRIANS,
    cases={
        "HD map": Case("pedestrian_hdm", "hdm"),
        "HD map with walkways": Case("pedestrian_full", "full"),
        "AIM": Case("pedestrian_aim", "aim"),
        "no map": Case("pedestrian_no_map", "none"),
        "in parks, HD map": Case("pedestrian_hdm", "hdm", "parks"),
        "in parks, HD map with walkways": Case("pedestrian_full", "full", "parks"),
        "in parks, AIM": Case("pedestrian_aim", "aim", "parks"),
        "in parks, no map": Case("pedestrian_no_map", "none", "parks"),
        "along roads, HD map": Case("pedestrian_hdm", "hdm", "plain"),
        "along roads, AIM": Case("pedestrian_aim", "aim", "plain"),
        **{name: Case(name, "none") for name in BASELINES},
        "HD map, last 5 %": Case("pedestrian_hdm", "hdm", "validation"),
        "AIM, last 5 %": Case("pedestrian_aim", "aim", "validation"),
    },
    pairs=(
        ("AIM", "HD map"),
        ("AIM", "HD map with walkways"),
        ("AIM", "no map"),
        ("in parks, AIM", "in parks, HD map"),
        ("in parks, AIM", "in parks, HD map with walkways"),
        ("in parks, AIM", "in parks, no map"),
        ("along roads, AIM", "along roads, HD map"),
    ),
    shown=("in parks, AIM", "in parks, HD map"),
    time=60.0,
)


def run(workspace: Workspace) -> list[Path]:
    """Write the paper's table of pedestrians, at synthetic places; return the files."""
    return run_table("pedestrians", TABLE, workspace)
