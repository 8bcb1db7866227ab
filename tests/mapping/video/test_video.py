"""Frames: times, order, pixels, sampling, and messages about damaged files."""

import gc
import os
import tracemalloc
import warnings
from collections.abc import Iterator, Sequence
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from geoaim.aim.files import write_aim
from geoaim.base.errors import GeoaimWarning, VideoError
from geoaim.mapping.video.frames import Frame, YuvEncoding, image_from_planes
from geoaim.mapping.video.video import open_video
from tests.aim.test_aim import make_aim

HEIGHT, WIDTH = 48, 64
RATE = 30


def picture(index: int, height: int = HEIGHT, width: int = WIDTH) -> np.ndarray:
    """Blocks that carry the frame's number in binary, over a fixed gradient."""
    image = np.zeros((height, width, 3), np.uint8)
    image[..., 1] = np.linspace(0, 255, width).astype(np.uint8)
    for bit in range(8):
        image[8:24, 8 * bit : 8 * bit + 8] = 255 * (index >> bit & 1)
    return image


def number_of(frame: Frame) -> int:
    """The number that `picture` wrote."""
    return sum((int(frame.grey[16, 8 * bit + 4]) > 128) << bit for bit in range(8))


def write_clip(
    path: Path,
    count: int = 60,
    *,
    gop: int = 12,
    bframes: int = 2,
    stamps: Sequence[int] | None = None,
    rotation: int = 0,
    x264: str = "",
    audio_only: bool = False,
    **options: str,
) -> Path:
    with av.open(str(path), "w", options=options) as container:
        if audio_only:
            sound = container.add_stream("aac", rate=8000)
            silence = av.AudioFrame.from_ndarray(np.zeros((1, 1024), np.float32), "fltp", "mono")
            silence.sample_rate = 8000
            container.mux([*sound.encode(silence), *sound.encode(None)])
            return path
        stream = container.add_stream("libx264", rate=RATE)
        stream.height, stream.width, stream.pix_fmt = HEIGHT, WIDTH, "yuv420p"
        stream.codec_context.gop_size = gop
        stream.options = {
            "bf": str(bframes),
            "preset": "ultrafast",
            "crf": "12",
            "sc_threshold": "0",
            "x264-params": x264,
        }
        if stamps is not None:
            stream.codec_context.time_base = Fraction(1, 1000)
        if rotation:
            stream.set_display_rotation(rotation)
        for index in range(count):
            frame = av.VideoFrame.from_ndarray(picture(index), format="rgb24")
            if stamps is not None:
                frame.pts, frame.time_base = stamps[index], Fraction(1, 1000)
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
    return path


