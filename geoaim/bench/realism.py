"""Made places against real ones: how their pictures look and how their agents move.

Each statistic is a distribution; the distance between two is the Kolmogorov-Smirnov statistic, 0
for the same and 1 for disjoint ones. Real sources differ from each other as well, so the yardstick
is the distance between real sources. Of spectra, amplitudes in octaves are compared, in decibels.

    python -m geoaim.bench.realism --output docs/bench/realism.json \
        --picture docs/images/realism.png
"""

import warnings
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import typer
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array

from geoaim.bench.data import find_data
from geoaim.bench.report import format_table, write_rows
from geoaim.errors import GeoaimWarning
from geoaim.synthetic import Sample, draw_place, make_sample, tracks_of
from geoaim.synthetic.compositing import paste
from geoaim.synthetic.filming import draw_agents, image_poses
from geoaim.synthetic.roads.layouts import PLAIN
from geoaim.track_formats import read_geotrax, read_interaction, read_sdd
from geoaim.tracks import Tracks

RESOLUTION = 0.1  # at which pictures are compared
VEHICLES = ("car", "van", "truck", "bus")
STEP = 0.1  # s
SMOOTH = 7  # steps of the window over which positions are averaged
MOVING, FAST = 0.5, 2.0  # m/s: from where agents have an acceleration, and a curvature
LANE = 1.75  # m to either side within which a vehicle ahead is followed
SEEN = 60.0  # m
OCTAVES = 2.0 ** np.arange(-7, 0)  # cycles a pixel
WINDOW = 256  # px of the squares whose spectra are taken
CROP = (420, 800)  # px of the pictures that are laid side by side
Statistics = Mapping[str, Float[Array, "_"]]


def main(
    seeds: Annotated[int, typer.Option(help="made places of each kind")] = 2,
    minutes: Annotated[float, typer.Option(help="of traffic in each")] = 3.0,
    output: Annotated[Path | None, typer.Option(help="JSON to write")] = None,
    picture: Annotated[Path | None, typer.Option(help="chart to write")] = None,
    beside: Annotated[
        Path | None, typer.Option(help="real and made pictures side by side, to look at")
    ] = None,
) -> None:
    """Compare made places with the shared real data."""
    folder = find_data()
    if folder is None:
        raise SystemExit("no real data: set GEOAIM_DATA")
    samples = [
        make_sample(seed, kind=kind, minutes=minutes, video=None)
        for kind in PLAIN
        for seed in range(1, seeds + 1)
    ]
    made, real = [_picture(s) for s in samples], _real_pictures(folder)
    if beside is not None:
        _lay_beside(list(real.values()), made[::seeds], beside)
    groups = {
        "picture": ([_look(p) for p in made], {name: _look(p) for name, p in real.items()}),
        "vehicles": (
            [_move(tracks_of(s), VEHICLES) for s in samples],
            {name: _move(t, VEHICLES) for name, t in real_vehicles(folder).items()},
        ),
        "pedestrians": (
            [_move(tracks_of(s), ("pedestrian",)) for s in samples],
            {name: _move(t, ("pedestrian",)) for name, t in real_people(folder).items()},
        ),
        "cyclists": (
            [_move(tracks_of(s), ("cyclist",)) for s in samples],
            {name: _move(t, ("cyclist",)) for name, t in real_people(folder).items()},
        ),
    }
    rows = [row for name, (made, real) in groups.items() for row in _compared(name, made, real)]
    print(format_table(rows))
    command = f"python -m geoaim.bench.realism --seeds {seeds} --minutes {minutes:g}"
    write_rows(rows, output, command=command)
    if picture is not None:
        _draw(groups, picture)


def _compared(
    group: str, made: Sequence[Statistics], real: Mapping[str, Statistics]
) -> Iterator[dict[str, Any]]:
    """For each statistic: the distance of made to real, and of real sources to each other."""
    together = _joined(made)
    for name in together:
        sources = {key: s[name] for key, s in real.items() if len(s[name]) >= 50}
        if len(sources) == 0 or len(together[name]) < 50:
            continue
        measure = _decibels if name == "spectrum" else _kolmogorov
        pooled = np.concatenate(list(sources.values())) if measure is _kolmogorov else None
        apart = [measure(together[name], values) for values in sources.values()]
        among = [measure(a, b) for a, b in combinations(sources.values(), 2)]
        row: dict[str, Any] = {"group": group, "statistic": name}
        if measure is _kolmogorov and pooled is not None:
            for label, values in (("made", together[name]), ("real", pooled)):
                row |= {f"{label} {q} %": float(np.percentile(values, q)) for q in (10, 50, 90)}
        row |= {
            "made to real": float(np.median(apart)),
            "real to real": float(np.median(among)) if among else float("nan"),
            "real, at most": float(np.max(among)) if among else float("nan"),
            "sources": len(sources),
        }
        yield row


