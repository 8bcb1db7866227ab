"""Flight logs as telemetry, and slow motion by the dates of telemetry."""

from pathlib import Path

import numpy as np
import pytest

from geoaim.base.errors import GeoaimWarning, GeoreferenceError
from geoaim.mapping.video.flight_log import read_flight_log
from geoaim.mapping.video.srt import parse_srt
from geoaim.mapping.video.video import open_video, warn_of_pace
from tests.mapping.video.test_subtitles import STATE, write_video

HEADER = (
    "time(millisecond),datetime(utc),latitude,longitude,height_above_takeoff({unit}),"
    "altitude_above_seaLevel({unit}), compass_heading(degrees), pitch(degrees),isPhoto,isVideo,"
    "gimbal_heading(degrees),gimbal_pitch(degrees),gimbal_roll(degrees),altitude({unit}),message"
)


def write_log(path: Path, *films: tuple[float, float], unit: str = "feet") -> Path:
    """A flight of 60 s that climbs 1 m/s, and records at some times; a row each 0.2 s."""
    metre = {"feet": 1 / 0.3048, "meters": 1.0}[unit]
    rows = [HEADER.format(unit=unit)]
    for number in range(300):
        time = number / 5
        film = int(any(first - 1e-6 <= time <= last + 1e-6 for first, last in films))
        height, altitude = time * metre, (time + 180) * metre
        rows.append(
            f"{200 * number},2026-05-14 10:21:{int(time):02d},54.7006,28.2907,{height:.3f},"
            f"{altitude:.3f}, 333.0, 4.0,0,{film},61.0,-90.0,0.0,{height:.3f},"
        )
    path.write_text("\n".join(rows) + "\n", encoding="utf-8-sig")
    return path


@pytest.mark.parametrize("unit", ["feet", "meters"])
def test_a_log_beside_a_video_is_its_telemetry(tmp_path: Path, unit: str) -> None:
    video = write_video(tmp_path / "a.mp4", "mov_text", [])  # 2 s
    write_log(tmp_path / "a.csv", (10.0, 12.0), (20.0, 40.0), unit=unit)
    telemetry = open_video(video).telemetry
    assert telemetry is not None
    np.testing.assert_allclose(telemetry.time, np.arange(11) / 5, atol=1e-9)
    np.testing.assert_allclose(telemetry.height, 10 + telemetry.time, atol=1e-3)
    np.testing.assert_allclose(telemetry.altitude, 190 + telemetry.time, atol=1e-3)
    np.testing.assert_allclose(np.degrees(telemetry.yaw), 29.0)
    np.testing.assert_allclose(np.degrees(telemetry.pitch), -90.0)
    assert np.isnan(telemetry.focal_length).all()


def test_parts_have_the_log_beside_the_first_of_them(tmp_path: Path) -> None:
    files = [write_video(tmp_path / name, "mov_text", []) for name in ("a.mp4", "b.mp4", "c.mp4")]
    write_log(tmp_path / "a.csv", (2.0, 3.0), (30.0, 36.0))
    telemetry = open_video(files).telemetry
    assert telemetry is not None
    np.testing.assert_allclose(telemetry.height[[0, -1]], [30.0, 36.0], atol=1e-3)


@pytest.mark.parametrize(
    "films", [((10.0, 12.0), (30.0, 32.0)), ((10.0, 40.0), (45.0, 59.0)), (), ((0.0, 50.0),)]
)
def test_a_log_whose_recording_is_not_clear_is_refused(tmp_path: Path, films: tuple) -> None:
    log = write_log(tmp_path / "a.csv", *films)
    with pytest.raises(GeoreferenceError, match=r"the video of 2.0 s is not clear.*leave only"):
        read_flight_log(log, 2.0)


def test_a_value_that_is_no_number_is_named(tmp_path: Path) -> None:
    log = write_log(tmp_path / "a.csv", (1.0, 3.0))
    log.write_text(log.read_text("utf-8").replace("28.2907", "28,2907E", 1), encoding="utf-8")
    with pytest.raises(GeoreferenceError, match=r"a number is needed"):
        read_flight_log(log, 2.0)


def test_boxes_of_the_same_name_are_no_log(tmp_path: Path) -> None:
    video = write_video(tmp_path / "a.mp4", "mov_text", [])
    (tmp_path / "a.csv").write_text("frame,id,x,y,w,h\n0,1,2,3,4,5\n")
    assert open_video(video).telemetry is None


def write_states(path: Path, length: float) -> Path:
    """Write an .SRT of 20 s whose dates last some other time."""
    entries = []
    for number in range(21):
        date = f"2026-05-14 10:21:{int(number / 20 * length):02d}.000"
        clock = f"00:00:{number:02d},000 --> 00:00:{number:02d},900"
        entries.append(f"{number + 1}\n{clock}\n{date}\n{STATE.format(0)}\n")
    path.write_text("\n".join(entries))
    return path


@pytest.mark.parametrize(
    ("length", "told"), [(5, "slow motion.*0.25 times"), (20, None), (19, None), (50, "time lapse")]
)
def test_dates_tell_slow_motion(tmp_path: Path, length: float, told: str | None) -> None:
    video = open_video(write_video(tmp_path / "a.mp4", "mov_text", []))
    write_states(tmp_path / "a.SRT", length)
    if told is None:
        warn_of_pace(video)
        return
    with pytest.warns(GeoaimWarning, match=told + ".*itsscale"):
        warn_of_pace(video)


def test_a_log_tells_slow_motion(tmp_path: Path) -> None:
    files = [write_video(tmp_path / f"{name}.mp4", "mov_text", []) for name in "abcd"]  # 8 s
    write_log(tmp_path / "a.csv", (10.0, 12.0))
    video = open_video(files)
    assert video.telemetry is not None
    assert video.telemetry.time[-1] == pytest.approx(8.0)
    with pytest.warns(GeoaimWarning, match=r"slow motion.* 2 s were recorded.* in 8 s"):
        warn_of_pace(video)


def test_dates_that_are_none_tell_nothing() -> None:
    text = "1\n00:00:00,000 --> 00:00:01,000\n2026-13-45 10:21:00\n" + STATE.format(0)
    assert np.isnan(parse_srt(text, "a.SRT").recorded)
