import json

import numpy as np
import pandas as pd
import pytest

from benchmarks.registration import public
from geoaim.base.encode import write_video
from geoaim.base.geometry import translation

FRAMES = 5


def test_frames_are_right_wrong_or_rejected(tmp_path, monkeypatch):
    monkeypatch.setattr(public, "HARD", {"plain": ("plain", None)})
    clips, tables = tmp_path / "clips", tmp_path / "mine"
    clips.mkdir()
    tables.mkdir()
    write_video(np.zeros((FRAMES, 48, 64, 3), np.uint8), clips / "street, plain.mp4")
    truth = np.stack([translation(0.5 * frame, 0) for frame in range(FRAMES)])
    public._write_matrices(truth, clips / "street, plain.truth.csv")
    given = truth.copy()
    given[1, 0, 2] += 0.1
    given[2, 0, 2] += 1.0
    given[3] = np.nan
    path = tables / "street, plain.csv"
    public._write_matrices(given, path)
    pd.read_csv(path).iloc[:-1].to_csv(path, index=False)  # the last frame is left out
    public.judge(clips, [tables], tmp_path / "result.json")
    [row] = json.loads((tmp_path / "result.json").read_text())["rows"]
    assert (row["method"], row["frames"]) == ("mine", 4)
    assert (row["right, %"], row["wrong, %"], row["rejected, %"]) == (25, 25, 50)
    assert row["median, px"] == pytest.approx(0.55)
