"""Pickles of plain data are read; those that would run anything are refused and run nothing."""

import os
import pickle
import subprocess
import sys
from collections import OrderedDict, defaultdict
from pathlib import Path

import numpy as np
import pytest

from geoaim.base.pickles import read_pickle, write_pickle

PLAIN = {
    "numbers": [0, 1, -5, 2**40, 2**70, 1.5, float("inf"), None, True],
    "text": "ä" * 300,
    "bytes": b"\0\xff" * 200,
    "nested": ({"a": (1, 2, 3, 4)}, [], {}, (), {1, 2}, frozenset({"b"})),
    "ordered": OrderedDict(a=1),
    "counted": defaultdict(int, a=2),
}
ARRAYS = {
    "floats": np.arange(12, dtype=np.float32).reshape(3, 4),
    "fortran": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
    "big-endian": np.arange(3, dtype=">f8"),
    "truth": np.array([True, False]),
    "texts": np.array(["go", "stop"]),
    "empty": np.zeros((0, 2)),
    "scalar": np.float32(1.5),
}


class Attack:
    """An object whose unpickling runs a command."""

    def __init__(self, function, *arguments):
        self.call = function, arguments

    def __reduce__(self):
        return self.call


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_plain_data_is_what_was_pickled(protocol):
    read = read_pickle(pickle.dumps(PLAIN | ARRAYS, protocol))
    assert {key: read[key] for key in PLAIN if key != "nested"} == {
        key: value for key, value in PLAIN.items() if key != "nested"
    }
    assert read["nested"][:4] == PLAIN["nested"][:4]
    for key, array in ARRAYS.items():
        np.testing.assert_array_equal(read[key], array)


def test_shared_arrays_stay_arrays_and_can_be_written_to():
    array = np.arange(3.0)
    one, other = read_pickle(pickle.dumps([array, array]))
    one += 1
    np.testing.assert_array_equal(other, one)


def test_what_is_written_is_read_by_python_and_here():
    content = write_pickle({"a": ARRAYS["floats"], "b": [1, "c"]})
    for read in (pickle.loads, read_pickle):
        value = read(content)
        np.testing.assert_array_equal(value["a"], ARRAYS["floats"])
        value["a"] += 1  # MetaDrive moves the origin so
        assert value["b"] == [1, "c"]
    assert b"_core" not in content


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_malicious_pickle_is_refused_and_runs_nothing(tmp_path, protocol):
    mark = tmp_path / "ran"
    attacks = (
        Attack(os.system, f"touch {mark}"),
        Attack(subprocess.check_call, ["touch", str(mark)]),
        Attack(eval, f"open({str(mark)!r}, 'w')"),
        Attack(getattr, os, "system"),
        Attack(Path.touch, mark),
        Attack(np.load, str(mark)),
        Attack(np.fromfile, str(mark)),
    )
    for attack in attacks:
        for content in ({"tracks": attack}, [np.zeros(2), attack], attack):
            with pytest.raises((ValueError, TypeError)):
                read_pickle(pickle.dumps(content, protocol))
    assert not mark.exists()
    subprocess.run(
        [sys.executable, "-c", "import sys, pickle; pickle.load(sys.stdin.buffer)"],
        input=pickle.dumps(attacks[0], protocol),
        check=True,
    )
    assert mark.exists()  # as Python's unpickler does


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"hello",
        pickle.dumps(PLAIN)[:-5],
        pickle.dumps(np.array([{}, 1], object)),
        pickle.dumps(np.zeros(2, "f4,i4")),
        pickle.dumps(np.zeros(3)).replace(b"\x03\x85", b"\x7f\x85"),
        pickle.dumps(Path("a")),
        pickle.dumps(len),
        b"\x80\x04\x8c\x02osq\x00\x8c\x06systemq\x01\x93.",
        b"\x80\x02ccopyreg\n_reconstructor\n(cbuiltins\nobject\nc__builtin__\nobject\nNt.",
        b"\x80\x02}r\xff\xff\xff\x7f)R.",
    ],
)
def test_what_is_no_plain_data_is_refused(content):
    with pytest.raises(ValueError, match=r"Error|no plain data"):
        read_pickle(content)


HOSTILE = {
    "a far place of the memo": b"\x80\x02]r\xff\xff\xff\x7f.K\x01",
    "a long text that is not there": b"\x80\x04\x8d\xff\xff\xff\xff\xff\x00\x00\x00abc.",
    "a large array": b"\x80\x02cnumpy\nndarray\n(J\xff\xff\xff\x7f\x85X\x02\0\0\0f8C\x00tR.",
    "an array of pointers": b"\x80\x03cnumpy\nndarray\n(K\x01\x85X\x01\0\0\0OC\x0812345678tR.",
    "many bytes": b"\x80\x02cbuiltins\nbytearray\nJ\xff\xff\xff\x7f\x85R.",
    "a type that lies": b"\x80\x02cnumpy\ndtype\nX\x02\0\0\0i8\x85R(K\x03X\x01\0\0\0|NN"
    b"X\x01\0\0\0Otb.",
}


@pytest.mark.parametrize("name", HOSTILE)
def test_what_a_pickle_claims_is_not_believed(name):
    try:
        assert read_pickle(HOSTILE[name]) == []
    except ValueError as error:
        assert "Error" in str(error)  # noqa: PT017


def test_large_pickle_is_read():
    value = {"a": np.arange(4e6), "b": [{"x": k, "y": [None] * 10} for k in range(30_000)]}
    read = read_pickle(pickle.dumps(value))
    np.testing.assert_array_equal(read["a"], value["a"])
    assert read["b"] == value["b"]
