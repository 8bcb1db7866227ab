import pytest
from scipy.stats import binom

from geoaim.imagery.alignment.verification import count_false_alarms


def test_false_alarms_follow_the_binomial_tail():
    share = 3.14159265 * 1.5**2 / 21**2
    assert count_false_alarms(40, 12) == pytest.approx(
        2 + binom.logsf(9, 40, share) / 2.302585093, abs=1e-6
    )
    assert count_false_alarms(40, 2) == 2.0
    assert count_false_alarms(600, 600) == -298.0
