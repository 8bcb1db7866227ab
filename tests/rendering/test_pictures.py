import av
import numpy as np
import pytest
from PIL import GifImagePlugin

from geoaim.rendering.pictures import write_pictures


@pytest.mark.parametrize(("name", "count"), [("a.mp4", 5), ("a.gif", 5), ("a.png", 1)])
def test_pictures_are_read_back(tmp_path, name, count):
    pictures = [np.full((64, 48, 3), 40 * k, np.uint8) for k in range(count)]
    write_pictures(pictures, tmp_path / name, frame_rate=10)
    with av.open(str(tmp_path / name)) as container:
        result = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert len(result) == count
    assert result[-1].shape == (64, 48, 3)
    assert np.abs(result[-1].astype(int) - pictures[-1]).max() < 20
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_a_gif_is_made_while_its_pictures_are(tmp_path, monkeypatch):
    made, written = [], []
    convert = GifImagePlugin._normalize_mode
    monkeypatch.setattr(
        GifImagePlugin, "_normalize_mode", lambda image: (written.append(1), convert(image))[1]
    )

    def draw():
        for k in range(5):
            made.append(len(written))
            yield np.full((8, 8, 3), 40 * k, np.uint8)

    write_pictures(draw(), tmp_path / "a.gif", frame_rate=10)
    assert made[-1] >= 3  # before the last is drawn


def test_other_suffixes_and_no_pictures_are_refused(tmp_path):
    with pytest.raises(ValueError, match="must end in"):
        write_pictures([], tmp_path / "a.webm", frame_rate=10)
    with pytest.raises(ValueError, match="no pictures"):
        write_pictures([], tmp_path / "a.mp4", frame_rate=10)
    assert list(tmp_path.iterdir()) == []
