"""How models of TrajNet windows are configured and trained."""

from collections.abc import Sequence
from dataclasses import replace

from geoaim.prediction.config import Config, TrainConfig
from geoaim.prediction.dataset import Dataset
from geoaim.prediction.segments import concat
from geoaim.prediction.windows import (
    DT_S,
    HISTORY_STEPS,
    WINDOW_STEPS,
    WindowFiles,
    read_windows,
    reverse_paths,
)

WITH_MAP = Config(
    kind="pedestrian",
    motion="slide",
    dt=DT_S,
    view_size=32,
    resolution=1.5,
    surface_contrast=True,
    view_stride=WINDOW_STEPS - HISTORY_STEPS,
    num_anchors=20,
    history=HISTORY_STEPS,
    horizon=WINDOW_STEPS - HISTORY_STEPS,
)
WITHOUT_MAP = replace(WITH_MAP, surface_contrast=False, use_observations=False)
WINDOW_TRAINING = TrainConfig(
    steps=4000,
    batch_size=128,
    kl_weight=1.2,
    kl_warmup=0.0,
    history=(HISTORY_STEPS, HISTORY_STEPS),
    mirror=True,
    scale_jitter=0.2,
    colour_jitter=0.2,
)


def make_windows_dataset(
    files: WindowFiles, config: Config, *, scenes: Sequence[str] = ()
) -> Dataset:
    """Make a dataset of windows, which are also reversed in time; the log evaluates the others.

    Args:
        files: where the windows lie.
        config: the model's configuration.
        scenes: names of scenes; empty: all.

    Returns:
        The dataset; its validation windows are training windows too, as published models have it.
    """
    windows = read_windows(files, config.view, scenes=scenes)
    both = concat([windows.segments, reverse_paths(windows.segments)])
    return Dataset(both, windows.segments, windows.ground)
