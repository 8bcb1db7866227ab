"""Pickles of plain data. Of a file that nobody vouches for, nothing is run.

Python's unpickler calls whatever a file names. Here it finds only the functions below, which build
containers and arrays of numbers and texts.
"""

import pickle
from collections.abc import Callable
from io import BytesIO
from typing import Any

import numpy as np


def read_pickle(content: bytes) -> Any:
    """Read a pickle of numbers, texts, lists, tuples, sets, dicts and NumPy arrays.

    Raises:
        ValueError: it is no pickle, or holds anything else, such as a function or an object.

    >>> read_pickle(pickle.dumps({"a": [1, 2.5, "b"]}))
    {'a': [1, 2.5, 'b']}
    """
    try:
        return _PlainUnpickler(BytesIO(content)).load()
    except Exception as error:  # a damaged file may raise any
        raise ValueError(f"{type(error).__name__}: {error}") from error


def write_pickle(value: Any) -> bytes:
    """Write a pickle whose arrays can be loaded with any version of NumPy (`_PlainPickler`)."""
    sink = BytesIO()
    _PlainPickler(sink, 4).dump(value)  # the protocol that Python 3.4 and later read
    return sink.getvalue()


class _PlainPickler(pickle.Pickler):
    """Pickles arrays as `numpy.ndarray(shape, type, buffer)`.

    NumPy's own way names a module that was renamed in NumPy 2.
    """

    def reducer_override(self, value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return np.ndarray, (value.shape, value.dtype.str, bytearray(value.tobytes()))
        return NotImplemented


# the one in Python: that in C makes room for any place of the memo that a damaged file names
class _PlainUnpickler(pickle._Unpickler):  # noqa: SLF001
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


class _Array(np.ndarray):
    """An array whose values follow in its state."""

    def __setstate__(self, state: tuple[Any, ...]) -> None:
        _, shape, kind, is_fortran, data = state
        made = _make_array(data, kind, shape, "F" if is_fortran else "C")
        state = (1, made.shape, made.dtype, False, made.tobytes())
        super().__setstate__(state)  # type: ignore[arg-type]


def _make_array(data: Any, kind: Any, shape: Any, order: Any = "C") -> np.ndarray:
    """Make an array of numbers or texts that can be written to."""
    dtype = (kind if isinstance(kind, _Type) else _Type(kind)).dtype
    return np.frombuffer(data, dtype).reshape(shape, order=order).copy()


BUILDERS: dict[str, Callable[..., Any]] = {
    "numpy.ndarray": lambda shape, kind, data: _make_array(data, kind, shape),
    "numpy.dtype": _Type,
    "numpy.core.multiarray._reconstruct": lambda *_: np.ndarray.__new__(_Array, (0,)),
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