def _kolmogorov(a: Float[Array, "_"], b: Float[Array, "_"]) -> float:
    """The largest difference of two cumulative distributions."""
    values = np.sort(np.concatenate([a, b]))
    return float(
        np.abs(
            np.searchsorted(np.sort(a), values, side="right") / len(a)
            - np.searchsorted(np.sort(b), values, side="right") / len(b)
        ).max()
    )


def _decibels(a: Float[Array, "_"], b: Float[Array, "_"]) -> float:
    """The root mean square difference of two spectra, by octave."""
    octaves = len(OCTAVES) - 1
    levels = [20 * np.log10(s.reshape(-1, octaves)).mean(axis=0) for s in (a, b)]
    return float(np.sqrt(((levels[0] - levels[1]) ** 2).mean()))


def _joined(parts: Sequence[Statistics]) -> dict[str, Float[Array, "_"]]:
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _look(image: UInt8[Array, "H W 3"]) -> Statistics:
    """Gradients, spectrum, grey levels and colour of a picture at `RESOLUTION`."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float64)
    right, down = grey[1:-1, 2:] - grey[1:-1, :-2], grey[2:, 1:-1] - grey[:-2, 1:-1]
    lab = cv2.cvtColor(image, cv2.COLOR_RGB2LAB).astype(np.float64)
    thin = np.random.default_rng(0).choice(grey.size, min(grey.size, 40_000), replace=False)
    steep = np.hypot(right, down) / 2
    return {
        "gradient": np.random.default_rng(0).choice(steep.ravel(), 40_000),
        "grey level": grey.ravel()[thin],
        "colourfulness": np.hypot(lab[..., 1] - 128, lab[..., 2] - 128).ravel()[thin],
        "edge direction": _peaks(right, down, steep),
        "spectrum": _spectrum(grey).ravel(),
    }


def _peaks(right: Array, down: Array, steep: Array) -> Float[Array, "_"]:
    """Directions of strong edges relative to the commonest one, radians in [-pi/4, pi/4)."""
    strong = steep > np.percentile(steep, 95)
    angle = np.arctan2(down[strong], right[strong]) % (np.pi / 2)
    counts, edges = np.histogram(angle, 90, (0, np.pi / 2))
    top = edges[np.argmax(counts)]
    turned = (angle - top + np.pi / 4) % (np.pi / 2) - np.pi / 4
    return np.random.default_rng(0).choice(turned, min(len(turned), 20_000), replace=False)


def _spectrum(grey: Float[Array, "H W"]) -> Float[Array, "n k"]:
    """Mean amplitude in each octave of windowed squares."""
    window = np.outer(np.hanning(WINDOW), np.hanning(WINDOW))
    radius = np.hypot(np.fft.fftfreq(WINDOW)[:, None], np.fft.fftfreq(WINDOW))
    bands = [(radius >= low) & (radius < 2 * low) for low in OCTAVES[:-1]]
    rows = []
    for top in range(0, grey.shape[0] - WINDOW + 1, WINDOW // 2):
        for left in range(0, grey.shape[1] - WINDOW + 1, WINDOW // 2):
            square = grey[top : top + WINDOW, left : left + WINDOW]
            power = np.abs(np.fft.fft2((square - square.mean()) * window)) ** 2
            rows.append([np.sqrt(power[band].mean() / (window**2).sum()) for band in bands])
    return np.array(rows)


def _picture(sample: Sample) -> UInt8[Array, "H W 3"]:
    """A made place with its traffic at the end."""
    still = draw_place(sample.place)
    tracks = tracks_of(sample)
    agents = draw_agents(tracks, 0.05, np.random.default_rng(1))
    paste(still, agents, image_poses(sample.place, tracks, 0.05)[-1])
    return _scaled(still, 0.05)


def _scaled(image: UInt8[Array, "H W 3"], resolution: float) -> UInt8[Array, "_ _ 3"]:
    scale = resolution / RESOLUTION
    return np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA))


def _lay_beside(
    real: list[UInt8[Array, "_ _ 3"]], made: list[UInt8[Array, "_ _ 3"]], path: Path
) -> None:
    """The middles of real pictures on the left, of made ones on the right."""
    middles = []
    for image in (p for pair in zip(real, made, strict=True) for p in pair):
        top, left = ((side - cut) // 2 for side, cut in zip(image.shape, CROP, strict=False))
        middles.append(image[top : top + CROP[0], left : left + CROP[1]])
    rows = [np.hstack(middles[k : k + 2]) for k in range(0, len(middles), 2)]
    path.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(path), np.vstack(rows)[..., ::-1])


def _real_pictures(folder: Path) -> dict[str, UInt8[Array, "_ _ 3"]]:
    """Drone stills of junctions."""
    street = str(next((folder / "hover/minsk_street").glob("*.jpg")).relative_to(folder))
    sources = {
        "songdo 3": ("hover/songdo_stills/00003.jpg", 0.04),
        "songdo 972": ("hover/songdo_stills/00972.jpg", 0.04),
        "minsk junction": ("hover/minsk_junction/DJI_0005-0018.jpg", 0.05),
        "minsk street": (street, 0.05),
    }
    return {
        name: _scaled(_opened(folder / path), metres) for name, (path, metres) in sources.items()
    }


def _opened(path: Path) -> UInt8[Array, "H W 3"]:
    image = cv2.imread(str(path))
    if image is None:
        raise FileNotFoundError(f"{path} is no picture")
    return np.ascontiguousarray(image[..., ::-1])


def real_vehicles(folder: Path) -> dict[str, list[Tracks]]:
    """Junctions of Songdo and Karlsruhe."""
    found = {"songdo": [read_geotrax(folder / "tracks/songdo_u/U_video_cut.csv", crs="EPSG:5186")]}
    for place in sorted((folder / "tracks/karlsruhe/tracks").iterdir()):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", GeoaimWarning)
            files = sorted(place.glob("vehicle_tracks_*.csv"))
            found[place.name[:4]] = [read_interaction(file) for file in files]
    return found


def real_people(folder: Path) -> dict[str, list[Tracks]]:
    """Three campus scenes of the Stanford Drone Dataset, at the resolutions that it estimates."""
    scales = _sdd_scales(folder / "tracks/sdd_raw/estimated_scales.yaml")
    found: dict[str, list[Tracks]] = {}
    for path in sorted((folder / "tracks/sdd_raw").glob("*/*/annotations.txt.gz")):
        scene, video = path.parts[-3:-1]
        tracks = read_sdd(path, resolution=scales[scene, video])
        found.setdefault(scene, []).append(tracks)
    return found


def _sdd_scales(path: Path) -> dict[tuple[str, str], float]:
    """Metres per pixel of each scene's videos, from a YAML of three levels."""
    scales, scene, video = {}, "", ""
    for line in path.read_text().splitlines():
        key, _, value = line.strip().partition(":")
        if line and not line[0].isspace():
            scene = key
        elif key == "scale":
            scales[scene, video] = float(value)
        elif not value:
            video = key
    return scales


