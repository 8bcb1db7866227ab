"""Help texts, progress bars, errors and tables on the terminal."""

import json
import signal
import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from threading import Event
from typing import Any

import rich.progress
import typer
from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment
from rich.table import Table
from rich.text import Text
from typer.core import TyperArgument, TyperCommand, TyperGroup, TyperOption

from geoaim.base.errors import IN_COMMAND, GeoaimError, GeoaimWarning, format_message
from geoaim.base.files import keep_files_of_others
from geoaim.base.progress import Progress
from geoaim.base.texts import show_text


class _Console(Console):
    """A console on which no text of a file acts."""

    def render(
        self, renderable: RenderableType, options: ConsoleOptions | None = None
    ) -> Iterator[Segment]:
        for part in super().render(renderable, options):
            yield part if part.control else Segment(show_text(part.text), part.style)


# markup is off, as file names may have brackets; in a file each message stays on one line
console = _Console(stderr=True, markup=False, width=None if sys.stderr.isatty() else 10_000)
TERMINATED = 143  # exit code
stopping = Event()  # set once SIGTERM has arrived
DEBUG = ContextVar("DEBUG", default=False)  # whether errors keep their traceback


class Count(rich.progress.ProgressColumn):
    """What is done of how much, such as steps of a training, and how many a second."""

    def render(self, task: rich.progress.Task) -> Text:
        """Make the text of a stage: none for stages of one part or of unknown length."""
        if task.total is None or task.total <= 1:
            return Text("")
        rate = "" if task.speed is None else f", {task.speed:.2g}/s"
        return Text(f"{task.completed:.0f} of {task.total:.0f}{rate}", style="progress.download")


@contextmanager
def show_progress() -> Iterator[Progress]:
    """Show a progress bar for each stage; yield the function that advances them."""
    columns = (
        *rich.progress.Progress.get_default_columns(),
        rich.progress.TimeElapsedColumn(),
        Count(),
    )
    tasks: dict[str, rich.progress.TaskID] = {}
    with rich.progress.Progress(*columns, console=console) as bars:

        def progress(stage: str, done: float, total: float | None) -> None:
            if stage not in tasks:
                for task in bars.task_ids:
                    bars.update(task, completed=bars.tasks[task].total or 1, total=1)
                tasks[stage] = bars.add_task(stage, total=total)
            bars.update(tasks[stage], completed=done, total=total)

        yield progress


@contextmanager
def report_errors() -> Iterator[None]:
    """Print warnings as yellow lines; print any error as one red line and exit with code 1.

    Files that another program writes meanwhile are kept.
    """
    with warnings.catch_warnings(), keep_files_of_others():
        warnings.simplefilter("always", GeoaimWarning)
        warnings.showwarning = lambda message, *_, **__: console.print(
            Text.assemble(("warning", "yellow"), f": {message}")
        )
        token = IN_COMMAND.set(True)
        try:
            yield
        except KeyboardInterrupt:
            _print_stopped()
            sys.exit(130)
        except SystemExit as stopped:
            if stopped.code == TERMINATED:
                _print_stopped()
            raise
        except typer.BadParameter:
            raise  # shown with the command's usage
        except Exception as error:
            if stopping.is_set():  # an import in C makes an error of the signal
                _print_stopped()
                sys.exit(TERMINATED)
            if DEBUG.get():
                raise
            expected = isinstance(error, GeoaimError | OSError | ValueError)
            hint = "" if expected else " (geoaim --debug COMMAND ... shows where)"
            message = f": {format_message(' '.join(str(error).split()))}{hint}"
            console.print(Text.assemble((type(error).__name__, "bold red"), message))
            sys.exit(1)
        finally:
            IN_COMMAND.reset(token)


def stop_when_terminated() -> None:
    """Remove unfinished files on SIGTERM as on Ctrl-C, and exit with code 143."""

    def stop(*_: object) -> None:
        stopping.set()
        sys.exit(TERMINATED)  # what it interrupts may be needed to print

    signal.signal(signal.SIGTERM, stop)


def _print_stopped() -> None:
    console.print("stopped; finished files are kept, unfinished ones are removed")


def print_table(title: str, lines: Mapping[str, str]) -> None:
    """Print names and values in two columns, below a title."""
    table = Table(show_header=False)
    for name, value in lines.items():
        table.add_row(name, value)
    if title:
        console.print(Text(title))
    console.print(table)


def print_result(
    files: Sequence[Path], lines: Mapping[str, str], as_json: bool, **more: Any
) -> None:
    """Print what was written, on standard error; or as JSON on standard output."""
    if as_json:
        content = {"files": [str(path) for path in files], "summary": dict(lines), **more}
        print(json.dumps(content, indent=1))
    else:
        print_table(" and ".join(map(str, files)), lines)


class Command(TyperCommand):
    """A command whose usage line names its arguments and its required options."""

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """Collect the parts of the usage line, such as AIM --tracks TRACKS [OPTIONS]."""
        pieces = []
        for parameter in self.get_params(ctx):
            name = str(parameter.name).upper()
            if isinstance(parameter, TyperArgument):
                name += "..." if parameter.nargs == -1 else ""
                pieces.append(name if parameter.required else f"[{name}]")
            elif isinstance(parameter, TyperOption) and parameter.required:
                pieces.append(f"{min(parameter.opts, key=len)} {name}")
        return [*pieces, "[OPTIONS]"]


class CommandGroup(TyperGroup):
    """Commands in groups, in plain help as well as in that of a terminal."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write each group's commands with the whole first sentence of their help."""
        groups: dict[str, list[tuple[str, str]]] = {}
        for name in self.list_commands(ctx):
            command: Any = self.get_command(ctx, name)
            sentence = " ".join(command.help.split("\n\n")[0].split())
            groups.setdefault(command.rich_help_panel or "Commands", []).append((name, sentence))
        for title, rows in groups.items():
            with formatter.section(title):
                formatter.write_dl(rows)
