"""Interrupt a program before its n-th change of files: by an error, or at once as a kill does."""

import errno
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing import get_context
from multiprocessing.sharedctypes import Synchronized
from pathlib import Path
from typing import Literal

KILLED = 137
CHANGES = {
    *("os.mkdir", "os.rename", "os.remove", "os.rmdir", "os.truncate", "os.link", "os.symlink"),
    "shutil.rmtree",
}
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND

How = Literal["kill", "error"]


@dataclass(frozen=True)
class Outcome:
    """How a writer ended.

    Args:
        exit_code: 0: it was done; `KILLED`; 1: it ended with an error.
        changes: files and folders that it changed, or was about to.
    """

    exit_code: int
    changes: int


def run_interrupted(
    write: Callable[[Path], None], target: Path, step: int | None, *, how: How, preload: str
) -> Outcome:
    """Run a writer in a child process and interrupt it before its n-th change of files.

    Args:
        write: takes the target; a function of a module.
        target: what is written; changes in its folder count.
        step: n, from 1; None: not interrupted.
        how: the process ends at once, or the operation fails as on a full disk.
        preload: module that the children need, imported once.
    """
    context = get_context("forkserver")
    context.set_forkserver_preload([preload])
    changes = context.Value("i", 0)
    child = context.Process(target=_run, args=(write, target, step, how, changes))
    child.start()
    child.join(60)
    if child.exitcode is None:
        child.kill()
        raise TimeoutError(f"change {step} did not end")
    return Outcome(child.exitcode, changes.value)


def _run(
    write: Callable[[Path], None], target: Path, step: int | None, how: How, changes: Synchronized
) -> None:
    def interrupt(event: str, arguments: tuple[object, ...]) -> None:
        if not _changes_files(event, arguments, target.parent):
            return
        changes.value += 1
        if changes.value == step and how == "kill":
            os._exit(KILLED)
        if changes.value == step:
            raise OSError(errno.ENOSPC, "No space left on device")

    sys.addaudithook(interrupt)
    try:
        write(target)
    except (OSError, ValueError):
        os._exit(1)
    os._exit(0)


def _changes_files(event: str, arguments: tuple[object, ...], folder: Path) -> bool:
    """Whether an audit event is about to change a file below a folder."""
    if event == "open":
        path, _, flags = arguments
        return isinstance(flags, int) and bool(flags & WRITING) and _is_below(path, folder)
    if event not in CHANGES:
        return False
    # rmtree names what it removes relative to an open folder
    is_relative = any(isinstance(argument, int) and argument >= 0 for argument in arguments[1:])
    return is_relative or _is_below(arguments[0], folder)


def _is_below(path: object, folder: Path) -> bool:
    return isinstance(path, str | os.PathLike) and Path(path).is_relative_to(folder)
