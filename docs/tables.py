"""Tables of the documentation, made from the results of the benchmarks in docs/bench."""

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from statistics import fmean
from typing import Any

BENCH = Path(__file__).parent / "bench"
Row = Mapping[str, Any]


def write_results(name: str) -> str:
    """A benchmark's tables in Markdown, with the command and the machine that made them."""
    source = SOURCES.get(name, name)
    results = json.loads((BENCH / f"{source}.json").read_text("utf-8"))
    tables = TABLES.get(name, write_all_rows)(results)
    return tables + "\n\n" + write_origin(source, results)


def write_origin(name: str, results: Row) -> str:
    """What made the results, and on which machine."""
    parts = []
    if "command" in results:
        parts.append(f"Made by `{results['command']}`")
    machine = results.get("machine")
    if machine:
        parts.append(f"on {machine['cores']} cores of {machine['processor'].split('@')[0].strip()}")
    link = f"[docs/bench/{name}.json](../bench/{name}.json)"
    return f"<small>{' '.join(parts)}{'; ' if parts else ''}{link}</small>"


def write_all_rows(results: Row) -> str:
    """All rows of a benchmark."""
    return write_rows(results["rows"])


def write_rows(rows: Sequence[Row]) -> str:
    """Rows under the keys of the first; a row with a key that its table lacks begins another."""
    groups: list[list[Row]] = []
    for row in rows:
        if not groups or not row.keys() <= groups[-1][0].keys():
            groups.append([])
        groups[-1].append(row)
    return "\n\n".join(
        write_table(
            [key.replace("_", " ") for key in group[0]],
            [[row.get(key) for key in group[0]] for row in group],
        )
        for group in groups
    )


def write_registration(results: Row) -> str:
    """Error and speed of each method, means over the videos of both stills."""
    columns = [(size, source) for size in ("1080p", "4k") for source in ("raw", "H.264")]
    header = ["method", *(f"{size} {source}, px" for size, source in columns)]
    header += ["1080p, frames/s", "4k, frames/s"]
    rows = []
    for method in _distinct(results["rows"], "method"):
        own = [row for row in results["rows"] if row["method"] == method]
        errors = [_mean(own, "error_mean_px", size=s, source=c) for s, c in columns]
        speeds = [round(_mean(own, "frames_per_s", size=size)) for size in ("1080p", "4k")]
        rows.append([method, *(f"{error:.3f}" for error in errors), *speeds])
    shift = [_mean(results["rows"], "codec_shift_px", size=s, source=c) for s, c in columns]
    shifts = [f"*{s:.3f}*" if s else "" for s in shift]
    rows.append(["*shift of the picture by the encoder*", *shifts, "", ""])
    return write_table(header, rows)


def write_robustness(results: Row) -> str:
    """What hard videos do to the two methods that say when they fail."""
    names = {
        "cars": "300 cars",
        "shadow": "a shadow over half of the frame",
        "gain": "gain x3 for a third of the time",
        "cut": "a cut to another place",
        "noise": "a fifth of the frames is noise",
    }
    header, rows = ["video"], []
    methods = _distinct(results["robustness"], "method")
    for method in methods:
        header += [f"{method}: good frames found", f"{method}: wrong frames accepted"]
    for kind, name in names.items():
        cells = [name]
        for method in methods:
            own = [r for r in results["robustness"] if (r["kind"], r["method"]) == (kind, method)]
            shares = [round(100 * row["right_share_of_valid"]) for row in own]
            cells += [_range(shares) + " %", _range([row["accepted_but_wrong"] for row in own])]
        rows.append(cells)
    return write_table(header, rows)


