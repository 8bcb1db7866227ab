"""Windows of the Stanford Drone Dataset as prepared for trajectory prediction (TrajNet).

A folder holds `<scene>.csv` with the columns frame, track, u_px, v_px: windows of `WINDOW_STEPS`
rows, of which the first `HISTORY_STEPS` are observed. `<scene>.jpg` or `.png` is the scene's image.
A table has the resolution of each image (columns scene, metres_per_pixel).
Models of windows follow trajectory proposals; the settings here are those of the Stanford table.
"""

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Float32
from numpy import ndarray as Array
from PIL import Image
from torch import Tensor

from geoaim.base.errors import TracksError
from geoaim.base.limits import MAX_POSITION_M, check_memory, refuse_damaged
from geoaim.base.progress import Progress, notebook_progress
from geoaim.prediction.baselines import Predictor
from geoaim.prediction.config import Config, TrainConfig
from geoaim.prediction.dataset import Dataset, stack_maps
from geoaim.prediction.evaluation import EvalConfig, evaluate
from geoaim.prediction.itra import ITRA
from geoaim.prediction.metrics import Metric
from geoaim.prediction.segments import PEDESTRIAN, Segments, concat
from geoaim.rendering.ground import GREY, Ground, View, make_ground
from geoaim.tracks.files import read_table
from geoaim.tracks.formats.shared import check_columns

WINDOW_STEPS = 20  # of a window of TrajNet
HISTORY_STEPS = 8
DT_S = 0.4
PEDESTRIAN_SIZE_M = 0.5
MIN_HEADING_TRAVEL_M = 0.15  # a shorter displacement gives no reliable heading
FORMATS = ("JPEG", "PNG")
BYTES_PER_PIXEL = 90  # memory for a pixel of an image while its map is made

ImageTransform = Callable[[Float32[Array, "H W 3"], float], Float32[Array, "H W 3"]]
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


@dataclass(frozen=True, eq=False)
class Windows:
    """Windows of all scenes, and the scenes' maps."""

    # each with one pedestrian. No headings are measured: the heading at all steps is that of the
    # last observed displacement
    segments: Segments
    ground: Ground  # the maps of all scenes
    resolutions: Float[Tensor, "B"]  # metres per pixel of each window's scene
    scenes: tuple[str, ...]  # the scene of each window


@dataclass(frozen=True)
class WindowFiles:
    """The folders and the table that `read_windows` reads."""

    windows: str | os.PathLike[str]  # folder of `<scene>.csv`
    images: str | os.PathLike[str] | None  # folder of `<scene>.jpg` or `.png`; None: no map
    table: str | os.PathLike[str]  # CSV with the resolution of each scene's image


def read_windows(
    files: WindowFiles,
    view: View,
    *,
    scenes: Sequence[str] = (),
    transform: ImageTransform | None = None,
) -> Windows:
    """Read the windows of all scenes of a folder, or of some of them.

    Args:
        files: where the files lie.
        view: the model's view, `config.view`; its resolution decides that of the map.
        scenes: names of scenes; empty: all.
        transform: takes a (H, W, 3) image, 0 to 1, and its metres per pixel; returns another image.

    Returns:
        The windows, and one ground of all scenes' maps.

    Raises:
        TracksError: a file is missing or malformed.
    """
    folder = Path(files.windows)
    scales = read_resolutions(Path(files.table))
    available = sorted(path.stem for path in folder.glob("*.csv") if path.stem in scales)
    names = sorted(scenes) or available
    missing = sorted(set(names) - set(available))
    if missing or not names:
        wanted = f"the scenes {', '.join(missing)}" if missing else "a <scene>.csv"
        raise TracksError(
            f"{folder} and {files.table} have {len(available)} scenes in common; {wanted} must be "
            "in both"
        )
    if files.images is None:
        plain = make_ground(torch.full((3, 1, 1), GREY), torch.eye(3))
        grounds = [replace(plain, averaged_over=view.resolution)] * len(names)
    else:
        images = Path(files.images)
        grounds = [_read_ground(images, name, scales[name], transform) for name in names]
    paths = [read_trajnet_windows(folder / f"{name}.csv", scales[name]) for name in names]
    scene_of = [name for name, path in zip(names, paths, strict=True) for _ in path]
    resolutions = torch.tensor([scales[name] for name in scene_of], dtype=torch.float32)
    segments = make_path_segments(torch.cat([torch.tensor(path).float() for path in paths]))
    counts = torch.tensor([len(path) for path in paths])
    segments = replace(segments, places=torch.repeat_interleave(counts))
    return Windows(segments, stack_maps(grounds, view), resolutions, tuple(scene_of))


def read_trajnet_windows(path: Path, resolution: float) -> Float[Array, "B T 2"]:
    """Read TrajNet's windows of one scene as paths, metres to the right and up.

    Raises:
        TracksError: columns are missing, or rows are not windows of `WINDOW_STEPS` of one track.
    """
    table = read_table(path, text=("track",))
    check_columns(path, table, numbers=("u_px", "v_px"), others=("frame", "track"))
    metres = table[["u_px", "v_px"]].to_numpy(float) * [resolution, -resolution]
    tracks = table["track"].to_numpy()
    if len(table) % WINDOW_STEPS or not (np.abs(metres) <= MAX_POSITION_M).all():
        raise TracksError(
            f"{path}: {len(table)} rows; windows of {WINDOW_STEPS} rows each, with pixels of an "
            "image, are needed"
        )
    if (tracks.reshape(-1, WINDOW_STEPS) != tracks[::WINDOW_STEPS, None]).any():
        raise TracksError(f"{path}: a window of {WINDOW_STEPS} rows has more than one track")
    return metres.reshape(-1, WINDOW_STEPS, 2)


