import pytest

from geoaim.base.csv_rows import parse_number, read_rows


def test_commas_at_line_ends_and_empty_lines_change_nothing():
    plain = read_rows(["aim,tracks", "a.tif,b.csv"])
    assert read_rows(["aim,tracks,,", "a.tif,b.csv,,"]) == plain
    assert read_rows(["aim,tracks", "", " , ", "a.tif,b.csv"])[1] == [(4, plain[1][0][1])]


@pytest.mark.parametrize(
    ("lines", "message"),
    [([], "names no columns"), (["aim", "a.tif,b.csv"], "line 2 has 2 cells for 1 columns")],
)
def test_lines_that_do_not_fit_the_header_are_refused(lines, message):
    with pytest.raises(ValueError, match=message):
        read_rows(lines)


@pytest.mark.parametrize("text", ["nan", "inf", "fast", ""])
def test_numbers_are_finite(text):
    assert parse_number("rate", "2.5") == 2.5
    with pytest.raises(ValueError, match=r"rate is .* a finite number is needed"):
        parse_number("rate", text)
