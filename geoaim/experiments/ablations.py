"""What choices that the paper leaves open are worth: short trainings that differ in one of them."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import nn

from geoaim.experiments.learning import SAMPLES, VEHICLES, lessons_of
from geoaim.experiments.models import kept_or_trained
from geoaim.experiments.places import TRAIN, make_places
from geoaim.experiments.results import differences, write_results
from geoaim.prediction.evaluation import Asked, evaluate
from geoaim.prediction.itra import ITRA, Config
from geoaim.prediction.lessons import Lessons
from geoaim.prediction.metrics import Measure
from geoaim.prediction.predict import OBSERVED
from geoaim.prediction.segments import pick
from geoaim.prediction.training import Training, from_scratch
from geoaim.progress import Progress

STEPS, BATCH = 250, 32
EVERY = 6  # of the pieces that are held out is judged
MEASURES = ("minADE", "minFDE", "MFD")


@dataclass(frozen=True)
class Choice:
    """One thing that is otherwise than in vehicles' models that see colours alone.

    Attributes:
        config: what the model is made of.
        divergence: weight of the latents' divergence.
        start: weights to begin with.
    """

    config: Config
    divergence: float = Training.divergence
    start: Callable[[Config], ITRA] | None = None


def plain_start(config: Config) -> ITRA:
    """torch's own starting weights of convolutions, as they were before He's."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        model = ITRA(config)
        for part in model.encoder.modules():
            if isinstance(part, nn.Conv2d):
                part.reset_parameters()
    return model


CHOICES = {
    "vehicles": Choice(VEHICLES),
    "vehicles, divergence 1": Choice(VEHICLES, divergence=1.0),
    "vehicles, divergence 0.3": Choice(VEHICLES, divergence=0.3),
    "vehicles, torch's start": Choice(VEHICLES, start=plain_start),
    "vehicles, no view": Choice(replace(VEHICLES, encoder="none")),
    "vehicles, ResNet-18": Choice(replace(VEHICLES, encoder="resnet18")),
}


def run(folder: Path, report: Progress) -> list[Path]:
    """choices that the paper leaves open, by short trainings on the same made places."""
    places = make_places(folder / "places", TRAIN["vehicle"], report=report)
    found: dict[str, dict[str, Measure]] = {}
    lessons = lessons_of(places, VEHICLES, "aim", report=report)
    valid = pick(lessons.valid, slice(None, None, EVERY))
    for name, choice in CHOICES.items():
        model = _trained(name, choice, lessons, folder, report)
        asked = Asked(OBSERVED, SAMPLES)
        measures = evaluate(model, valid, lessons.ground, asked, report=report)
        found[name] = {key: measures[key] for key in MEASURES}
    about = {
        "steps": STEPS,
        "batch": BATCH,
        "pieces": len(valid),
        "judged on": "ends of recordings of places that were learnt from",
        "less the first row": {
            name: differences(found[name], found["vehicles"]) for name in found if "," in name
        },
    }
    return write_results("ablations", found, about)


def _trained(name: str, choice: Choice, lessons: Lessons, folder: Path, report: Progress) -> ITRA:
    training = from_scratch(choice.config.kind, steps=STEPS, batch=BATCH)
    training = replace(training, divergence=choice.divergence)
    where = folder / "models" / "ablations" / name.replace(",", "").replace(" ", "_")
    start = None if choice.start is None else choice.start(choice.config)
    return kept_or_trained(where, choice.config, training, lambda: lessons, report, start=start)
