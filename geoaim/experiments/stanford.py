"""Real pedestrians: the Stanford Drone Dataset's windows, with published numbers beside ours."""

from dataclasses import replace
from pathlib import Path

import torch

from geoaim.bench.data import data_folder
from geoaim.errors import TracksError
from geoaim.experiments.places import Report, blurred_and_noisy
from geoaim.experiments.results import write_results
from geoaim.prediction.baselines import BASELINES
from geoaim.prediction.checkpoints import read_model
from geoaim.prediction.evaluation import evaluate_windows, window_asked
from geoaim.prediction.itra import ITRA, Config
from geoaim.prediction.metrics import interval, summary
from geoaim.prediction.segments import joined
from geoaim.prediction.training import Lessons, Training, train
from geoaim.prediction.windows import OBSERVED, SECONDS, Windows, backwards, read_windows
from geoaim.simulation.ground import Ground

VALIDATION = ("bookstore_3", "coupa_3", "deathCircle_3", "gates_1", "hyang_6", "nexus_8")
SAMPLES = 20
BLUR = 1.5  # px of the ground, 0.2 m each
SEES = Config(
    "pedestrian", "slide", SECONDS, size=32, resolution=0.75, every=12, modes=20, sigma=0.2
)
MODELS = {
    "map": SEES,
    "no map": replace(SEES, encoder="none"),
    "no map, no plans": replace(SEES, encoder="none", modes=0),
}
TRAINING = Training(
    steps=4000,
    batch=128,
    divergence=1.2,
    warm_up=0.0,
    observed=(OBSERVED, OBSERVED),
    mirror=True,
    resize=0.2,
    colour=0.2,
)
BEST = "no map"  # on validation scenes the map adds nothing yet; this one learns from all scenes
# minADE and minFDE of 20 on the standard test part, pixels, as their authors or later papers say
PUBLISHED = {
    "S-GAN": (27.23, 41.44),
    "Trajectron++": (19.30, 32.70),
    "constant velocity with noise": (12.11, 21.73),
    "PECNet": (9.96, 15.88),
    "Y-net": (7.85, 11.85),
    "NSP-SFM": (6.52, 10.61),
    "MUSE-VAE": (6.36, 11.10),
}


def run(folder: Path, report: Report) -> list[Path]:
    """real pedestrians of the Stanford Drone Dataset, minADE and minFDE of 20."""
    given = _data()
    names = [path.stem for path in sorted((given / "windows").glob("*.csv"))]
    rest = [name for name in names if name not in VALIDATION]
    asked = window_asked(SAMPLES)
    found = {}
    for name, config in MODELS.items():
        model = _trained(name, config, rest, folder, report)
        valid = _windows(given, config, VALIDATION)
        spread = replace(asked, spread=1.0) if config.modes == 0 else asked
        found[name] = evaluate_windows(model, valid, spread, report=report)
        if name == "map":
            worse = replace(valid, ground=_degraded(valid))
            found["map, blurred and noisy"] = evaluate_windows(model, worse, asked, report=report)
    for name in BASELINES:
        found[name] = evaluate_windows(name, valid, asked, report=report)
    gain = {
        measure: interval(found["map"][measure], found["no map"][measure])
        for measure in found["map"]
    }
    _trained("all scenes", MODELS[BEST], names, folder, report)
    tables = {name: summary(measures) for name, measures in found.items()}
    about = {"windows": len(valid.segments), "scenes": VALIDATION, "samples": SAMPLES}
    return write_results("stanford", tables, {**about, "map less no map": gain})


def _trained(name: str, config: Config, scenes: list[str], folder: Path, report: Report) -> ITRA:
    where = folder / "models" / f"stanford_{name.replace(',', '').replace(' ', '_')}"
    if (where / "model.pt").exists():
        return read_model(where / "model.pt")
    windows = _windows(_data(), config, scenes)
    both = joined([windows.segments, backwards(windows.segments)])
    lessons = Lessons(both, windows.segments, windows.ground)
    return train(config, TRAINING, lessons, where, progress=report)


def _windows(given: Path, config: Config, scenes: tuple[str, ...] | list[str]) -> Windows:
    images = None if config.encoder == "none" else given / "images"
    return read_windows(given / "windows", images, given / "scenes.csv", config.view, only=scenes)


def _degraded(windows: Windows) -> Ground:
    """The ground as the paper degrades it."""
    image = windows.ground.image.permute(1, 2, 0).numpy()
    worse = torch.tensor(blurred_and_noisy(image, BLUR)).permute(2, 0, 1)
    return replace(windows.ground, image=worse)


def _data() -> Path:
    folder = data_folder()
    if folder is None or not (folder / "tracks/sdd_trajnet").is_dir():
        raise TracksError("the Stanford windows are not here; name their folder by GEOAIM_DATA")
    return folder / "tracks/sdd_trajnet"
