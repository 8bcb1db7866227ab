"""Does a method that wins on synthetic data win on real data too? Two tasks, several methods.

    python -m benchmarks.registration.transfer --json docs/bench/transfer.json

- Registration: five methods on hover videos over drawn ground and over two real stills (both with
  synthetic cameras, so that the truth is known), with similar numbers of vehicles. Mean corner
  error, pixels.
- Prediction: positions of agents after 3 s by five rules, on synthetic and on real tracks, from
  observed positions alone. Mean displacement, metres. Synthetic tracks are used with a tracker's
  noise as well.

Two sources agree on a pair of methods if they rank it in the same order. Pairs count where both
sources tell the methods apart by a tenth.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.stats import gmean

from benchmarks.data import find_data
from benchmarks.hover_videos import HoverVideo, make_lane_traffic
from benchmarks.realism.motion import DT, VEHICLES, read_real_pedestrians, read_real_vehicles
from benchmarks.registration.benchmark import measure_rate_and_errors
from benchmarks.registration.methods import list_methods
from benchmarks.results import JsonFile, format_table, write_rows
from benchmarks.stills import STILLS, read_clean_still
from benchmarks.synthetic import Hover, film, make_sample, tracks_of
from benchmarks.synthetic.roads.layouts import STANDARD_KINDS
from geoaim.tracks.changes import resample_tracks
from geoaim.tracks.tracks import Tracks

MIN_RELATIVE_DIFFERENCE = 0.1  # methods that differ by less are not told apart
MIN_FIGURE = 1e-3  # keeps logarithms finite
HISTORY_STEPS, HORIZON_STEPS = 10, 30
MAX_GAP_S = 0.3  # between positions, which ends a window
TRACKER_NOISE_M = 0.2
MIN_SPEED_M_S = 0.5
METHODS = {  # methods of registration, and their names in `list_methods`
    "geoaim": "geoaim",
    "ORB": "ORB 2000 + MAGSAC",
    "SIFT half": "SIFT 2000 half + MAGSAC",
    "KLT half": "KLT half + MAGSAC",
    "ECC quarter": "ECC quarter",
}
VEHICLES_ON_STILLS = {"moving": 15, "queue": 2}
Figures = dict[str, dict[str, float]]  # figures by source and method


def main(
    json: JsonFile = None,
    frames: Annotated[int, typer.Option(help="of each video")] = 20,
    minutes: Annotated[float, typer.Option(help="of synthetic traffic at each place")] = 3.0,
) -> None:
    """Run both tasks on synthetic and real data; print tables, and write JSON when asked."""
    folder = find_data()
    if folder is None:
        raise SystemExit("no real data: set GEOAIM_DATA to a folder that holds hover/ and tracks/")
    rows: list[dict[str, Any]] = []
    for task, figures in (
        ("registration, px", _measure_registration(frames)),
        *_measure_prediction(folder, minutes),
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
        rows,
        json,
        command="python -m benchmarks.registration.transfer",
        frames=frames,
        minutes=minutes,
    )


def compare_rankings(one: Mapping[str, float], other: Mapping[str, float]) -> dict[str, Any]:
    """Count the pairs of methods that two sources rank alike, given each method's error by name.

    Returns:
        "pairs" of methods that differ by over 10 % in both sources, how many are "agreeing", and
        the names of those that are "swapped".
    """
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


def _measure_registration(frames: int) -> Figures:
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
            name: measure_rate_and_errors(method, video, pictures)["error_mean_px"]
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


def _measure_prediction(folder: Path, minutes: float) -> Iterator[tuple[str, Figures]]:
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
    return replace(tracks, states=states, observed=None)


def measure_rules(recordings: list[Tracks], types: tuple[str, ...]) -> dict[str, float]:
    """Measure the mean displacement error (m) of each rule, by name, of moving agents of types."""
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
    """Cut a window each second, of all agents of some types that are present in it.

    The history is as observed, without later positions.
    """
    even = resample_tracks(tracks, 1 / DT, max_gap=MAX_GAP_S)
    chosen = np.isin(even.types, types)
    observed, recorded = (states[chosen, :, :2] for states in (even.get_observed(), even.states))
    windows = []
    for start in range(0, len(even.times) - HISTORY_STEPS - HORIZON_STEPS + 1, 10):
        now, end = start + HISTORY_STEPS, start + HISTORY_STEPS + HORIZON_STEPS
        window = np.concatenate([observed[:, start:now], recorded[:, now:end]], axis=1)
        windows.append(window[np.isfinite(window).all(axis=(1, 2))])
    return np.concatenate(windows or [np.empty((0, HISTORY_STEPS + HORIZON_STEPS, 2))])


def _rotate(vectors: Float[Array, "n 2"], angle: Float[Array, "n"]) -> Float[Array, "n 2"]:
    c, s = np.cos(angle), np.sin(angle)
    x, y = vectors.T
    return np.stack([c * x - s * y, s * x + c * y], 1)


if __name__ == "__main__":
    typer.run(main)
