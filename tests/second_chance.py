"""Run pytest; tests that fail run once more, each alone, and those that pass only then are named.

    python tests/second_chance.py PYTEST_ARGUMENTS...

A test that fails beside others and passes alone depends on the machine's load or on another test:
it does not fail the run, but is to be mended. A test that fails twice fails the run.
"""

import json
import subprocess
import sys
import tempfile
from pathlib import Path

MOST = 20  # more failures than this are no accident
FAILED = 1  # pytest's exit code where tests failed
HEADING = "Passed only alone, at the second try; mend what they depend on:"


def run_pytest(arguments: list[str], cache: Path) -> int:
    """Run pytest with a cache of its own; returns its exit code."""
    command = [sys.executable, "-m", "pytest", *arguments, "-o", f"cache_dir={cache}"]
    return subprocess.run(command, check=False).returncode


def list_failed(cache: Path) -> list[str]:
    """List the ids of the tests that failed in a run with this cache."""
    path = cache / "v/cache/lastfailed"
    return sorted(json.loads(path.read_text())) if path.is_file() else []


def main(arguments: list[str]) -> int:
    """Run the tests, and those that fail once more; returns the exit code."""
    with tempfile.TemporaryDirectory() as folder:
        code = run_pytest(arguments, Path(folder, "all"))
        failed = list_failed(Path(folder, "all"))
        if code != FAILED or not 0 < len(failed) <= MOST:
            return code
        print(f"\n{len(failed)} failed; each runs once more, alone", flush=True)
        options = [argument for argument in arguments if "::" not in argument]
        options = [option for option in options if not Path(option).exists()]
        again = [
            (name, run_pytest([*options, "-n", "0", name], Path(folder, str(index))))
            for index, name in enumerate(failed)
        ]
    twice = [name for name, code in again if code]
    once = [name for name, code in again if not code]
    if once:
        print("\n".join(["", HEADING, *(f"  {name}" for name in once)]))
    if twice:
        print("\n".join(["", "Failed twice:", *(f"FAILED {name}" for name in twice)]))
    return FAILED if twice else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
