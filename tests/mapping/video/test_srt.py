"""Telemetry in .SRT files: the dialects of DJI's models, and files that are none of them."""

from pathlib import Path

import numpy as np
import pytest

from geoaim.base.errors import GeoaimWarning, GeoreferenceError
from geoaim.mapping.video.srt import read_srt
from geoaim.mapping.video.video import open_video
from tests.mapping.video.test_video import write_clip

DIALECTS = Path(__file__).parent / "srt"
# Each flies at 54.6872 N, 25.2797 E, 60 m above the take-off: an invented flight of four entries.
STATED = {
    "mavic_pro": {"height"},
    "matrice_300": {"height"},
    "mavic_mini": {"height"},
    "phantom_4_rtk": {"height", "yaw", "pitch"},
    "mavic_2_zoom": {"focal_length"},
    "air_2": {"focal_length"},
    "mini_3_pro": {"height", "focal_length", "altitude"},
    "mavic_3": {"height", "focal_length", "altitude", "yaw", "pitch"},
}
VALUES = {"height": 60, "focal_length": 24, "altitude": 170, "yaw": 0, "pitch": -np.pi / 2}
TOLERANCES = {"height": 0.5, "focal_length": 1e-9, "altitude": 1.2, "yaw": 0.01, "pitch": 0.02}
FIRST = (DIALECTS / "mavic_3.SRT").read_bytes().decode()


@pytest.mark.parametrize("dialect", STATED)
def test_dialect_is_read(dialect: str) -> None:
    found = read_srt(DIALECTS / f"{dialect}.SRT")
    assert len(found.time) == 4
    np.testing.assert_allclose(found.latitude, 54.6872, atol=3.1e-4)
    np.testing.assert_allclose(found.longitude, 25.2797, atol=7.1e-4)
    for name, value in VALUES.items():
        actual = getattr(found, name)
        if name in STATED[dialect]:
            np.testing.assert_allclose(actual, value, atol=TOLERANCES[name])
        else:
            assert np.isnan(actual).all()


def test_zero_position_is_no_fix(tmp_path: Path) -> None:
    text = FIRST.replace("54.687200", "0.000000").replace("25.279701", "0.000000", 1)
    assert np.isnan(read(tmp_path, text).latitude).tolist() == [True, False, False, False]


def test_not_available_is_no_fix(tmp_path: Path) -> None:
    text = (
        (DIALECTS / "mavic_mini.SRT").read_text().replace("GPS (25.2790, 54.6872", "GPS (n/a, n/a")
    )
    found = read(tmp_path, text.replace("H 60.10m", "H n/a", 1))
    assert np.isnan(found.longitude).tolist() == [True, False, False, False]
    assert np.isnan(found.height).tolist() == [False, True, False, False]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("dzoom: 1.00", "dzoom: 1,00", "entry 1: dzoom is '1,00'"),
        ("54.687200", "54,687200", "entry 1: latitude is '54,687200'; a number with a decimal"),
        ("focal_len: 24.00", "focal_len: 24,00", "focal_length is '24,00'"),
        ("60.200 abs", "60.2OO abs", "entry 3: height is '60.2OO'"),
        ("[iso: 150]", "[latitude: 54.7]", "latitude is stated 2 times"),
        ("54.687202", "54.697202", "entry 3: position changes by 1113 m in 0.033 s"),
        ("60.200 abs", "6.200 abs", "height changes by 54 m"),
        ("gb_yaw: 90.2", "gb_yaw: 9.2", "yaw changes by 81 degrees"),
        ("gb_pitch: -89.2", "gb_pitch: -8.2", "pitch changes by 81 degrees"),
        ("24.00", "70.00", "focal_length changes by 192 % in 0.033 s"),
        ("24.00", "24", "focal_length is 2.4 in entry 1; it lies between 5 and 1500"),
        ("54.687200", "154.687200", "latitude is 154.687 in entry 1.* swapped"),
        ("00:00:00,066 -->", "00:00:00,006 -->", "entry 3 is earlier than the one before it"),
        ("00:00:00,066 -->", "x00:00:00,066 -->", "4 lines with '-->', but 3"),
        ("-->", "to", "not an .SRT file"),
        ("ude:", "ode:", "no latitude and longitude"),
        ("[latitude: 54.687200]", "GPS(54,6872,25,2797,16)", "neither"),
        ("[latitude: 54.687200]", "GPS(54.6872,25.2797,69.80)", "neither"),
        ("[gb_yaw: 90.0 gb_pitch: -89.0 gb_roll: 0.0]", "G.PRY (-89,0°, 0,0°, 90,0°)", "6 parts"),
    ],
)
def test_what_is_not_plausible_is_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    every = old in ("-->", "ude:")
    assert old in FIRST
    with pytest.raises(GeoreferenceError, match=message):
        read(tmp_path, FIRST.replace(old, new, -1 if every else 1))


