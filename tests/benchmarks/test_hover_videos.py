import numpy as np
import pytest

from benchmarks import hover_videos
from benchmarks.synthetic import Hover, render_frame
from benchmarks.synthetic.scenery.texture import make_natural_noise


@pytest.fixture(autouse=True)
def synthetic_stills(monkeypatch):
    field = make_natural_noise((540, 960), 1.2, np.random.default_rng(0))
    grey = (110 + 30 * field).clip(0, 255).astype(np.uint8).repeat(4, axis=0).repeat(4, axis=1)
    sprite = np.full((48, 104, 4), 255, np.uint8)
    monkeypatch.setattr(hover_videos, "read_clean_still", lambda still: np.dstack([grey] * 3))
    monkeypatch.setattr(hover_videos, "cut_sprites", lambda still: [sprite])


def _video(kind, count=10):
    return hover_videos.make_hover_video("00003", size="720p", count=count, kind=kind)


def test_video_is_re_iterable_and_indexable():
    video = _video("plain", count=3)
    first, again = list(video), list(video)
    assert len(video) == len(first) == 3
    np.testing.assert_array_equal(first, again)
    np.testing.assert_array_equal(first[2], video[2])
    with pytest.raises(IndexError):
        video[3]


def test_a_fifth_of_the_frames_is_noise_and_never_the_first():
    video = _video("noise")
    assert video.is_valid[0]
    assert (~video.is_valid).sum() == 2
    bad = int(np.flatnonzero(~video.is_valid)[0])
    np.testing.assert_array_equal(video[bad], video[bad])
    assert np.corrcoef(video[bad].ravel(), render_frame(video.clip, bad).ravel())[0, 1] < 0.05


def test_cut_shows_the_other_still_at_the_end():
    video = _video("cut")
    np.testing.assert_array_equal(video.is_valid, np.arange(10) < 6)
    np.testing.assert_array_equal(video[8], render_frame(video.other, 8))


def test_gain_saturates_the_middle_third():
    video = _video("gain")
    assert video.is_valid.all()
    assert (video[4] == 255).mean() > 0.5
    np.testing.assert_array_equal(video[8], render_frame(video.clip, 8))


def test_shadow_covers_half_of_the_frame_in_the_middle_of_the_clip():
    video = _video("shadow", count=5)
    plain = render_frame(video.clip, 2).astype(float)
    factor = video[2][..., 0] / plain[..., 0].clip(1)
    assert 0.35 < (factor < 0.3).mean() < 0.6


def test_queue_stands_for_six_tenths_and_leaves():
    hover = Hover(count=50)
    traffic = hover_videos.make_lane_traffic(
        "00972", hover, moving=4, queue=3, generator=np.random.default_rng(0)
    )
    steps = np.hypot(*np.diff(traffic.poses[:, :6, :2], axis=0).T)
    still = (steps == 0).sum(axis=1) / 49
    np.testing.assert_allclose(still, 0.6, atol=0.03)
    assert np.isnan(traffic.poses[-1, :6]).any(axis=1).all()


def test_many_cars_are_three_hundred():
    assert len(_video("cars", count=2).clip.traffic.sprites) >= 300
