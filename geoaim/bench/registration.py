"""Registration against its peers: speed and error on made hover videos with exact truth.

    python -m geoaim.bench.registration --json docs/bench/registration.json \
        --chart docs/images/registration.png

The peer stabilo is measured when installed: `pip install --no-deps stabilo`.
"""

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import cv2
import numpy as np
import typer
from jaxtyping import Float, UInt8
from matplotlib.figure import Figure
from numpy import ndarray as Array

from geoaim.bench.hover_videos import HoverVideo, Kind, make_hover_video
from geoaim.bench.report import save, table
from geoaim.bench.stills import STILLS
from geoaim.geometry import from_opencv, image_corners, transform_points
from geoaim.mapping.registration.keyframes import Placement
from geoaim.mapping.registration.patches import align, make_template, reduce
from geoaim.mapping.registration.register import choose_reference, place_frames
from geoaim.mapping.video.video import open_video
from geoaim.synthetic import frame_boxes, reference_from_frames, write_video

Matrices = Float[Array, "T 3 3"]
# A method: frames and boxes in; matrices (NaN where it refuses) and seconds a frame out.
Method = Callable[[Any, list[Array]], tuple[Matrices, list[float]]]
HARD: tuple[Kind, ...] = ("cars", "shadow", "gain", "cut", "noise")


def geoaim_method(frames: Any, boxes: list[Array]) -> tuple[Matrices, list[float]]:
    """This library: no boxes, the model chosen by the data."""
    reference = choose_reference(open_video(frames), time=0.0)
    placed: Iterator[tuple[Any, Placement]] = place_frames(open_video(frames), reference)
    matrices: list[Array] = []
    seconds: list[float] = []
    while True:
        start = time.perf_counter()
        step = next(placed, None)
        if step is None:
            return np.array(matrices), seconds
        seconds.append(time.perf_counter() - start)
        matrices.append(step[1].matrix)


def stabilo_method(*, with_boxes: bool) -> Method:
    """The best public peer: ORB, brute force, MAGSAC++, with or without the vehicles' boxes."""
    from stabilo import Stabilizer  # a peer, not a dependency

    def run(frames: Any, boxes: list[Array]) -> tuple[Matrices, list[float]]:
        stabilizer = Stabilizer(mask_use=with_boxes)
        matrices: list[Array] = []
        seconds: list[float] = []
        for index, frame in enumerate(frames):
            bgr = np.ascontiguousarray(frame[..., ::-1])
            low, high = boxes[index][:, :2], boxes[index][:, 2:]
            centred = np.hstack([(low + high) / 2, high - low])
            given = centred if with_boxes else None
            start = time.perf_counter()
            if index == 0:
                stabilizer.set_ref_frame(bgr, given)
            stabilizer.stabilize(bgr, given)
            seconds.append(time.perf_counter() - start)
            found = stabilizer.get_cur_trans_matrix()
            matrices.append(np.full((3, 3), np.nan) if found is None else from_opencv(found))
        return np.array(matrices, float), seconds

    return run


def feature_method(make: Callable[[], Any], norm: int, shrink: int) -> Method:
    """Detect, match by brute force, MAGSAC++: what most scripts do."""

    def run(frames: Any, boxes: list[Array]) -> tuple[Matrices, list[float]]:
        detector, matcher = make(), cv2.BFMatcher(norm, crossCheck=True)
        scale = np.diag([1 / shrink, 1 / shrink, 1.0])
        first: Any = None
        matrices: list[Array] = []
        seconds: list[float] = []
        for frame in frames:
            start = time.perf_counter()
            grey = _grey(frame, shrink)
            points, descriptors = detector.detectAndCompute(grey, None)
            first = first or (points, descriptors)
            pairs = matcher.match(descriptors, first[1])
            source = np.array([points[pair.queryIdx].pt for pair in pairs])
            target = np.array([first[0][pair.trainIdx].pt for pair in pairs])
            found, _ = cv2.findHomography(source, target, cv2.USAC_MAGSAC, 2.0)
            seconds.append(time.perf_counter() - start)
            matrix = np.full((3, 3), np.nan) if found is None else from_opencv(found)
            matrices.append(np.linalg.inv(scale) @ matrix @ scale)
        return np.array(matrices), seconds

    return run


