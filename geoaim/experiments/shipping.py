"""The models that come with the package, and how good they are at places that they never saw."""

import shutil
from pathlib import Path

from geoaim.experiments.learning import PEOPLE, VEHICLES, judge
from geoaim.experiments.models import trained
from geoaim.experiments.places import TEST, TRAIN, make_places
from geoaim.experiments.results import write_results
from geoaim.files import atomic_write
from geoaim.prediction.baselines import BASELINES
from geoaim.prediction.checkpoints import shipped
from geoaim.progress import Progress


def run(folder: Path, report: Progress) -> list[Path]:
    """the two shipped models, taught by made places and judged at others; into the package."""
    written, tables = [], {}
    for name, config in (("vehicles", VEHICLES), ("people", PEOPLE)):
        places = make_places(folder / "places", TEST[config.kind], report=report)
        model = trained(f"{config.kind}_aim", folder, report=report)
        with atomic_write(shipped(config.kind)) as temporary:
            shutil.copyfile(folder / "models" / f"{config.kind}_aim" / "model.pt", temporary)
        written.append(shipped(config.kind))
        tables[f"{name}, ITRA"] = judge(model, places, config, "aim")
        for who in BASELINES:
            tables[f"{name}, {who}"] = judge(who, places, config, "none")
    about = {"places to learn from": TRAIN, "places to be judged on": TEST}
    return [*written, *write_results("shipped", tables, about)]
