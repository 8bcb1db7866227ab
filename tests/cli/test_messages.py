"""Messages of commands name options that exist and were not given."""

import re
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import typer
from PIL import Image
from typer.testing import CliRunner

from geoaim.cli import app
from tests.conftest import textured
from tests.mapping.video.test_exif import write_photo

SRT = """{number}
00:00:0{number},000 --> 00:00:0{number},900
{fields}

"""
MAVIC_PRO = "GPS(25.2797,54.6872,16) BAROMETER:60.0"
AIR_2 = "[focal_len : 240] [latitude: 54.6872] [longitude: 25.2797] [altitude: 60.0]"
GEOTRAX = "Vehicle_ID,Frame_Number,Local_X,Local_Y,Vehicle_Length,Vehicle_Width,Vehicle_Class\n"
SDD = '0 10 10 20 20 0 0 0 0 "Car"\n'
POINT = "name,u,v,x,y\na,1,2,3,4\n"
TILES = "https://127.0.0.1:9/{z}/{x}/{y}.png"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with inputs in which something is missing."""
    picture = textured(np.random.default_rng(1), 120, 160)
    (tmp_path / "photos").mkdir()
    for name in ("a", "b"):
        write_photo(
            tmp_path / "photos" / f"{name}.jpg",
            tags={0x0112: 3},
            picture=Image.fromarray(picture),
            GimbalPitchDegree="",
            RelativeAltitude="",
        )
    Image.fromarray(picture).save(tmp_path / "still.png")
    for name, fields in (("mavic", MAVIC_PRO), ("air", AIR_2)):
        entries = "".join(SRT.format(number=number, fields=fields) for number in (0, 1))
        (tmp_path / f"{name}.SRT").write_text(entries)
        _write_video(tmp_path / f"{name}.mp4", picture)
    (tmp_path / "geotrax.csv").write_text(GEOTRAX + "1,0,3,4,4,2,0\n")
    (tmp_path / "annotations.txt").write_text(SDD)
    (tmp_path / "points.csv").write_text(POINT)
    (tmp_path / "labels").mkdir()
    (tmp_path / "labels/other.txt").write_text("0 0.5 0.5 0.1 0.1\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def _write_video(path: Path, picture: np.ndarray) -> None:
    import av

    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=10)
        stream.height, stream.width, stream.pix_fmt = *picture.shape[:2], "yuv420p"
        for _ in range(5):
            container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        container.mux(stream.encode(None))


CASES = [
    ("build mavic.mp4 -o a.tif", {"--yaw", "--focal-length", "--points"}),
    ("build mavic.mp4 --yaw 61 --flying-height 112 -o a.tif", {"--focal-length", "--points"}),
    ("build air.mp4 --yaw 0 -o a.tif", {"--flying-height", "--points"}),
    ("build air.mp4 --yaw 0 --focal-length 24 -o a.tif", {"--flying-height", "--points"}),
    ("build photos --flying-height 80 -o a.tif", {"--yaw", "--points"}),
    ("build still.png -o a.tif", {"--points", "--frame-resolution", "--resolution"}),
    ("build still.png --points points.csv -o a.tif", set()),
    ("build still.png --resolution 1 --detections labels -o a.tif", set()),
    (f"align '{TILES}' -o a.tif", {"--aim", "--tracks"}),
    (f"align '{TILES}' --resolution 0.2 -o a.tif", {"--aim", "--tracks"}),
    ("align 'https://127.0.0.1:9/tiles' -o a.tif", set()),
    ("align still.png --zoom 18 -o a.tif", {"--zoom"}),
    ("convert geotrax.csv -o a.csv", {"--tracks-frame-rate"}),
    ("convert annotations.txt -o a.csv", {"--tracks-resolution"}),
    ("convert geotrax.csv --tracks-resolution 1 -o a.csv", {"--tracks-resolution"}),
]


def test_messages_name_options_that_exist_and_are_not_given(folder: Path) -> None:
    for command, asks in CASES:
        words = shlex.split(command)
        result = CliRunner().invoke(app, words)
        message = " ".join(result.output.split())
        assert result.exit_code == 1, message
        named = set(re.findall(r"(?<![\w-])--[a-z][a-z-]*", message))
        known = {option for item in _list_parameters(words[0]) for option in item.opts}
        assert asks <= named <= known, message
        assert "omit" in message or not named & set(words), message
        assert not re.search(r"\w=\.\.\.|Tiles\(|\w+=(?=[ ,;)]|$)", message), message


def _list_parameters(command: str) -> list[Any]:
    return list(typer.main.get_command(app).commands[command].params)  # type: ignore[attr-defined]
