import os
import sys

import numpy as np
import pytest

from geoaim.base.encode import write_video


@pytest.mark.skipif(sys.platform != "linux", reason="needs the cores of a process to be chosen")
def test_a_video_does_not_depend_on_the_machines_cores(tmp_path):
    still = np.random.default_rng(0).integers(0, 255, (360, 640, 3), dtype=np.uint8)
    frames = [np.roll(still, 3 * index, axis=1) for index in range(8)]
    cores = os.sched_getaffinity(0)
    if len(cores) < 2:
        pytest.skip("needs two cores")
    on_all = write_video(frames, tmp_path / "all.mp4").read_bytes()
    os.sched_setaffinity(0, [min(cores)])
    try:
        on_one = write_video(frames, tmp_path / "one.mp4").read_bytes()
    finally:
        os.sched_setaffinity(0, cores)
    assert on_one == on_all


@pytest.mark.parametrize(("height", "expected"), [(90, b"mbtree=0"), (96, b"mbtree=1")])
def test_x264_runs_without_what_makes_its_bytes_differ(tmp_path, height, expected):
    """Of one video in a hundred, by memory that it reads beyond pictures of an odd half height."""
    frames = np.zeros((3, height, 160, 3), np.uint8)
    assert expected in write_video(frames, tmp_path / "a.mp4").read_bytes()  # it writes its options
