"""Errors about data; a bad call raises ValueError or TypeError."""

import collections.abc
import contextvars
import sys
import warnings
from contextlib import contextmanager

from geoaim.base.texts import show_text

# characters that end a line or control a terminal; damaged files have them in names and values
CONTROLS = dict.fromkeys((*range(32), *range(127, 160), 0x2028, 0x2029), " ")
MAX_START, MAX_END = 700, 300  # characters of a longer message that are kept
# whether a command of geoaim runs, and not a program that imports it
IN_COMMAND = contextvars.ContextVar("IN_COMMAND", default=False)


def format_message(text: str) -> str:
    r"""Make a message one line that is safe to print; the middle of a very long one is left out.

    >>> format_message("a\n\u202eb")
    'a \\u202eb'
    """
    line = show_text(text.translate(CONTROLS))
    too_long = len(line) > MAX_START + MAX_END
    return f"{line[:MAX_START]} ... {line[-MAX_END:]}" if too_long else line


class GeoaimError(Exception):
    """Data that cannot be used: the message says what was found, what was needed, what to do."""

    def __str__(self) -> str:
        """The message by `format_message`."""
        return format_message(super().__str__())


class VideoError(GeoaimError):
    """No frame of a video could be read."""


class RegistrationError(GeoaimError):
    """Too few frames could be registered to the reference."""


class BackgroundError(GeoaimError):
    """The registered frames do not give a background."""


class GeoreferenceError(GeoaimError):
    """Control points, telemetry or a CRS do not give a position on the Earth."""


class AlignmentError(GeoaimError):
    """Imagery cannot be aligned: too little in common with the evidence, or an ambiguous fit."""


class AimError(GeoaimError):
    """A file is not an AIM, or an AIM cannot be written as asked."""


class TracksError(GeoaimError):
    """A file has no tracks or traffic lights, or they contradict themselves."""


class MapError(GeoaimError):
    """A file is not an HD map or drawing, or lies elsewhere than needed."""


class ImageryError(GeoaimError):
    """Imagery cannot be read, or lies elsewhere than needed."""


class CatalogError(GeoaimError):
    """A table of recordings, or a catalogue, cannot be read."""


class ModelError(GeoaimError):
    """A file is not a prediction model, or has another version."""


class GeoaimWarning(UserWarning):
    """The result is less than was asked for: a damaged file, a skipped point."""


_collected: contextvars.ContextVar[list[str] | None]
_collected = contextvars.ContextVar("_collected", default=None)


@contextmanager
def collect_warnings() -> collections.abc.Iterator[list[str]]:
    """Collect the messages of `warn`, which warn all the same, in a list."""
    found: list[str] = []
    token = _collected.set(found)
    try:
        yield found
    finally:
        _collected.reset(token)


def warn(message: str) -> None:
    """Warn with `GeoaimWarning`, at the line outside the package from which it was called."""
    if (found := _collected.get()) is not None:
        found.append(format_message(message))
    level, frame = 2, sys._getframe(1)  # noqa: SLF001
    while frame.f_back and frame.f_back.f_globals.get("__name__", "").startswith("geoaim"):
        level, frame = level + 1, frame.f_back
    warnings.warn(format_message(message), GeoaimWarning, stacklevel=level + 1)


def name_option(option: str, argument: str) -> str:
    """Name what a message advises to give: a command's option, or the argument in Python.

    >>> name_option("--flying-height", "height=")
    'height='
    """
    return option if IN_COMMAND.get() else argument
