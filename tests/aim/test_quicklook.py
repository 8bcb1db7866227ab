import numpy as np

from geoaim.aim.quicklook import draw_quicklook
from geoaim.aim.summary import summarize_report
from geoaim.base.files import write_figure
from geoaim.base.geometry import translation
from geoaim.imagery.alignment.before_after import draw_alignment
from geoaim.mapping.georeference.from_telemetry import make_local_georeference
from geoaim.mapping.report import report_georeference
from tests.aim.test_aim import make_aim

POINT = {"name": "p", "x": 4.0, "y": 20.0, "residual_x": 0.1, "residual_y": 0.0, "used": True}
REPORT = {
    "registration": {
        "model": "homography",
        "valid": 9,
        "frames": 10,
        "uncertainty_px": 0.05,
        "path": [[0.0, 1.0, 2.0], [1.0, 2.0, 2.5]],
    },
    "background": {"method": "median", "frames_used": 9, "contested_share": 0.01},
    "georeference": {
        "approximate": False,
        "model": "similarity",
        "uncertainty": {
            "map_m": [[0.4, 0.3], [0.2, 0.3]],
            "middle_m": 0.1,
            "median_m": 0.2,
            "worst_corner": "top left",
            "worst_corner_m": 0.4,
            "worst_corner_with_point_there_m": 0.1,
        },
        "points": [POINT | {"leave_one_out_m": 0.03}],
    },
}


def test_summary_has_a_line_for_each_stage():
    lines = make_aim(report=REPORT).summarize()
    assert lines["registered frames"] == "9 of 10"
    assert lines["uncertainty (95 %)"] == "0.10 m in the middle, median 0.20 m"
    assert lines["worst corner"] == "top left of the frame, 0.40 m; with a point there 0.10 m"
    assert lines["leave-one-out error"] == "0.0300 m (RMS of 1 points)"


def test_contested_pixels_of_a_mean_with_traffic_are_not_said_to_be_none():
    background = {"method": "mean", "frames_used": 9, "contested_share": 0.0}
    lines = summarize_report({"background": background})
    assert lines["contested"] == "not looked for: this is a mean with its traffic"


def test_summary_of_a_map_of_version_0_1_has_its_corner_uncertainty():
    report = {"model": "affine", "approximate": False, "points": []}
    bounds = {"corner_uncertainty_m": [0.1, 0.4]}
    lines = summarize_report({"georeference": report | bounds})
    assert lines["corner uncertainty"] == "0.40 m (95 %)"


def test_no_uncertainty_is_stated_finer_than_a_centimetre():
    uncertainty = REPORT["georeference"]["uncertainty"] | {"middle_m": 0.004}
    report = {"georeference": REPORT["georeference"] | {"uncertainty": uncertainty}}
    lines = make_aim(report=report).summarize()
    assert lines["uncertainty (95 %)"] == "under 1 cm in the middle, median 0.20 m"


def test_a_scale_that_was_given_has_no_uncertainty(tmp_path):
    local = make_local_georeference(resolution=0.1, size=(40, 60))
    georeference = report_georeference(local, None)
    assert (georeference["given_scale"], georeference["uncertainty"]) == (True, None)
    aim = make_aim(report={"georeference": georeference})
    lines = aim.summarize()
    assert lines["scale"] == "as given; nothing in the frames checks it"
    assert not any("uncertainty" in name or "corner" in name for name in lines)
    write_figure(draw_quicklook(aim), tmp_path / "look.png")


def test_quicklook_is_written_with_and_without_a_report(tmp_path):
    for report in (REPORT, {}):
        write_figure(draw_quicklook(make_aim(report=report)), tmp_path / "look.png")
        assert (tmp_path / "look.png").stat().st_size > 10_000


def test_alignment_picture_shows_imagery_before_and_after():
    alignment = {"true_from_stated": translation(1.0, 0.0)}
    imagery = make_aim(report={"alignment": {"aim": alignment}})
    before, after = draw_alignment(imagery, aim=make_aim()).axes
    assert (before.get_title(), after.get_title()) == ("as stated", "aligned")
    assert not np.array_equal(before.images[0].get_array(), after.images[0].get_array())
