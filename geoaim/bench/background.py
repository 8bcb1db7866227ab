"""Backgrounds against exact truth at 4K: error, ghosts, sharpness, time and memory of each method.

    python -m geoaim.bench.background --json docs/bench/background.json

The made video ("queue") has traffic over a fifth of the frame and queues that stand for 60 % of
the time. Every method reads the same H.264 frames, sampled over the clip, with true transforms,
and runs in a process of its own. Real sequences have no truth: there methods are compared.
"""

import json as jsonlib
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import cv2
import numpy as np
import typer
from jaxtyping import Bool, Float, Float32, UInt8
from numpy import ndarray as Array

from geoaim.bench.data import find_data
from geoaim.bench.hover_videos import make_hover_video
from geoaim.bench.report import format_table, measure_peak_megabytes, write_rows
from geoaim.encode import write_video
from geoaim.mapping.background.accumulate import compare_exposure, expose, first_exposure, warp
from geoaim.mapping.background.estimate import (
    Background,
    average_frames,
    remove_traffic,
    spread_order,
)
from geoaim.mapping.registration.register import register
from geoaim.mapping.video.detections import Detections, read_detections
from geoaim.mapping.video.frames import Frame
from geoaim.mapping.video.video import Video, open_video
from geoaim.synthetic import (
    list_boxes,
    measure_traffic_share,
    reference_from_frames,
    render_background,
)

MARGIN = 100  # px; the camera's drift leaves the rim to fewer frames
STOOD = 0.3  # share of the time from which traffic counts as standing


class Held(list[Frame]):
    """Decoded frames in memory, so that decoding is not timed."""

    @property
    def height(self) -> int:
        """Pixels."""
        return self[0].grey.shape[0]

    @property
    def width(self) -> int:
        """Pixels."""
        return self[0].grey.shape[1]


@dataclass(frozen=True, eq=False)
class Registered:
    """Frames of a video with known places, in an order that spreads over it; re-iterable."""

    video: Video | Held
    reference_from_frame: Float[Array, "T 3 3"]
    boxes: Detections | None = None
    most: int | None = None

    def __iter__(self) -> Iterator[tuple[Frame, Float[Array, "3 3"]]]:
        some = islice(self.video, self.most)
        return ((frame, self.reference_from_frame[frame.index]) for frame in some)

    @property
    def size(self) -> tuple[int, int]:
        """Height and width of the frames."""
        return self.video.height, self.video.width


def plain_mean(frames: Registered) -> Background:
    """The mean of all frames."""
    return average_frames(frames, size=frames.size)


def masked_mean(frames: Registered) -> Background:
    """The mean of what lies outside of the boxes."""
    return average_frames(frames, size=frames.size, detections=frames.boxes)


def without_boxes(frames: Registered) -> Background:
    """The mean of what is not found to be traffic."""
    return remove_traffic(frames, size=frames.size)


def half_without_boxes(frames: Registered) -> Background:
    """The same of the first 30 frames, which spread over the clip as all 60 do."""
    return remove_traffic(replace(frames, most=30), size=frames.size)


def numpy_median(frames: Registered) -> UInt8[Array, "H W 3"]:
    """numpy.median of all warped frames, held in memory, 64 rows at a time."""
    stack = list(warped(frames))
    result = np.empty((*frames.size, 3), np.uint8)
    for row in range(0, frames.size[0], 64):
        part = np.stack([image[row : row + 64] for image in stack])
        result[row : row + 64] = np.rint(np.median(part, axis=0))
    return result


def mog2(frames: Registered) -> UInt8[Array, "H W 3"]:
    """OpenCV's mixture of Gaussians."""
    model = cv2.createBackgroundSubtractorMOG2(history=64, detectShadows=False)
    for image in warped(frames):
        model.apply(image)
    return np.asarray(model.getBackgroundImage(), np.uint8)


def gsoc(frames: Registered) -> UInt8[Array, "H W 3"]:
    """OpenCV's GSOC (contrib)."""
    model = cv2.bgsegm.createBackgroundSubtractorGSOC()
    for image in warped(frames):
        model.apply(image)
    return np.asarray(model.getBackgroundImage(), np.uint8)


