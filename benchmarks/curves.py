"""Error against cost: the Pareto front, the knee, and automatic choices against the best."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from scipy.stats import gmean

from benchmarks.results import Row

NEAR_BEST = 1.05  # times the best error: as good as the best
NEAR_KNEE = 1.25  # times the knee's size: at the knee
MIN_DEPTH = 0.05  # how far a knee lies below the line between the ends, as a share of both ranges


def find_pareto_front(cost: Float[Array, " n"], error: Float[Array, " n"]) -> Bool[Array, " n"]:
    """Find the Pareto front: points to which no other is better in one and as good in the other.

    >>> find_pareto_front(np.array([1.0, 2.0, 3.0]), np.array([5.0, 6.0, 4.0]))
    array([ True, False,  True])
    """
    no_worse = (cost[:, None] <= cost) & (error[:, None] <= error)
    better = (cost[:, None] < cost) | (error[:, None] < error)
    return ~(no_worse & better).any(0) & np.isfinite(cost) & np.isfinite(error)


def find_knee(cost: Float[Array, " n"], error: Float[Array, " n"]) -> int:
    """Find the knee: beyond it, much more cost gains little.

    On logarithmic axes, the point of the Pareto front that lies farthest below the line from its
    cheapest to its most accurate point (Satopää et al. 2011, "Finding a Kneedle in a haystack").
    Where none lies clearly below, it is the end with the smaller product of cost and error.

    >>> find_knee(np.array([1.0, 2.0, 4.0, 8.0]), np.array([9.0, 3.0, 1.0, 0.9]))
    2
    """
    front = np.flatnonzero(find_pareto_front(cost, error))
    front = front[np.argsort(cost[front], kind="stable")]
    x, y = np.log(cost[front]), np.log(error[front])
    if len(front) > 2:
        depth = (x[-1] - x) / np.ptp(x) - (y - y[-1]) / np.ptp(y)
        if depth.max() >= MIN_DEPTH:
            return int(front[depth.argmax()])
    return int(front[0] if x[0] + y[0] <= x[-1] + y[-1] else front[-1])


def find_best_size(rows: Sequence[Row]) -> Row:
    """Find the row of one setting at the knee; rows marked "automatic" are left out."""
    sizes = [row for row in rows if not row.get("automatic")]
    cost, error = (np.array([row[key] for row in sizes], float) for key in ("cost", "error"))
    return sizes[find_knee(cost, error)]


def summarise_sizes(rows: Sequence[Row]) -> list[Row]:
    """Compare the default of each setting with the knee of its sizes.

    Args:
        rows: rows with "setting", "size", "error", "cost" and "default" (whether it is the
            default); rows marked "automatic" are not compared as sizes.

    Returns:
        A row for each setting.
    """
    found: list[Row] = []
    for name in dict.fromkeys(row["setting"] for row in rows):
        own = [row for row in rows if row["setting"] == name]
        default = next(row for row in own if row["default"])
        knee = find_best_size(own)
        ratio = default["size"] / knee["size"]
        place = "before" if ratio < 1 / NEAR_KNEE else "beyond" if ratio > NEAR_KNEE else "at"
        found.append(
            {
                "setting": name,
                "default": default["size"],
                "knee": knee["size"],
                "the default is": f"{place} the knee",
                "error at the default": default["error"],
                "error at the knee": knee["error"],
                "cost over the knee's": default["cost"] / knee["cost"],
            }
        )
    return found


def judge_choices(cases: Sequence[Row], tolerance: float) -> dict[str, Any]:
    """Compare an automatic choice with the best one, found afterwards, and with the most complex.

    Args:
        cases: cases with "errors" and "sizes" of all choices, the most complex last, and the
            "error" and "size" of the automatic one.
        tolerance: an error may always exceed the best one by this much, in its unit.

    Returns:
        A row: shares of the cases within 5 % of the best error, and mean sizes.
    """
    errors, sizes, own, size = (
        np.array([case[key] for case in cases], float)
        for key in ("errors", "sizes", "error", "size")
    )
    best = errors.min(axis=1)
    near = NEAR_BEST * best
    shares = {
        "within 5 % of the best, %": own <= near,
        "within 5 % or the tolerance, %": own <= np.maximum(near, best + tolerance),
        "richest within 5 %, %": errors[:, -1] <= near,
    }
    return {
        "cases": len(cases),
        "tolerance": tolerance,
        **{name: 100 * float(share.mean()) for name, share in shares.items()},
        "error over the best": float(gmean(own / best)),
        "richest's error over the best": float(gmean(errors[:, -1] / best)),
        "mean size chosen": float(size.mean()),
        "mean size of the richest": float(sizes[:, -1].mean()),
    }


def average_methods(rows: pd.DataFrame, keys: list[str]) -> list[Row]:
    """Average columns of a table over the rows of each method.

    `rows` has the column "method" and numbers in the columns `keys`. The result is a list with a
    dictionary for each method, in the order of the table: "method", and the mean of each key.
    """
    means = rows.groupby("method", sort=False)[keys].mean().reset_index()
    return [{str(key): value for key, value in row.items()} for row in means.to_dict("records")]


def mark_pareto_fronts(
    groups: Mapping[str, Sequence[Row]], cost: str, error: str
) -> list[dict[str, Any]]:
    """Copy the rows, adding the dataset's name and whether the method is Pareto-optimal in it.

    Args:
        groups: the rows of each dataset, one for each method, by the dataset's name.
        cost: key of the cost.
        error: key of the error.

    Returns:
        The rows, with the keys "data" and "on the front" ("yes" or "no").
    """
    marked = []
    for name, rows in groups.items():
        x, y = (np.array([row[key] for row in rows], float) for key in (cost, error))
        for row, on in zip(rows, find_pareto_front(x, y).tolist(), strict=True):
            marked.append({"data": name, **row, "on the front": "yes" if on else "no"})
    return marked
