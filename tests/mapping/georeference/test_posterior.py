import pytest

from geoaim.mapping.georeference.posterior import ellipse_factor


def test_ellipse_factor_of_known_f_quantiles():
    assert ellipse_factor(4.0) ** 2 / 2.0 == pytest.approx(6.9443, abs=1e-3)  # F(2, 4)
    assert ellipse_factor(2.0) ** 2 / 2.0 == pytest.approx(19.0, abs=1e-9)
