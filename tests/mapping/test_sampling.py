from dataclasses import replace
from itertools import chain

import numpy as np
import pytest

from geoaim.mapping.registration.register import register
from geoaim.mapping.report import report_registration
from geoaim.mapping.sampling import read_registered, sample_video
from geoaim.mapping.video.video import open_video
from geoaim.synthetic.camera import render_frame


def blank_video(count: int):
    return open_video(np.zeros((count, 8, 8, 3), np.uint8), rate=10)


def read_indices(video, frames) -> list[list[int]]:
    return [[frame.index for frame in batch] for batch in sample_video(video, frames).read()]


def test_batches_of_auto_double_and_share_no_frame():
    batches = read_indices(blank_video(640), "auto")
    assert [len(batch) for batch in batches] == [16, 16, 32]
    assert len(set(chain.from_iterable(batches))) == 64
    for batch in batches:
        assert max(np.diff(batch)) <= 640 / len(batch) + 1


def test_one_pass_gives_the_same_batches():
    video = blank_video(640)
    assert read_indices(replace(video, keyframe_interval=np.inf), "auto") == read_indices(
        video, "auto"
    )


def test_one_pass_reads_the_video_once():
    readings = []
    video = blank_video(640)

    def read_at(times, slack):
        readings.append(len(times))
        return video.read_at(times, slack)

    spaced = replace(video, keyframe_interval=10.0, read_at=read_at)
    assert sum(len(batch) for batch in read_indices(spaced, "auto")) == 64
    assert readings == [64]


def test_only_frames_that_fit_into_memory_are_kept():
    assert sample_video(blank_video(640), "auto").fits_memory
    assert not sample_video(replace(blank_video(640), height=10_000, width=10_000), 6).fits_memory


def test_short_video_is_read_whole_in_one_batch():
    assert read_indices(blank_video(12), "auto") == [list(range(12))]


def test_all_frames_of_a_long_video_fill_bands_of_rows():
    sampling = sample_video(blank_video(200), "all")
    assert (sampling.bands, sampling.frame_count, sampling.plain_mean) == (4, 200, True)


def test_number_of_frames_is_at_most_that_of_the_video():
    assert sample_video(blank_video(12), 20).frame_count == 12
    assert read_indices(blank_video(12), 3) == [[0, 5, 11]]


@pytest.mark.usefixtures("unchecked")
def test_other_choices_are_refused():
    with pytest.raises(ValueError, match="'auto', 'all' or a number"):
        sample_video(blank_video(12), "some")


def test_registered_frames_are_read_again_without_the_invalid_ones(clip):
    frames = [render_frame(clip, index) for index in range(3)]
    frames[1] = np.random.default_rng(0).integers(0, 256, frames[0].shape, np.uint8)
    registration = register(frames, reference_time=0)
    sampling = sample_video(open_video(frames), "all")
    again = list(read_registered(sampling, registration))
    assert [frame.index for frame, _ in again] == [0, 2]
    np.testing.assert_array_equal(again[1][1], registration.reference_from_frame[2])
    assert report_registration(registration)["valid"] == 2
