"""Telemetry in the subtitles inside a video, and which of its streams is the video."""

from fractions import Fraction

import av
import numpy as np
import pytest

from geoaim.mapping.video.video import open_video

STATE = (
    "[focal_len: 24.00] [latitude: 54.700{0}00] [longitude: 28.290769] [rel_alt: 112.897 "
    "abs_alt: 293.897] [gb_yaw: 61.0 gb_pitch: -90.0]"
)
STYLES = b"""[Script Info]
ScriptType: v4.00+

[V4+ Styles]
Format: Name, Fontname, Fontsize
Style: Default,Arial,16

[Events]
Format: Layer, Start, End, Style, Name, MarginL, MarginR, MarginV, Effect, Text
"""


def write_video(path, codec, texts, thumbnail=False):
    with av.open(str(path), "w") as container:
        first = container.add_stream("mjpeg", rate=10) if thumbnail else None
        if first is not None:
            first.width, first.height, first.pix_fmt = 320, 240, "yuvj420p"
        video = container.add_stream("mpeg4", rate=10)
        video.width, video.height, video.pix_fmt = 64, 48, "yuv420p"
        subtitles = container.add_stream(codec)
        subtitles.codec_context.subtitle_header = STYLES
        if first is not None:
            still = av.VideoFrame.from_ndarray(np.zeros((240, 320, 3), np.uint8))
            container.mux([*first.encode(still), *first.encode()])
        for _ in range(20):
            frame = av.VideoFrame.from_ndarray(np.zeros((48, 64, 3), np.uint8))
            container.mux(video.encode(frame))
        container.mux(video.encode())
        for number, text in enumerate(texts):
            content = text.encode()
            if codec == "mov_text":
                content = len(content).to_bytes(2, "big") + content
            packet = av.Packet(content)
            packet.stream, packet.time_base, packet.duration = subtitles, Fraction(1, 1000), 100
            packet.pts = packet.dts = 100 * number
            container.mux(packet)
    return path


@pytest.mark.parametrize(("name", "codec"), [("a.mp4", "mov_text"), ("a.mkv", "subrip")])
def test_states_in_subtitles_are_telemetry(tmp_path, name, codec):
    states = [STATE.format(number) for number in range(5)]
    telemetry = open_video(write_video(tmp_path / name, codec, states)).telemetry
    np.testing.assert_allclose(telemetry.time, np.arange(5) / 10, atol=1e-3)
    np.testing.assert_allclose(telemetry.latitude, 54.7 + np.arange(5) / 1e4)
    np.testing.assert_array_equal(telemetry.height, np.full(5, 112.897))


def test_subtitles_that_are_spoken_are_no_telemetry(tmp_path):
    path = write_video(tmp_path / "a.mp4", "mov_text", ["Good morning!", "--> over there"])
    assert open_video(path).telemetry is None


def test_the_longest_stream_is_the_video_and_a_thumbnail_is_not(tmp_path):
    video = open_video(write_video(tmp_path / "a.mp4", "mov_text", [], thumbnail=True))
    assert (video.width, video.height, video.frame_count) == (64, 48, 20)
