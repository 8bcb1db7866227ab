"""TrackFormat: what `read_tracks` must know about one file format."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from geoaim.tracks import Tracks

Matcher = Callable[[Path, str], bool]  # of a path and its first line, "" for a folder


@dataclass(frozen=True)
class TrackFormat:
    """One file format of tracks.

    Attributes:
        name: what the format is called, usually its dataset.
        matches: whether a path with this first line has the format.
        read: reads a path; its options are keywords.
        options: keywords that `read` takes: "world" and "resolution", or one of them.
        required: those of them that it cannot do without.
    """

    name: str
    matches: Matcher
    read: Callable[..., Tracks]
    options: tuple[str, ...] = ()
    required: tuple[str, ...] = ()


def has_columns(*names: str, delimiter: str = ",") -> Matcher:
    """Make a matcher: the first line names all of these columns, among others.

    >>> has_columns("id", "x")(Path("a.csv"), 'time,"id",x,y')
    True
    """

    def matches(path: Path, line: str) -> bool:
        return set(names) <= {name.strip().strip('"') for name in line.split(delimiter)}

    return matches
