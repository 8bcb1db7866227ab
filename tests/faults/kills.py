"""Kill each writing command at random moments, and count what it leaves.

A child process gets SIGKILL or SIGTERM after a random time, up to a little more than an
uninterrupted run takes. It has to leave all of its old files, or all of the new ones, of which a
picture may be missing; an interrupted training has to end as an uninterrupted one when it is called
again. A run goes on where its output stops.
"""

import argparse
import json
import shutil
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from random import Random

from benchmarks.results import write_json
from geoaim import read_texture
from geoaim.base.files import TEMPORARY, atomic_write
from tests.faults import small_sample, writers
from tests.faults.interruption import run_and_signal, run_interrupted

EXIT_CODES = {0, -signal.SIGKILL, -signal.SIGTERM, 128 + signal.SIGTERM}
COMMAND = "python -m tests.faults.kills -o docs/bench/kills.json"
LATEST = 1.2  # moment, of an uninterrupted run's time
OUTCOMES = ("SIGKILL", "SIGTERM", "interrupted", "old", "new", "broken", "leftovers", "errors")
# begin without files, and end as if they had not been interrupted when they are called again
RESUMED = ("train", "catalog")
FOLDERS: dict[str, Callable[[Path], Callable[[Path], None]]] = {
    "place": lambda inputs: partial(writers.place, inputs),
    "sample": lambda _: small_sample.write_small_sample,
}


@dataclass(frozen=True)
class Case:
    """A command, and what it writes from old inputs and from new ones."""

    name: str
    write: Callable[[Path], None]  # from new inputs
    old: Path
    new: dict[str, bytes]
    changes: int
    seconds: float  # that it takes


def make_case(name: str, folder: Path) -> Case:
    """Run a command of `writers.WRITERS` on old inputs and on new ones, or one of `FOLDERS`."""
    if name in FOLDERS:
        return _make_folder_case(name, folder)
    for version in (0, 1):
        writers.write_inputs(folder / f"inputs{version}", version)
        write = partial(writers.write, name, folder / f"inputs{version}")
        target = folder / str(version) / "out"
        target.parent.mkdir()
        began = time.perf_counter()
        outcome = run_interrupted(write, target, None, how="kill")
        seconds = time.perf_counter() - began
        assert outcome.exit_code == 0, outcome.printed
    old, new = folder / "0", read_files(folder / "1")
    if name not in ("catalog", "texture"):  # its collection, and the CRS, are the same
        assert all(new[path] != content for path, content in read_files(old).items())
    return Case(name, write, old, new, outcome.changes, seconds)


def _make_folder_case(name: str, folder: Path) -> Case:
    """Write a folder where there is none."""
    writers.write_inputs(folder / "inputs", 0)
    write = FOLDERS[name](folder / "inputs")
    (folder / "old").mkdir()
    began = time.perf_counter()
    outcome = run_interrupted(write, folder / "out", None, how="kill")
    seconds = time.perf_counter() - began
    assert outcome.exit_code == 0, outcome.printed
    new = {f"out/{name}": content for name, content in read_files(folder / "out").items()}
    return Case(name, write, folder / "old", new, outcome.changes, seconds)


def read_files(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


def write_next(folder: Path) -> None:
    """Write a file; whatever geoaim writes next to leftovers removes them."""
    with atomic_write(folder / "next.txt") as temporary:
        temporary.write_text("")


def read_after_next_run(folder: Path) -> dict[str, bytes]:
    """Read the files of a folder into which another run has written since, which leaves no rest."""
    for place in (folder, *(path for path in folder.glob("[!.]*") if path.is_dir())):
        write_next(place)
        (place / "next.txt").unlink()
        assert not list(place.glob(f"{TEMPORARY}*"))
    files = read_files(folder)
    if "texture.json" in files:  # while a pair is replaced, its JSON names a spare picture
        named = json.loads(files["texture.json"])["image"]
        if named != "texture.png":
            read_texture(folder)
            return {"texture.png": files[named]}
        files = {name: data for name, data in files.items() if not name.startswith("texture-")}
    return files


def count_kills(case: Case, count: int, folder: Path, random: Random) -> Counter[str]:
    """Kill a command at random moments, by both signals in turn, and count the outcomes."""
    counts = Counter(dict.fromkeys(OUTCOMES, 0))
    for number in range(count):
        sent = (signal.SIGKILL, signal.SIGTERM)[number % 2]
        target = folder / str(number) / "out"
        if case.name in RESUMED:
            target.parent.mkdir()
        else:
            shutil.copytree(case.old, target.parent)
        outcome = run_and_signal(case.write, target, random.uniform(0, LATEST * case.seconds), sent)
        if outcome.exit_code not in EXIT_CODES:
            print(case.name, outcome, flush=True)
            counts["errors"] += 1
        if case.name in RESUMED:
            run_interrupted(case.write, target, None, how="kill")
        counts.update((sent.name, _judge(case, target.parent)))
        counts["interrupted"] += outcome.exit_code != 0
        shutil.rmtree(target.parent)
    return counts


def _judge(case: Case, folder: Path) -> str:
    """Whether the files of a folder are all old or all new; a picture may be missing."""
    try:
        left = read_after_next_run(folder)
    except AssertionError:
        return "leftovers"
    suffix = "" if case.name in (*FOLDERS, *RESUMED) else writers.WRITERS[case.name][1]
    for state, files in (("old", read_files(case.old)), ("new", case.new)):
        has_main = suffix and any(name.endswith((suffix, "texture.png")) for name in left)
        if left == files or (has_main and left.items() <= files.items()):
            return state
    return "broken"


def main() -> None:
    """Count the outcomes of all writing commands."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=50, help="moments, of the signals in turn")
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    parser.add_argument("-o", "--output", type=Path, help="JSON to write")
    arguments = parser.parse_args()
    path = arguments.output
    rows = json.loads(path.read_text())["rows"] if path and path.exists() else []
    for name in (*writers.WRITERS, *FOLDERS)[len(rows) :]:
        with tempfile.TemporaryDirectory() as temporary:
            folder = Path(temporary)
            (folder / "kills").mkdir()
            case = make_case(name, folder)
            random = Random(f"{name} {arguments.seed}")
            counts = count_kills(case, arguments.count, folder / "kills", random)
        rows.append({"writer": name, **counts})
        print(rows[-1], flush=True)
        if path:
            write_json({"command": f"{COMMAND} --count {arguments.count}", "rows": rows}, path)
    raise SystemExit(any(row["broken"] + row["leftovers"] + row["errors"] for row in rows))


if __name__ == "__main__":
    main()
