"""The report of a catalogue: a page with a map of the places and pictures, and the same as JSON."""

import json
from collections import Counter
from collections.abc import Sequence
from html import escape
from io import StringIO
from typing import Any

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from geoaim.aim.summary import summarize_report
from geoaim.base.pages import read_page_style
from geoaim.base.texts import plot_text
from geoaim.catalog.recordings import VERSION
from geoaim.catalog.records import CHANGES, FOLDER, LOOK, MAP, Record, Status
from geoaim.catalog.tracks_of_days import get_tracks_path, group_tracks

REPORT = "report.json"
PAGE = "report.html"
MAX_NAMED_PLACES = 40  # names that are shown on the map of places
# kinds of a record in the order of the page, and their colours of geoaim/base/page.css
COLOURS: dict[Status, str] = {"built": "good", "refused": "doubt", "failed": "wrong"}
PLACE_COLOUR = "#1a7f37"
STYLE = (
    ".geoaim-report{max-width:1100px;margin:2em auto;padding:0 1em;font-size:15px}"
    "table{border-collapse:collapse;width:100%}td,th{text-align:left;vertical-align:top;"
    "padding:.4em .6em;border-top:1px solid var(--line)}td img{width:260px;max-width:100%}"
    "small{color:var(--muted)}.good{color:var(--good)}.doubt{color:var(--doubt)}"
    ".wrong{color:var(--wrong)}.places svg{width:100%;height:auto;background:#fff}"
)


def format_report(records: Sequence[Record]) -> dict[str, bytes]:
    """Format the page and the JSON of a catalogue."""
    rows = [summarize_record(record) for record in records]
    counts = Counter(record.status for record in records)
    report = {"version": VERSION, "counts": dict(counts), "recordings": rows}
    text = json.dumps(report, indent=1, allow_nan=False)
    return {REPORT: text.encode(), PAGE: format_page(records).encode()}


def summarize_record(record: Record) -> dict[str, Any]:
    """Summarize a record: whether it was built, or why not; time, quality and uncertainty."""
    return {
        "name": record.name,
        "place": record.choices.get("place"),
        "datetime": record.datetime,
        "status": record.status,
        "reason": record.reason,
        "warnings": list(record.warnings),
        "seconds": record.seconds,
        "processor_seconds": record.processor_seconds,
        "input_bytes": sum(file.size for file in record.inputs),
        "map_bytes": sum(file.size for file in record.files.values()),
        "corners_lonlat": record.grid.get("corners_lonlat"),
        "content_hash": record.content_hash,
        "summary": summarize_report(record.report),
    }


def format_page(records: Sequence[Record]) -> str:
    """Format the page: counts, a map of the places, and a row for each recording."""
    counts = Counter(record.status for record in records)
    total = sum(record.processor_seconds for record in records)
    line = ", ".join(f"{counts[status]} {status}" for status in COLOURS if counts[status])
    return (
        f"<!doctype html><html lang=en class=geoaim-report><meta charset=utf-8>"
        f"<meta name=viewport content='width=device-width'><title>Maps by geoaim</title>"
        f"<style>{read_page_style()}{STYLE}</style><main><h1>{len(records)} recordings: {line}</h1>"
        f"<p>geoaim {escape(VERSION)}; {total / 3600:.2f} hours of processor time</p>"
        f"<div class=places>{_draw_places(records)}</div><table>"
        f"<tr><th>map<th>recording<th>what is known{_format_rows(records)}"
        f"</table></main></html>"
    )


def _format_rows(records: Sequence[Record]) -> str:
    """The rows: those of each place by their dates, then the others by what became of them."""
    groups: dict[str | None, list[Record]] = {}
    for record in sorted(records, key=lambda record: (record.datetime or "", record.name)):
        groups.setdefault(record.choices.get("place"), []).append(record)
    alone = groups.pop(None, [])
    tracked, rows = group_tracks(records), ""
    for place, days in sorted(groups.items(), key=lambda item: str(item[0])):
        link = f": <a href='{get_tracks_path(str(place))}'>tracks</a>" if place in tracked else ""
        rows += f"<tr><th colspan=3>{escape(str(place))}, {len(days)} recordings{link}"
        rows += "".join(map(_format_row, days))
    if groups and alone:
        rows += "<tr><th colspan=3>of no place"
    alone.sort(key=lambda record: (-list(COLOURS).index(record.status), record.name))
    return rows + "".join(map(_format_row, alone))


def _format_row(record: Record) -> str:
    folder, colour = f"{FOLDER}/{escape(record.name)}", COLOURS[record.status]
    picture = ""
    if record.status == "built":
        look = f"<img loading=lazy src='{folder}/{LOOK}' alt='map of {escape(record.name)}'>"
        picture = f"<a href='{folder}/{MAP}'>{look}</a>"
    if CHANGES in record.files:
        picture += (
            f"<br><img loading=lazy src='{folder}/{CHANGES}' alt='what differs from the first day'>"
        )
    lines = [f"{name}: {value}" for name, value in summarize_report(record.report).items()]
    if "changed_share" in record.report:
        share = record.report["changed_share"]
        lines.append(f"ground that differs from the first day (red): {share:.2%}")
    facts = "<br>".join(map(escape, [record.reason, *lines] if record.reason else lines))
    notes = "".join(f"<br><small>warning: {escape(text)}</small>" for text in record.warnings)
    return (
        f"<tr><td>{picture}<td><b>{escape(record.name)}</b><br>"
        f"<span class={colour}>{record.status}</span>"
        f"<br><small>{escape((record.datetime or '')[:16])}<br>{record.seconds:.0f} s</small>"
        f"<td>{facts}{notes}"
    )


def _draw_places(records: Sequence[Record]) -> str:
    """A map of the places as SVG; empty where none has a place on the Earth."""
    placed = [record for record in records if record.grid.get("corners_lonlat")]
    if not placed:
        return ""
    places = np.array([np.mean(record.grid["corners_lonlat"], axis=0) for record in placed])
    figure = Figure(figsize=(10, 5), layout="constrained")
    axes = figure.add_subplot()
    axes.plot(*places.T, "o", color=PLACE_COLOUR, markersize=5, alpha=0.7)
    if len(placed) <= MAX_NAMED_PLACES:
        for record, place in zip(placed, places, strict=True):
            axes.annotate(
                plot_text(record.name), place, xytext=(4, 4), textcoords="offset points", fontsize=7
            )
    axes.set_aspect(1 / np.cos(np.radians(places[:, 1].mean())), adjustable="datalim")
    axes.set(xlabel="longitude, degrees", ylabel="latitude, degrees")
    axes.ticklabel_format(useOffset=False)
    axes.grid(color="#ddd")
    text = StringIO()
    with rc_context({"svg.hashsalt": "geoaim"}):  # the same catalogue gives the same page
        figure.savefig(text, format="svg", metadata={"Date": None})
    svg = text.getvalue()
    return svg[svg.index("<svg") :].replace(
        "<svg", "<svg role='img' aria-label='where the recordings lie'", 1
    )
