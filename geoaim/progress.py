"""The callback by which long work reports its progress."""

from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

Item = TypeVar("Item")
Progress = Callable[[str, float, float | None], None]  # stage, done, total if it is known


def no_progress(stage: str, done: float, total: float | None) -> None:
    """Do nothing: the default of functions that report their progress.

    Args:
        stage: name of the stage.
        done: amount of work done in it, such as frames.
        total: amount of work in all; None if unknown.
    """


def report_each(
    items: Iterable[Item], progress: Progress, stage: str, total: float | None
) -> Iterator[Item]:
    """Yield items, and report the number of each before it is yielded.

    Args:
        items: of any kind.
        progress: takes stage, done and total.
        stage: its name.
        total: number of items; None if unknown.

    Yields:
        The items.
    """
    for count, item in enumerate(items, 1):
        progress(stage, count, total)
        yield item
