"""Which cases of a test run in `make test`; the others are left to `make test-slow`."""

from collections.abc import Iterable

import pytest


def keep_quick(names: Iterable[str], *quick: str) -> list[object]:
    """Make parameters of names, of which all but the quick ones are marked as slow."""
    names = list(names)
    assert set(quick) <= set(names), "a quick case is not among the cases"
    return [
        pytest.param(name, marks=() if name in quick else pytest.mark.slow, id=str(name))
        for name in names
    ]
