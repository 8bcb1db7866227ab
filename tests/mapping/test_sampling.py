from dataclasses import replace

import numpy as np
import pytest

from benchmarks.synthetic.camera import render_frame
from geoaim.mapping.registration.register import register
from geoaim.mapping.report import report_registration
from geoaim.mapping.sampling import sample_video, select_registered_frames
from geoaim.mapping.video.video import open_video


def blank_video(count: int):
    return open_video(np.zeros((count, 8, 8, 3), np.uint8), rate=10)


def read_indices(video, frames) -> list[int]:
    return [frame.index for frame in sample_video(video, frames).read()]


def test_auto_takes_64_frames_spread_over_the_video():
    indices = read_indices(blank_video(640), "auto")
    assert len(set(indices)) == 64
    assert set(np.diff(indices)) <= {10, 11}


def test_frames_that_fit_into_memory_are_decoded_once():
    readings = []
    video = blank_video(640)

    def read_at(times, slack):
        readings.append(len(times))
        return video.read_at(times, slack)

    sample = sample_video(replace(video, read_at=read_at), 6)
    assert [len(list(sample.read())) for _ in range(2)] == [6, 6]
    assert sample.is_kept
    large = replace(video, read_at=read_at, height=10_000, width=10_000)
    assert not sample_video(large, 6).is_kept
    assert readings == [6]


def test_short_video_is_read_whole():
    assert read_indices(blank_video(12), "auto") == list(range(12))


def test_all_frames_of_a_long_video_fill_bands_of_rows():
    sample = sample_video(blank_video(200), "all")
    assert (sample.bands, sample.count, sample.plain_mean) == (4, 200, True)


def test_number_of_frames_is_at_most_that_of_the_video():
    assert sample_video(blank_video(12), 20).count == 12
    assert read_indices(blank_video(12), 3) == [0, 5, 11]


@pytest.mark.usefixtures("unchecked")
def test_other_choices_are_refused():
    with pytest.raises(ValueError, match="'auto', 'all' or a number"):
        sample_video(blank_video(12), "some")


def test_only_registered_frames_are_averaged(clip):
    frames = [render_frame(clip, index) for index in range(3)]
    frames[1] = np.random.default_rng(0).integers(0, 256, frames[0].shape, np.uint8)
    registration = register(frames, reference_time=0)
    again = list(select_registered_frames(open_video(frames), registration))
    assert [frame.index for frame, _ in again] == [0, 2]
    np.testing.assert_array_equal(again[1][1], registration.reference_from_frame[2])
    assert report_registration(registration)["valid"] == 2
