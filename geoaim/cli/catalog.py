"""Build and inspect a catalogue of the maps of many recordings."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated

import rich.progress
import typer

from geoaim.cli import options
from geoaim.cli.console import Command, CommandGroup, console, print_table, report_errors

if TYPE_CHECKING:
    from geoaim.catalog import Record
    from geoaim.catalog.engine import RecordingProgress

app = typer.Typer(
    name="catalog",
    cls=CommandGroup,
    help="Build the maps of many recordings, on one machine or many, and inspect them.",
    no_args_is_help=True,
)
CatalogFolder = Annotated[str, typer.Argument(help="path or address of the catalogue's folder")]


@app.command(cls=Command)
def build(
    recordings: Annotated[
        str, typer.Argument(help="CSV with a row for each recording: video, gcps, ...")
    ],
    output: Annotated[str, options.output("path or address of the catalogue's folder")],
    scheduler: Annotated[
        str | None,
        typer.Option(help="address of a running Dask scheduler, such as tcp://10.0.0.1:8786"),
    ] = None,
    workers: Annotated[
        int | None, typer.Option(help="workers on this machine; one for each core", min=1)
    ] = None,
    memory: Annotated[
        str, typer.Option(help="memory limit of each worker on this machine, such as 4GB")
    ] = "auto",
    store: Annotated[
        list[str] | None,
        typer.Option(help="addresses that the table may name, such as s3://bucket/"),
    ] = None,
) -> None:
    """Build the maps of many recordings: those that are new or changed since the last run.

    Recordings that give no map are refused with the reason, and do not stop the others.

    Example: geoaim catalog build recordings.csv -o maps
    """
    from geoaim.catalog import Cluster, build_catalog, read_recordings

    with report_errors():
        if scheduler is not None and (workers is not None or memory != "auto"):
            raise ValueError(
                "--workers and --memory are of workers on this machine; a scheduler has its own"
            )
        rows = read_recordings(recordings, stores=store or ())
        with _show_recordings(len(rows)) as (progress, finish):
            result = build_catalog(
                rows,
                output,
                cluster=Cluster(scheduler, workers, memory),
                progress=progress,
                finished=finish,
            )
        now = set(result.built_now)
        for status in ("refused", "failed"):
            for record in result.list_by_status(status):
                console.print(f"{status}: {record.name}: {record.reason}")
        counts = {
            status: len(result.list_by_status(status)) for status in ("built", "refused", "failed")
        }
        new = sum(record.name in now for record in result.list_by_status("built"))
        total = ", ".join(f"{count} {status}" for status, count in counts.items() if count)
        console.print(f"{output}: {total}; {new} built by this run. Open report.html")
    if counts["failed"]:
        raise typer.Exit(1)


@app.command(name="list", cls=Command)
def list_maps(catalog: CatalogFolder) -> None:
    """List the recordings of a catalogue: built, refused or failed, and how good."""
    from rich.table import Table

    from geoaim.catalog import read_catalog

    with report_errors():
        table = Table("name", "status", "frames", "uncertainty, m", "contested", "reason")
        for record in read_catalog(catalog).records.values():
            table.add_row(record.name, record.status, *_describe_quality(record), record.reason)
        console.print(table)


@app.command(cls=Command)
def show(
    catalog: CatalogFolder, name: Annotated[str, typer.Argument(help="of the recording")]
) -> None:
    """Show what is known of one recording and its map."""
    from geoaim.aim.summary import summarize_report
    from geoaim.catalog import read_catalog

    with report_errors():
        records = read_catalog(catalog).records
        if name not in records:
            raise ValueError(f"{catalog} has no recording {name!r}; `geoaim catalog list` has all")
        record = records[name]
        lines = {"status": record.status} | ({"reason": record.reason} if record.reason else {})
        lines |= {file.role: file.address for file in record.inputs if file.role != "detections"}
        lines |= summarize_report(record.report)
        lines |= {f"warning {number}": text for number, text in enumerate(record.warnings, 1)}
        lines |= {"built": f"{record.started}, {record.seconds:.0f} s, geoaim {record.version}"}
        print_table(name, lines)


@app.command(cls=Command)
def verify(
    catalog: CatalogFolder,
    repair: Annotated[
        bool, typer.Option("--repair", help="remove changed files; the next build makes them again")
    ] = False,
) -> None:
    """Read all files of a catalogue and find what is missing or changed; exit code 1 if any is."""
    from geoaim.catalog import remove_changed_files, verify_catalog

    with report_errors():
        problems = verify_catalog(catalog)
        for problem in problems:
            console.print(f"{problem.path}: {problem.found}")
        if problems and repair:
            remove_changed_files(catalog, problems)
            console.print("changed files are removed; `geoaim catalog build` makes what is missing")
        elif problems:
            console.print(
                "`geoaim catalog verify --repair` removes changed files, and `geoaim catalog "
                "build` makes what is missing"
            )
        else:
            console.print(f"{catalog}: all files are as they were written")
    if problems:
        raise typer.Exit(1)


def _describe_quality(record: "Record") -> tuple[str, str, str]:
    if record.status != "built":
        return "", "", ""
    report = record.report
    uncertainty = report["georeference"].get("uncertainty") or {}
    median = uncertainty.get("median_m")
    return (
        f"{report['registration']['valid']} of {report['registration']['frames']}",
        "unknown" if median is None else f"{median:.2f}",
        f"{report['background']['contested_share']:.2%}",
    )


@contextmanager
def _show_recordings(
    total: int,
) -> Iterator[tuple["RecordingProgress", Callable[["Record", int], None]]]:
    """Show a bar over all recordings, and one for each that is being built."""
    columns = (*rich.progress.Progress.get_default_columns(), rich.progress.TimeElapsedColumn())
    bars = rich.progress.Progress(*columns, console=console)
    every = bars.add_task("recordings", total=total)
    running: dict[str, rich.progress.TaskID] = {}

    def progress(name: str, stage: str, done: float, total: float | None) -> None:
        if name not in running:
            running[name] = bars.add_task(name)
        bars.update(running[name], description=f"{name}: {stage}", completed=done, total=total)

    def finish(record: "Record", left: int) -> None:
        if record.name in running:
            bars.remove_task(running.pop(record.name))
        bars.update(every, completed=total - left)

    with bars:
        yield progress, finish
        bars.update(every, completed=total)
