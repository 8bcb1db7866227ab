"""Pickles of plain data. Of a file that nobody vouches for, nothing is run.

Python's unpickler calls whatever a file names. Here it finds only the functions below, which build
containers and arrays of numbers and texts, in a process with limits: a small file can name much
memory and endless work without calling anything.
"""

import os
import pickle
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from io import BytesIO
from typing import Any

import numpy as np

MEMORY, MEMORY_PER_BYTE = 3e8, 20  # bytes while a pickle is read, and for each byte of it
SECONDS, BYTES_PER_S = 3, 5e6
MAX_SHARING = 3  # size of the data, with what is shared counted each time, by that of the file
SMALL = 100_000  # bytes; sharing in smaller data does no harm


def read_pickle(content: bytes) -> Any:
    """Read a pickle of numbers, texts, lists, tuples, sets, dicts and NumPy arrays.

    Raises:
        ValueError: it is no pickle, holds anything else, such as a function or an object, or takes
            far more memory or time than its size explains.

    >>> read_pickle(pickle.dumps({"a": [1, 2.5, "b"]}))
    {'a': [1, 2.5, 'b']}
    """
    size = len(content)
    memory, seconds = MEMORY + MEMORY_PER_BYTE * size, SECONDS + size / BYTES_PER_S
    return _load(run_with_limits(copy_pickle, content, memory=memory, seconds=seconds))


def write_pickle(value: Any) -> bytes:
    """Write a pickle whose arrays can be loaded with any version of NumPy (`_PlainPickler`)."""
    sink = BytesIO()
    _PlainPickler(sink, 4).dump(value)  # the protocol that Python 3.4 and later read
    return sink.getvalue()


def copy_pickle(content: bytes) -> bytes:
    """Read a pickle within this process, and write the plain data in it anew."""
    budget = [MAX_SHARING * len(content) + SMALL]
    return write_pickle(_copy_plain(_load(content), budget))


class _PlainPickler(pickle.Pickler):
    """Pickles arrays as `numpy.ndarray(shape, type, buffer)`.

    NumPy's own way names a module that was renamed in NumPy 2.
    """

    def reducer_override(self, value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return np.ndarray, (value.shape, value.dtype.str, bytearray(value.tobytes()))
        return NotImplemented


def _load(content: bytes) -> Any:
    return _PlainUnpickler(BytesIO(content)).load()


class _PlainUnpickler(pickle.Unpickler):
    """Finds the functions of `BUILDERS` alone."""

    def find_class(self, module: str, name: str) -> Any:
        full = f"{module.replace('__builtin__', 'builtins').replace('_core', 'core')}.{name}"
        if full not in BUILDERS:
            raise ValueError(f"it names {full!r}, which is no plain data")
        return BUILDERS[full]


class _Type:
    """A type of NumPy, as a pickle describes it: NumPy's own would believe any state."""

    def __init__(self, code: str, *_: object) -> None:
        self.dtype = np.dtype(code if isinstance(code, str) else "O")
        if self.dtype.kind not in "biufSU":  # numbers and texts
            raise ValueError(f"it has an array of {code!r}; one of numbers or texts is needed")

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        if any(state[2:5]):
            raise ValueError("it has an array of a type with fields")
        self.dtype = self.dtype.newbyteorder(state[1])


class _Array:
    """An array whose values follow in its state."""

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        _, shape, kind, is_fortran, data = state
        self.array = _make_array(data, kind, shape, "F" if is_fortran else "C")


def _make_array(data: Any, kind: Any, shape: Any, order: Any = "C") -> np.ndarray:
    """Make an array of numbers or texts that can be written to."""
    dtype = (kind if isinstance(kind, _Type) else _Type(kind)).dtype
    return np.frombuffer(data, dtype).reshape(shape, order=order).copy()


def _copy_plain(value: Any, budget: list[int]) -> Any:
    """Copy plain data; what is shared counts against the budget each time."""
    if isinstance(value, _Array):
        value = value.array
    budget[0] -= 1 + _measure_size(value)
    if budget[0] < 0:
        raise ValueError("it shares parts so often that they make far more than the file")
    if value is None or type(value) in (bool, int, float, str, bytes, bytearray, np.ndarray):
        return value
    if type(value) is dict:
        if not all(isinstance(key, str | int | float | bytes | None) for key in value):
            raise ValueError("a key in it is no text and no number")
        return {key: _copy_plain(item, budget) for key, item in value.items()}
    if type(value) in (list, tuple, set, frozenset):
        return type(value)(_copy_plain(item, budget) for item in value)
    raise ValueError(f"it has a {type(value).__name__}, which is no plain data")


def _measure_size(value: object) -> int:
    """Measure the bytes of an array or a text; names, which are often shared, count little."""
    if isinstance(value, np.ndarray):
        return max(value.nbytes, *value.shape, 0)
    return len(value) // 8 if isinstance(value, str | bytes | bytearray) else 0


BUILDERS: dict[str, Callable[..., Any]] = {
    "numpy.ndarray": lambda shape, kind, data: _make_array(data, kind, shape),
    "numpy.dtype": _Type,
    "numpy.core.multiarray._reconstruct": lambda *_: _Array(),
    "numpy.core.multiarray.scalar": lambda kind, data: _make_array(data, kind, ()).item(),
    "numpy.core.numeric._frombuffer": _make_array,
    "_codecs.encode": lambda text, _: str.encode(text, "latin-1"),
    "builtins.bytes": lambda data=b"": bytes(memoryview(data)),
    "builtins.bytearray": lambda data=b"": bytearray(memoryview(data)),
    "builtins.set": set,
    "builtins.frozenset": frozenset,
    "collections.defaultdict": lambda *_: {},
    "collections.OrderedDict": lambda *_: {},
    # factories of default dictionaries
    **{f"builtins.{kind.__name__}": kind for kind in (int, float, list, dict)},
    "builtins.long": int,  # in protocols 0 to 2
}


PROGRAM = "import sys; sys.path[:] = {path!r}; from {module} import {name}; {serve}"
SERVE = "from geoaim.base.pickles import serve; serve({name}, {memory}, {seconds})"
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
