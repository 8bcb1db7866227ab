import pytest

from tests.mapping.background.clips import make_ground


@pytest.fixture
def ground():
    return make_ground()
