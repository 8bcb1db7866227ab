"""Wait for an event instead of a time, up to a limit that no machine at work reaches."""

import time
from collections.abc import Callable

LIMIT_S = 600.0  # of what takes seconds on an idle machine
PAUSE_S = 0.02


def wait_until(happened: Callable[[], object], event: str) -> None:
    """Wait until a function returns something true; fail at the limit, naming the event."""
    end = time.monotonic() + LIMIT_S
    while not happened():
        assert time.monotonic() < end, f"after {LIMIT_S:g} s still not: {event}"
        time.sleep(PAUSE_S)