def ecc_method(frames: Any, boxes: list[Array]) -> tuple[Matrices, list[float]]:
    """ECC at a quarter of the size, each frame started from the last."""
    small = [
        cv2.resize(
            cv2.cvtColor(f, cv2.COLOR_RGB2GRAY),
            None,
            fx=1 / 4,
            fy=1 / 4,
            interpolation=cv2.INTER_AREA,
        )
        for f in frames
    ]
    scale = np.diag([1 / 4, 1 / 4, 1.0])
    warp: Any = np.eye(3, dtype=np.float32)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-5)
    matrices: list[Array] = []
    seconds: list[float] = []
    for grey in small:
        start = time.perf_counter()
        try:
            _, warp = cv2.findTransformECC(small[0], grey, warp, cv2.MOTION_HOMOGRAPHY, criteria)
            matrix = np.linalg.inv(from_opencv(warp.astype(np.float64)))
        except cv2.error:
            matrix = np.full((3, 3), np.nan)
        seconds.append(time.perf_counter() - start)
        matrices.append(np.linalg.inv(scale) @ matrix @ scale)
    return np.array(matrices), seconds


def klt_method(frames: Any, boxes: list[Array]) -> tuple[Matrices, list[float]]:
    """KLT from the reference at half size, corners on a grid, forward and backward."""
    scale = np.diag([1 / 2, 1 / 2, 1.0])
    reference: Any = None
    corners: Any = None
    guess: Any = None
    matrices: list[Array] = []
    seconds: list[float] = []
    for frame in frames:
        start = time.perf_counter()
        grey = _grey(frame, 2)
        if reference is None:
            reference = grey
            corners = guess = cv2.goodFeaturesToTrack(grey, 400, 0.005, grey.shape[1] / 32)
        flags = cv2.OPTFLOW_USE_INITIAL_FLOW
        moved, one, _ = cv2.calcOpticalFlowPyrLK(
            reference, grey, corners, guess.copy(), flags=flags
        )
        back, two, _ = cv2.calcOpticalFlowPyrLK(grey, reference, moved, corners.copy(), flags=flags)
        good = (np.asarray(one) & np.asarray(two)).ravel().astype(bool)
        good &= np.hypot(*(back - corners).reshape(-1, 2).T) < 0.5
        found, _ = cv2.findHomography(moved[good], corners[good], cv2.USAC_MAGSAC, 1.0)
        seconds.append(time.perf_counter() - start)
        guess = moved
        matrix = np.full((3, 3), np.nan) if found is None else from_opencv(found)
        matrices.append(np.linalg.inv(scale) @ matrix @ scale)
    return np.array(matrices), seconds


def _grey(frame: UInt8[Array, "H W 3"], shrink: int) -> UInt8[Array, "h w"]:
    return reduce(cv2.cvtColor(frame, cv2.COLOR_RGB2GRAY), shrink)


def methods() -> dict[str, Method]:
    """All that are measured, by name."""
    found: dict[str, Method] = {
        "geoaim": geoaim_method,
        "ORB 2000 + MAGSAC": feature_method(lambda: cv2.ORB.create(2000), cv2.NORM_HAMMING, 1),
        "SIFT 2000 half + MAGSAC": feature_method(lambda: cv2.SIFT.create(2000), cv2.NORM_L2, 2),
        "KLT half + MAGSAC": klt_method,
        "ECC quarter": ecc_method,
    }
    try:
        found["stabilo with boxes"] = stabilo_method(with_boxes=True)
        found["stabilo"] = stabilo_method(with_boxes=False)
    except ImportError:
        print("stabilo is not installed: pip install --no-deps stabilo")
    return found


def corner_errors(matrices: Matrices, truth: Matrices, video: HoverVideo) -> Float[Array, " T"]:
    """Mean distance of the four mapped corners from the truth, pixels; NaN where refused."""
    corners = image_corners(video.clip.height, video.clip.width)
    apart = transform_points(matrices, corners) - transform_points(truth, corners)
    return np.linalg.norm(apart, axis=-1).mean(-1)


def measure(name: str, method: Method, video: HoverVideo, frames: Any) -> dict[str, Any]:
    """One row: rate from the median time of a frame, errors of the good frames."""
    boxes = [frame_boxes(video.clip, index) for index in range(len(video))]
    matrices, seconds = method(frames, boxes)
    errors = corner_errors(matrices, reference_from_frames(video.clip), video)
    given = np.isfinite(errors)
    right = given & video.is_valid & (errors < 0.3)
    good = errors[video.is_valid & given]
    return {
        "method": name,
        "frames_per_s": float(1 / np.median(seconds[1:])),
        "error_mean_px": float(good[good < 100].mean()),
        "error_p95_px": float(np.quantile(good, 0.95)),
        "error_max_px": float(good.max()),
        "valid_share_of_good": float(
            (given & video.is_valid & (errors < 0.3)).sum() / video.is_valid.sum()
        ),
        "wrong_given_as_right": int((given & ~right).sum()),
    }