METHODS: dict[str, Callable[[Registered], Any]] = {
    "plain mean": plain_mean,
    "mean masked by boxes": masked_mean,
    "without boxes": without_boxes,
    "without boxes, 30 frames": half_without_boxes,
    "numpy median": numpy_median,
    "MOG2": mog2,
    "GSOC": gsoc,
}


def warped(frames: Registered) -> Iterator[UInt8[Array, "H W 3"]]:
    """RGB frames on the canvas at one exposure, for the peers."""
    exposure, gain = first_exposure(frames.size), 1.0
    for frame, matrix in frames:
        gain = compare_exposure(exposure, frame, matrix, gain)
        yield expose(warp(frame.image, matrix, frames.size), gain, 0.0)


def make_input(still: str, size: str, count: int, folder: Path) -> None:
    """Encode frames sampled over a made clip of 20 s, and keep the truth beside them."""
    video = make_hover_video(still, size=size, count=600, kind="queue")
    order = np.linspace(0, len(video) - 1, count).round().astype(int)[spread_order(count)]
    write_video((video[index] for index in order), folder / "frames.mp4", frame_rate=1)
    boxes = [np.insert(list_boxes(video.clip, i), 0, n, axis=1) for n, i in enumerate(order)]
    np.savez(
        folder / "truth.npz",
        # the first frame in order is the reference
        reference_from_frame=reference_from_frames(video.clip)[order],
        boxes=np.concatenate(boxes),
        clean=render_background(video.clip, 0),
        share=measure_traffic_share(video.clip),
    )


def read_input(folder: Path) -> tuple[Registered, Any]:
    """What `make_input` wrote."""
    truth = np.load(folder / "truth.npz")
    boxes = truth["boxes"]
    video = open_video(folder / "frames.mp4", threads=cv2.getNumThreads())
    by_frame = read_detections([boxes[boxes[:, 0] == i, 1:] for i in range(len(truth["boxes"]))])
    return Registered(video, truth["reference_from_frame"], by_frame), truth


def run_method(name: str, folder: Path, threads: int) -> dict[str, Any]:
    """One method in this process: its figures against the truth."""
    cv2.setNumThreads(threads)
    frames, truth = read_input(folder)
    start = time.perf_counter()
    result = METHODS[name](frames)
    seconds = time.perf_counter() - start
    peak = measure_peak_megabytes()
    row: dict[str, Any] = {"method": name}
    image = result.image if isinstance(result, Background) else result
    zones = _zones(truth["share"])
    error = (image.astype(np.float32) - truth["clean"]) ** 2
    row |= {zone: float(np.sqrt(error[where].mean())) for zone, where in zones.items()}
    first = next(iter(frames))[0].image
    row["gradient energy %"] = 100 * gradient_energy(image, first, truth["clean"], zones["static"])
    held = replace(frames, video=Held(frames.video))
    start = time.perf_counter()
    METHODS[name](held)
    row |= {"seconds": seconds, "decoded beforehand": time.perf_counter() - start, "peak MB": peak}
    if isinstance(result, Background):
        row |= {"contested %": 100 * float(result.contested.mean()), "change": result.change}
    return row


def gradient_energy(
    image: UInt8[Array, "H W 3"],
    frame: UInt8[Array, "H W 3"],
    clean: UInt8[Array, "H W 3"],
    where: Bool[Array, "H W"],
) -> float:
    """Gradient energy of an image over that of a single frame, free of the noise of both.

    Both are correlated with the gradients of the truth, which has no noise: what survives of an
    amplitude, squared.
    """
    truth = _gradients(clean)[:, where]
    kept, single = ((_gradients(picture)[:, where] * truth).sum() for picture in (image, frame))
    return float((kept / single) ** 2)


def _gradients(image: UInt8[Array, "H W 3"]) -> Float32[Array, "2 H W"]:
    """Differences of neighbours, right and down; these see the finest detail."""
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32)
    return np.stack([np.roll(grey, -1, axis) - grey for axis in (1, 0)])


def _zones(share: Float32[Array, "H W"]) -> dict[str, Bool[Array, "H W"]]:
    inside = np.zeros(share.shape, bool)
    inside[MARGIN:-MARGIN, MARGIN:-MARGIN] = True
    passed, stood = (share > 0) & (share < STOOD), share >= STOOD
    return {"static": inside & (share == 0), "passed": inside & passed, "stood": inside & stood}


