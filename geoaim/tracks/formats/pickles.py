"""Pickles of plain data, read without Python's unpickler, which runs what a file tells it to.

The instructions of a pickle are listed by `pickletools`, which runs nothing, and followed here only
as far as they build numbers, texts, containers and NumPy arrays of numbers and texts. All others
are refused.
"""

import pickle
import pickletools
from collections.abc import Callable
from dataclasses import dataclass, field
from io import BytesIO
from typing import Any, Literal

import numpy as np

MARK = object()
CONSTANTS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False}
VALUES = {  # instructions with a value of their own
    *("INT", "LONG", "LONG1", "LONG4", "BININT", "BININT1", "BININT2", "FLOAT", "BINFLOAT"),
    *("UNICODE", "BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8", "BYTEARRAY8"),
    *("BINBYTES", "SHORT_BINBYTES", "BINBYTES8"),
}
EMPTY: dict[str, Callable[[], Any]] = {
    "EMPTY_LIST": list,
    "EMPTY_DICT": dict,
    "EMPTY_TUPLE": tuple,
    "EMPTY_SET": set,
    "MARK": lambda: MARK,
}
TUPLE_SIZES = {"TUPLE1": 1, "TUPLE2": 2, "TUPLE3": 3}
# factories of default dictionaries
FACTORIES = ("builtins.int", "builtins.float", "builtins.list", "builtins.dict")
ARRAY_KINDS = "biufSU"  # kinds of NumPy's types: numbers and texts
PROTOCOL = 4  # which Python 3.4 and later read


@dataclass
class _Object:
    """What a GLOBAL names, or an array or type that is not complete yet."""

    name: str
    value: Any = None


@dataclass
class _Machine:
    """The stack and the memo of a pickle."""

    stack: list[Any] = field(default_factory=list)
    memo: dict[int, Any] = field(default_factory=dict)

    def pop_to_mark(self) -> list[Any]:
        """Remove the last mark and what is above it, which is returned."""
        position = max(k for k, value in enumerate(self.stack) if value is MARK)
        items = self.stack[position + 1 :]
        del self.stack[position:]
        return items


def read_pickle(content: bytes) -> Any:
    """Read a pickle of numbers, texts, lists, tuples, sets, dicts and NumPy arrays.

    Raises:
        ValueError: it is no pickle, or holds anything else, such as a function or an object.

    >>> read_pickle(pickle.dumps({"a": [1, 2.5, "b"]}))
    {'a': [1, 2.5, 'b']}
    """
    machine = _Machine()
    for opcode, argument, _ in pickletools.genops(content):
        _follow(machine, opcode.name, argument)
    (value,) = machine.stack
    return value


def write_pickle(value: Any) -> bytes:
    """Write a pickle whose arrays can be loaded with any version of NumPy (`_PlainPickler`)."""
    sink = BytesIO()
    _PlainPickler(sink, PROTOCOL).dump(value)
    return sink.getvalue()


