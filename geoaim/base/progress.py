"""The callback by which long work reports its progress; the default shows bars in notebooks."""

import sys
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from html import escape
from importlib import import_module
from typing import Any, TypeVar

MIN_INTERVAL_S = 0.2  # time between two drawings of the bars
Item = TypeVar("Item")
Progress = Callable[[str, float, float | None], None]  # stage, done, total if it is known


def no_progress(stage: str, done: float, total: float | None) -> None:
    """Do nothing: for callers who want no bars."""


def notebook_progress(stage: str, done: float, total: float | None) -> None:
    """Show a bar for each stage below the cell of a notebook; elsewhere do nothing.

    It is the default of functions that report their progress.
    """
    get_shell = getattr(sys.modules.get("IPython"), "get_ipython", None)
    shell: Any = get_shell() if get_shell else None
    if not hasattr(shell, "kernel"):
        return
    display: Any = import_module("IPython.display")
    cell = _cells.setdefault("last", _Cell(shell.execution_count))
    if cell.number != shell.execution_count:
        cell = _cells["last"] = _Cell(shell.execution_count)
    is_new, cell.stages[stage] = stage not in cell.stages, (done, total)
    if cell.handle is None:
        cell.handle = display.display(display.HTML(_format_bars(cell)), display_id=True)
    elif is_new or done == total or time.monotonic() - cell.drawn > MIN_INTERVAL_S:
        cell.handle.update(display.HTML(_format_bars(cell)))
        cell.drawn = time.monotonic()


@dataclass
class _Cell:
    """The bars below a cell of a notebook."""

    number: int  # number of the cell's execution
    stages: dict[str, tuple[float, float | None]] = field(default_factory=dict)  # done, total
    handle: Any = None  # handle by which the bars are redrawn
    drawn: float = 0.0  # time of the last drawing, s


_cells: dict[str, _Cell] = {}


def _format_bars(cell: _Cell) -> str:
    """Format a line for each stage; those before the last one are complete."""
    lines, last = [], next(reversed(cell.stages))
    for stage, (done, total) in cell.stages.items():
        of = "" if total is None or (stage != last and done < total) else f" of {total:g}"
        share = f' value="{done if stage == last else total}" max="{total}"' if total else ""
        lines.append(f"<progress{share}></progress> {escape(stage)}: {done:g}{of}<br>")
    return "".join(lines)


def report_each(
    items: Iterable[Item], progress: Progress, stage: str, total: float | None
) -> Iterator[Item]:
    """Yield items; before each, report how many have been yielded, this one included."""
    for count, item in enumerate(items, 1):
        progress(stage, count, total)
        yield item
