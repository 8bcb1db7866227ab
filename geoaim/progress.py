"""The callback by which long work reports its progress."""

from collections.abc import Callable

Progress = Callable[[str, float, float | None], None]  # stage, done, total if it is known


def no_progress(stage: str, done: float, total: float | None) -> None:
    """Do nothing: the default of functions that report their progress.

    Args:
        stage: name of the stage.
        done: amount of work done in it, such as frames.
        total: amount of work in all; None if unknown.
    """
