"""Fixtures for all tests. The jaxtyping hook that checks shapes is set in pyproject.toml."""

from collections.abc import Iterator
from pathlib import Path

import jaxtyping
import pytest


@pytest.fixture
def unchecked() -> Iterator[None]:
    """Turn the shape checks off, to see how the package itself refuses a wrong argument."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """The folder of real data; a test that asks for it is skipped where there is none."""
    from geoaim.bench.data import data_folder

    folder = data_folder()
    if folder is None:
        pytest.skip("no real data: GEOAIM_DATA is not set and ../shared/data does not exist")
    return folder
