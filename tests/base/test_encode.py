import os
import sys

import cv2
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


def test_a_video_of_an_odd_half_height_is_the_same_each_time(tmp_path):
    still = cv2.GaussianBlur(
        np.random.default_rng(0).integers(0, 255, (90, 160, 3), dtype=np.uint8), (0, 0), 2
    )
    frames = [np.roll(still, 3 * index, axis=1) for index in range(3)]
    written = {write_video(frames, tmp_path / "a.mp4").read_bytes() for _ in range(100)}
    assert len(written) == 1
