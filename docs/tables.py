"""Tables of the documentation, which stand in its pages between two comments.

    python docs/tables.py

writes them anew: `<!-- table: NAME -->` from the results of a benchmark in docs/bench,
`<!-- experiment: NAME -->` from docs/experiments, `<!-- options: build -->` from a command, and
`<!-- decisions -->` from docs/decisions. Each ends at `<!-- end -->`.
"""

import inspect
import json
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from math import isnan, nan
from pathlib import Path
from statistics import fmean
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from typer.models import ArgumentInfo

from geoaim.cli import app

DOCS = Path(__file__).parent
BENCH = DOCS / "bench"
MARKED = re.compile(
    r"(<!-- (table|experiment|options|decisions):? ?([\w ]*?) -->\n).*?(<!-- end -->)", re.S
)
Row = Mapping[str, Any]


def fill(text: str) -> str:
    """Write the tables of a page anew."""
    return MARKED.sub(lambda m: f"{m[1]}\n{WRITERS[m[2]](m[3])}\n\n{m[4]}", text)


def write_experiment(name: str) -> str:
    """Write the tables of an experiment, which its script wrote."""
    return (DOCS / "experiments" / f"{name}.md").read_text("utf-8").strip()


def write_decisions(_: str = "") -> str:
    """Write a table of all decisions: title with a link, and what was decided."""
    rows = ["| decision | what |", "|---|---|"]
    for path in sorted(DOCS.glob("decisions/*.md")):
        if path.name != "index.md":
            text = path.read_text("utf-8")
            [title] = re.findall(r"\A# (.+)$", text, re.M)
            [what] = re.findall(r"^- \*\*What:\*\* (.+)$", text, re.M)
            rows.append(f"| [{title}]({path.name}) | {_write_line(what)} |")
    return "\n".join(rows)


