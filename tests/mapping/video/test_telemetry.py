"""Telemetry of DJI drones: the styles of .SRT, and EXIF with XMP."""

import math
import os
from pathlib import Path

import numpy as np
import pytest

from geoaim.errors import GeoreferenceError
from geoaim.mapping.video.telemetry import read_exif, read_srt
from geoaim.mapping.video.video import open_video

BRACKETS = """\ufeff1\r
00:00:00,000 --> 00:00:00,033\r
<font size="28">FrameCnt: 1, DiffTime: 33ms\r
2024-05-01 10:00:00.123\r
[iso: 100] [shutter: 1/1000.0] [fnum: 2.8] [focal_len: 24.00] [latitude: 53.900123] \
[longitude: -27.566789] [rel_alt: 100.300 abs_alt: 320.112] \
[gb_yaw: -90.0 gb_pitch: -89.9 gb_roll: 0.0] </font>\r
\r
2\r
00:01:02,500 --> 00:01:02,533\r
<font size="28">[latitude: 53.900124] [longitude: -27.566790] [rel_alt: 101.5 abs_alt: 321.0]\
</font>\r
"""

OLDER_BRACKETS = """1
00:00:01,000 --> 00:00:02,000
[iso : 110] [fnum : 280] [focal_len : 240] [latitude : -33.5] [longtitude : 151.25]
"""

BAROMETER = """1
00:00:01,000 --> 00:00:02,000
HOME(149.0251,-20.2532) 2017.08.05 14:11:51
GPS(149.0253,-20.2533,16) BAROMETER:1.9
ISO:100 Shutter:60 EV: Fnum:F2.8
"""

HEIGHT = """1
00:00:00,000 --> 00:00:01,000
F/2.8, SS 206.14, ISO 150, EV 0, GPS (-122.3699, 37.8166, 15), D 24.26m, H 6.00m, H.S 2.10m/s
"""


def write(folder: Path, text: str) -> Path:
    (folder / "DJI_0001.SRT").write_bytes(text.encode())
    return folder / "DJI_0001.SRT"


def test_bracketed_style_is_read(tmp_path: Path) -> None:
    found = read_srt(write(tmp_path, BRACKETS))
    np.testing.assert_allclose(found.time, [0.0, 62.5])
    np.testing.assert_allclose(found.latitude, [53.900123, 53.900124])
    np.testing.assert_allclose(found.longitude, [-27.566789, -27.566790])
    np.testing.assert_allclose(found.height, [100.3, 101.5])
    np.testing.assert_allclose(found.altitude, [320.112, 321.0])
    np.testing.assert_allclose(found.yaw, [-math.pi, math.nan])  # west
    np.testing.assert_allclose(found.pitch, [math.radians(-89.9), math.nan])
    np.testing.assert_allclose(found.focal_length, [24.0, math.nan])


def test_misspelt_longitude_and_tenths_of_focal_length_are_read(tmp_path: Path) -> None:
    found = read_srt(write(tmp_path, OLDER_BRACKETS))
    assert (found.latitude[0], found.longitude[0]) == (-33.5, 151.25)
    assert found.focal_length[0] == 24.0
    assert np.isnan(found.height[0])


@pytest.mark.parametrize(
    ("text", "expected"),
    [(BAROMETER, (-20.2533, 149.0253, 1.9)), (HEIGHT, (37.8166, -122.3699, 6.0))],
)
def test_older_style_states_longitude_first(
    tmp_path: Path, text: str, expected: tuple[float, float, float]
) -> None:
    found = read_srt(write(tmp_path, text))
    assert (found.latitude[0], found.longitude[0], found.height[0]) == expected
    assert np.isnan(found.yaw[0])


def test_zero_position_is_no_fix(tmp_path: Path) -> None:
    start = "1\n00:00:00,000 --> 00:00:01,000\n[latitude: 0.0] [longitude: 0.0]\n\n"
    found = read_srt(write(tmp_path, start + BRACKETS.lstrip("\ufeff")))
    assert np.isnan(found.latitude).tolist() == [True, False, False]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "not an .SRT file"),
        ("1\n00:00:00,000 --> 00:00:01,000\nGood morning\n", "no latitude and longitude"),
        ("1\n00:00:00,000 --> 00:00:01,000\nGPS(20.5,149.2,9)\n", "swapped"),
    ],
)
def test_file_without_a_place_is_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(GeoreferenceError, match=message):
        read_srt(write(tmp_path, text))


def test_exif_and_xmp_of_a_photo_are_read(tmp_path: Path) -> None:
    pillow = pytest.importorskip("PIL.Image")  # comes with matplotlib
    exif = pillow.Exif()
    exif.get_ifd(0x8769)[0xA405] = 24  # FocalLengthIn35mmFilm
    place = {1: "S", 2: (33.0, 30.0, 36.0), 3: "E", 4: (151.0, 15.0, 0.0), 5: b"\0", 6: 120.5}
    exif.get_ifd(0x8825).update(place)
    xmp = (
        b'<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:Description '
        b'drone-dji:RelativeAltitude="+80.30" drone-dji:GimbalYawDegree="+90.00" '
        b'drone-dji:GimbalPitchDegree="-90.00"/></x:xmpmeta>'
    )
    pillow.new("RGB", (32, 24)).save(tmp_path / "a.jpg", exif=exif, xmp=xmp)
    heading = pillow.Exif()
    heading.get_ifd(0x8825).update({16: "T", 17: 180.0})  # GPSImgDirection
    pillow.new("RGB", (32, 24)).save(tmp_path / "b.jpg", exif=heading)
    found = open_video(tmp_path, rate=2).telemetry
    assert found is not None
    np.testing.assert_allclose(found.time, [0.0, 0.5])
    np.testing.assert_allclose(found.latitude, [-33.51, math.nan])
    np.testing.assert_allclose(found.longitude, [151.25, math.nan])
    np.testing.assert_allclose(found.altitude, [120.5, math.nan])
    np.testing.assert_allclose(found.height, [80.3, math.nan])
    np.testing.assert_allclose(found.yaw, [0.0, -math.pi / 2], atol=1e-12)  # east, south
    np.testing.assert_allclose(found.pitch, [-math.pi / 2, math.nan])
    np.testing.assert_allclose(found.focal_length, [24.0, math.nan])


def test_photos_without_a_place_give_none(tmp_path: Path) -> None:
    assert read_exif([tmp_path / "absent.jpg"]) is None


def test_real_photos_state_where_they_were_taken() -> None:
    folder = Path(os.environ.get("GEOAIM_DATA", "")) / "georef/brighton_beach/images_half"
    if "GEOAIM_DATA" not in os.environ or not folder.is_dir():
        pytest.skip("GEOAIM_DATA does not point to the shared data")
    found = open_video(folder).telemetry
    assert found is not None
    assert np.ptp(found.latitude) < 0.01
    np.testing.assert_allclose(found.latitude, 46.843, atol=0.005)
    np.testing.assert_allclose(found.longitude, -91.994, atol=0.005)
    np.testing.assert_allclose(found.focal_length, 20.0)