def made_table(stills: list[str], size: str, count: int, threads: int) -> list[dict[str, Any]]:
    """All methods on made videos; times also as multiples of the plain mean's, without decoding."""
    rows = []
    for still in stills:
        with TemporaryDirectory() as name:
            make_input(still, size, count, Path(name))
            command = [sys.executable, "-m", "geoaim.bench.background", "--threads", str(threads)]
            for method in METHODS:
                call = [*command, "--method", method, "--folder", name]
                answer = subprocess.run(call, check=True, capture_output=True, text=True).stdout
                row = {"still": still, **jsonlib.loads(answer.splitlines()[-1])}
                rows.append(row)
                first = next(r for r in rows if r["still"] == still)
                row["times plain mean"] = row["decoded beforehand"] / first["decoded beforehand"]
                print(format_table([row]).splitlines()[-1], flush=True)
    return rows


def real_table() -> list[dict[str, Any]]:
    """Real sequences without truth: how far the methods are apart, and what stays contested."""
    data = find_data()
    if data is None:
        return []
    rows = []
    for place in ("hover/minsk_junction", "hover/munich_mos074", "hover/munich_street02"):
        video = open_video(data / place)
        registration = register(video)
        valid = registration.valid
        frames = Registered(
            open_video(sorted((data / place).glob("*.jpg"))),
            registration.reference_from_frame,
            read_detections(data / place),
        )
        rows.append(_compare(place, frames, valid))
    for path in sorted((data / "static").glob("*.mp4")):
        frames_read = [frame.image for frame in open_video(path).sample(64)]
        still = np.broadcast_to(np.eye(3), (len(frames_read), 3, 3))
        frames = Registered(open_video(frames_read), still)
        rows.append(_compare(path.name, frames, np.ones(len(frames_read), bool)))
    return rows


def _compare(name: str, frames: Registered, valid: Bool[Array, "T"]) -> dict[str, Any]:
    keep = [pair for pair in frames if valid[pair[0].index]]
    start = time.perf_counter()
    found = remove_traffic(keep, size=frames.size)
    row: dict[str, Any] = {
        "sequence": name,
        "frames": found.frames_used,
        "seconds": time.perf_counter() - start,
        "contested %": 100 * float(found.contested.mean()),
        "gains": f"{found.gains.min():.3f} to {found.gains.max():.3f}",
        "ghosts of mean %": _ghosts(average_frames(keep, size=frames.size), found),
        "ghosts of boxes %": float("nan"),
    }
    if frames.boxes is not None:
        boxed = average_frames(keep, size=frames.size, detections=frames.boxes)
        row["ghosts of boxes %"] = _ghosts(boxed, found)
    return row


def _ghosts(one: Background, other: Background) -> float:
    """Share of pixels that differ by more than 20 grey levels over 5 x 5 pixels."""
    both = (one.coverage > 0) & (other.coverage > 0)
    apart = cv2.blur(cv2.absdiff(one.image, other.image).max(-1), (5, 5)) > 20
    return 100 * float((apart & both).mean())


def main(
    json: Annotated[Path | None, typer.Option(help="where to write the figures")] = None,
    size: Annotated[str, typer.Option(help="of the made videos: 720p, 1080p, 4k")] = "4k",
    frames: Annotated[int, typer.Option(help="sampled over the clip")] = 60,
    stills: Annotated[str, typer.Option(help="comma-separated")] = "00003,00972",
    threads: Annotated[int, typer.Option(help="of OpenCV and of the decoder")] = 2,
    method: Annotated[str | None, typer.Option(hidden=True)] = None,
    folder: Annotated[Path | None, typer.Option(hidden=True)] = None,
) -> None:
    """Measure backgrounds."""
    if method and folder:
        print(jsonlib.dumps(run_method(method, folder, threads)))
        return
    cv2.setNumThreads(threads)
    made = made_table(stills.split(","), size, frames, threads)
    print(format_table(made), "\n")
    real = real_table()
    if real:
        print(format_table(real))
    command = " ".join(["python -m geoaim.bench.background", *sys.argv[1:]])
    write_rows(made, json, command=command, size=size, frames=frames, real=real)


if __name__ == "__main__":
    typer.run(main)