def _write_line(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;").replace("{", "&#123;")


def write_options(command: str) -> str:
    """The arguments and options of a command as a table."""
    lines = ["| option | value | default | meaning |", "|---|---|---|---|"]
    for parameter in list_parameters(command):
        names = ", ".join(f"`{name}`" for name in parameter.names)
        cells = (
            names,
            _value(parameter),
            _default(parameter),
            _write_line(parameter.info.help or ""),
        )
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


@dataclass(frozen=True)
class Parameter:
    """An argument or option of a command.

    Attributes:
        names: as they are typed; capitals for an argument.
        kind: the type in the function's signature.
        default: of the function; `inspect.Parameter.empty` when the parameter is required.
        info: what typer was told about it.
    """

    names: list[str]
    kind: Any
    default: Any
    info: Any


def list_commands() -> dict[str, Callable[..., Any]]:
    """The function of each command by the command's name; of a group's, by both names."""
    commands = {}
    groups = [("", app)]
    groups += [(f"{g.typer_instance.info.name} ", g.typer_instance) for g in app.registered_groups]
    for prefix, group in groups:
        for info in group.registered_commands:
            assert info.callback is not None
            name = info.name or info.callback.__name__.replace("_", "-")
            commands[prefix + name] = info.callback
    return commands


def list_parameters(command: str) -> list[Parameter]:
    """Arguments and options of a command, as typer reads them from its function."""
    function = list_commands()[command]
    hints = get_type_hints(function, include_extras=True)
    parameters = []
    for name, parameter in inspect.signature(function).parameters.items():
        kind, info = get_args(hints[name])[:2]
        if isinstance(info, ArgumentInfo):
            names = [name.upper()]
        else:
            long = [f"--{name.replace('_', '-')}"]
            stated = (info.default, *(info.param_decls or ()))  # the first is Option's default
            names = [d for d in stated if isinstance(d, str) and d.startswith("-")]
            names = names if any(d.startswith("--") for d in names) else long + names
        parameters.append(Parameter(names, kind, parameter.default, info))
    return parameters


def _value(parameter: Parameter) -> str:
    kind = parameter.kind
    if isinstance(kind, UnionType) or get_origin(kind) is Union:
        kind = next(k for k in get_args(kind) if k is not type(None))
    if get_origin(kind) is Literal:
        return ", ".join(f"`{choice}`" for choice in get_args(kind))
    if inspect.isclass(kind) and issubclass(kind, Enum):
        return ", ".join(f"`{choice.value}`" for choice in kind)
    name = _KINDS.get(kind, "text")
    low, high = parameter.info.min, parameter.info.max
    if low is not None and high is not None:
        return f"{name}, {low:g} to {high:g}"
    return name if low is None else f"{name}, at least {low:g}"


_KINDS = {bool: "flag", float: "number", int: "whole number", Path: "path"}


def _default(parameter: Parameter) -> str:
    if parameter.default is inspect.Parameter.empty:
        return "required"
    if parameter.default is None or parameter.default is False:
        return ""
    return f"`{getattr(parameter.default, 'value', parameter.default)}`"


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
    if "commit" in results:
        parts.append(f"on {results['date']} (commit {results['commit'][:8]})")
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


def write_without_detector(results: Row) -> str:
    """What the videos are judged by: agents that are found, and what is stated of them."""
    keys = ["video", "moving recall", "standing recall", "precision", "IDF1", "HOTA"]
    keys += ["position m", "position m 90 %", "length m", "width m", "heading moving °"]
    keys += ["in position's 95 % region", "in heading's 95 % range", "proposed scale / true"]
    return write_rows([{key: row[key] for key in keys} for row in results["rows"]])


def write_tracking_hard(results: Row) -> str:
    """Each tracker's IDF1 and time under each condition, means over the cases."""
    rows = [row for row in results["rows"] if row["agents of"] == "vehicle"]
    methods = [name for name in _distinct(rows, "method") if "not given" not in name]
    header = ["boxes", *(f"IDF1, {name}" for name in methods), "HOTA, geoaim"]
    header += ["best other HOTA", "geoaim by case", "in its 95 % region of position", "of heading"]
    table = []
    for boxes in _distinct(rows, "boxes"):
        hotas = [_mean(rows, "HOTA", boxes=boxes, method=name) for name in methods]
        own = [r for r in rows if (r["boxes"], r["method"]) == (boxes, "geoaim")]
        found = [_mean(rows, "IDF1", boxes=boxes, method=name) for name in methods]
        cells = ["" if isnan(value) else f"{value:.3f}" for value in found]
        cells += [f"{hotas[0]:.3f}", f"{max(value for value in hotas[1:] if value == value):.3f}"]
        cells.append(", ".join(f"{row['IDF1']:.3f}" for row in own))
        for key in ("in position's 95 % region", "in heading's 95 % range"):
            cells.append(_range([round(row[key]) for row in own]) + " %")
        table.append([boxes, *cells])
    times = [f"{_mean(rows, 'ms a frame', method=name):.1f}" for name in methods]
    table.append(["*ms a frame*", *times, *[""] * 5])
    return write_table(header, table)


def write_models_without_detector(results: Row) -> str:
    """A row for each model, a column for each place."""
    rows = results["rows"]
    names = [key for key in rows[0] if key != "video"]
    table = [{"": name, **{row["video"]: row[name] for row in rows}} for name in names]
    return write_rows(table)


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


SOURCES = {"robustness": "registration", "length": "pipeline", "tilts": "georeference"}
SOURCES |= {f"catalog_{name}": "catalog" for name in ("losses", "store", "rows")}
SOURCES |= {
    f"detection_{name}": "detection"
    for name in ("stills", "reliability", "proposed", "wrong", "time")
}
SOURCES |= {"plan_country": "unit_costs", "plan_recordings": "unit_costs"}
SOURCES |= {f"{name}_sizes": name for name in ("registration", "background", "georeference")}
TABLES: dict[str, Callable[[Row], str]] = {
    "registration": write_registration,
    "robustness": write_robustness,
    "background": write_background,
    "pipeline": write_pipeline,
    "length": lambda results: write_rows(results["lengths"]),
    "birdview": write_birdview,
    "tracking_hard": write_tracking_hard,
    "without_detector": write_without_detector,
    "real_cars": write_without_detector,
    "models_without_detector": write_models_without_detector,
    "georeference": write_georeference,
    "georeference_sizes": write_sizes,
    "tilts": lambda results: write_rows(results["few points of tilted cameras"]),
    "registration_sizes": write_sizes,
    "background_sizes": write_sizes,
    "stability": write_stability,
    "catalog_losses": lambda results: write_rows(results["losses"]),
    "catalog_store": lambda results: write_rows(results["store"]),
    "catalog_rows": lambda results: write_rows(results["rows_of_tables"]),
    "detection_stills": lambda results: write_rows(results["stills"]),
    "detection_reliability": lambda results: write_rows(results["reliability"]),
    "detection_proposed": lambda results: write_rows(results["proposed_scale"]),
    "detection_wrong": lambda results: write_rows(results["wrong_scale"]),
    "detection_time": lambda results: write_rows(results["time"]),
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
    return fmean(chosen) if chosen else nan


def _range(values: Sequence[int]) -> str:
    low, high = min(values), max(values)
    return f"{low}" if low == high else f"{low} to {high}"


WRITERS = {
    "table": write_results,
    "experiment": write_experiment,
    "options": write_options,
    "decisions": write_decisions,
}


def main() -> None:
    """Write the tables of all pages."""
    for page in DOCS.rglob("*.md"):
        text = page.read_text("utf-8")
        if fill(text) != text:
            page.write_text(fill(text), "utf-8")
            print(page.relative_to(DOCS))


if __name__ == "__main__":
    main()
