r"""Imagery of others laid on an AIM, or under tracks: how well, how surely, how fast.

    python -m geoaim.bench.alignment --json docs/bench/alignment.json \
        --chart docs/images/alignment.png

Made pairs: the ground of a made place, and another day's picture of it by another sensor at 0.3 to
0.6 m a pixel, misplaced by up to 15 m, 5 degrees and 5 %. Errors are means over the place, in
pixels of the picture. Rivals match features of the whole pictures and fit a homography by MAGSAC++;
what has fewer than ten inliers counts as refused. Real pairs and tracks need `GEOAIM_DATA`.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import cv2
import matplotlib.pyplot as plt
import numpy as np
import typer
from jaxtyping import Float
from numpy import ndarray as Array

from geoaim.aim import AIM
from geoaim.bench.alignment_pairs import GROUND, Pair, error, made_pairs, misplaced
from geoaim.bench.alignment_real import rotterdam, zooms
from geoaim.bench.data import find_data
from geoaim.bench.report import format_table, time_medians, write_rows
from geoaim.errors import AlignmentError
from geoaim.geometry import from_opencv, similarity_about, transform_points
from geoaim.imagery.alignment import template_matching
from geoaim.imagery.alignment.by_image import align_image
from geoaim.imagery.alignment.by_tracks import align_tracks
from geoaim.imagery.alignment.result import ImageryAlignment
from geoaim.imagery.mosaic import read_imagery
from geoaim.synthetic.roads.layouts import STANDARD_KINDS
from geoaim.track_formats import read_geotrax
from geoaim.tracks import Tracks

INLIERS = 10


def by_features(pair: Pair, detector: Any, norm: int) -> Float[Array, "3 3"]:
    """true_from_stated by features of both pictures at one resolution, and MAGSAC++.

    Raises:
        AlignmentError: fewer than ten matches agree.
    """
    step = pair.picture.resolution / pair.aim.resolution
    ground = cv2.resize(
        pair.aim.image, None, fx=1 / step, fy=1 / step, interpolation=cv2.INTER_AREA
    )
    aim_from_ground = np.diag([step, step, 1.0])
    points, descriptors = [], []
    for image in (pair.picture.image, ground):
        keys, found = detector.detectAndCompute(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), None)
        points.append(np.array([key.pt for key in keys]).reshape(-1, 2))
        descriptors.append(found)
    pairs = cv2.BFMatcher(norm, crossCheck=True).match(*descriptors)
    source, target = (points[k][[(m.queryIdx, m.trainIdx)[k] for m in pairs]] for k in (0, 1))
    if len(source) < INLIERS:
        raise AlignmentError(f"{len(source)} matches")
    matrix, inliers = cv2.findHomography(source, target, cv2.USAC_MAGSAC, 2.0, maxIters=10_000)
    if matrix is None or inliers.sum() < INLIERS:
        raise AlignmentError(f"{0 if inliers is None else inliers.sum()} matches agree")
    ground_from_picture = from_opencv(matrix)
    return (
        pair.aim.world_from_image
        @ aim_from_ground
        @ ground_from_picture
        @ np.linalg.inv(pair.picture.world_from_image)
    )


def ways() -> dict[str, Callable[[Pair], tuple[Float[Array, "3 3"], float]]]:
    """What is compared: true_from_stated and its 95 % uncertainty in metres, if it has one."""
    orb = cv2.ORB.create(nfeatures=5000)
    sift = cv2.SIFT.create(nfeatures=5000, enable_precise_upscale=True)

    def ours(pair: Pair) -> tuple[Float[Array, "3 3"], float]:
        found = align_image(pair.picture, pair.aim)
        return found.true_from_stated, found.uncertainty

    def with_shadows(pair: Pair) -> tuple[Float[Array, "3 3"], float]:
        kept, template_matching.SHADOW_RADIUS_M = template_matching.SHADOW_RADIUS_M, 0.0
        try:
            return ours(pair)
        finally:
            template_matching.SHADOW_RADIUS_M = kept

    return {
        "geoaim": ours,
        "geoaim, shadows not flattened": with_shadows,
        "SIFT + MAGSAC++": lambda pair: (by_features(pair, sift, cv2.NORM_L2), np.nan),
        "ORB + MAGSAC++": lambda pair: (by_features(pair, orb, cv2.NORM_HAMMING), np.nan),
    }


def compare_on_made(pairs: list[Pair], trials: int) -> list[dict[str, Any]]:
    """Every way on all made pairs."""
    generator = np.random.default_rng(5)
    cases = [misplaced(pair, generator) for pair in pairs for _ in range(trials)]
    strangers = [
        replace(one, aim=other.aim, name="stranger")
        for one, other in zip(cases, cases[trials * 5 :] + cases[: trials * 5], strict=True)
    ]
    strangers = [_brought_over(case) for case in strangers[::trials]]
    rows = []
    for name, way in ways().items():
        found = np.array([_measured(case, way) for case in cases])
        errors, bounds, seconds = found.T
        answered = np.isfinite(errors)
        pretended = sum(np.isfinite(_measured(case, way)[0]) for case in strangers)
        rows.append(
            {
                "way": name,
                "cases": len(cases),
                "median, px": float(np.median(np.where(answered, errors, np.inf)))
                if answered.mean() > 0.5
                else None,
                "95 %, px": float(np.percentile(errors[answered], 95)) if answered.any() else None,
                "under 1 px, %": 100 * float((errors < 1).mean()),
                "refused": int((~answered).sum()),
                "over 1 px and not refused": int((errors >= 1).sum()),
                "in the 95 % region, %": 100 * float((errors < bounds)[answered].mean())
                if np.isfinite(bounds).any()
                else None,
                "answers for another place": f"{pretended} of {len(strangers)}",
                "s": float(np.median(seconds)),
            }
        )
    return rows


def _brought_over(case: Pair) -> Pair:
    """A picture of another place, where the AIM is."""
    apart = case.aim.corners.mean(axis=0) - case.picture.corners.mean(axis=0)
    shift = np.eye(3)
    shift[:2, 2] = apart
    picture = replace(
        case.picture,
        world_from_image=shift @ case.picture.world_from_image,
        world=case.aim.world,
    )
    return replace(case, picture=picture)


def _measured(
    pair: Pair, way: Callable[[Pair], tuple[Float[Array, "3 3"], float]]
) -> tuple[float, float, float]:
    """Error and uncertainty in pixels of the picture, NaN where refused; and seconds."""
    pixel, start = pair.picture.resolution, time.perf_counter()
    try:
        matrix, bound = way(pair)
    except AlignmentError:
        return np.nan, np.nan, time.perf_counter() - start
    return error(pair, matrix) / pixel, bound / pixel, time.perf_counter() - start


def songdo(folder: Path, trials: int = 20) -> list[dict[str, Any]]:
    """Vehicles of five seconds on a real orthophoto, misplaced by up to 10 m and 3 degrees."""
    tracks = read_geotrax(folder / "tracks/songdo_u/U_video_cut.csv", crs="EPSG:5186")
    corners = tracks.states[tracks.present][:, :2]
    spread = np.array([corners.min(axis=0) - 40, corners.max(axis=0) + 40])
    picture = read_imagery(
        folder / "tracks/songdo_u/ortho_U_25cm_epsg5186.tif", world=tracks.world, corners=spread
    )
    return [_by_tracks("songdo", picture, tracks, np.radians(50.2), trials)]


def made_tracks(pairs: list[Pair]) -> list[dict[str, Any]]:
    """A minute of made traffic on other days' pictures, by kind of place."""
    rows = []
    for kind in STANDARD_KINDS:
        mine = [pair for pair in pairs if pair.name.startswith(kind)]
        parts = [
            _by_tracks(kind, pair.picture, pair.tracks, None, 2)
            for pair in mine
            if pair.tracks is not None
        ]
        whole = {name: [part[name] for part in parts] for name in parts[0]}
        rows.append(
            {
                "tracks": f"made, {kind}",
                "cases": sum(whole["cases"]),
                "refused": sum(whole["refused"]),
                "error, m, median": float(np.median(whole["error, m, median"])),
                "largest, m": max(whole["largest, m"]),
                "in the 95 % region": sum(whole["in the 95 % region"]),
                "s": float(np.median(whole["s"])),
            }
        )
    return rows