def decoded(video: HoverVideo) -> list[UInt8[Array, "H W 3"]]:
    """The same frames after H.264 by x264's preset "medium" at crf 20."""
    with TemporaryDirectory() as folder:
        path = write_video(video, Path(folder) / "clip.mp4")
        return [frame.image for frame in open_video(path)]


def codec_shift(raw: list[UInt8[Array, "H W 3"]], coded: list[UInt8[Array, "H W 3"]]) -> float:
    """How far the encoder itself moved the picture: each fourth frame against its own original.

    Predicted blocks keep a part of the motion that the encoder found too small to code. No method
    that sees one frame at a time can be much better than this, pixels.
    """
    shifts = []
    for before, after in zip(raw[1::4], coded[1::4], strict=True):
        own = align(make_template(_grey(before, 1)), _grey(after, 1), np.eye(3), "homography")
        if own is not None:
            corners = image_corners(*before.shape[:2])
            apart = transform_points(own.matrix, corners) - corners
            shifts.append(np.linalg.norm(apart, axis=1).mean())
    return float(np.mean(shifts))


def accuracy(sizes: list[str], frames: int) -> list[dict[str, Any]]:
    """Every method on plain videos of both stills, raw and after H.264."""
    rows = []
    for size in sizes:
        for still in STILLS:
            video = make_hover_video(still, size=size, count=frames)
            raw = list(video)
            coded = decoded(video)
            limit = codec_shift(raw, coded)
            for source, pictures in (("raw", raw), ("H.264", coded)):
                for name, method in methods().items():
                    row: dict[str, Any] = {"size": size, "still": still, "source": source}
                    row["codec_shift_px"] = limit if source == "H.264" else 0.0
                    rows.append(row | measure(name, method, video, pictures))
                    print(table(rows[-1:]).splitlines()[-1], flush=True)
    return rows


def robustness(sizes: list[str], frames: int) -> list[dict[str, Any]]:
    """This library and the peer on the hard videos, no boxes given."""
    chosen = {name: m for name, m in methods().items() if name in ("geoaim", "stabilo")}
    rows = []
    for size in sizes:
        for still in STILLS:
            for kind in HARD:
                video = make_hover_video(still, size=size, count=frames, kind=kind)
                pictures = list(video)
                for name, method in chosen.items():
                    row = {"size": size, "still": still, "kind": kind}
                    rows.append(row | measure(name, method, video, pictures))
                    print(table(rows[-1:]).splitlines()[-1], flush=True)
    return rows


def chart(rows: list[dict[str, Any]], path: Path) -> None:
    """Speed against error, a point a method, size and still."""
    figure = Figure(figsize=(7.5, 4.5), layout="constrained")
    axes = figure.subplots()
    names = sorted({row["method"] for row in rows})
    for number, name in enumerate(names):
        for size, mark in (("1080p", "o"), ("4k", "s")):
            some = [r for r in rows if r["method"] == name and r["size"] == size]
            if some:
                axes.scatter(
                    [r["frames_per_s"] for r in some],
                    [r["error_mean_px"] for r in some],
                    color=f"C{number}",
                    marker=mark,
                    label=f"{name}, {size}",
                )
    axes.set(xscale="log", yscale="log", xlabel="frames a second", ylabel="mean corner error, px")
    axes.set_title("Registration on made hover videos with exact truth (right and low is better)")
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize=7, ncols=2)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=130)


def main(
    json: Annotated[Path | None, typer.Option(help="where to write the figures")] = None,
    chart_path: Annotated[Path | None, typer.Option("--chart", help="speed against error")] = None,
    sizes: Annotated[str, typer.Option(help="comma-separated")] = "1080p,4k",
    frames: Annotated[int, typer.Option(help="of each video")] = 60,
    threads: Annotated[int, typer.Option(help="of OpenCV")] = 2,
) -> None:
    """Measure all methods; print tables, and write JSON and a chart when asked."""
    cv2.setNumThreads(threads)
    plain = accuracy(sizes.split(","), frames)
    hard = robustness(sizes.split(","), frames)
    print(table(plain), table(hard), sep="\n\n")
    command = "python -m geoaim.bench.registration"
    save(plain, json, command=command, frames=frames, robustness=hard)
    if chart_path:
        chart(plain, chart_path)


if __name__ == "__main__":
    typer.run(main)
