"""Numbers of frames are those of decoding order, on videos of irregular stamps, too."""

from pathlib import Path

import numpy as np
import pytest

from geoaim.base.errors import GeoaimError, GeoaimWarning, VideoError
from geoaim.mapping.georeference.reference_frame import _find_frame_index
from geoaim.mapping.video.detections import read_detections
from geoaim.mapping.video.video import Video, open_video, read_frame
from tests.mapping.video.test_video import number_of, write_clip

# a recorder that dropped four of five frames at first; milliseconds
STAMPS = [round(1000 * (5 * k if k < 12 else 48 + k) / 30) for k in range(48)]
TIMES = np.array(STAMPS) / 1000


@pytest.fixture(params=[("mp4", 0), ("mp4", 2), ("mkv", 2), ("ts", 0)], ids=str)
def clip(request: pytest.FixtureRequest, tmp_path: Path) -> Video:
    suffix, bframes = request.param
    path = tmp_path / f"clip.{suffix}"
    return open_video(write_clip(path, len(STAMPS), stamps=STAMPS, bframes=bframes))


def test_sampled_frames_have_their_numbers(clip: Video) -> None:
    frames = list(clip.sample(7))
    assert len(frames) > 4
    assert [frame.index for frame in frames] == [number_of(frame) for frame in frames]


def test_frames_at_times_have_their_numbers(clip: Video) -> None:
    wanted = [3, 11, 12, 30]
    frames = list(clip.frames_at(TIMES[wanted] + 1e-3))
    assert [frame.index for frame in frames] == [number_of(frame) for frame in frames] == wanted
    assert read_frame(clip, TIMES[4]).index == 4


def test_frames_in_order_have_their_numbers(clip: Video) -> None:
    assert [frame.index for frame in clip] == [number_of(frame) for frame in clip]


def test_the_time_of_a_number_leads_to_that_frame(clip: Video) -> None:
    assert clip.listed.count == len(STAMPS)
    for number in (0, 5, 11, 12, 47):
        assert clip.find_time(number) == pytest.approx(TIMES[number], abs=1.5e-3)
        [frame] = clip.frames_at([clip.find_time(_find_frame_index(number, clip))])
        assert number_of(frame) == number
    with pytest.raises(ValueError, match="48 frames"):
        clip.find_time(48)


def test_detections_of_a_number_are_of_that_frame(clip: Video, tmp_path: Path) -> None:
    folder = tmp_path / "labels"
    folder.mkdir()
    for number in range(len(STAMPS)):
        (folder / f"{number:06d}.txt").write_text(f"0 {(number + 1) / 50} 0.5 0.01 0.1\n")
    rows = "".join(f"{number + 1},1,{number},0,4,4,1\n" for number in range(len(STAMPS)))
    (tmp_path / "mot.txt").write_text(rows)
    arrays = [np.array([[number, 0, number + 4, 4]]) for number in range(len(STAMPS))]
    found = [read_detections(x, video=clip) for x in (folder, tmp_path / "mot.txt", arrays)]
    for frame in clip.sample(7):
        lefts = [boxes(frame).boxes[0, 0] for boxes in found]
        number = number_of(frame)
        share = (number + 1) / 50 - 0.005
        assert lefts == [pytest.approx(share * frame.grey.shape[1]), number, number]


def test_detections_by_time_find_the_frame_on_irregular_stamps(clip: Video, tmp_path: Path) -> None:
    rows = "".join(f"{time:.4f},{k},1,4,4\n" for k, time in enumerate(TIMES))
    (tmp_path / "boxes.csv").write_text(f"time,x,y,width,height\n{rows}")
    boxes = read_detections(tmp_path / "boxes.csv", video=clip)
    for frame in clip.sample(7):
        assert boxes(frame).boxes[0, 0] == number_of(frame) - 2


def make_video(count: int = 5, *, source: str = "hover.mp4", **fields: object) -> Video:
    from dataclasses import replace

    video = open_video(np.zeros((count, 20, 40, 3), np.uint8))
    return replace(video, source=source, **fields)


def write_labels(folder: Path, names: list[str]) -> Path:
    folder.mkdir(exist_ok=True)
    for number, name in enumerate(names):
        (folder / f"{name}.txt").write_text(f"0 0.5 0.{number + 1} 0.1 0.1\n")
    return folder


@pytest.mark.parametrize(
    "names",
    [
        ["000000", "000001", "000002", "000003", "000004"],
        ["hover_1", "hover_2", "hover_3", "hover_4"],  # ultralytics, without boxes in the last
        ["000001", "000002", "000003", "000004", "000005"],  # beyond the last, if counted from 0
        ["frame_0", "frame_1", "frame_2", "frame_3"],
    ],
)
def test_names_count_from_0_or_1(tmp_path: Path, names: list[str]) -> None:
    video = make_video()
    boxes = read_detections(write_labels(tmp_path / "a", names), video=video)
    for number, frame in enumerate(list(video)[: len(names)]):
        middle = boxes(frame).boxes[0, 1::2].mean() / 20
        assert middle == pytest.approx((number + 1) / 10)


@pytest.mark.parametrize("names", [["000001", "000002"], ["1", "2"], ["hover1", "hover2"]])
def test_numbers_that_may_count_from_1_are_taken_from_0_with_a_warning(
    tmp_path: Path, names: list[str]
) -> None:
    folder = write_labels(tmp_path / "a", names)
    with pytest.warns(GeoaimWarning, match="from 0 or from 1; they are taken to count from 0"):
        boxes = read_detections(folder, video=make_video())
    assert [boxes(frame) is not None for frame in make_video()][:3] == [False, True, True]


@pytest.mark.parametrize(
    ("names", "images", "message"),
    [
        (["a", "b"], None, r"of a, b, \.\.\., of which none .* from 0 \(000000, .* hover_1"),
        (["a", "b"], ("c.jpg",), r"of a, b, .* the names of its images \(c"),
        (["000000", "000009"], None, "boxes of frame number 9, but hover.mp4 has 5 frames"),
    ],
)
def test_names_of_no_frame_are_refused(
    tmp_path: Path, names: list[str], images: tuple[str, ...] | None, message: str
) -> None:
    video = make_video() if images is None else make_video(1, names=images)
    with pytest.raises(GeoaimError, match=message):
        read_detections(write_labels(tmp_path / "a", names), video=video)


def test_a_part_keeps_the_numbers_and_times_of_its_video(clip: Video) -> None:
    part = open_video(f"{clip.source}#t={TIMES[8] - 0.02:.3f},{TIMES[40] + 0.01:.3f}")
    assert part.frame_count == 33
    frames = list(part)
    assert [frame.index for frame in frames] == [number_of(frame) for frame in frames]
    assert [frame.index for frame in frames] == list(range(8, 41))
    sampled = [frame.index for frame in part.sample(5)]
    assert all(8 <= index <= 40 for index in sampled)
    assert read_frame(part, 0.0).index == _find_frame_index(None, part) == part.first == 8
    assert part.find_time(30) == pytest.approx(TIMES[30], abs=1.5e-3)
    assert number_of(next(part.frames_at([TIMES[2]]))) == 2


def test_a_part_without_frames_is_refused(clip: Video) -> None:
    with pytest.raises(VideoError, match=r"no frame between 90 and 95 s; its frames are of 0\.00"):
        open_video(f"{clip.source}#t=90,95")