def _by_tracks(
    name: str, picture: AIM, tracks: Tracks, road: float | None, trials: int
) -> dict[str, Any]:
    """Errors of the tracks' middle; across the road where one is named."""
    generator = np.random.default_rng(11)
    errors, inside, seconds, refused = [], 0, [], 0
    places = tracks.states[tracks.present][:, :2]
    middle = (places.min(axis=0) + places.max(axis=0)) / 2
    for _ in range(trials):
        angle, reach = generator.uniform(0, 2 * np.pi), generator.uniform(0, 10)
        matrix = similarity_about(middle, np.radians(generator.uniform(-3, 3)), 1.0)
        matrix[:2, 2] += reach * np.array([np.cos(angle), np.sin(angle)])
        moved = replace(picture, world_from_image=matrix @ picture.world_from_image)
        start = time.perf_counter()
        try:
            found: ImageryAlignment = align_tracks(moved, tracks)
        except AlignmentError:
            refused += 1
            continue
        seconds.append(time.perf_counter() - start)
        apart = transform_points(found.true_from_stated @ matrix, found.center[None])[0]
        apart = apart - found.center
        inside += int(apart @ np.linalg.solve(found.covariance, apart) < 5.99)
        across = apart if road is None else apart @ [[-np.sin(road)], [np.cos(road)]]
        errors.append(float(np.linalg.norm(across)))
    return {
        "tracks": name,
        "cases": trials,
        "refused": refused,
        "error, m, median": float(np.median(errors)) if errors else None,
        "largest, m": max(errors, default=None),
        "in the 95 % region": inside,
        "s": float(np.median(seconds)) if seconds else None,
    }


