"""Read mutated files in children with memory and time limits, and count what becomes of them.

    python -m tests.faults.run --count 10000 -o docs/bench/faults.json

Outcomes: read; refused, by an error under GeoaimError; traceback, any other error; crash, the
process died; slow, over 5 s of processor time (more where a fixed piece of work shows a slower
processor) or twenty minutes in all; memory, over 1 GB above the start;
implausible, read with numbers outside the plausibility that geoaim states and without a warning;
unnamed, refused by more than one line, or by one that does not name the file.
A run goes on where its output stops; `--reader NAME` counts one reader anew, and with `--seed N`
repeats one mutation and shows its traceback.
"""

import argparse
import json
import multiprocessing
import os
import resource
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path

import cv2
import torch

from benchmarks.results import write_json
from geoaim.base.errors import GeoaimError, GeoaimWarning
from tests.faults.mutations import mutate_file
from tests.faults.plausible import describe_implausible
from tests.faults.readers import READERS
from tests.faults.seeds import write_seeds

OUTCOMES = ("read", "refused", "traceback", "crash", "slow", "memory", "implausible", "unnamed")
MAX_SECONDS, MAX_BYTES = 5.0, 10**9
MAX_WORK = 100  # times the reference's processor time, where that is more than MAX_SECONDS
HARD_SECONDS, HARD_BYTES = 1200, 4 * 10**9  # at which a child is stopped
CHILD_SHARE = 500  # mutations of one child


@dataclass(frozen=True)
class Result:
    """What became of one mutation."""

    seed: int
    outcome: str
    detail: str = ""


def count_outcomes(name: str, seeds: range, folder: Path) -> tuple[Counter[str], list[Result]]:
    """Read mutations of one reader; count the outcomes, and list those that are faults."""
    counts, faults = Counter(dict.fromkeys(OUTCOMES, 0)), []
    for result in _read_all(name, seeds, folder):
        counts[result.outcome] += 1
        if result.outcome not in ("read", "refused"):
            faults.append(result)
    return counts, faults


def _read_all(name: str, seeds: range, folder: Path) -> Iterator[Result]:
    """Yield a result for each seed; a child that dies is followed by another."""
    context = multiprocessing.get_context("fork")
    position = 0
    while position < len(seeds):
        ours, theirs = context.Pipe(duplex=False)
        some = seeds[position : position + CHILD_SHARE]
        child = context.Process(target=_read_some, args=(name, some, folder, theirs))
        child.start()
        theirs.close()
        done = 0
        while done < len(some):
            try:
                if not ours.poll(HARD_SECONDS):
                    yield Result(some[done], "slow", f"over {HARD_SECONDS} s")
                    break
                yield ours.recv()
            except EOFError:
                child.join()
                yield Result(some[done], "crash", f"exit code {child.exitcode}")
                break
            done += 1
        else:
            done -= 1
        child.kill()
        child.join()
        ours.close()
        position += done + 1


def _read_some(name: str, seeds: range, folder: Path, results: Connection) -> None:
    """Read mutations one after another, in a folder of their own."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # codecs and GDAL complain there
    own = Path(tempfile.mkdtemp(dir=folder.parent))
    shutil.copytree(folder, own, dirs_exist_ok=True)
    started = _read_status("VmSize")
    resource.setrlimit(resource.RLIMIT_AS, (started + HARD_BYTES, resource.RLIM_INFINITY))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for seed in seeds:
        results.send(read_mutation(name, seed, folder, own))
    shutil.rmtree(own)
    os._exit(0)


def read_mutation(name: str, seed: int, folder: Path, own: Path) -> Result:
    """Mutate the reader's file in a folder of its own, read it, and measure time and memory."""
    reader = READERS[name]
    index = sorted(READERS).index(name)
    (own / reader.file).write_bytes(
        mutate_file(folder / reader.file, reader.mutations, (index, seed))
    )
    Path("/proc/self/clear_refs").write_text("5")  # the peak starts anew
    before, began = _read_status("VmRSS"), time.process_time()
    outcome, detail, value = "read", "", None
    with warnings.catch_warnings(record=True) as shown:
        warnings.simplefilter("always")
        try:
            value = reader.read(own)
        except GeoaimError as error:
            named = str(own) in str(error) or Path(reader.file).stem in str(error)
            clear = "\n" not in str(error) and (named or not reader.names_file)
            outcome, detail = "refused" if clear else "unnamed", str(error)
        except MemoryError as error:
            outcome, detail = "memory", repr(error)
        except BaseException as error:
            outcome, detail = "traceback", _name_place(error)
    seconds, grown = time.process_time() - began, _read_status("VmHWM") - before
    if grown > MAX_BYTES:
        outcome, detail = "memory", f"{grown / 1e9:.1f} GB, then {outcome}: {detail}"
    elif seconds > MAX_SECONDS and seconds > MAX_WORK * _time_reference():
        outcome, detail = "slow", f"{seconds:.1f} s, then {outcome}: {detail}"
    warned = any(issubclass(warning.category, GeoaimWarning) for warning in shown)
    if outcome == "read" and (problem := describe_implausible(value, warned=warned)):
        outcome, detail = "implausible", problem
    return Result(seed, outcome, detail[:300])