class _PlainPickler(pickle.Pickler):
    """Pickles arrays as `numpy.ndarray(shape, type, buffer)`.

    NumPy's own way names a module that was renamed in NumPy 2.
    """

    def reducer_override(self, value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return np.ndarray, (value.shape, value.dtype.str, bytearray(value.tobytes()))
        return NotImplemented


def _follow(machine: _Machine, name: str, argument: Any) -> None:
    """Follow an instruction."""
    stack = machine.stack
    if name in VALUES:
        stack.append(argument)
    elif name in CONSTANTS:
        stack.append(CONSTANTS[name])
    elif name in EMPTY:
        stack.append(EMPTY[name]())
    elif name in MEMO_STEPS:
        MEMO_STEPS[name](machine, argument)
    elif name in STEPS:
        STEPS[name](machine)
    elif name in TUPLE_SIZES:
        size = TUPLE_SIZES[name]
        stack[-size:] = [tuple(stack[-size:])]
    elif name == "GLOBAL":
        stack.append(_make_object(argument.replace(" ", ".")))
    elif name not in ("PROTO", "FRAME", "STOP"):
        raise ValueError(f"its instruction {name} builds no plain data")


def _put(machine: _Machine, key: int | None) -> None:
    machine.memo[len(machine.memo) if key is None else int(key)] = machine.stack[-1]


def _get(machine: _Machine, key: int) -> None:
    value = machine.memo[int(key)]
    is_complete_array = isinstance(value, _Object) and isinstance(value.value, np.ndarray)
    machine.stack.append(value.value if is_complete_array else value)


def _append(machine: _Machine) -> None:
    item = machine.stack.pop()
    _require(machine.stack[-1], list).append(item)


def _append_all(machine: _Machine) -> None:
    items = machine.pop_to_mark()
    _require(machine.stack[-1], list).extend(items)


def _add_all(machine: _Machine) -> None:
    items = machine.pop_to_mark()
    _require(machine.stack[-1], set).update(items)


def _set_item(machine: _Machine) -> None:
    key, value = machine.stack[-2:]
    del machine.stack[-2:]
    _require(machine.stack[-1], dict)[key] = value


def _set_items(machine: _Machine) -> None:
    items = machine.pop_to_mark()
    _require(machine.stack[-1], dict).update(zip(items[::2], items[1::2], strict=True))


def _make_list(machine: _Machine) -> None:
    machine.stack.append(machine.pop_to_mark())


def _make_tuple(machine: _Machine) -> None:
    machine.stack.append(tuple(machine.pop_to_mark()))


def _make_dict(machine: _Machine) -> None:
    items = machine.pop_to_mark()
    machine.stack.append(dict(zip(items[::2], items[1::2], strict=True)))


def _make_frozen_set(machine: _Machine) -> None:
    machine.stack.append(frozenset(machine.pop_to_mark()))


def _name_object(machine: _Machine) -> None:
    module, name = machine.stack[-2:]
    machine.stack[-2:] = [_make_object(f"{module}.{name}")]


def _make_object(name: str) -> _Object:
    if name not in BUILDERS and name not in FACTORIES:
        raise ValueError(f"it names {name!r}, which is no plain data")
    return _Object(name)


def _call(machine: _Machine) -> None:
    """Build what a known name stands for from its arguments."""
    function, arguments = machine.stack[-2:]
    name = _require(function, _Object).name
    if name not in BUILDERS:
        raise ValueError(f"it calls {name!r}, which builds no plain data")
    machine.stack[-2:] = [BUILDERS[name](*_require(arguments, tuple))]


def _complete(machine: _Machine) -> None:
    """Give an array or a type of NumPy its state."""
    state = machine.stack.pop()
    unfinished = _require(machine.stack[-1], _Object)
    if unfinished.name == "array":
        _, shape, kind, is_fortran, data = state
        unfinished.value = _make_array(data, kind, shape, "F" if is_fortran else "C")
        machine.stack[-1] = unfinished.value
    elif unfinished.name == "type" and not any(state[2:5]):
        unfinished.value = np.dtype(unfinished.value).newbyteorder(state[1])
    else:
        raise ValueError(f"it gives a state to {unfinished.name!r}, which is no array")


def _require(value: Any, *kinds: type) -> Any:
    if not isinstance(value, kinds):
        raise ValueError(f"it has a {type(value).__name__} where a {kinds[0].__name__} is needed")
    return value


def _make_array(
    data: Any, kind: Any, shape: tuple[int, ...], order: Literal["C", "F"] = "C"
) -> Any:
    """Make an array of numbers or texts that can be written to."""
    dtype = np.dtype(kind.value if isinstance(kind, _Object) else _require(kind, str))
    if dtype.kind not in ARRAY_KINDS:
        raise ValueError(f"it has an array of {dtype}; one of numbers or texts is needed")
    array = np.frombuffer(_require(data, bytes, bytearray), dtype)
    return array.reshape(shape, order=order).copy()


def _make_scalar(kind: Any, data: bytes) -> Any:
    return _make_array(data, kind, ()).item()


BUILDERS: dict[str, Callable[..., Any]] = {
    "numpy.ndarray": lambda shape, kind, data: _make_array(data, kind, shape),
    "numpy.dtype": lambda code, *_: _Object("type", _require(code, str)),
    "_codecs.encode": lambda text, encoding: _require(text, str).encode("latin-1"),
    "builtins.bytearray": lambda data=b"": bytearray(_require(data, bytes)),
    "builtins.set": lambda items=(): set(_require(items, list)),
    "builtins.frozenset": lambda items=(): frozenset(_require(items, list)),
    "collections.defaultdict": lambda *_: {},
    "collections.OrderedDict": lambda *_: {},
}
for _core in ("numpy.core", "numpy._core"):  # names in NumPy 1 and 2
    BUILDERS |= {
        f"{_core}.multiarray._reconstruct": lambda *_: _Object("array"),
        f"{_core}.multiarray.scalar": _make_scalar,
        f"{_core}.numeric._frombuffer": _make_array,
    }
MEMO_STEPS: dict[str, Callable[[_Machine, Any], None]] = {
    **dict.fromkeys(("PUT", "BINPUT", "LONG_BINPUT", "MEMOIZE"), _put),
    **dict.fromkeys(("GET", "BINGET", "LONG_BINGET"), _get),
}
STEPS: dict[str, Callable[[_Machine], None]] = {
    "APPEND": _append,
    "APPENDS": _append_all,
    "ADDITEMS": _add_all,
    "SETITEM": _set_item,
    "SETITEMS": _set_items,
    "LIST": _make_list,
    "TUPLE": _make_tuple,
    "DICT": _make_dict,
    "FROZENSET": _make_frozen_set,
    "STACK_GLOBAL": _name_object,
    "REDUCE": _call,
    "BUILD": _complete,
}
