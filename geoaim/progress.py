"""How far long work has come, told to whoever shows it."""

from collections.abc import Callable

Progress = Callable[[str, float, float | None], None]  # stage, done, and of how much, if known


def no_progress(stage: str, done: float, total: float | None) -> None:
    """Tell nobody."""