def _name_place(error: BaseException) -> str:
    """The error, and the last lines of ours that led to it."""
    frames = [f for f in traceback.extract_tb(error.__traceback__) if "geoaim/" in f.filename]
    places = " > ".join(f"{Path(f.filename).name}:{f.lineno}" for f in frames[-3:])
    return f"{type(error).__name__} at {places}: {error}"


def _time_reference() -> float:
    """Processor time of a fixed piece of work, 0.05 s on an idle machine."""
    began = time.process_time()
    sum(len(str(number)) for number in range(700_000))
    return time.process_time() - began


def _read_status(name: str) -> int:
    """A figure of this process's memory, bytes."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(f"{name}:"):
            return int(line.split()[1]) * 1024
    raise KeyError(name)


def make_seeds(folder: Path) -> None:
    """Write the seeds in a child, so that no thread of a library is alive when others fork."""
    child = multiprocessing.get_context("fork").Process(target=write_seeds, args=(folder,))
    child.start()
    child.join()
    if child.exitcode != 0:
        raise RuntimeError("the seeds could not be written")


def main() -> None:
    """Count the outcomes of all readers, or repeat one mutation."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=100, help="mutations of each reader")
    parser.add_argument("--first", type=int, default=0, help="seed of the first mutation")
    parser.add_argument("--reader", action="append", help="a name; all readers if omitted")
    parser.add_argument("--seed", type=int, help="repeat one mutation, with its traceback")
    parser.add_argument("-o", "--output", type=Path, help="JSON to write")
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary, "seeds")
        folder.mkdir()
        make_seeds(folder)
        if arguments.seed is not None:
            _repeat(arguments.reader[0], arguments.seed, folder)
            return
        path = arguments.output or Path(temporary, "faults.json")
        for name in arguments.reader or READERS:
            seeds = range(arguments.first, arguments.first + arguments.count)
            _count_reader(path, name, seeds, folder, anew=bool(arguments.reader))
        sys.exit(bool(json.loads(path.read_text())["faults"]))


def _count_reader(path: Path, name: str, seeds: range, folder: Path, *, anew: bool) -> None:
    """Count a reader's outcomes, from where the output stops, and write them now and then."""
    results = json.loads(path.read_text()) if path.exists() else {"rows": [], "faults": []}
    rows = {row["reader"]: row for row in results["rows"]}
    row = {"reader": name, **dict.fromkeys(OUTCOMES, 0)} if anew else rows.get(name)
    row = row or {"reader": name, **dict.fromkeys(OUTCOMES, 0)}
    kept = [fault for fault in results["faults"] if fault["reader"] != name or not anew]
    for start in range(sum(row[key] for key in OUTCOMES), len(seeds), CHILD_SHARE):
        counts, faults = count_outcomes(name, seeds[start : start + CHILD_SHARE], folder)
        row = {"reader": name, **{key: row[key] + counts[key] for key in OUTCOMES}}
        rows[name] = row
        kept += [{"reader": name, **vars(fault)} for fault in faults]
        written = {
            "command": f"python -m tests.faults.run --count {len(seeds)} -o docs/bench/faults.json",
            "rows": [rows[known] for known in READERS if known in rows],
            "faults": kept,
        }
        write_json(written, path)
        print(row, *(f"\n  {fault}" for fault in faults[:5]), flush=True)


def _repeat(name: str, seed: int, folder: Path) -> None:
    reader = READERS[name]
    index = sorted(READERS).index(name)
    content = mutate_file(folder / reader.file, reader.mutations, (index, seed))
    (folder / reader.file).write_bytes(content)
    print(content[:3000])
    reader.read(folder)


if __name__ == "__main__":
    main()
