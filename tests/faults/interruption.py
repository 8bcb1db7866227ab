"""Interrupt a program before its n-th change of files: by an error, or at once as a kill does.

Python reports its own changes. Libraries in C write without a report, but only files in temporary
folders; a limit of the size of files makes their writing fail as on a full disk.
"""

import errno
import os
import signal
import sys
import traceback
from collections.abc import Callable
from contextlib import suppress
from ctypes import c_int
from dataclasses import dataclass
from io import StringIO
from multiprocessing import get_context
from multiprocessing.context import ForkServerProcess
from multiprocessing.queues import SimpleQueue
from pathlib import Path
from typing import Literal

from geoaim.cli.console import stop_when_terminated
from tests.waiting import LIMIT_S

if sys.platform != "win32":
    import resource

KILLED = 137
CHANGES = {
    *("os.mkdir", "os.rename", "os.remove", "os.rmdir", "os.truncate", "os.link", "os.symlink"),
    "shutil.rmtree",
}
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND

# imported once by the server of which the children are forks
PRELOADED = ["tests.faults.small_sample", "tests.faults.writers", "torch._dynamo"]

How = Literal["kill", "error", "stop", "stop again", "full"]


@dataclass(frozen=True)
class Outcome:
    """How a writer ended.

    Args:
        exit_code: 0: it was done; `KILLED`; 1: it ended with an error; None: it did not end.
        changes: files and folders that it changed, or was about to.
        printed: on stderr; empty after a kill.
    """

    exit_code: int | None
    changes: int
    printed: str


def run_interrupted(
    write: Callable[[Path], None], target: Path, step: int | None, *, how: How
) -> Outcome:
    """Run a writer in a child process and interrupt it before its n-th change of files.

    Args:
        write: takes the target; a function of a module.
        target: what is written; changes in its folder count.
        step: n, from 1, or the size of files for "full"; None: not interrupted.
        how: the process ends at once, the operation fails, Ctrl-C is pressed, it is pressed again
            before each later change, or no file may become larger.
    """
    child, changes, printed = _start(write, target, step, how)
    child.join(LIMIT_S)
    if child.exitcode is None:
        child.kill()
        raise TimeoutError(f"change {step} did not end")
    text = "" if printed.empty() else printed.get()
    return Outcome(child.exitcode, changes.value, text)


def run_and_signal(
    write: Callable[[Path], None], target: Path, delay: float, sent: signal.Signals
) -> Outcome:
    """Run a writer in a child process, and send it a signal.

    Args:
        write: takes the target; a function of a module.
        target: what is written.
        delay: from the start of the child to the signal, s.
        sent: the signal.
    """
    child, changes, printed = _start(write, target, None, "kill")
    child.join(delay)
    if child.exitcode is None:
        with suppress(ProcessLookupError):  # it has just ended
            os.kill(child.pid, sent)
    child.join(LIMIT_S)
    if child.exitcode is None:
        child.kill()
        return Outcome(None, changes.value, "does not end")
    text = "" if printed.empty() else printed.get()
    return Outcome(child.exitcode, changes.value, text)


def _start(
    write: Callable[[Path], None], target: Path, step: int | None, how: How
) -> tuple[ForkServerProcess, c_int, SimpleQueue]:
    context = get_context("forkserver")
    context.set_forkserver_preload(PRELOADED)
    # a child that is killed while it holds a lock would keep it for ever
    changes, printed = context.Value("i", 0, lock=False), context.SimpleQueue()
    child = context.Process(target=_run, args=(write, target, step, how, changes, printed))
    child.start()
    return child, changes, printed


def _run(
    write: Callable[[Path], None],
    target: Path,
    step: int | None,
    how: How,
    changes: c_int,
    printed: SimpleQueue,
) -> None:
    def interrupt(event: str, arguments: tuple[object, ...]) -> None:
        if not _changes_files(event, arguments, target.parent):
            return
        changes.value += 1
        if changes.value == step and how == "kill":
            os._exit(KILLED)
        if changes.value == step and how == "error":
            raise OSError(errno.ENOSPC, "No space left on device")
        if changes.value == step and how == "stop":
            raise KeyboardInterrupt
        if step is not None and changes.value >= step and how == "stop again":
            raise KeyboardInterrupt

    stop_when_terminated()
    sys.addaudithook(interrupt)
    sys.stderr = StringIO()
    if how == "full" and step is not None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (step, step))
    exit_code = 0
    try:
        write(target)
    except (OSError, ValueError):
        exit_code = 1
    except SystemExit as error:
        exit_code = error.code
    except Exception:  # told to the test, since this stderr is read by it alone
        traceback.print_exc()
        exit_code = 1
    printed.put(sys.stderr.getvalue())
    os._exit(exit_code)


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