def read_resolutions(path: Path) -> dict[str, float]:
    """Read metres per pixel by scene from a table like `scenes.csv`.

    Raises:
        TracksError: the table is malformed.
    """
    table = read_table(path, text=("scene",))
    check_columns(path, table, numbers=("metres_per_pixel",), others=("scene",))
    if len(twice := table["scene"][table["scene"].duplicated()]):
        raise TracksError(f"{path} has several rows of the scene {twice.iloc[0]}; one is needed")
    scales = dict(zip(table["scene"].astype(str), table["metres_per_pixel"], strict=True))
    for name, scale in scales.items():
        if not 0 < scale < math.inf:
            raise TracksError(f"{path}: metres_per_pixel of {name} is {scale}")
    return scales


def make_path_segments(paths: Float[Tensor, "B T 2"]) -> Segments:
    """Make a segment of one pedestrian from each path (metres, steps of `DT_S`).

    The heading at all steps is that of the last observed motion.
    """
    count, steps = paths.shape[:2]
    last = paths[:, HISTORY_STEPS - 1]
    recent, whole = last - paths[:, HISTORY_STEPS - 4], last - paths[:, 0]
    far_enough = recent.norm(dim=1) > MIN_HEADING_TRAVEL_M
    direction = torch.where(far_enough[:, None], recent, whole)
    heading = torch.atan2(direction[:, 1], direction[:, 0])[:, None].expand(-1, steps)
    distances = paths.diff(dim=1).norm(dim=2)
    speed = torch.cat([distances[:, :1], distances], dim=1) / DT_S
    states = torch.cat([paths, heading[..., None], speed[..., None]], dim=2)
    every = torch.ones(count, 1, dtype=torch.bool)
    return Segments(
        states=states[:, None],
        present=every[..., None].expand(-1, -1, steps).clone(),
        sizes=torch.full((count, 1, 2), PEDESTRIAN_SIZE_M),
        layers=torch.full((count, 1), PEDESTRIAN),
        controlled=every,
        places=torch.zeros(count, dtype=torch.long),
        stop_lines=torch.zeros(count, 0, 2, 2),
        light_states=torch.zeros(count, steps, 0, dtype=torch.long),
        dt=DT_S,
    )


def reverse_paths(segments: Segments) -> Segments:
    """Reverse the paths of `make_path_segments` in time, as an augmentation."""
    reversed_paths = make_path_segments(segments.states[:, 0, :, :2].flip(1))
    return replace(reversed_paths, places=segments.places)


def _read_ground(
    folder: Path, name: str, resolution: float, transform: ImageTransform | None
) -> Ground:
    """Read a scene's image, which has to fit into memory."""
    paths = [folder / f"{name}{suffix}" for suffix in (".jpg", ".png")]
    path = next((path for path in paths if path.exists()), None)
    if path is None:
        raise TracksError(f"{folder}: there is neither {paths[0].name} nor {paths[1].name}")
    needed = "a JPEG or PNG that can be read"
    with refuse_damaged(path, TracksError, needed), Image.open(path, formats=FORMATS) as picture:
        width, height = picture.size
        needed_bytes = BYTES_PER_PIXEL * height * width
        content = f"{height} x {width} pixels of {resolution:g} m"
        check_memory(path, needed_bytes, os.path.getsize(path), TracksError, content)
        image = np.asarray(picture.convert("RGB")).astype(np.float32) / 255
    if transform is not None:
        image = transform(image, resolution)
    matrix = torch.tensor([[1 / resolution, 0, 0], [0, -1 / resolution, 0]])
    return make_ground(torch.tensor(image).permute(2, 0, 1), matrix)


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


def evaluate_windows(
    predictor: Predictor,
    windows: Windows,
    samples: int,
    *,
    seed: int = 0,
    progress: Progress = notebook_progress,
) -> dict[str, Metric]:
    """Compute minADE and minFDE of windows, in pixels of their images and in metres.

    Args:
        predictor: `make_window_predictor` of a model, or one of `BASELINES`.
        windows: the ground truth.
        samples: futures of each window.
        seed: seed of the noise.
        progress: takes stage, done and total.

    Returns:
        Metrics `minADE_px`, `minADE_m`, `minFDE_px` and `minFDE_m`.
    """
    config = EvalConfig(HISTORY_STEPS, samples, seed=seed)
    metres = evaluate(predictor, windows.segments, windows.ground, config, progress=progress)
    resolutions = windows.resolutions.double().numpy()
    metrics = {}
    for name in ("minADE", "minFDE"):
        metrics[f"{name}_px"] = Metric(metres[name].sums / resolutions, metres[name].counts)
        metrics[f"{name}_m"] = metres[name]
    return metrics


def make_window_predictor(model: ITRA, samples: int) -> Predictor:
    """Make the predictor of a model for `evaluate_windows` with `samples` futures.

    With at least as many proposals as samples, latents are set to their mean.
    """
    proposals = model.config.num_anchors >= samples
    return partial(model.sample, latent_scale=0.0 if proposals else 1.0)
