"""Does a method that wins on synthetic data win on real data too? Three tasks, several methods.

    python -m geoaim.bench.transfer --json docs/bench/transfer.json

- Registration: five methods on hover videos over drawn ground and over two real stills (both with
  synthetic cameras, so that the truth is known), with similar numbers of vehicles. Mean corner
  error, pixels.
- Prediction: positions of agents after 3 s by five rules, on synthetic and on real tracks. Mean
  displacement, metres. Synthetic tracks are used with a tracker's noise as well.
- Alignment: windows of an image matched in that of another sensor, by five representations of the
  image. Windows with an error above a metre, per cent. The truth of real images is the median of
  all windows and representations.

Two sources agree on a pair of methods if they rank it in the same order. Pairs count where both
sources tell the methods apart by a tenth.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import rasterio
import typer
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.stats import gmean

from geoaim.bench.data import find_data
from geoaim.bench.hover_videos import HoverVideo, make_lane_traffic
from geoaim.bench.realism_motion import (
    DT,
    SMOOTH,
    VEHICLES,
    read_real_pedestrians,
    read_real_vehicles,
    resample_positions,
)
from geoaim.bench.registration import measure
from geoaim.bench.registration_methods import list_methods
from geoaim.bench.report import JsonFile, format_table, write_rows
from geoaim.bench.stills import STILLS, read_clean_still
from geoaim.synthetic import Hover, draw_place, film, make_sample, tracks_of
from geoaim.synthetic.imagery import Sensor, make_other_day, photograph
from geoaim.synthetic.roads.layouts import STANDARD_KINDS, PlaceKind
from geoaim.tracks import Tracks

MIN_RELATIVE_DIFFERENCE = 0.1  # below it, methods are not told apart
MIN_FIGURE = 1e-3  # keeps logarithms finite
HISTORY_STEPS, HORIZON_STEPS = 10, 30
TRACKER_NOISE_M = 0.2
MIN_SPEED_M_S = 0.5
METHODS = {  # of registration, and their names in `list_methods`
    "geoaim": "geoaim",
    "ORB": "ORB 2000 + MAGSAC",
    "SIFT half": "SIFT 2000 half + MAGSAC",
    "KLT half": "KLT half + MAGSAC",
    "ECC quarter": "ECC quarter",
}
VEHICLES_ON_STILLS = {"moving": 15, "queue": 2}
RESOLUTION = 0.5  # metres per pixel at which images are aligned
WINDOW_PX, SEARCH_PX = 64, 8  # size of a window, and largest shift to either side
PLACES_PER_KIND = 3  # synthetic places whose images are aligned
MAX_ERROR_M = 1.0
Figures = dict[str, dict[str, float]]  # by source and method


def main(
    json: JsonFile = None,
    frames: Annotated[int, typer.Option(help="of each video")] = 20,
    minutes: Annotated[float, typer.Option(help="of synthetic traffic at each place")] = 3.0,
) -> None:
    """Run all three tasks on synthetic and real data; print tables, and write JSON when asked."""
    folder = find_data()
    if folder is None:
        raise SystemExit("no real data: set GEOAIM_DATA to a folder that holds hover/ and tracks/")
    rows: list[dict[str, Any]] = []
    for task, figures in (
        ("registration, px", measure_registration(frames)),
        *measure_prediction(folder, minutes),
        ("alignment, % wrong", measure_alignment(folder)),
    ):
        rows += [{"task": task, "source": source} | row for source, row in figures.items()]
        print(format_table([row for row in rows if row["task"] == task]), flush=True)
        synthetic = [row for source, row in figures.items() if source.startswith("synthetic ")]
        average = {
            name: float(gmean([max(row[name], MIN_FIGURE) for row in synthetic]))
            for name in synthetic[0]
        }
        for source, row in figures.items():
            if not source.startswith("synthetic "):
                agreement = compare_rankings(average, row)
                print(f"{task}: synthetic and {source}: {agreement}")
                rows.append({"task": task, "source": source, **agreement})
    write_rows(
        rows, json, command="python -m geoaim.bench.transfer", frames=frames, minutes=minutes
    )


def compare_rankings(one: Mapping[str, float], other: Mapping[str, float]) -> dict[str, Any]:
    """Count the pairs of methods that two sources rank alike; see the module's docstring."""
    swapped, pairs = [], 0
    for a, b in combinations(one, 2):
        ratios = [
            np.log(max(figures[a], MIN_FIGURE) / max(figures[b], MIN_FIGURE))
            for figures in (one, other)
        ]
        if min(abs(ratio) for ratio in ratios) > np.log1p(MIN_RELATIVE_DIFFERENCE):
            pairs += 1
            if ratios[0] * ratios[1] < 0:
                swapped.append(f"{a} / {b}")
    return {"agreeing": pairs - len(swapped), "pairs": pairs, "swapped": swapped}


