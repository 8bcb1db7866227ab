"""Telemetry of photos: EXIF, and XMP as DJI writes it."""

import math
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from geoaim.base.errors import GeoreferenceError
from geoaim.mapping.video.exif import read_exif
from geoaim.mapping.video.telemetry import Telemetry
from geoaim.mapping.video.video import open_video


def test_exif_and_xmp_of_a_photo_are_read(tmp_path: Path) -> None:
    exif = Image.Exif()
    exif[0x8769] = {0xA405: 24}  # FocalLengthIn35mmFilm
    place = {1: "S", 2: (33.0, 30.0, 36.0), 3: "E", 4: (151.0, 15.0, 0.0), 5: b"\0", 6: 120.5}
    exif[0x8825] = place
    xmp = (  # a segment of its own: old versions of Pillow write none
        b'http://ns.adobe.com/xap/1.0/\0<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:Description '
        b'drone-dji:RelativeAltitude="+80.30" drone-dji:GimbalYawDegree="+90.00" '
        b'drone-dji:GimbalPitchDegree="-90.00"/></x:xmpmeta>'
    )
    segment = b"\xff\xe1" + (len(xmp) + 2).to_bytes(2, "big") + xmp
    photo = Image.new("RGB", (32, 24))
    photo.save(tmp_path / "a.jpg", exif=exif, extra=segment)
    heading = Image.Exif()
    heading[0x8825] = {16: "T", 17: 180.0}  # GPSImgDirection
    photo.save(tmp_path / "b.jpg", exif=heading)
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


def write_photo(
    path: Path,
    *,
    place: dict[int, Any] | None = None,
    camera: dict[int, Any] | None = None,
    tags: dict[int, Any] | None = None,
    picture: Image.Image | None = None,
    **gimbal: str,
) -> Path:
    """Write a photo as DJI's cameras do, at 33.51 S, 151.25 E, looking down, its top east."""
    exif = Image.Exif()
    exif.update({0x010F: "DJI"} | (tags or {}))
    exif[0x8769] = {0xA405: 24} | (camera or {})
    usual = {1: "S", 2: (33.0, 30.0, 36.0), 3: "E", 4: (151.0, 15.0, 0.0)} | (place or {})
    exif[0x8825] = {key: value for key, value in usual.items() if value is not None}
    stated = {
        "GpsLatitude": "-33.510000",
        "GpsLongitude": "+151.250000",
        "RelativeAltitude": "+80.30",
        "GimbalRollDegree": "+0.00",
        "GimbalYawDegree": "+90.00",
        "GimbalPitchDegree": "-90.00",
    } | gimbal
    listed = " ".join(f'drone-dji:{name}="{value}"' for name, value in stated.items() if value)
    xmp = (
        b'http://ns.adobe.com/xap/1.0/\0<x:xmpmeta xmlns:x="adobe:ns:meta/">'
        + f"<rdf:Description {listed}/></x:xmpmeta>".encode()
    )
    segment = b"\xff\xe1" + (len(xmp) + 2).to_bytes(2, "big") + xmp
    (picture or Image.new("RGB", (32, 24))).save(path, exif=exif, extra=segment)
    return path


def read_photo(folder: Path, **stated: Any) -> Telemetry:
    found = read_exif([write_photo(folder / "a.jpg", **stated)])
    assert found is not None
    return found


def test_a_roll_of_180_turns_the_heading(tmp_path: Path) -> None:
    found = read_photo(tmp_path, GimbalRollDegree="+180.00", GimbalYawDegree="-90.00")
    np.testing.assert_allclose(found.yaw, 0.0, atol=1e-9)


@pytest.mark.parametrize("longitude", ["GpsLongitude", "GpsLongtitude"])
def test_without_a_letter_the_sign_is_that_of_xmp(tmp_path: Path, longitude: str) -> None:
    stated = {"GpsLongitude": "", longitude: "-151.250000"}
    found = read_photo(tmp_path, place={1: None, 3: None}, **stated)
    np.testing.assert_allclose([found.latitude[0], found.longitude[0]], [-33.51, -151.25])


def test_a_position_in_xmp_alone_is_read(tmp_path: Path) -> None:
    found = read_photo(tmp_path, place={1: None, 2: None, 3: None, 4: None})
    np.testing.assert_allclose([found.latitude[0], found.longitude[0]], [-33.51, 151.25])


@pytest.mark.parametrize(
    ("stated", "message"),
    [
        ({"place": {1: None}, "GpsLatitude": ""}, "GPSLatitude has no letter N or S beside it"),
        ({"place": {1: "N"}}, "EXIF states latitude 33.51, XMP -33.51"),
        ({"place": {18: "TOKYO"}}, "GPSMapDatum is 'TOKYO'; WGS-84 is needed"),
    ],
)
def test_a_place_that_the_fields_leave_open_is_refused(
    tmp_path: Path, stated: dict[str, Any], message: str
) -> None:
    with pytest.raises(GeoreferenceError, match=message):
        read_photo(tmp_path, **stated)


def test_wgs_84_in_any_spelling_and_a_depth_are_read(tmp_path: Path) -> None:
    found = read_photo(tmp_path, place={18: "WGS-84", 5: b"\1", 6: 12.5})
    np.testing.assert_allclose([found.latitude[0], found.altitude[0]], [-33.51, -12.5])


@pytest.mark.parametrize(("zoom", "focal_length"), [(2.0, 48.0), (1.0, 24.0), (0.0, 24.0)])
def test_a_drones_digital_zoom_lengthens_the_focal_length(
    tmp_path: Path, zoom: float, focal_length: float
) -> None:
    found = read_photo(tmp_path, camera={0xA404: zoom})
    np.testing.assert_allclose(found.focal_length, focal_length)


@pytest.mark.parametrize(
    ("stated", "missing", "reason"),
    [
        ({"tags": {0x010F: "Apple"}, "camera": {0xA404: 2.0}}, "focal_length", "DigitalZoomRatio"),
        ({"camera": {0xA002: 64, 0xA003: 32}}, "focal_length", "was cut"),
        ({"tags": {0x0112: 6}}, "yaw", "Orientation is 6"),
        ({"GimbalReverse": "1"}, "yaw", "GimbalReverse is 1"),
    ],
)
def test_fields_that_others_leave_open_are_left_out_with_the_reason(
    tmp_path: Path, stated: dict[str, Any], missing: str, reason: str
) -> None:
    found = read_photo(tmp_path, **stated)
    assert np.isnan(getattr(found, missing)).all()
    assert reason in found.remarks[missing]


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
