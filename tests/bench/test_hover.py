import av
import numpy as np
import pytest

from geoaim.bench import hover as made
from geoaim.bench.data import find_data
from geoaim.synthetic import Hover, render_frame
from geoaim.synthetic.scenery.texture import natural_noise


@pytest.fixture(autouse=True)
def made_stills(monkeypatch):
    field = natural_noise((540, 960), 1.2, np.random.default_rng(0))
    grey = (110 + 30 * field).clip(0, 255).astype(np.uint8).repeat(4, axis=0).repeat(4, axis=1)
    sprite = np.full((48, 104, 4), 255, np.uint8)
    monkeypatch.setattr(made, "clean_still", lambda still: np.dstack([grey] * 3))
    monkeypatch.setattr(made, "car_sprites", lambda still: [sprite])


def _video(kind, count=10):
    return made.made_video("00003", size="720p", count=count, kind=kind)


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
    assert video.good[0]
    assert (~video.good).sum() == 2
    bad = int(np.flatnonzero(~video.good)[0])
    np.testing.assert_array_equal(video[bad], video[bad])
    assert np.corrcoef(video[bad].ravel(), render_frame(video.clip, bad).ravel())[0, 1] < 0.05


def test_cut_shows_the_other_still_at_the_end():
    video = _video("cut")
    np.testing.assert_array_equal(video.good, np.arange(10) < 6)
    np.testing.assert_array_equal(video[8], render_frame(video.other, 8))


def test_gain_saturates_the_middle_third():
    video = _video("gain")
    assert video.good.all()
    assert (video[4] == 255).mean() > 0.5
    np.testing.assert_array_equal(video[8], render_frame(video.clip, 8))


def test_shadow_covers_half_of_the_frame_in_the_middle_of_the_clip():
    video = _video("shadow", count=5)
    plain = render_frame(video.clip, 2).astype(float)
    factor = video[2][..., 0] / plain[..., 0].clip(1)
    assert 0.35 < (factor < 0.3).mean() < 0.6


def test_queue_stands_for_six_tenths_and_leaves():
    hover = Hover(count=50)
    traffic = made.lane_traffic(
        "00972", hover, moving=4, queue=3, generator=np.random.default_rng(0)
    )
    steps = np.hypot(*np.diff(traffic.poses[:, :6, :2], axis=0).T)
    still = (steps == 0).sum(axis=1) / 49
    np.testing.assert_allclose(still, 0.6, atol=0.03)
    assert np.isnan(traffic.poses[-1, :6]).any(axis=1).all()


def test_many_cars_are_three_hundred():
    assert len(_video("cars", count=2).clip.traffic.sprites) >= 300


def test_truth_is_written_beside_the_video(tmp_path):
    video = _video("plain", count=4)
    path = made.write_made_video(video, tmp_path / "plain.mp4")
    with av.open(str(path)) as container:
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert len(frames) == 4
    assert np.abs(frames[2].astype(int) - video[2]).mean() < 6
    truth = np.load(path.with_suffix(".npz"))
    np.testing.assert_allclose(truth["reference_from_frame"][0], np.eye(3), atol=1e-9)
    assert truth["boxes"].shape[1] == 5


def test_box_is_filled_with_what_lies_around_it():
    generator = np.random.default_rng(0)
    road = (110 + 4 * generator.standard_normal((200, 300, 1))).repeat(3, axis=2).astype(np.uint8)
    spoilt = road.copy()
    spoilt[80:110, 120:180] = 255
    clean = made._remove_boxes(spoilt, np.array([[120, 80, 180, 110]]))
    assert np.abs(clean[80:110, 120:180].astype(int) - 110).mean() < 6


@pytest.mark.skipif(find_data() is None, reason="needs hover/songdo_stills: set GEOAIM_DATA")
def test_sprites_are_cut_from_the_stills(monkeypatch):
    monkeypatch.undo()
    sprites = made.car_sprites("00972")
    assert len(sprites) > 20
    assert all(sprite.shape[1] > sprite.shape[0] for sprite in sprites)


def test_data_folder_that_is_named_wrongly_is_an_error(monkeypatch, tmp_path):
    monkeypatch.setenv("GEOAIM_DATA", str(tmp_path / "nowhere"))
    with pytest.raises(FileNotFoundError, match="GEOAIM_DATA"):
        find_data()