def measure_registration(frames: int) -> Figures:
    """Measure the mean corner error of each method on drawn ground and on stills."""
    every = list_methods()
    methods = {name: every[full_name] for name, full_name in METHODS.items()}
    videos = {f"still {still}": _film_still(still, frames) for still in STILLS}
    for kind in STANDARD_KINDS:
        sample = make_sample(1, kind=kind, video=(1080, 1920), hover=Hover(count=frames))
        assert sample.clip is not None
        videos[f"synthetic {kind}"] = HoverVideo(sample.clip, "plain", np.ones(frames, bool))
    figures: Figures = {}
    for source, video in videos.items():
        pictures = list(video)
        figures[source] = {
            name: measure(method, video, pictures)["error_mean_px"]
            for name, method in methods.items()
        }
    return figures


def _film_still(still: str, frames: int) -> HoverVideo:
    """Film a real still whose cars are removed, with synthetic vehicles on it."""
    hover, generator = Hover(count=frames), np.random.default_rng(0)
    traffic = make_lane_traffic(still, hover, **VEHICLES_ON_STILLS, generator=generator)
    ground = read_clean_still(still)
    clip = film(ground, traffic, hover, height=1080, width=1920, generator=generator)
    return HoverVideo(clip, "plain", np.ones(frames, bool))


def measure_prediction(folder: Path, minutes: float) -> Iterator[tuple[str, Figures]]:
    """Measure the mean displacement error of each rule: of vehicles, then of pedestrians."""
    samples = [make_sample(1, kind=kind, minutes=minutes, video=None) for kind in STANDARD_KINDS]
    synthetic = {f"synthetic {s.place.roads.layout.kind}": [tracks_of(s)] for s in samples}
    for task, real, types in (
        ("vehicles, m", read_real_vehicles(folder), VEHICLES),
        ("pedestrians, m", read_real_pedestrians(folder), ("pedestrian",)),
    ):
        noisy = {"noisy": [_add_noise(tracks) for [tracks] in synthetic.values()]}
        sources = synthetic | (noisy if types == VEHICLES else {}) | real
        yield task, {source: measure_rules(tracks, types) for source, tracks in sources.items()}


def _add_noise(tracks: Tracks) -> Tracks:
    """Add a tracker's noise to positions."""
    states = tracks.states.copy()
    noise = np.random.default_rng(0).standard_normal(states[..., :2].shape)
    states[..., :2] += TRACKER_NOISE_M * noise
    return replace(tracks, states=states)


def measure_rules(recordings: list[Tracks], types: tuple[str, ...]) -> dict[str, float]:
    """Measure the mean displacement error of each rule, of agents that move."""
    windows = np.concatenate([_cut_windows(tracks, types) for tracks in recordings])
    history, truth = windows[:, :HISTORY_STEPS], windows[:, -1]
    duration = DT * HORIZON_STEPS
    position = history[:, -1]
    velocity = (history[:, -1] - history[:, -4]) / (3 * DT)
    earlier_velocity = (history[:, 3] - history[:, 0]) / (3 * DT)
    mean_velocity = (history[:, -1] - history[:, 0]) / (DT * (HISTORY_STEPS - 1))
    between = DT * (HISTORY_STEPS - 4)  # s between both velocities
    acceleration = (velocity - earlier_velocity) / between
    turn = np.arctan2(
        earlier_velocity[:, 0] * velocity[:, 1] - earlier_velocity[:, 1] * velocity[:, 0],
        (earlier_velocity * velocity).sum(axis=1),
    )
    half_turn = turn / between * duration / 2
    arc = np.sinc(half_turn / np.pi)[:, None] * duration * _rotate(velocity, half_turn)
    ends = {
        "stand": position,
        "velocity": position + duration * velocity,
        "mean velocity": position + duration * mean_velocity,
        "acceleration": position + duration * velocity + duration**2 / 2 * acceleration,
        "turn rate": position + arc,
    }
    moves = np.hypot(*velocity.T) > MIN_SPEED_M_S
    return {name: float(np.hypot(*(end - truth)[moves].T).mean()) for name, end in ends.items()}


