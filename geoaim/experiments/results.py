"""Results of experiments: a small JSON file and a Markdown table of each."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from geoaim.bench.report import describe_machine, write_json
from geoaim.files import atomic_write
from geoaim.prediction.metrics import Metric, bootstrap_interval, summarise
from geoaim.prediction.report import format_markdown
from geoaim.progress import Progress, no_progress

Metrics = Mapping[str, Metric]


@dataclass(frozen=True)
class Workspace:
    """Where an experiment reads and writes."""

    folder: Path  # keeps synthetic places and trained models between runs
    results: Path = Path("docs/experiments")  # folder of tables and figures
    progress: Progress = no_progress  # takes stage, done and total

    @property
    def places(self) -> Path:
        """Folder of synthetic places."""
        return self.folder / "places"

    @property
    def models(self) -> Path:
        """Folder of trained models."""
        return self.folder / "models"


def write_results(
    name: str, metrics: Mapping[str, Metrics], settings: Mapping[str, Any], folder: Path
) -> list[Path]:
    """Write means with their intervals, as JSON and as Markdown.

    Args:
        name: of the experiment.
        metrics: by method.
        settings: what else the JSON holds.
        folder: of the files.

    Returns:
        The paths of both files, JSON first.
    """
    tables = {method: summarise(values) for method, values in metrics.items()}
    command = f"geoaim experiment {name}"
    content = {"command": command, "machine": describe_machine(), **settings, "methods": tables}
    paths = [folder / f"{name}.json", folder / f"{name}.md"]
    write_json(content, paths[0])
    with atomic_write(paths[1]) as temporary:
        temporary.write_text(f"`{command}`\n\n{format_markdown(tables)}\n", encoding="utf-8")
    return paths


def compute_seed_means(trainings: Sequence[Metrics]) -> list[dict[str, float]]:
    """Compute the mean of each metric, by name, of each training of a model."""
    return [{name: metric.mean for name, metric in one.items()} for one in trainings]


def compute_differences(one: Metrics, other: Metrics) -> dict[str, tuple[float, float]]:
    """Compute the 95 % interval, by metric, of one method minus another on the same segments."""
    return {name: bootstrap_interval(one[name], other[name]) for name in one if name in other}
