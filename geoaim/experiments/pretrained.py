"""The models that come with the package: their training, and their evaluation at test places."""

import shutil
from pathlib import Path

from geoaim.experiments.models import train_model
from geoaim.experiments.places import TEST, TRAIN, make_places
from geoaim.experiments.protocol import PEDESTRIANS, VEHICLES, evaluate_places
from geoaim.experiments.results import Workspace, write_results
from geoaim.files import atomic_write
from geoaim.prediction.baselines import BASELINES


def run(workspace: Workspace) -> list[Path]:
    """The two pretrained models, trained and tested at synthetic places."""
    written, metrics = [], {}
    for config in (VEHICLES, PEDESTRIANS):
        kind = config.kind
        places = make_places(workspace.places, TEST[kind], progress=workspace.progress)
        model = train_model(f"{kind}_aim", workspace)
        path = workspace.folder / "pretrained" / f"{kind}.pt"
        with atomic_write(path) as temporary:
            shutil.copyfile(workspace.models / f"{kind}_aim" / "model.pt", temporary)
        written.append(path)
        metrics[f"{kind}s, ITRA"] = evaluate_places(model.sample, places, config, "aim")
        for name, predictor in BASELINES.items():
            metrics[f"{kind}s, {name}"] = evaluate_places(predictor, places, config, "none")
    settings = {"training places": TRAIN, "test places": TEST}
    return [*written, *write_results("pretrained", metrics, settings, workspace.results)]