def speed(made: Pair) -> list[dict[str, Any]]:
    """A scene of 200 x 200 m at 0.2 m a pixel, beside one Fourier correlation of that size."""
    side = 1000
    one, two = np.random.default_rng(0).random((2, side, side), np.float32)

    def correlate() -> Array:
        return np.fft.irfft2(np.fft.rfft2(one).conj() * np.fft.rfft2(two))

    height, width = made.aim.image.shape[:2]
    more = ((0, side - height), (0, side - width), (0, 0))  # mirrored, to fill the square
    photo = cv2.resize(made.picture.image, (width, height), interpolation=cv2.INTER_CUBIC)
    aim, picture = (
        AIM.from_image(
            np.pad(image, more, "reflect"), made.aim.world_from_image, made.aim.world, "drawn"
        )
        for image in (made.aim.image, np.asarray(photo))
    )
    pair = misplaced(Pair("square", aim, picture, np.eye(3)), np.random.default_rng(2))
    ours, floor = time_medians([lambda: align_image(pair.picture, pair.aim), correlate], 5)
    return [
        {
            "scene": "200 x 200 m, 0.2 m a pixel",
            "error, px": error(pair, align_image(pair.picture, pair.aim).true_from_stated) / GROUND,
            "s": ours,
            "of a Fourier correlation": ours / floor,
        }
    ]


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Time against error, and what is wrong and not refused."""
    figure, axes = plt.subplots(figsize=(7, 4.2), layout="constrained")
    for row in rows:
        if row["median, px"] is None:  # over half of the cases were refused
            continue
        wrong = row["over 1 px and not refused"]
        label = f"{row['way']}: {row['under 1 px, %']:.0f} % under 1 px, {wrong} wrong"
        axes.plot(row["s"], row["median, px"], "o", markersize=11, label=label)
    axes.legend(fontsize=8)
    axes.set(xscale="log", yscale="log", xlabel="s for a pair", ylabel="median error, px")
    axes.set_title(f"{rows[0]['cases']} made pairs of other days and sensors")
    axes.margins(0.35)
    axes.grid(alpha=0.3)
    figure.savefig(path, dpi=110)


def main(
    json: Annotated[Path | None, typer.Option(help="where to write the figures")] = None,
    chart: Annotated[Path | None, typer.Option(help="where to draw time against error")] = None,
    seeds: Annotated[int, typer.Option(help="of made places of each kind")] = 4,
    trials: Annotated[int, typer.Option(help="misplacements of each made pair")] = 4,
) -> None:
    """Compare on made pairs, then measure real pairs, tracks and tiles where they are at hand."""
    cv2.setNumThreads(2)
    pairs = list(made_pairs(seeds))
    folder = find_data()
    made = compare_on_made(pairs, trials)
    parts: list[Callable[[], list[dict[str, Any]]]] = [
        lambda: made,
        lambda: made_tracks(pairs),
        lambda: speed(pairs[0]),
    ]
    if folder is not None:
        parts += [lambda: songdo(folder), lambda: rotterdam(folder), lambda: zooms(folder)]
    rows: list[dict[str, Any]] = []
    for part in parts:
        rows += (found := part())
        print(format_table(found) + "\n", flush=True)
    write_rows(rows, json, command="python -m geoaim.bench.alignment")
    if chart is not None:
        draw(made, chart)


if __name__ == "__main__":
    typer.run(main)