def _cut_windows(tracks: Tracks, types: tuple[str, ...]) -> Float[Array, "n S 2"]:
    """Cut a window each second, of all agents of some types that are present in it."""
    positions = resample_positions(tracks, np.array([kind in types for kind in tracks.types]))
    length, windows = HISTORY_STEPS + HORIZON_STEPS, []
    for start in range(SMOOTH // 2, positions.shape[1] - length - SMOOTH // 2 + 1, 10):
        window = positions[:, start : start + length]
        windows.append(window[np.isfinite(window).all(axis=(1, 2))])
    return np.concatenate(windows) if windows else np.empty((0, length, 2))


def _rotate(vectors: Float[Array, "n 2"], angle: Float[Array, "n"]) -> Float[Array, "n 2"]:
    c, s = np.cos(angle), np.sin(angle)
    x, y = vectors.T
    return np.stack([c * x - s * y, s * x + c * y], 1)


def measure_alignment(folder: Path) -> Figures:
    """Measure the share of windows that each representation matches wrongly, per cent."""
    representations: dict[str, Callable[[Array], Array]] = {
        "intensity": lambda grey: grey[None],
        "equalised": lambda grey: _equalise(grey)[None],
        "gradient vector": _compute_gradient,
        "gradient size": lambda grey: np.hypot(*_compute_gradient(grey))[None],
        "orientation": _compute_orientation,
    }
    sources = {f"synthetic {kind}": _draw_pairs(kind) for kind in STANDARD_KINDS}
    sources["rotterdam"] = _read_pairs(folder)
    figures: Figures = {}
    for source, pairs in sources.items():
        wrong: list[Array] = []
        for one, two in pairs:
            shifts = np.array([_match_windows(one, two, r) for r in representations.values()])
            truth = np.median(shifts, axis=(0, 1)) if source == "rotterdam" else np.zeros(2)
            errors = np.linalg.norm(shifts - truth, axis=-1)
            wrong.append(errors * RESOLUTION > MAX_ERROR_M)
        shares = 100 * np.concatenate(wrong, axis=1).mean(axis=1)
        figures[source] = dict(zip(representations, shares.tolist(), strict=True))
    return figures


def _draw_pairs(kind: PlaceKind) -> Iterator[tuple[Array, Array]]:
    """Draw synthetic places, and orthophotos of them by another sensor on another day."""
    for seed in range(1, PLACES_PER_KIND + 1):
        sample = make_sample(seed, kind=kind, minutes=0.2, video=None)
        place, day, sensor = sample.place, make_other_day(sample.place), Sensor(RESOLUTION)
        photo = photograph(place, day, tracks_of(sample), sensor, resolution=0.1)
        yield _to_grey(draw_place(place, resolution=0.1), 0.1), _to_grey(photo, RESOLUTION)


def _read_pairs(folder: Path) -> Iterator[tuple[Array, Array]]:
    """Read panchromatic and multispectral images of one satellite pass."""
    for number in (1, 2, 3):
        pair = []
        for sensor in ("pan", "ms"):
            with rasterio.open(folder / f"pairs/rotterdam_pan_ms/{sensor}{number}.tif") as file:
                grey = file.read().astype(np.float64)[:3].mean(axis=0)
                pair.append(_resize(grey / np.percentile(grey, 99) * 200, file.res[0]))
        yield pair[0], pair[1]


def _to_grey(image: Array, resolution: float) -> Float[Array, "H W"]:
    return _resize(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float64), resolution)


def _resize(grey: Float[Array, "H W"], resolution: float) -> Float[Array, "_ _"]:
    scale = resolution / RESOLUTION
    return np.asarray(cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))


def _match_windows(
    one: Array, two: Array, represent: Callable[[Array], Array]
) -> Float[Array, "n 2"]:
    """Match windows of one image in another; their shifts, pixels down and right."""
    rows, columns = (min(a, b) for a, b in zip(one.shape, two.shape, strict=True))
    template, image = represent(one[:rows, :columns]), represent(two[:rows, :columns])
    shifts = []
    for top in range(SEARCH_PX, rows - WINDOW_PX - SEARCH_PX, WINDOW_PX // 2):
        for left in range(SEARCH_PX, columns - WINDOW_PX - SEARCH_PX, WINDOW_PX // 2):
            window = template[:, top : top + WINDOW_PX, left : left + WINDOW_PX]
            bottom, right = top + WINDOW_PX + SEARCH_PX, left + WINDOW_PX + SEARCH_PX
            area = image[:, top - SEARCH_PX : bottom, left - SEARCH_PX : right]
            shifts.append(np.subtract(_match_template(window, area), SEARCH_PX))
    return np.array(shifts, float)


def _match_template(window: Array, area: Array) -> tuple[int, int]:
    """Match a window of several channels by the sum of normalised correlations; row and column."""
    scores: Any = 0.0
    for one, two in zip(window.astype(np.float32), area.astype(np.float32), strict=True):
        scores = scores + cv2.matchTemplate(two, one, cv2.TM_CCOEFF_NORMED)
    row, column = np.unravel_index(np.argmax(scores), scores.shape)
    return int(row), int(column)


def _compute_gradient(grey: Float[Array, "H W"]) -> Float[Array, "2 H W"]:
    return np.stack(np.gradient(cv2.GaussianBlur(grey, (0, 0), 1.0))[::-1])


def _equalise(grey: Float[Array, "H W"]) -> Float[Array, "H W"]:
    bytes_ = np.asarray(np.clip(grey, 0, 255), np.uint8)
    return cv2.createCLAHE(4.0, (8, 8)).apply(bytes_).astype(np.float64)


def _compute_orientation(grey: Float[Array, "H W"]) -> Float[Array, "2 H W"]:
    """Double-angle orientation of the gradient, invariant to its sign."""
    x, y = _compute_gradient(grey)
    size = np.hypot(x, y) + 1e-9
    weight = size / (size + np.median(size)) / size**2
    return np.stack([(x * x - y * y) * weight, 2 * x * y * weight])


if __name__ == "__main__":
    typer.run(main)