@pytest.mark.parametrize("unknown", ["N/A", "n/a", "NaN", "null", "--"])
def test_every_spelling_of_no_fix_leaves_the_entry_out_alone(tmp_path: Path, unknown: str) -> None:
    text = (DIALECTS / "mavic_pro.SRT").read_text()
    text = text.replace("GPS(25.2791,54.6872,16)", f"GPS({unknown},{unknown},3)")
    assert np.isnan(read(tmp_path, text).latitude).tolist() == [False, True, False, False]


@pytest.mark.parametrize("roll", [180.0, -180.0, 90.0, 3.0])
def test_roll_turns_the_top_of_a_picture_taken_straight_down(tmp_path: Path, roll: float) -> None:
    flat = read(tmp_path, FIRST.replace("gb_pitch: -89", "gb_pitch: -90"))
    yaw = 90.0 - roll  # what stays is the heading of the top, here east
    text = FIRST.replace("gb_pitch: -89", "gb_pitch: -90").replace(
        "gb_roll: 0.0", f"gb_roll: {roll}"
    )
    for old in (90.0, 90.1, 90.2, 90.3):
        text = text.replace(f"gb_yaw: {old} ", f"gb_yaw: {old - 90 + yaw:.1f} ")
    turned = read(tmp_path, text)
    np.testing.assert_allclose(turned.yaw, flat.yaw, atol=0.01)


def test_roll_leaves_the_heading_of_an_oblique_view(tmp_path: Path) -> None:
    text = FIRST.replace("gb_pitch: -89", "gb_pitch: -20").replace("gb_roll: 0.0", "gb_roll: 3.0")
    np.testing.assert_allclose(read(tmp_path, text).yaw, read(tmp_path, FIRST).yaw, atol=1e-9)


@pytest.mark.parametrize(
    ("dzoom", "ratio", "focal_length"),
    [("2.00", "20000", 48.0), ("1.00", "10000", 24.0), ("0.00", "0", 24.0), ("2", "20000", 48.0)],
)
def test_digital_zoom_lengthens_the_focal_length(
    tmp_path: Path, dzoom: str, ratio: str, focal_length: float
) -> None:
    text = FIRST.replace("dzoom: 1.00", f"dzoom: {dzoom}").replace(": 10000,", f": {ratio},")
    np.testing.assert_allclose(read(tmp_path, text).focal_length, focal_length)


@pytest.mark.parametrize("other", ["dzoom: 3.00", "hybrid_zoom: 2.0"])
def test_zooms_that_do_not_tell_the_focal_length_leave_it_out(tmp_path: Path, other: str) -> None:
    found = read(tmp_path, FIRST.replace("dzoom: 1.00", other))
    assert np.isnan(found.focal_length).all()
    assert other.split(":")[0] in found.remarks["focal_length"]


@pytest.mark.parametrize("dialect", ["mavic_2_zoom", "air_2"])
def test_an_altitude_alone_is_no_height(dialect: str) -> None:
    found = read_srt(DIALECTS / f"{dialect}.SRT")
    assert np.isnan(found.height).all()
    assert "from the sea" in found.remarks["height"]


@pytest.mark.parametrize("rotation", [0, 90])
def test_a_video_that_is_turned_for_display_states_no_heading(
    tmp_path: Path, rotation: int
) -> None:
    clip = write_clip(tmp_path / "DJI_0001.mp4", 12, rotation=rotation)
    read(tmp_path, FIRST)
    found = open_video(clip).telemetry
    assert found is not None
    assert np.isnan(found.yaw).all() == bool(rotation)
    assert np.isfinite(found.pitch).all()


def read(folder: Path, text: str):
    (folder / "DJI_0001.SRT").write_bytes(text.encode())
    return read_srt(folder / "DJI_0001.SRT")


def write_flight(latitudes: list[float]) -> str:
    return "\n".join(
        f"{k + 1}\n00:00:{k // 10:02d},{k % 10}00 --> 00:00:{k // 10:02d},{k % 10}90\n"
        f"[latitude: {latitude:.6f}] [longitude: 25.279701] [rel_alt: 60.0 abs_alt: 170.0]\n"
        for k, latitude in enumerate(latitudes)
    )


@pytest.mark.parametrize("jumps", [[17], [0], [59], [20, 21], [5, 40]])
def test_few_positions_that_jump_are_left_out(tmp_path: Path, jumps: list[int]) -> None:
    latitudes = [54.8 if k in jumps else 54.687 + 1e-6 * k for k in range(60)]
    with pytest.warns(GeoaimWarning, match=rf"{len(jumps)} of 60 entries, from {jumps[0] + 1} on"):
        found = read(tmp_path, write_flight(latitudes))
    assert np.flatnonzero(np.isnan(found.latitude)).tolist() == jumps
    assert np.flatnonzero(np.isnan(found.longitude)).tolist() == jumps
    assert np.isfinite(found.height).all()


@pytest.mark.parametrize("jumps", [range(10), range(0, 60, 10), range(30), range(20, 26)])
def test_many_positions_that_jump_are_refused(tmp_path: Path, jumps: range) -> None:
    latitudes = [54.8 if k in jumps else 54.687 for k in range(60)]
    with pytest.raises(GeoreferenceError, match=r"position changes by 12579 m in 0\.1 s"):
        read(tmp_path, write_flight(latitudes))
