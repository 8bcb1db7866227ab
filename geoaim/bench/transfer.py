"""Does a method that wins on made data win on real data too? Three tasks, several methods each.

    python -m geoaim.bench.transfer --json docs/bench/transfer.json

- registration: five methods on hover videos over drawn ground and over two real stills (made
  cameras over both, so that the truth is known), with about as many vehicles; mean corner error,
  pixels;
- prediction: where agents are after 3 s, by five rules, on made and on real tracks; mean
  displacement, metres. Once more with noise on the made ones, as real trackers have it;
- alignment: windows of a picture found in that of another sensor, by five ways to compare them;
  windows that are more than a metre from the truth, per cent. Of the real pictures the truth is
  the median of all windows and ways.

Agreement is the number of pairs of methods that made and real data put in the same order, of those
that both tell apart by a tenth.
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
from geoaim.bench.registration_methods import (
    Method,
    make_feature_method,
    register_with_ecc,
    register_with_geoaim,
    register_with_klt,
)
from geoaim.bench.report import format_table, write_rows
from geoaim.bench.stills import STILLS, read_clean_still
from geoaim.synthetic import Hover, draw_place, film, make_sample, tracks_of
from geoaim.synthetic.imagery import Sensor, make_other_day, photograph
from geoaim.synthetic.roads.layouts import STANDARD_KINDS, PlaceKind
from geoaim.tracks import Tracks

EQUAL = 0.1  # relative difference below which two figures are not told apart
SEEN, AHEAD = 10, 30  # steps of a track that are seen, and to the one that is predicted
NOISE = 0.2  # m, of a tracker
VEHICLES_FILMED = {"moving": 15, "queue": 2}  # over the stills
PIXEL = 0.5  # m, at which pictures are aligned
WINDOW, SEARCH = 64, 8  # px of a window, and how far it is looked for
PLACES = 3  # made places of each kind whose pictures are aligned
Figures = dict[str, dict[str, float]]  # by source and method


def main(
    json: Annotated[Path | None, typer.Option(help="where to write the figures")] = None,
    frames: Annotated[int, typer.Option(help="of each video")] = 20,
    minutes: Annotated[float, typer.Option(help="of made traffic in each place")] = 3.0,
) -> None:
    """Measure all three tasks on made and real data; print tables, and write JSON when asked."""
    folder = find_data()
    if folder is None:
        raise SystemExit("no real data: set GEOAIM_DATA to a folder that holds hover/ and tracks/")
    rows: list[dict[str, Any]] = []
    for task, figures in (
        ("registration, px", registration(frames)),
        *prediction(folder, minutes),
        ("alignment, % wrong", alignment(folder)),
    ):
        rows += [{"task": task, "source": source} | found for source, found in figures.items()]
        print(format_table([row for row in rows if row["task"] == task]), flush=True)
        made = _mean([found for source, found in figures.items() if source.startswith("made ")])
        for source, found in figures.items():
            if not source.startswith("made "):
                alike, pairs, swapped = agreement(made, found)
                print(f"{task}: made and {source} agree on {alike} of {pairs} pairs {swapped}")
                rows.append({"task": task, "source": source, "alike": alike, "pairs": pairs})
                rows[-1]["swapped"] = swapped
    write_rows(
        rows, json, command="python -m geoaim.bench.transfer", frames=frames, minutes=minutes
    )


def agreement(one: Mapping[str, float], other: Mapping[str, float]) -> tuple[int, int, list[str]]:
    """Pairs of methods that both put in the same order, all that both tell apart, and the rest."""
    swapped, pairs = [], 0
    for a, b in combinations(one, 2):
        ratios = [np.log(_some(figures[a]) / _some(figures[b])) for figures in (one, other)]
        if min(abs(ratio) for ratio in ratios) > np.log1p(EQUAL):
            pairs += 1
            if ratios[0] * ratios[1] < 0:
                swapped.append(f"{a} / {b}")
    return pairs - len(swapped), pairs, swapped


def _some(figure: float) -> float:
    """A figure that has a logarithm."""
    return max(figure, 1e-3)


def registration(frames: int) -> Figures:
    """Mean corner error of each method on drawn ground and on the stills."""
    methods: dict[str, Method] = {
        "geoaim": register_with_geoaim,
        "ORB": make_feature_method(lambda: cv2.ORB.create(2000), cv2.NORM_HAMMING, 1),
        "SIFT half": make_feature_method(lambda: cv2.SIFT.create(2000), cv2.NORM_L2, 2),
        "KLT half": register_with_klt,
        "ECC quarter": register_with_ecc,
    }
    videos = {f"still {still}": _over_still(still, frames) for still in STILLS}
    for kind in STANDARD_KINDS:
        made = make_sample(1, kind=kind, video=(1080, 1920), hover=Hover(count=frames))
        assert made.clip is not None
        videos[f"made {kind}"] = HoverVideo(made.clip, "plain", np.ones(frames, bool))
    found: Figures = {}
    for source, video in videos.items():
        pictures = list(video)
        found[source] = {
            name: measure(name, method, video, pictures)["error_mean_px"]
            for name, method in methods.items()
        }
    return found


def _over_still(still: str, frames: int) -> HoverVideo:
    """A hover video over a real still, its cars removed and a few others driving."""
    hover, generator = Hover(count=frames), np.random.default_rng(0)
    traffic = make_lane_traffic(still, hover, **VEHICLES_FILMED, generator=generator)
    ground = read_clean_still(still)
    clip = film(ground, traffic, hover, height=1080, width=1920, generator=generator)
    return HoverVideo(clip, "plain", np.ones(frames, bool))


def prediction(folder: Path, minutes: float) -> Iterator[tuple[str, Figures]]:
    """Mean displacement of each rule after 3 s: vehicles, then people on foot."""
    samples = [make_sample(1, kind=kind, minutes=minutes, video=None) for kind in STANDARD_KINDS]
    made = {f"made {s.place.roads.layout.kind}": [tracks_of(s)] for s in samples}
    for task, real, types in (
        ("vehicles, m", read_real_vehicles(folder), VEHICLES),
        ("pedestrians, m", read_real_pedestrians(folder), ("pedestrian",)),
    ):
        noisy = {"noisy": [_noisy(tracks) for several in made.values() for tracks in several]}
        sources = made | noisy | real if types == VEHICLES else made | real
        yield task, {source: predicted(tracks, types) for source, tracks in sources.items()}


def _noisy(tracks: Tracks) -> Tracks:
    """Tracks as a tracker sees them."""
    states = tracks.states.copy()
    states[..., :2] += NOISE * np.random.default_rng(0).standard_normal(states[..., :2].shape)
    return replace(tracks, states=states)


def predicted(recordings: list[Tracks], types: tuple[str, ...]) -> dict[str, float]:
    """Mean displacement of each rule after 3 s, of agents that move when last seen."""
    windows = np.concatenate([_windows(tracks, types) for tracks in recordings])
    seen, truth = windows[:, :SEEN], windows[:, -1]
    seconds = DT * AHEAD
    last, before = (seen[:, -1] - seen[:, -4]) / (3 * DT), (seen[:, 3] - seen[:, 0]) / (3 * DT)
    moves = np.hypot(*last.T) > 0.5
    mean = (seen[:, -1] - seen[:, 0]) / (DT * (SEEN - 1))
    since = DT * (SEEN - 4)  # s between the two velocities
    pull = (last - before) / since
    turn = np.arctan2(
        before[:, 0] * last[:, 1] - before[:, 1] * last[:, 0], (before * last).sum(axis=1)
    )
    rate = turn / since
    half = rate * seconds / 2
    chord = np.sinc(half / np.pi)[:, None] * seconds * _turned(last, half)
    ends = {
        "stand": seen[:, -1],
        "velocity": seen[:, -1] + seconds * last,
        "mean velocity": seen[:, -1] + seconds * mean,
        "acceleration": seen[:, -1] + seconds * last + seconds**2 / 2 * pull,
        "turn rate": seen[:, -1] + chord,
    }
    return {name: float(np.hypot(*(end - truth)[moves].T).mean()) for name, end in ends.items()}


def _windows(tracks: Tracks, types: tuple[str, ...]) -> Float[Array, "n S 2"]:
    """Each second, whoever is there from the first step seen to the one that is predicted."""
    places = resample_positions(tracks, np.array([kind in types for kind in tracks.types]))
    length, rows = SEEN + AHEAD, []
    for start in range(SMOOTH // 2, places.shape[1] - length - SMOOTH // 2 + 1, 10):
        window = places[:, start : start + length]
        rows.append(window[np.isfinite(window).all(axis=(1, 2))])
    return np.concatenate(rows) if rows else np.empty((0, length, 2))


def _turned(vectors: Float[Array, "n 2"], angle: Float[Array, "n"]) -> Float[Array, "n 2"]:
    c, s = np.cos(angle), np.sin(angle)
    return np.stack(
        [c * vectors[:, 0] - s * vectors[:, 1], s * vectors[:, 0] + c * vectors[:, 1]], 1
    )


def alignment(folder: Path) -> Figures:
    """Windows that each way of comparing places wrongly, per cent, for each pair of pictures."""
    ways: dict[str, Callable[[Array], Array]] = {
        "intensity": lambda grey: grey[None],
        "equalised": lambda grey: _equalised(grey)[None],
        "gradient vector": _gradient,
        "gradient size": lambda grey: np.hypot(*_gradient(grey))[None],
        "orientation": _orientation,
    }
    found: Figures = {}
    made = {f"made {kind}": _made_pairs(kind) for kind in STANDARD_KINDS}
    for source, pairs in (made | {"rotterdam": _real_pairs(folder)}).items():
        wrong: list[Array] = []
        for one, two in pairs:
            shifts = np.array([_shifts(one, two, way) for way in ways.values()])
            truth = np.median(shifts, axis=(0, 1)) if source == "rotterdam" else np.zeros(2)
            apart = np.linalg.norm(shifts - truth, axis=-1)
            wrong.append(apart * PIXEL > 1.0)
        shares = np.concatenate(wrong, axis=1).mean(axis=1)
        found[source] = {name: 100 * float(s) for name, s in zip(ways, shares, strict=True)}
    return found


def _made_pairs(kind: PlaceKind) -> Iterator[tuple[Array, Array]]:
    """A drawn place, and an orthophoto of it by another sensor on another day."""
    for seed in range(1, PLACES + 1):
        sample = make_sample(seed, kind=kind, minutes=0.2, video=None)
        place, day, sensor = sample.place, make_other_day(sample.place), Sensor(PIXEL)
        photo = photograph(place, day, tracks_of(sample), sensor, resolution=0.1)
        yield _grey(draw_place(place, resolution=0.1), 0.1), _grey(photo, PIXEL)


def _real_pairs(folder: Path) -> Iterator[tuple[Array, Array]]:
    """A panchromatic and a multispectral picture from one pass of a satellite."""
    for number in (1, 2, 3):
        paths = [folder / f"pairs/rotterdam_pan_ms/{kind}{number}.tif" for kind in ("pan", "ms")]
        pictures = []
        for path in paths:
            with rasterio.open(path) as file:
                grey = file.read().astype(np.float64)[:3].mean(axis=0)
                pictures.append(_scaled(grey / np.percentile(grey, 99) * 200, file.res[0]))
        yield pictures[0], pictures[1]


def _grey(image: Array, metres: float) -> Float[Array, "H W"]:
    return _scaled(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float64), metres)


def _scaled(grey: Float[Array, "H W"], metres: float) -> Float[Array, "_ _"]:
    scale = metres / PIXEL
    return np.asarray(cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))


def _shifts(one: Array, two: Array, way: Callable[[Array], Array]) -> Float[Array, "n 2"]:
    """Where each window of the first picture is found in the second, pixels down and right."""
    rows, columns = (min(a, b) for a, b in zip(one.shape, two.shape, strict=True))
    here, there = way(one[:rows, :columns]), way(two[:rows, :columns])
    found = []
    for top in range(SEARCH, rows - WINDOW - SEARCH, WINDOW // 2):
        for left in range(SEARCH, columns - WINDOW - SEARCH, WINDOW // 2):
            patch = here[:, top : top + WINDOW, left : left + WINDOW]
            area = there[
                :, top - SEARCH : top + WINDOW + SEARCH, left - SEARCH : left + WINDOW + SEARCH
            ]
            found.append(np.subtract(_best(patch, area), SEARCH))
    return np.array(found, float)


def _best(patch: Array, area: Array) -> tuple[int, int]:
    """Where in an area a patch of several channels fits best, by normalised correlation."""
    scores: Any = 0.0
    for one, two in zip(patch.astype(np.float32), area.astype(np.float32), strict=True):
        scores = scores + cv2.matchTemplate(two, one, cv2.TM_CCOEFF_NORMED)
    v, u = np.unravel_index(np.argmax(scores), scores.shape)
    return int(v), int(u)


def _gradient(grey: Float[Array, "H W"]) -> Float[Array, "2 H W"]:
    return np.stack(np.gradient(cv2.GaussianBlur(grey, (0, 0), 1.0))[::-1])


def _equalised(grey: Float[Array, "H W"]) -> Float[Array, "H W"]:
    bytes_ = np.asarray(np.clip(grey, 0, 255), np.uint8)
    return cv2.createCLAHE(4.0, (8, 8)).apply(bytes_).astype(np.float64)


def _orientation(grey: Float[Array, "H W"]) -> Float[Array, "2 H W"]:
    """Twice the angle of the gradient: dark to bright reads as bright to dark does."""
    x, y = _gradient(grey)
    size = np.hypot(x, y) + 1e-9
    weight = size / (size + np.median(size)) / size**2
    return np.stack([(x * x - y * y) * weight, 2 * x * y * weight])


def _mean(figures: list[dict[str, float]]) -> dict[str, float]:
    """The geometric mean over sources."""
    return {
        name: float(np.exp(np.mean([np.log(_some(found[name])) for found in figures])))
        for name in figures[0]
    }


if __name__ == "__main__":
    typer.run(main)
