"""The models that come with the package: their training, and their evaluation at test places."""

import shutil
from pathlib import Path

from benchmarks.prediction.models import train_model
from benchmarks.prediction.places import TEST, TRAIN, make_places
from benchmarks.prediction.protocol import PEDESTRIANS, VEHICLES
from benchmarks.prediction.results import Workspace, write_results
from benchmarks.prediction.tables import Case, evaluate_case
from geoaim.base.files import atomic_write
from geoaim.prediction.baselines import BASELINES


def run(workspace: Workspace) -> list[Path]:
    """Train and test the two pretrained models at synthetic places; return the files."""
    written, metrics = [], {}
    for config in (VEHICLES, PEDESTRIANS):
        kind, name = config.kind, f"{config.kind}_aim"
        places = make_places(workspace.places, TEST[kind], progress=workspace.progress)
        model = train_model(name, workspace)
        path = workspace.folder / "pretrained" / f"{kind}.pt"
        with atomic_write(path) as temporary:
            shutil.copyfile(workspace.models / name / "model.pt", temporary)
        written.append(path)
        metrics[f"{kind}s, ITRA"] = evaluate_case(model.sample, Case(name, "aim"), config, places)
        for rule, predictor in BASELINES.items():
            case = Case(rule, "none")
            metrics[f"{kind}s, {rule}"] = evaluate_case(predictor, case, config, places)
    settings = {"training places": TRAIN, "test places": TEST}
    return [*written, *write_results("pretrained", metrics, settings, workspace.results)]
