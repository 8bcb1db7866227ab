"""Results of experiments: a small JSON file and a Markdown table of each."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks.results import describe_machine, write_json
from geoaim.base.files import atomic_files, write_figure
from geoaim.base.progress import Progress, notebook_progress
from geoaim.prediction.metrics import Metric, bootstrap_interval, summarise
from geoaim.prediction.report import format_markdown

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Metrics = Mapping[str, Metric]


@dataclass(frozen=True)
class Workspace:
    """Where an experiment reads and writes."""

    folder: Path  # keeps synthetic places and trained models between runs
    results: Path = Path("docs/experiments")  # folder of tables and figures
    progress: Progress = notebook_progress  # takes stage, done and total

    @property
    def places(self) -> Path:
        """Folder of synthetic places."""
        return self.folder / "places"

    @property
    def models(self) -> Path:
        """Folder of trained models."""
        return self.folder / "models"


def write_results(
    name: str,
    metrics: Mapping[str, Metrics],
    settings: Mapping[str, Any],
    folder: Path,
    *,
    figure: "Figure | None" = None,
) -> list[Path]:
    """Write means with their intervals, as JSON and as Markdown; all files change together.

    Args:
        name: name of the experiment.
        metrics: metrics by method.
        settings: what else the JSON holds.
        folder: folder in which the files are written.
        figure: is written as a .png beside them.

    Returns:
        The paths of the files, JSON first.
    """
    tables = {method: summarise(values) for method, values in metrics.items()}
    command = f"python -m benchmarks.prediction {name}"
    content = {"command": command, "machine": describe_machine(), **settings, "methods": tables}
    suffixes = (".json", ".md", *([] if figure is None else [".png"]))
    paths = [folder / f"{name}{suffix}" for suffix in suffixes]
    with atomic_files(*paths) as parts:
        write_json(content, parts[0])
        parts[1].write_text(f"`{command}`\n\n{format_markdown(tables)}\n", encoding="utf-8")
        if figure is not None:
            write_figure(figure, parts[2])
    return paths


def compute_seed_means(trainings: Sequence[Metrics]) -> list[dict[str, float]]:
    """Compute the mean of each metric, by name, of each training of a model."""
    return [{name: metric.mean for name, metric in one.items()} for one in trainings]


def compute_differences(one: Metrics, other: Metrics) -> dict[str, tuple[float, float]]:
    """Compute the 95 % interval, by metric, of one method minus another on the same segments."""
    return {name: bootstrap_interval(one[name], other[name]) for name in one if name in other}