def _move(recordings: Tracks | list[Tracks], types: tuple[str, ...]) -> Statistics:
    """How agents of some types move."""
    several = recordings if isinstance(recordings, list) else [recordings]
    return _joined([_motion(tracks, types) for tracks in several])


def _motion(tracks: Tracks, types: tuple[str, ...]) -> dict[str, Float[Array, "_"]]:
    """Speeds, accelerations, curvatures and distances, all from positions smoothed alike."""
    places = resample(tracks, np.array([kind in types for kind in tracks.types]))
    velocity = np.gradient(places, STEP, axis=1)
    speed = np.hypot(velocity[..., 0], velocity[..., 1])
    pull = np.gradient(speed, STEP, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        change = np.gradient(velocity, STEP, axis=1)
        cross = velocity[..., 0] * change[..., 1] - velocity[..., 1] * change[..., 0]
        bend = np.abs(cross) / speed**3
    moves, fast = speed > MOVING, speed > FAST
    is_vehicle = types == VEHICLES
    found = {
        "speed while moving, m/s": speed[moves],
        "share of time standing": (speed < MOVING)[np.isfinite(speed)].astype(float),
        "acceleration, m/s2": pull[moves & np.isfinite(pull)],
        "curvature, 1/m": bend[(fast if is_vehicle else moves) & np.isfinite(bend)],
        "sideways acceleration, m/s2": (bend * speed**2)[moves & np.isfinite(bend)],
    }
    if is_vehicle:
        found |= _headways(tracks)
    else:
        found["distance to the nearest, m"] = _nearest(places)
    return {name: np.asarray(values, float) for name, values in found.items()}


def resample(tracks: Tracks, chosen: Bool[Array, "N"]) -> Float[Array, "n T 2"]:
    """Positions at even steps, averaged over a window; NaN near gaps and ends."""
    times = np.arange(tracks.times[0], tracks.times[-1], STEP)
    places = np.full((int(chosen.sum()), len(times), 2), np.nan)
    kernel = np.ones(SMOOTH) / SMOOTH
    for row, agent in enumerate(np.flatnonzero(chosen)):
        steps = np.flatnonzero(tracks.present[agent])
        here = tracks.times[steps]
        whole = np.array([np.interp(times, here, tracks.states[agent, steps, k]) for k in (0, 1)]).T
        gap = (
            np.interp(times, here[:-1], np.diff(here))
            if len(here) > 1
            else np.full(len(times), 9.0)
        )
        whole[(times < here[0]) | (times > here[-1]) | (gap > 3 * STEP)] = np.nan
        for k in (0, 1):
            places[row, :, k] = np.convolve(whole[:, k], kernel, "same")
        places[row, : SMOOTH // 2] = places[row, len(times) - SMOOTH // 2 :] = np.nan
    return places


def _headways(tracks: Tracks) -> dict[str, Float[Array, "_"]]:
    """Time gaps behind whoever is followed, and distances in queues, each second."""
    vehicle = np.array([kind in VEHICLES for kind in tracks.types])
    every = max(round(1.0 / float(np.median(np.diff(tracks.times)))), 1)
    gaps, queues = [], []
    for step in range(0, len(tracks.times), every):
        who = np.flatnonzero(tracks.present[:, step] & vehicle)
        x, y, heading, speed = tracks.states[who, step].T
        east, north = x - x[:, None], y - y[:, None]
        along = east * np.cos(heading)[:, None] + north * np.sin(heading)[:, None]
        aside = north * np.cos(heading)[:, None] - east * np.sin(heading)[:, None]
        alike = np.cos(heading - heading[:, None]) > 0.9
        ahead = (along > 0.5) & (along < SEEN) & (np.abs(aside) < LANE) & alike
        along = np.where(ahead, along, np.inf)
        if len(who) < 2:
            continue
        leader = np.argmin(along, axis=1)
        length = tracks.sizes[who, 0]
        gap = along[np.arange(len(who)), leader] - (length + length[leader]) / 2
        follows = np.isfinite(gap)
        moving, standing = follows & (speed > FAST), follows & (speed < 0.3) & (speed[leader] < 0.3)
        gaps.append(gap[moving] / speed[moving])
        queues.append(gap[standing])
    return {
        "headway, s": np.concatenate(gaps or [np.empty(0)]),
        "distance in queues, m": np.concatenate(queues or [np.empty(0)]),
    }


def _nearest(places: Float[Array, "n T 2"]) -> Float[Array, "_"]:
    """Distance to the nearest other, each second, below 10 m."""
    found = []
    for step in range(0, places.shape[1], 10):
        now = places[np.isfinite(places[:, step, 0]), step]
        if len(now) > 1:
            apart = np.hypot(*np.moveaxis(now[:, None] - now[None], -1, 0))
            np.fill_diagonal(apart, np.inf)
            nearest = apart.min(axis=1)
            found.append(nearest[nearest < 10])
    return np.concatenate(found or [np.empty(0)])


def _draw(groups: Mapping[str, tuple[list[Statistics], dict[str, Statistics]]], path: Path) -> None:
    """Cumulative distributions: made ones thick, each real source thin."""
    import matplotlib.pyplot as plt

    panels = [
        (group, name)
        for group, (made, real) in groups.items()
        for name in made[0]
        if name not in ("spectrum", "share of time standing")
        and sum(len(s[name]) >= 50 for s in real.values()) > 0
        and len(_joined(made)[name]) >= 50
    ]
    columns = 5
    rows = -(-len(panels) // columns)
    figure, axes = plt.subplots(rows, columns, figsize=(17, 2.6 * rows), layout="constrained")
    axes = axes.ravel()
    for axis, (group, name) in zip(axes, panels, strict=False):
        made, real = groups[group]
        for source, statistics in real.items():
            _cumulative(axis, statistics[name], source, linewidth=1.0)
        _cumulative(axis, _joined(made)[name], "made", linewidth=2.4, color="black")
        axis.set_title(f"{group}: {name}", fontsize=9)
        axis.legend(fontsize=6)
    for axis in axes[len(panels) :]:
        axis.axis("off")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=80)


def _cumulative(axis: Any, values: Float[Array, "_"], label: str, **style: Any) -> None:
    if len(values) < 50:
        return
    shares = np.linspace(0, 1, 201)
    axis.plot(np.quantile(values, shares), shares, label=label, **style)
    low, high = np.quantile(values, [0.01, 0.99])
    left, right = axis.get_xlim() if len(axis.lines) > 1 else (low, high)
    axis.set_xlim(min(left, low), max(right, high))


if __name__ == "__main__":
    typer.run(main)
