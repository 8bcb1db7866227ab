"""Windows of the Stanford Drone Dataset in its trajectory-prediction form, and any in that form.

A folder holds `<scene>.csv` with the columns frame, track, u_px, v_px: pieces of `STEPS` rows, of
which the first `OBSERVED` are given. `<scene>.jpg` or `.png` is what lies below them, and a table
has the metres a pixel of each scene (columns scene, metres_per_pixel).
"""

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from jaxtyping import Float, Float32
from numpy import ndarray as Array
from PIL import Image
from torch import Tensor

from geoaim.errors import TracksError
from geoaim.prediction.atlas import make_atlas, no_map
from geoaim.prediction.segments import PERSON, Segments
from geoaim.simulation.ground import Ground, View, make_ground

OBSERVED, STEPS = 8, 20
SECONDS = 0.4
PERSON_SIZE = 0.5  # m
CLEAR = 0.15  # m: over a shorter way the last steps tell no heading
COLUMNS = ["frame", "track", "u_px", "v_px"]


@dataclass(frozen=True, eq=False)
class Windows:
    """Windows of all scenes in one plane.

    Attributes:
        segments: each with its one walker, whose heading at all steps is that of his last
            observed ones: none was measured.
        ground: what lies below, of all scenes.
        metres: (S,) metres a pixel of each window's scene.
        scenes: the scene of each window.
    """

    segments: Segments
    ground: Ground
    metres: Float[Tensor, "S"]
    scenes: tuple[str, ...]


Change = Callable[[Float32[Array, "H W 3"], float], Float32[Array, "H W 3"]]


def unchanged(image: Float32[Array, "H W 3"], resolution: float) -> Float32[Array, "H W 3"]:
    """The image."""
    return image


def read_windows(
    folder: str | os.PathLike[str],
    images: str | os.PathLike[str] | None,
    table: str | os.PathLike[str],
    view: View,
    *,
    only: Sequence[str] = (),
    change: Change = unchanged,
) -> Windows:
    """Read all scenes of a folder, or some of them.

    Args:
        folder: of the windows.
        images: of the scenes; None: no map.
        table: metres a pixel.
        view: as models will see the ground.
        only: names of scenes; all if left out.
        change: of each image, by its metres a pixel, before anything else.

    Raises:
        TracksError: a file is missing or not in that form.
    """
    folder = Path(folder)
    scales = _read_scales(Path(table))
    found = sorted(path.stem for path in folder.glob("*.csv") if path.stem in scales)
    wanted = sorted(only) or found
    missing = set(wanted) - set(found)
    if missing or not wanted:
        raise TracksError(
            f"{folder}: {len(found)} scenes are here and in {table}; "
            + (f"{', '.join(sorted(missing))} are not" if missing else "windows are <scene>.csv")
        )
    places = [_read_places(folder / f"{name}.csv") * scales[name] for name in wanted]
    if images is None:
        ground, offsets = no_map(), torch.zeros(len(wanted), 2)
    else:
        grounds = [_ground(Path(images), name, scales[name], change) for name in wanted]
        ground, offsets = make_atlas(grounds, view)
    moved = [torch.tensor(x).float() + d for x, d in zip(places, offsets, strict=True)]
    counts = [len(x) for x in places]
    metres = torch.cat([torch.full((n,), scales[k]) for n, k in zip(counts, wanted, strict=True)])
    names = tuple(k for n, k in zip(counts, wanted, strict=True) for _ in range(n))
    return Windows(walkers(torch.cat(moved)), ground, metres.float(), names)


def walkers(places: Float[Tensor, "S T 2"]) -> Segments:
    """A segment for each of so many paths, of which the first `OBSERVED` steps are known."""
    count, steps = places.shape[:2]
    last = places[:, OBSERVED - 1]
    near, far = last - places[:, OBSERVED - 4], last - places[:, 0]
    way = torch.where((near.norm(dim=1) > CLEAR)[:, None], near, far)
    heading = torch.atan2(way[:, 1], way[:, 0])[:, None].expand(-1, steps)
    ways = places.diff(dim=1).norm(dim=2)
    speed = torch.cat([ways[:, :1], ways], dim=1) / SECONDS
    states = torch.cat([places, heading[..., None], speed[..., None]], dim=2)
    everywhere = torch.ones(count, 1, dtype=torch.bool)
    return Segments(
        states=states[:, :, None],
        present=everywhere[:, None].expand(-1, steps, -1).clone(),
        sizes=torch.full((count, 1, 2), PERSON_SIZE),
        planes=torch.full((count, 1), PERSON),
        controlled=everywhere,
        lines=torch.zeros(count, 0, 2, 2),
        lights=torch.zeros(count, steps, 0, dtype=torch.long),
        seconds=SECONDS,
    )


def backwards(segments: Segments) -> Segments:
    """The same paths, walked from their ends: other paths that somebody might have walked."""
    return walkers(segments.states[:, :, 0, :2].flip(1))


def _read_scales(path: Path) -> dict[str, float]:
    table = _read(path, ["scene", "metres_per_pixel"])
    scales = dict(
        zip(table["scene"].astype(str), table["metres_per_pixel"].astype(float), strict=True)
    )
    wrong = [name for name, scale in scales.items() if not 0 < scale < math.inf]
    if wrong:
        raise TracksError(f"{path}: metres a pixel of {wrong[0]} are {scales[wrong[0]]}")
    return scales


def _read_places(path: Path) -> Float[Array, "S T 2"]:
    """Pixels to the right and up of all windows."""
    table = _read(path, COLUMNS)
    places = table[["u_px", "v_px"]].to_numpy(float)
    tracks = table["track"].to_numpy()
    if len(table) % STEPS or not np.isfinite(places).all():
        raise TracksError(
            f"{path}: {len(table)} rows, of which {STEPS} each make a window, with finite pixels"
        )
    if (tracks.reshape(-1, STEPS) != tracks[::STEPS, None]).any():
        raise TracksError(f"{path}: a window of {STEPS} rows is of more than one track")
    return places.reshape(-1, STEPS, 2) * [1, -1]


def _read(path: Path, columns: list[str]) -> pd.DataFrame:
    try:
        table = pd.read_csv(path)
    except (OSError, ValueError) as error:
        raise TracksError(f"{path}: {error}") from None
    if not set(columns) <= set(table):
        raise TracksError(f"{path}: has the columns {list(table)}; {columns} are needed")
    return table


def _ground(folder: Path, name: str, metres: float, change: Change) -> Ground:
    paths = [folder / f"{name}{ending}" for ending in (".jpg", ".png")]
    path = next((path for path in paths if path.exists()), None)
    if path is None:
        raise TracksError(f"{folder}: neither {paths[0].name} nor {paths[1].name} is here")
    with Image.open(path) as picture:
        pixels = np.asarray(picture.convert("RGB"))
    image = torch.tensor(change(pixels.astype(np.float32) / 255, metres)).permute(2, 0, 1)
    return make_ground(image, torch.tensor([[1 / metres, 0, 0], [0, -1 / metres, 0]]))
