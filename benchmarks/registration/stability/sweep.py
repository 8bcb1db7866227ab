"""Sweep the registration over kinds of disturbance.

python -m benchmarks.registration.stability.sweep --split validation --rivals -o build/stability
"""

import time
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
import pandas as pd
import typer

from benchmarks.registration.methods import Method, list_methods
from benchmarks.registration.stability.charts import write_cases, write_report
from benchmarks.registration.stability.clips import Clip, SweepCase, list_cases, make_clip
from benchmarks.registration.stability.judge import judge_frames
from benchmarks.registration.stability.kinds import KINDS
from geoaim.base.errors import RegistrationError
from geoaim.mapping.registration.register import register

QUICK_KINDS = ["plain", "coherent traffic", "solar panels", "water", "defocus", "jump"]
RIVALS = ("ORB 2000 + MAGSAC", "SIFT 2000 half + MAGSAC", "stabilo")


def run_geoaim(case: SweepCase, clip: Clip) -> list[dict[str, Any]]:
    """Register a clip as `geoaim register` would, and judge its frames.

    In clips of even seeds the reference is the first frame, else it is chosen by the data.
    """
    count, reference = len(clip.frames), 0
    matrices, uncertainty = np.full((count, 3, 3), np.nan), np.full(count, np.nan)
    inlier_share = np.zeros(count)
    start = time.perf_counter()
    try:
        done = register(clip.frames, reference_time=0.0 if case.seed % 2 == 0 else None)
    except RegistrationError as error:
        reasons: tuple[str, ...] = (str(error),) * count
    else:
        matrices, reference = done.reference_from_frame, done.reference.index
        uncertainty = done.uncertainty
        reasons, inlier_share = done.reason, done.inlier_share
    seconds = (time.perf_counter() - start) / count
    rows = judge_frames(clip, reference, matrices, uncertainty)
    for row in rows:
        row["reason"], row["inlier_share"] = reasons[row["index"]], inlier_share[row["index"]]
    return [{"method": "geoaim", **vars(case), **row, "seconds": seconds} for row in rows]


def run_rivals(case: SweepCase, clip: Clip, methods: dict[str, Method]) -> list[dict[str, Any]]:
    """Register a clip to its first frame by other methods, and judge its frames.

    Args:
        case: the clip's kind, level and seed.
        clip: the clip with its truth.
        methods: methods to run, by name.

    Returns:
        A row for each method and frame: as of `judge_frames`, with method, the case's fields,
        reason (empty), inlier share (NaN) and mean seconds of a frame.
    """
    coloured = [np.dstack([f] * 3) if f.ndim == 2 else f for f in clip.frames]
    rows = []
    for name, method in methods.items():
        matrices, seconds = method(coloured, [np.empty((0, 4))] * len(coloured))
        extra = {"reason": "", "inlier_share": np.nan, "seconds": float(np.mean(seconds))}
        judged = judge_frames(clip, 0, matrices, None)
        rows += [{"method": name, **vars(case), **row, **extra} for row in judged]
    return rows


def main(  # noqa: PLR0913  (its options)
    output: Annotated[Path, typer.Option("-o", help="folder to write")] = Path("build/stability"),
    split: Annotated[str, typer.Option(help="validation or test")] = "validation",
    kinds: Annotated[str, typer.Option(help="separated by semicolons; all by default")] = "",
    repeats: Annotated[int, typer.Option(help="seeds of each level and base")] = 1,
    skipped: Annotated[int, typer.Option(help="seeds that earlier sweeps used")] = 0,
    rivals: Annotated[bool, typer.Option(help="other methods on the same frames")] = False,
    every: Annotated[int, typer.Option(help="use every n-th clip")] = 1,
    quick: Annotated[bool, typer.Option(help="a few kinds, three levels of each")] = False,
) -> None:
    """Sweep, print the table of kinds, and write JSON, Markdown and charts.

    The bases take turns from clip to clip: of three, every third clip has the same one.
    """
    cv2.setNumThreads(1)
    chosen = QUICK_KINDS if quick else [kind for kind in kinds.split(";") if kind] or list(KINDS)
    available = list_methods() if rivals else {}
    methods = {name: available[name] for name in RIVALS if name in available}
    output.mkdir(parents=True, exist_ok=True)
    rows: list[dict[str, Any]] = []
    for kind in chosen:
        cases = list_cases(split, [kind.strip()], repeats=repeats, skipped=skipped)
        for number, case in enumerate(cases):
            if number % every == 0 and (not quick or case.rank % 3 == 0):
                clip = make_clip(case)
                rows += run_geoaim(case, clip) + run_rivals(case, clip, methods)
        write_cases(pd.DataFrame(rows), output / f"{split}.json")  # so that it can be stopped
    print(write_report(pd.DataFrame(rows), output, split))


if __name__ == "__main__":
    typer.run(main)