@pytest.fixture(scope="module")
def clips(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("clips")
    kinds = ("mp4", "mkv", "ts", "avi", "h264")
    front = {"mp4": {"movflags": "faststart"}}  # the index first: a cut file stays readable
    return {kind: write_clip(folder / f"clip.{kind}", **front.get(kind, {})) for kind in kinds}


@pytest.fixture
def images(tmp_path: Path) -> Path:
    for index in range(12):
        cv2.imwrite(str(tmp_path / f"frame_{index}.png"), picture(index)[..., ::-1])
    (tmp_path / "frame_0.txt").write_text("0 0.5 0.5 0.1 0.1")
    return tmp_path


@pytest.mark.parametrize("kind", ["mp4", "mkv", "ts", "avi", "h264"])
def test_every_frame_comes_once_in_order_and_again(clips: dict[str, Path], kind: str) -> None:
    video = open_video(clips[kind])
    for _ in range(2):
        assert [number_of(frame) for frame in video] == list(range(60))
    assert [frame.index for frame in video] == list(range(60))
    assert (video.height, video.width, video.names) == (HEIGHT, WIDTH, None)


@pytest.mark.parametrize("kind", ["mp4", "mkv", "ts"])
def test_times_start_at_zero_and_follow_the_rate(clips: dict[str, Path], kind: str) -> None:
    video = open_video(clips[kind])
    times = [frame.time for frame in video]
    np.testing.assert_allclose(times, np.arange(60) / RATE, atol=6e-4)
    assert (video.frame_count, video.rate) == (60, RATE)
    assert video.duration == pytest.approx(2.0)


def test_variable_frame_rate_keeps_the_timestamps(tmp_path: Path) -> None:
    stamps = np.cumsum([0, 20, 80, 20, 200, 33, 33, 500, 20, 20])
    video = open_video(write_clip(tmp_path / "v.mkv", 10, stamps=stamps.tolist()))
    np.testing.assert_allclose([frame.time for frame in video], stamps / 1000, atol=1e-9)
    assert [number_of(frame) for frame in video.frames_at([0.11, 0.3])] == [2, 3]


@pytest.mark.parametrize(("use_editlist", "first"), [("0", 0), ("1", 10)])
def test_negative_timestamps_and_edit_lists_start_at_time_zero(
    tmp_path: Path, use_editlist: str, first: int
) -> None:
    """An edit list hides what lies before zero; without one, all frames count from the first."""
    stamps = [-400 + 40 * index for index in range(30)]
    path = write_clip(tmp_path / "n.mov", 30, stamps=stamps, use_editlist=use_editlist)
    video = open_video(path)
    whole = list(video)
    assert [number_of(frame) for frame in whole] == list(range(first, 30))
    assert [frame.time for frame in whole][:2] == pytest.approx([0.0, 0.04])
    assert video.frame_count == len(whole)
    found = [number_of(frame) for frame in video.frames_at([0.0, 0.21, 0.41])]
    assert found == [first, first + 5, first + 10]
    assert number_of(next(video.sample(5))) == first


def test_raw_stream_without_timestamps_counts_by_its_rate(clips: dict[str, Path]) -> None:
    video = open_video(clips["h264"])
    assert video.frame_count is None
    assert np.isnan(video.duration)
    np.testing.assert_allclose([f.time for f in video], np.arange(60) / video.rate)
    assert [number_of(frame) for frame in video.sample(4)] == [0, 19, 39, 59]


@pytest.mark.parametrize("kind", ["mp4", "mkv", "ts", "avi"])
def test_frames_at_times_are_those_of_the_whole_pass(clips: dict[str, Path], kind: str) -> None:
    video = open_video(clips[kind])
    whole = {round(frame.time, 4): frame.image for frame in video}
    times = sorted(whole)
    wanted = [times[index] for index in (0, 1, 11, 12, 13, 30, 47, 48, 59)]
    found = list(video.frames_at([time + 0.005 for time in wanted[::-1]]))
    assert [round(frame.time, 4) for frame in found] == wanted
    for frame in found:
        np.testing.assert_array_equal(frame.image, whole[round(frame.time, 4)])


def test_frames_at_gives_each_frame_once(clips: dict[str, Path]) -> None:
    found = open_video(clips["mp4"]).frames_at([0.5, 0.505, 0.51, 0.5])
    assert [frame.index for frame in found] == [15]


def test_frames_at_a_time_past_the_end_warns(clips: dict[str, Path]) -> None:
    with pytest.warns(GeoaimWarning, match="1 of 1 requested frames cannot be read"):
        list(open_video(clips["mp4"]).frames_at([100.0]))


def test_times_that_are_not_numbers_are_refused(clips: dict[str, Path]) -> None:
    with pytest.raises(ValueError, match="finite"):
        open_video(clips["mp4"]).frames_at([float("nan")])
    with pytest.raises(ValueError, match="at least 1"):
        open_video(clips["mp4"]).sample(0)


@pytest.mark.parametrize("kind", ["mp4", "mkv"])
def test_samples_snap_to_keyframes_where_these_are_dense(clips: dict[str, Path], kind: str) -> None:
    found = list(open_video(clips[kind]).sample(6))
    assert [frame.decoded.key_frame for frame in found] == [True] * 5 + [False]
    assert [number_of(frame) for frame in found] == [0, 12, 24, 36, 48, 59]
    assert [frame.index for frame in found] == [0, 12, 24, 36, 48, 59]


@pytest.mark.parametrize("kind", ["mp4", "mkv", "ts", "avi", "h264"])
@pytest.mark.parametrize("count", [1, 2, 7, 25])
def test_samples_are_even_distinct_and_start_at_the_first(
    clips: dict[str, Path], kind: str, count: int
) -> None:
    found = [number_of(frame) for frame in open_video(clips[kind]).sample(count)]
    assert len(found) == count
    step = 59 / max(count - 1, 1)
    np.testing.assert_allclose(found, np.arange(count) * step, atol=step / 2 + 1)
    assert found[0] == 0


def test_more_samples_than_frames_are_all_frames(clips: dict[str, Path]) -> None:
    assert [f.index for f in open_video(clips["mp4"]).sample(99)] == list(range(60))


def test_samples_decode_keyframes_only(tmp_path: Path, decoded_packets: list[object]) -> None:
    """A video ten times as long costs no more: the packets that are decoded are as many."""
    spent = []
    for count in (60, 600):
        video = open_video(write_clip(tmp_path / f"{count}.mp4", count, gop=6))
        decoded_packets.clear()
        assert len(list(video.sample(8))) == 8
        spent.append(len(decoded_packets))
    assert spent[1] <= spent[0]


@pytest.mark.parametrize(("bframes", "share"), [(0, 1.0), (2, 2 / 3)])
def test_frames_that_no_other_needs_are_decoded_without_slack_only(
    tmp_path: Path, bframes: int, share: float
) -> None:
    video = open_video(write_clip(tmp_path / "b.mp4", 120, gop=1000, bframes=bframes))
    times = np.arange(120) / RATE
    exact, close = (list(video.read_at(times, slack / RATE)) for slack in (0.0, 3.0))
    assert [number_of(frame) for frame in exact] == list(range(120))
    assert number_of(close[0]) == 0
    assert len(close) <= 120 * share
    assert all(number_of(frame) == frame.index for frame in close)


def test_keyframes_of_open_groups_are_those_of_the_whole_pass(tmp_path: Path) -> None:
    video = open_video(write_clip(tmp_path / "open.mp4", 100, x264="open-gop=1"))
    whole = {frame.index: frame.image for frame in video}
    found = list(video.sample(9))
    assert sum(frame.decoded.key_frame for frame in found) > 6
    for frame in found:
        np.testing.assert_array_equal(frame.image, whole[frame.index])


@pytest.mark.parametrize(("gop", "interval"), [(1, 1 / RATE), (12, 0.4), (1000, np.inf)])
def test_keyframe_interval_is_that_of_the_file(tmp_path: Path, gop: int, interval: float) -> None:
    video = open_video(write_clip(tmp_path / "spaced.mp4", gop=gop))
    assert video.keyframe_interval == pytest.approx(interval)


def test_arrays_need_no_keyframes_but_iterables_are_read_from_the_first_frame_on() -> None:
    arrays = [picture(0), picture(1)]
    assert open_video(arrays).keyframe_interval == 0
    assert open_video(ReIterable(arrays)).keyframe_interval == np.inf


def test_grey_is_a_read_only_view_of_the_decoder(clips: dict[str, Path]) -> None:
    frame = next(iter(open_video(clips["mp4"])))
    assert frame.grey.shape == (HEIGHT, WIDTH)
    assert not frame.grey.flags.owndata
    assert not frame.grey.flags.writeable
    luma = np.frombuffer(frame.decoded.planes[0], np.uint8)
    assert np.shares_memory(frame.grey, luma)


def test_frames_stay_valid_after_the_video_has_moved_on(clips: dict[str, Path]) -> None:
    kept = [frame for frame in open_video(clips["mp4"]) if frame.index % 10 == 0]
    gc.collect()
    assert [number_of(frame) for frame in kept] == [0, 10, 20, 30, 40, 50]


def test_image_undoes_the_encoder(clips: dict[str, Path]) -> None:
    frame = next(iter(open_video(clips["mp4"])))
    assert frame.image.dtype == np.uint8
    assert np.abs(frame.image.astype(int) - picture(0)).mean() < 4


@pytest.mark.parametrize("matrix", [1, 2, 5, 7, 9])
@pytest.mark.parametrize("full", [False, True])
def test_planes_give_the_same_image_as_swscale(matrix: int, full: bool) -> None:
    generator = np.random.default_rng(matrix)
    planes = generator.integers(60, 190, (3 * HEIGHT // 2, WIDTH), dtype=np.uint8)
    decoded = av.VideoFrame.from_ndarray(planes, format="yuv420p")
    decoded.colorspace, decoded.color_range = matrix, 2 if full else 1
    frame = Frame(0, 0.0, None, decoded)
    assert frame.planes is not None
    assert frame.encoding is not None
    assert frame.encoding.full_range == full
    difference = image_from_planes(*frame.planes, frame.encoding) - frame.image.astype(int)
    assert np.abs(difference).max() <= 3
    assert np.abs(difference).mean() < 1.5


def test_planes_of_odd_size_give_an_image_of_that_size() -> None:
    planes = np.full((5, 7), 126.0), np.full((3, 4), 128.0), np.full((3, 4), 128.0)
    image = image_from_planes(*planes, YuvEncoding(0.299, 0.114, True))
    np.testing.assert_array_equal(image, np.full((5, 7, 3), 126, np.uint8))


@pytest.mark.parametrize("name", ["nv12", "yuv422p", "yuv420p10le", "rgb24", "gray"])
def test_grey_of_any_format_is_its_luma(name: str) -> None:
    decoded = av.VideoFrame.from_ndarray(picture(5), format="rgb24").reformat(format=name)
    frame = Frame(0, 0.0, None, decoded)
    assert number_of(frame) == 5
    assert frame.planes is None
    assert frame.image.shape == (HEIGHT, WIDTH, 3)


@pytest.mark.parametrize("rotation", [90, 180, -90])
def test_rotation_of_the_display_matrix_is_applied(tmp_path: Path, rotation: int) -> None:
    video = open_video(write_clip(tmp_path / "r.mp4", 3, rotation=rotation))
    expected = np.rot90(picture(0), rotation // 90)  # FFmpeg counts counter-clockwise, as numpy
    assert (video.height, video.width) == expected.shape[:2]
    for frame in (next(iter(video)), next(video.sample(1))):
        assert np.abs(frame.image.astype(int) - expected).mean() < 4
        assert frame.grey.shape == expected.shape[:2]
        assert frame.planes is None


@pytest.mark.parametrize("kind", ["mp4", "mkv", "avi"])
def test_truncated_file_gives_the_frames_before_the_break(
    clips: dict[str, Path], tmp_path: Path, kind: str
) -> None:
    whole = clips[kind].read_bytes()
    (tmp_path / f"cut.{kind}").write_bytes(whole[: len(whole) * 7 // 10])
    video = open_video(tmp_path / f"cut.{kind}")
    with pytest.warns(GeoaimWarning, match=r"breaks off after frame \d+ .* 60 frames"):
        found = [number_of(frame) for frame in video]
    assert found == list(range(len(found)))
    assert 15 < len(found) < 59
    with pytest.warns(GeoaimWarning):
        assert 2 < len(list(video.sample(10))) < 10


def test_truncated_mp4_without_index_says_so(tmp_path: Path) -> None:
    path = write_clip(tmp_path / "cut.mp4")
    os.truncate(path, path.stat().st_size // 2)
    with pytest.raises(VideoError, match="moov"):
        open_video(path)


def test_damage_in_the_middle_is_left_out_with_a_warning(
    clips: dict[str, Path], tmp_path: Path
) -> None:
    broken = bytearray(clips["mkv"].read_bytes())
    middle = len(broken) // 2
    broken[middle : middle + 400] = np.random.default_rng(0).bytes(400)
    (tmp_path / "hole.mkv").write_bytes(broken)
    with pytest.warns(GeoaimWarning, match=r"damaged, left out \d+ frame\(s\) after frame \d+"):
        found = [(frame.index, number_of(frame)) for frame in open_video(tmp_path / "hole.mkv")]
    assert all(index == number for index, number in found)  # the gap shows in the index
    assert found[-1] == (59, 59)
    assert 30 <= len(found) < 60


def test_whole_files_give_no_warning(clips: dict[str, Path]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for path in clips.values():
            assert len(list(open_video(path))) == 60
            assert len(list(open_video(path).sample(9))) == 9


def test_frames_years_apart_are_refused(clips: dict[str, Path], tmp_path: Path) -> None:
    content = bytearray(clips["avi"].read_bytes())
    scale = content.index(b"strh") + 28  # of which a second has `rate`, the number after it
    content[scale : scale + 8] = b"\xff\xff\xff\x0f\1\0\0\0"
    (tmp_path / "damaged.avi").write_bytes(content)
    with pytest.raises(VideoError, match=r"damaged\.avi: frame 1 is at 2\.68e\+08 s, 864000 s at"):
        list(open_video(tmp_path / "damaged.avi"))


def test_files_that_are_no_video_are_refused_at_once(tmp_path: Path) -> None:
    (tmp_path / "empty.mp4").touch()
    (tmp_path / "text.mp4").write_text("not a video" * 50)
    (tmp_path / "folder").mkdir()
    (tmp_path / "broken.png").write_bytes(b"\x89PNG not an image")
    write_clip(tmp_path / "sound.mp4", audio_only=True)
    for name, message in {
        "absent.mp4": "no such file",
        "empty.mp4": "the file is empty",
        "text.mp4": "not a video that FFmpeg can read",
        "sound.mp4": "no video in this file, but audio; give a video",
        "folder": "no image found",
        "*.tif": "no image found",
        "broken.png": "not an image that can be read",
    }.items():
        with pytest.raises(VideoError, match=message):
            open_video(tmp_path / name)


def test_folder_is_read_in_natural_order_with_the_index_as_time(images: Path) -> None:
    video = open_video(images)
    assert video.names == tuple(f"frame_{index}.png" for index in range(12))
    assert [(f.index, f.time, number_of(f)) for f in video] == [(i, i, i) for i in range(12)]
    assert [frame.name for frame in video.sample(2)] == ["frame_0.png", "frame_11.png"]
    np.testing.assert_array_equal(next(iter(video)).image, picture(0))
    assert video.telemetry is None


def test_glob_list_and_single_image_are_read(images: Path) -> None:
    assert len(list(open_video(str(images / "frame_1*.png")))) == 3
    assert [number_of(f) for f in open_video([images / "frame_7.png", images / "frame_2.png"])] == [
        7,
        2,
    ]
    assert [number_of(frame) for frame in open_video(images / "frame_3.png")] == [3]
    assert [f.time for f in open_video(images, rate=4).frames_at([0.3, 0.5])] == [0.25, 0.5]


def test_image_of_another_size_is_named(images: Path) -> None:
    cv2.imwrite(str(images / "frame_5.png"), picture(5, 40, 64))
    with pytest.raises(VideoError, match=r"frame_5\.png: 40 x 64 .* 48 x 64"):
        list(open_video(images))


def test_map_as_an_image_is_refused_in_one_line(tmp_path: Path, capfd) -> None:
    write_aim(make_aim(), tmp_path / "map.tif")
    with pytest.raises(VideoError, match="is a map of geoaim"):
        open_video(tmp_path / "map.tif")
    assert capfd.readouterr().err == ""


def test_exif_orientation_of_images_is_applied(tmp_path: Path) -> None:
    pillow = pytest.importorskip("PIL.Image")  # comes with matplotlib
    exif = pillow.Exif()
    exif[0x0112] = 6
    pillow.fromarray(picture(5)).save(tmp_path / "turned.jpg", exif=exif, quality=95)
    frame = next(iter(open_video(tmp_path)))
    assert np.abs(frame.image.astype(int) - np.rot90(picture(5), -1)).mean() < 8


def test_arrays_are_frames_and_a_generator_is_refused() -> None:
    arrays = [picture(index) for index in range(5)]
    for source in (arrays, np.stack(arrays), ReIterable(arrays)):
        video = open_video(source, rate=10)
        assert [number_of(frame) for frame in video] == [0, 1, 2, 3, 4]
        assert [number_of(frame) for frame in video.sample(3)] == [0, 2, 4]
        assert [frame.time for frame in video.frames_at([0.3, 9.0])] == pytest.approx([0.3, 0.4])
    grey = open_video([array[..., 0] for array in arrays])
    assert next(iter(grey)).image.shape == (HEIGHT, WIDTH, 3)
    assert open_video(grey) is grey
    with pytest.raises(TypeError, match="one-shot iterator"):
        open_video(iter(arrays))


class ReIterable:
    def __init__(self, arrays: list[np.ndarray]) -> None:
        self.arrays = arrays

    def __iter__(self) -> Iterator[np.ndarray]:
        return iter(self.arrays)


def test_arrays_that_are_no_images_are_refused() -> None:
    with pytest.raises(VideoError, match="no frames"):
        open_video([])
    with pytest.raises(TypeError, match="frame 0: uint8"):
        open_video([np.zeros((4, 4), np.float32)])
    with pytest.raises(VideoError, match="frame 1: 5 x 4"):
        list(open_video([np.zeros((4, 4), np.uint8), np.zeros((5, 4), np.uint8)]))
    with pytest.raises(TypeError, match="int"):
        open_video(3)


def test_memory_does_not_grow_with_the_length() -> None:
    peaks = []
    for count in (20, 200):
        tracemalloc.start()
        for frame in open_video(Made(count)):
            assert frame.image.size
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 1.5 * peaks[0]


class Made:
    """Frames that are made when asked for."""

    def __init__(self, count: int) -> None:
        self.count = count

    def __iter__(self) -> Iterator[np.ndarray]:
        return (np.full((200, 300, 3), index, np.uint8) for index in range(self.count))


def test_decoded_frames_are_not_kept(tmp_path: Path) -> None:
    import weakref

    alive: list[weakref.ref[Frame]] = []
    for frame in open_video(write_clip(tmp_path / "long.mp4", 120, gop=30)):
        alive.append(weakref.ref(frame))
        assert sum(ref() is not None for ref in alive) <= 2


def test_malformed_sidecar_warns_and_absent_one_is_none(tmp_path: Path) -> None:
    video = open_video(write_clip(tmp_path / "DJI_0001.mp4", 3))
    assert video.telemetry is None
    (tmp_path / "DJI_0001.SRT").write_text("1\n00:00:00,000 --> 00:00:01,000\nHello\n")
    with pytest.warns(GeoaimWarning, match="telemetry is ignored"):
        assert open_video(tmp_path / "DJI_0001.mp4").telemetry is None


def test_digits_that_are_no_numbers_are_sorted_as_text(tmp_path):
    names = ["1\u00b22.png", "2.png", "10.png"]
    for name in names:
        (tmp_path / name).write_bytes(cv2.imencode(".png", np.zeros((4, 4, 3), np.uint8))[1])
    assert open_video(tmp_path).names == tuple(names)


def test_a_video_that_is_to_be_shown_mirrored_is_warned_of(tmp_path):
    path = write_clip(tmp_path / "a.mp4", 3)
    content = bytearray(path.read_bytes())
    at = content.index(b"tkhd") + 44  # the matrix of the track's header
    assert content[at : at + 4] == (1 << 16).to_bytes(4, "big")
    content[at : at + 4] = (-1 << 16).to_bytes(4, "big", signed=True)
    path.write_bytes(content)
    with pytest.warns(GeoaimWarning, match="shown as in a mirror"):
        open_video(path)


def test_pixels_that_are_not_square_are_warned_of(tmp_path):
    path = tmp_path / "a.mp4"
    with av.open(path, "w") as container:
        stream = container.add_stream("mpeg4", rate=10)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.codec_context.sample_aspect_ratio = Fraction(4, 3)
        frame = av.VideoFrame.from_ndarray(np.zeros((48, 64, 3), np.uint8))
        container.mux(stream.encode(frame))
        container.mux(stream.encode())
    with pytest.warns(GeoaimWarning, match="1.33 times as wide as high"):
        open_video(path)
