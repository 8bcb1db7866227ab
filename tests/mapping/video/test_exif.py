"""Telemetry of photos: EXIF, and XMP as DJI writes it."""

import math
import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from geoaim.mapping.video.exif import read_exif
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
