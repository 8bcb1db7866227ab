"""Files of one recording are one video: frames, times and telemetry."""

from pathlib import Path

import numpy as np
import pytest

from geoaim.base.errors import VideoError
from geoaim.mapping.video.video import open_video
from tests.mapping.video.test_subtitles import STATE, write_video
from tests.mapping.video.test_video import RATE, number_of, write_clip


@pytest.fixture
def parts(tmp_path: Path) -> list[Path]:
    """A recording of 20, 30 and 10 frames; every file numbers its own from 0."""
    counts = {"DJI_2.mp4": 20, "DJI_9.mp4": 30, "DJI_10.mp4": 10}
    return [write_clip(tmp_path / name, count, gop=6) for name, count in counts.items()]


def test_parts_follow_one_another(parts: list[Path]) -> None:
    video = open_video(parts)
    assert (video.frame_count, video.duration) == (60, pytest.approx(2.0))
    np.testing.assert_allclose(video.read_times(), np.arange(60) / RATE)
    own = [*range(20), *range(30), *range(10)]
    for frames in (list(video), list(video)):
        assert [frame.index for frame in frames] == list(range(60))
        assert [number_of(frame) for frame in frames] == own
        np.testing.assert_allclose([frame.time for frame in frames], np.arange(60) / RATE)
    read = {
        frame.index: number_of(frame) for frame in video.frames_at(np.array([19, 20, 59]) / RATE)
    }
    assert read == {19: 19, 20: 0, 59: 9}
    sampled = [frame.index for frame in video.sample(11)]
    assert (len(sampled), sampled[0]) == (11, 0)
    assert max(np.diff(sampled)) <= 12


def test_a_pattern_takes_the_videos_in_natural_order(parts: list[Path]) -> None:
    parts[0].with_suffix(".SRT").write_text("")
    video = open_video(str(parts[0].parent / "DJI_*"))
    assert [number_of(frame) for frame in video][-10:] == list(range(10))  # DJI_10 comes last
    cut = open_video(f"{parts[0].parent}/DJI_*#t=0.6,0.8")
    assert [frame.index for frame in cut] == list(range(18, 25))


def test_telemetry_of_parts_is_joined(tmp_path: Path) -> None:
    states = [STATE.format(number % 2) for number in range(25)]  # the last ones outlast the frames
    files = [write_video(tmp_path / "a.mp4", "mov_text", states)]
    files += [write_video(tmp_path / "b.mp4", "mov_text", [])]
    files += [write_video(tmp_path / "c.mp4", "mov_text", [STATE.format(7)] * 2)]
    telemetry = open_video(files).telemetry
    assert telemetry is not None
    np.testing.assert_allclose(telemetry.time, [*(np.arange(20) / 10), 4.0, 4.1], atol=1e-3)
    np.testing.assert_allclose(telemetry.latitude[[0, 1, 20]], [54.7, 54.7001, 54.7007])


def test_files_of_another_size_or_rate_are_no_parts(parts: list[Path], tmp_path: Path) -> None:
    other = write_video(tmp_path / "other.mp4", "mov_text", [])  # 10 frames a second
    with pytest.raises(VideoError, match=r"64 x 48 px and 10 frames .*no parts of one recording"):
        open_video([parts[0], other])


def test_a_list_of_one_file_is_that_file(parts: list[Path]) -> None:
    assert open_video(parts[:1]).source == str(parts[0])