def write_background(results: Row) -> str:
    """Each method on each kind of clip, means over the seeds; then real sequences."""
    keys = ["static", "passed", "stood", "wrong %", "wrong marked %", "good marked %"]
    keys += ["gradient energy %", "ms"]
    rows = []
    for clip in _distinct(results["rows"], "clip"):
        of_clip = [row for row in results["rows"] if row["clip"] == clip]
        for method in _distinct(of_clip, "method"):
            own = [row for row in of_clip if row["method"] == method]
            values = [[row[key] for row in own if row[key] is not None] for key in keys]
            rows.append([clip, method, *(fmean(known) if known else None for known in values)])
    return write_table(["clip", "method", *keys], rows) + "\n\n" + write_rows(results["real"])


def write_pipeline(results: Row) -> str:
    """Frames a second of whole pipelines."""
    rows = [
        [name.replace("_", " "), speed, f"{share:.0%}"]
        for name, speed, share in (row.values() for row in results["rows"])
    ]
    return write_table(["pipeline", "frames/s", "of decoding alone"], rows)


def write_birdview(results: Row) -> str:
    """Time of a batch, and errors of each method against the truth."""
    parts = [
        results["rows"],
        *(v for k, v in results.items() if isinstance(v, list) and k != "rows"),
    ]
    return "\n\n".join(write_rows(rows) for rows in parts)


def write_georeference(results: Row) -> str:
    """Errors by noise and number of points, without the times, which the chart shows."""
    keys = [key for key in results["rows"][0] if not key.endswith(", ms")]
    return write_rows([{key: row[key] for key in keys} for row in results["rows"]])


def write_sizes(results: Row) -> str:
    """The default of each setting and its knee, then how automatic choices fare."""
    choices = [rows for name, rows in results.items() if name.startswith("choice ")]
    return "\n\n".join(write_rows(rows) for rows in [results["defaults"], *choices])


def write_stability(results: Row) -> str:
    """Methods side by side, then each kind of hardship."""
    return write_rows(results["methods"]) + "\n\n" + write_rows(results["rows"])


SOURCES = {"robustness": "registration", "length": "pipeline"}
SOURCES |= {f"catalog_{name}": "catalog" for name in ("losses", "store", "rows")}
SOURCES |= {"plan_country": "unit_costs", "plan_recordings": "unit_costs"}
SOURCES |= {f"{name}_sizes": name for name in ("registration", "background", "georeference")}
TABLES: dict[str, Callable[[Row], str]] = {
    "registration": write_registration,
    "robustness": write_robustness,
    "background": write_background,
    "pipeline": write_pipeline,
    "length": lambda results: write_rows(results["lengths"]),
    "birdview": write_birdview,
    "georeference": write_georeference,
    "georeference_sizes": write_sizes,
    "registration_sizes": write_sizes,
    "background_sizes": write_sizes,
    "stability": write_stability,
    "catalog_losses": lambda results: write_rows(results["losses"]),
    "catalog_store": lambda results: write_rows(results["store"]),
    "catalog_rows": lambda results: write_rows(results["rows_of_tables"]),
    "plan_country": lambda results: write_rows(results["country"]),
    "plan_recordings": lambda results: write_rows(results["recordings"]),
}


def write_table(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """A table in Markdown."""
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    lines += ["| " + " | ".join(_cell(cell) for cell in row) + " |" for row in rows]
    return "\n".join(lines)


def _cell(value: Any) -> str:
    if value is None or value != value:
        return ""
    if isinstance(value, bool) or not isinstance(value, float):
        return str(value)
    return f"{value:.0f}" if abs(value) >= 100 else f"{value:.3g}"


def _distinct(rows: Sequence[Row], key: str) -> list[Any]:
    return list(dict.fromkeys(row[key] for row in rows))


def _mean(rows: Sequence[Row], key: str, **wanted: Any) -> float:
    chosen = [row[key] for row in rows if all(row[k] == v for k, v in wanted.items())]
    return fmean(chosen)


def _range(values: Sequence[int]) -> str:
    low, high = min(values), max(values)
    return f"{low}" if low == high else f"{low} to {high}"
