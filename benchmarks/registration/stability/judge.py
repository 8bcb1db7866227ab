"""Judge registrations against the truth: errors, verdicts, breakpoints, calibration."""

from typing import Any

import cv2
import numpy as np
import pandas as pd
from jaxtyping import Float
from numpy import ndarray as Array

from benchmarks.registration.stability.clips import Clip, make_check_points
from geoaim.base.geometry import transform_points

MAX_RIGHT_ERROR_PX = 1.0
# The stated uncertainty is the RMS displacement over the image. The factor to its 95 % region is
# that of a displacement common to all points: chi-squared with two degrees of freedom.
TO_95 = float(np.sqrt(5.991 / 2))
MAX_UNDERSTATEMENT = 5.0
FAR_PX = 10.0
SMALLEST_STATED_PX = 1e-3  # identical frames state next to nothing
MIN_RIGHT_SHARE = 0.8  # share of right frames at a level that is not beyond the breakpoint
VERDICTS = ("right", "rejected", "wrong but uncertain", "understated", "wrong and overconfident")


def judge_frames(
    clip: Clip,
    reference: int,
    matrices: Float[Array, "T 3 3"],
    uncertainty: Float[Array, " T"] | None,
) -> list[dict[str, Any]]:
    """Judge each frame but the reference.

    The truth is where 5 x 5 points of a frame really lie in the reference. Where no homography can
    be exact (lens, rolling shutter, torn frames), the error is still what a user would see on the
    map, and `floor` is the error of the homography that fits the truth best.

    Args:
        clip: the clip.
        reference: number of the frame to which the others are registered.
        matrices: (T, 3, 3) reference_from_frame, NaN where rejected.
        uncertainty: (T,) stated standard deviation over the image, px; None where not stated.

    Returns:
        A row for each frame: index; error and floor (largest over the points), rms (over the
        points) and stated (the method's own uncertainty), px; verdict, one of `VERDICTS`.
    """
    grid, rows = make_check_points(clip.size), []
    for index, matrix in enumerate(matrices):
        if index == reference:
            continue
        truth = clip.find_truth(reference, index)
        best, _ = cv2.findHomography(grid, truth)
        error = np.linalg.norm(transform_points(matrix, grid) - truth, axis=1)
        stated = np.nan if uncertainty is None else float(uncertainty[index])
        row = {
            "index": index,
            "error": float(error.max()),
            "rms": float(np.sqrt((error**2).mean())),
            "floor": float(np.linalg.norm(transform_points(best, grid) - truth, axis=1).max()),
            "stated": stated,
        }
        rows.append(row | {"verdict": decide_verdict(row["error"], row["rms"], stated)})
    return rows


def decide_verdict(error: float, rms: float, stated: float) -> str:
    """Decide the verdict on one frame.

    Args:
        error: largest over the frame, px; NaN where rejected.
        rms: root mean square over the points, px.
        stated: standard deviation over the image, px; NaN where the method states none.

    Returns:
        One of `VERDICTS`: "wrong but uncertain" if the stated 95 % region contains the error,
        "understated" if the error is right but over five times the stated deviation.
    """
    if not np.isfinite(error):
        return "rejected"
    if error > MAX_RIGHT_ERROR_PX:
        is_told = rms <= TO_95 * stated and rms <= MAX_UNDERSTATEMENT * stated
        return "wrong but uncertain" if is_told else "wrong and overconfident"
    return "understated" if rms > MAX_UNDERSTATEMENT * stated else "right"


def find_breakpoint(frames: pd.DataFrame) -> int:
    """Find the rank of the last level before the share of right frames first falls too low.

    -1: it is too low at the first level already.
    """
    share = (frames.error <= MAX_RIGHT_ERROR_PX).groupby(frames["rank"]).mean()
    return int((share >= MIN_RIGHT_SHARE).cummin().sum()) - 1


def summarise(frames: pd.DataFrame) -> pd.DataFrame:
    """Summarise judged frames by kind: verdicts, share inside the stated 95 %, breakpoint."""
    rows = []
    for kind, of_kind in frames.groupby("kind", sort=False):
        own = of_kind[of_kind.method == "geoaim"]
        valid = own[own.error.notna()]
        levels = of_kind.groupby("rank")["level"].first().to_list()
        row: dict[str, Any] = {"kind": kind, "frames": len(own)}
        row |= {verdict: int((own.verdict == verdict).sum()) for verdict in VERDICTS}
        row["inside 95 %"] = float((valid.rms <= TO_95 * valid.stated).mean())
        stated = valid.stated.clip(lower=SMALLEST_STATED_PX)
        row["rms / stated"] = float(np.sqrt(((valid.rms / stated) ** 2).mean()))
        for method, theirs in of_kind.groupby("method", sort=False):
            rank = find_breakpoint(theirs)
            row[f"{method} up to"] = f"{levels[rank]:g}" if rank >= 0 else "none"
        rows.append(row)
    return pd.DataFrame(rows)


def compare_methods(frames: pd.DataFrame) -> list[dict[str, Any]]:
    """Compute the share of right, rejected and wrong frames of each method, percent.

    Other methods reject only frames in which they find no transform.
    """
    rows = []
    for method, own in frames.groupby("method", sort=False):
        is_wrong, is_rejected = own.error > MAX_RIGHT_ERROR_PX, own.error.isna()
        silent = is_wrong & (own.verdict != "wrong but uncertain")
        rows.append(
            {
                "method": method,
                "frames": len(own),
                "right, %": round(100 * float((~is_wrong & ~is_rejected).mean()), 1),
                "rejected, %": round(100 * float(is_rejected.mean()), 1),
                "wrong without saying so, %": round(100 * float(silent.mean()), 1),
                "by over 10 px, %": round(100 * float((silent & (own.error > FAR_PX)).mean()), 1),
                "median error if right, px": round(float(own.error[~is_wrong].median()), 3),
            }
        )
    return rows


def count_silent(frames: pd.DataFrame) -> dict[str, Any]:
    """Count this library's silent failures: frames "wrong and overconfident" or "understated".

    The keys are "frames", "valid" frames, "silent" failures, their "share" of all frames, and how
    many of them are "far" off, by over 10 px.
    """
    own = frames[frames.method == "geoaim"]
    silent = own[own.verdict.isin(["wrong and overconfident", "understated"])]
    return {
        "frames": len(own),
        "valid": int(own.error.notna().sum()),
        "silent": len(silent),
        "share": len(silent) / len(own),
        "far": int((silent.error > FAR_PX).sum()),
    }


def find_best_ranks(frames: pd.DataFrame) -> dict[str, int]:
    """Find the breakpoint of the best other method in each kind; -1 for none."""
    best = {}
    for kind, of_kind in frames.groupby("kind", sort=False):
        theirs = of_kind[of_kind.method != "geoaim"]
        ranks = (find_breakpoint(one) for _, one in theirs.groupby("method"))
        best[str(kind)] = max(ranks, default=-1)
    return best


def measure_rejections(frames: pd.DataFrame, best_ranks: dict[str, int]) -> float:
    """Compute the share of rejected frames up to the best other method's breakpoint.

    NaN without other methods.
    """
    own = frames[frames.method == "geoaim"]
    below = own[own["rank"] <= own.kind.map(best_ranks)]
    return float((below.verdict == "rejected").mean())
