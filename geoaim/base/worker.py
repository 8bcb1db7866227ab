"""Work on files that nobody vouches for, in a new process with limits of memory and time."""

import os
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress

PROGRAM = "import sys; sys.path[:] = {path!r}; from {module} import {name}; {serve}"
SERVE = "from geoaim.base.worker import serve; serve({name}, {memory}, {seconds})"
WALL_RATIO = 10  # of the time on the clock to the processor time: a busy machine is no attack


def run_with_limits(
    work: Callable[[bytes], bytes], content: bytes, *, memory: float, seconds: float
) -> bytes:
    """Run a function on bytes in a new process."""
    serve = SERVE.format(name=work.__name__, memory=int(memory), seconds=int(seconds))
    program = PROGRAM.format(path=sys.path, module=work.__module__, name=work.__name__, serve=serve)
    try:
        done = subprocess.run(
            [sys.executable, "-P", "-c", program],
            input=content,
            capture_output=True,
            timeout=WALL_RATIO * seconds,
            # each thread of a library reserves memory
            env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        )
    except subprocess.TimeoutExpired:
        raise ValueError(f"reading it takes more than {WALL_RATIO * seconds:.0f} s") from None
    if done.returncode == 0:
        return done.stdout
    lines = done.stderr.decode(errors="replace").splitlines()
    exceeded = f"reading it takes more than {seconds:.0f} s or {memory / 1e6:.0f} MB"
    raise ValueError(lines[-1] if done.returncode == 1 and lines else exceeded)


def serve(work: Callable[[bytes], bytes], memory: int, seconds: int) -> None:
    """Do the work of `run_with_limits`: in the new process, from stdin to stdout."""
    with suppress(ImportError):  # Windows has none
        import resource

        with suppress(OSError, ValueError):  # macOS
            with open("/proc/self/statm") as file:
                used = int(file.read().split()[0]) * resource.getpagesize()
            resource.setrlimit(resource.RLIMIT_AS, (used + memory, used + memory))
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        result = work(sys.stdin.buffer.read())
    except Exception as error:
        sys.exit(f"{type(error).__name__}: {error}")
    sys.stdout.buffer.write(result)
