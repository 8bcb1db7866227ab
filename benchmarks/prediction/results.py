"""Results of experiments: a small JSON file and a Markdown table of each."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmarks.results import describe_machine, write_json
from geoaim.base.files import atomic_files, write_figure
from geoaim.base.progress import Progress, notebook_progress
from geoaim.prediction.metrics import Metric, bootstrap_interval, summarise
from geoaim.prediction.report import format_cell

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


def format_markdown(summaries: Mapping[str, Mapping[str, Mapping[str, float]]]) -> str:
    """Format summaries (see `summarise`) as a table, a row for each method by its name.

    The numbers of agents and segments are those of the first metric.

    >>> value = {"mean": 1.0, "low": 0.9, "high": 1.1, "count": 20, "segments": 3}
    >>> print(format_markdown({"a": {"minADE": value}}))
    | | agents | segments | minADE |
    | --- | --- | --- | --- |
    | a | 20 | 3 | 1 (0.9 to 1.1) |
    """
    names = list(dict.fromkeys(name for summary in summaries.values() for name in summary))
    columns = ["", "agents", "segments", *names]
    lines = [_format_row(columns), "|" + " --- |" * len(columns)]
    for method, summary in summaries.items():
        cells = [format_cell(summary[name]) if name in summary else "" for name in names]
        first = summary.get(names[0])
        counts = [f"{first['count']:.0f}", f"{first['segments']:.0f}"] if first else ["", ""]
        lines.append(_format_row([method, *counts, *cells]))
    return "\n".join(lines)


def _format_row(cells: list[str]) -> str:
    return " ".join(f"| {cell}".rstrip() for cell in cells) + " |"
