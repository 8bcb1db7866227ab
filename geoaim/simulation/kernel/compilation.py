"""How the loops are compiled, and where the compiled code is kept."""

import hashlib
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import numba

Function = TypeVar("Function", bound=Callable[..., object])

FAST_MATH = {"reassoc", "contract", "arcp", "nsz"}  # sums may be taken in another order


def compile_loops(function: Function) -> Function:
    """Compile a function of numbers and arrays; it runs without the interpreter's lock.

    The code is kept on disk, in a folder that is named by the loops' source: numba by itself does
    not notice changes in a file that another one imports.
    """
    compile_function: Any = partial(numba.njit, nogil=True, error_model="numpy", fastmath=FAST_MATH)
    with _use_cache_folder():
        try:
            compiled = compile_function(function, cache=True)
        except RuntimeError:  # no folder can be written to
            compiled = compile_function(function)
    return compiled


@contextmanager
def _use_cache_folder() -> Iterator[None]:
    """Let numba keep what is compiled in the user's cache, or where NUMBA_CACHE_DIR says."""
    config: Any = numba.config
    given = config.CACHE_DIR
    folder = Path(__file__).parent
    files = [*sorted(folder.glob("*.py")), folder.parent / "rasterization.py"]
    source = b"".join(path.read_bytes() for path in files)
    name = "geoaim-" + hashlib.sha256(source).hexdigest()[:16]
    config.CACHE_DIR = os.path.join(given or _find_user_cache(), name)
    try:
        yield
    finally:
        config.CACHE_DIR = given


def _find_user_cache() -> str:
    """Find the folder for files that programs can make again."""
    home = Path.home()
    if sys.platform == "win32":
        return os.environ.get("LOCALAPPDATA", str(home / "AppData" / "Local"))
    if sys.platform == "darwin":
        return str(home / "Library" / "Caches")
    return os.environ.get("XDG_CACHE_HOME", str(home / ".cache"))
