"""Problems of a catalogue: files that are missing, changed, or belong to nothing."""

from dataclasses import dataclass

CHECKSUM_DIFFERS = "changed: its checksum is another one"


@dataclass(frozen=True)
class Problem:
    """A file that is not as it was written."""

    path: str  # in the catalogue
    found: str  # what is wrong
    is_changed: bool = False  # whether its content is another one than was written
