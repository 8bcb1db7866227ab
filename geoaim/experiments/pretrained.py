"""The models that come with the package: their training, and their evaluation at test places."""

import shutil
from pathlib import Path

from geoaim.experiments.models import get_training_folder, train_model
from geoaim.experiments.places import TEST, TRAIN, make_places
from geoaim.experiments.protocol import PEDESTRIANS, VEHICLES, evaluate_places
from geoaim.experiments.results import Folders, write_results
from geoaim.files import atomic_write
from geoaim.prediction.baselines import BASELINES
from geoaim.progress import Progress


def run(folders: Folders, progress: Progress) -> list[Path]:
    """The two pretrained models, trained and tested at synthetic places."""
    written, metrics = [], {}
    for config in (VEHICLES, PEDESTRIANS):
        kind = config.kind
        places = make_places(folders.work / "places", TEST[kind], progress=progress)
        model = train_model(f"{kind}_aim", folders.work, progress=progress)
        path = folders.work / "pretrained" / f"{kind}.pt"
        with atomic_write(path) as temporary:
            source = get_training_folder(folders.work, f"{kind}_aim", 0) / "model.pt"
            shutil.copyfile(source, temporary)
        written.append(path)
        metrics[f"{kind}s, ITRA"] = evaluate_places(model.sample, places, config, "aim")
        for name, predictor in BASELINES.items():
            metrics[f"{kind}s, {name}"] = evaluate_places(predictor, places, config, "none")
    settings = {"training places": TRAIN, "test places": TEST}
    return [*written, *write_results("pretrained", metrics, settings, folders.results)]
