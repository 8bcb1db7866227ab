"""Files and folders that are written whole or not at all."""

import os
import shutil
import sys
import time
import uuid
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from contextvars import ContextVar
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING

if sys.platform != "win32":
    import fcntl

if TYPE_CHECKING:
    from matplotlib.figure import Figure

TEMPORARY = ".geoaim-writing-"  # begins the names of temporary folders; 32 hex digits follow


class _Command:
    """When the command that runs began, and what it has written."""

    def __init__(self, began: float) -> None:
        self.began = began  # seconds, as of files
        self.written: set[Path] = set()


_COMMAND = ContextVar[_Command | None]("_COMMAND", default=None)


@contextmanager
def keep_files_of_others() -> Iterator[None]:
    """Within the block, replace no file that another program has written since it began."""
    token = _COMMAND.set(_Command(time.time()))
    try:
        yield
    finally:
        _COMMAND.reset(token)


@contextmanager
def atomic_write(path: str | os.PathLike[str], *, shared: bool = False) -> Iterator[Path]:
    """Yield a temporary path whose file replaces `path` when the block ends without an error.

    The folder is created when it is missing. When the block fails, an existing file stays as it
    was. A symbolic link stays; the file to which it points is replaced. `shared` is as in
    `atomic_files`.
    """
    with atomic_files(path, shared=shared) as (temporary,):
        yield temporary


@contextmanager
def atomic_files(*paths: str | os.PathLike[str], shared: bool = False) -> Iterator[list[Path]]:
    """Yield a list of temporary paths whose files replace `paths` together, like `atomic_write`.

    The block must write all of them. The other files are removed before the first one is replaced,
    so that a kill in between never leaves a new first file beside old ones. Permissions of files
    that exist are kept. Files of other programs that `keep_files_of_others` keeps stay, and those
    of the block get other names, unless they are `shared`, such as tiles in a cache.

    Raises:
        ValueError: a path is a pipe, a device or another thing that cannot be replaced by a file.
        FileExistsError: another program has written a file; says which names were taken instead.
    """
    targets = [Path(path).resolve() if Path(path).is_symlink() else Path(path) for path in paths]
    for path in targets:
        if path.exists() and not (path.is_file() or path.is_dir()):
            raise ValueError(f"{path} is no ordinary file and is not replaced; name a file")
    with ExitStack() as stack:
        folders = {
            parent: stack.enter_context(_make_temporary_folder(parent))
            for parent in dict.fromkeys(path.parent for path in targets)
        }
        temporary = [folders[path.parent] / path.name for path in targets]
        stack.enter_context(_name_in_errors(targets[0]))
        yield temporary
        for file, path in zip(temporary, targets, strict=True):
            _flush(file)
            if path.is_file():
                shutil.copymode(path, file)
        foreign = [] if shared else [path for path in targets if _is_foreign(path)]
        kept = _find_free_names(targets) if foreign else targets
        for path in kept[1:]:
            path.unlink(missing_ok=True)
        for file, path in zip(temporary, kept, strict=True):
            os.replace(file, path)
        if command := _COMMAND.get():
            command.written.update(path.resolve() for path in kept)
        if foreign:
            raise FileExistsError(
                f"{foreign[0]} was written by another program meanwhile and is kept; "
                f"this result is in {' and '.join(map(str, kept))}"
            )


@contextmanager
def atomic_folder(folder: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a temporary folder that becomes `folder` when the block ends without an error.

    No file that exists is changed or removed.

    Raises:
        ValueError: the folder holds files, is a file, or is not writable; checked before and after
            the block.
    """
    folder = Path(folder).resolve()
    check_new_folder(folder)
    with _make_temporary_folder(folder.parent) as temporary:
        with _name_in_errors(folder):
            yield temporary
        check_new_folder(folder)  # another run may have written it meanwhile
        if folder.exists():
            folder.rmdir()  # Windows renames to no existing folder
        temporary.rename(folder)


@contextmanager
def lock_folder(folder: str | os.PathLike[str], *, wait: bool = False) -> Iterator[None]:
    """Keep other processes that lock a folder out of it until the block ends; make it if missing.

    Raises:
        ValueError: another process has locked it, and this one should not wait.
    """
    Path(folder).mkdir(parents=True, exist_ok=True)
    try:
        with _lock(Path(folder), wait=wait):
            yield
    except BlockingIOError:
        raise ValueError(f"another process writes into {folder}; name another folder") from None


def check_writable(path: Path) -> None:
    """Check that a file or folder may be made in the folder in which it lies, or would lie.

    Raises:
        ValueError: that folder is a file, or may not be written to.
    """
    folder = next(parent for parent in path.absolute().parents if parent.exists())
    if not folder.is_dir():
        raise ValueError(f"{folder} is a file; a folder is needed to write {path.name} into")
    if not os.access(folder, os.W_OK):
        raise ValueError(f"{folder} cannot be written to; choose another folder for {path.name}")


def check_new_folder(folder: Path) -> None:
    """Check that a folder can be written as a whole: it is missing or empty."""
    check_writable(folder)
    if not folder.exists():
        return
    if not folder.is_dir():
        raise ValueError(f"{folder} is a file; a folder is needed")
    names = sorted(path.name for path in folder.iterdir())
    if names:
        raise ValueError(f"{folder} holds {', '.join(names[:3])}; name a new folder")
    if os.path.ismount(folder) or folder.samefile(Path.cwd()):
        raise ValueError(f"{folder} is in use and cannot be replaced; name a new folder in it")


# in a folder that `geoaim place` wrote; those of the roads only where they were given
MAP_FILE, TRACKS_FILE, REPORT_FILE = "map.tif", "tracks.csv", "report.json"
LOOK_FILE, FILM_FILE = "map.png", "film.mp4"
ROAD_FILES = {"lights": "lights.csv", "hdmap": "map.osm", "stop_lines": "stop_lines.geojson"}


def find_in_folder(path: str | os.PathLike[str], name: str) -> Path:
    """Find a file of `geoaim place` where its folder is given; any other path stays as it is."""
    folder = Path(path)
    has_both = (folder / MAP_FILE).is_file() and (folder / name).is_file()
    return folder / name if has_both else folder


def write_figure(figure: "Figure", path: str | os.PathLike[str]) -> None:
    """Write a figure as a PNG of 100 pixels per inch, by `atomic_write`."""
    from matplotlib.text import Text

    for text in figure.findobj(Text):  # a name from a file may hold dollar signs
        text.set_parse_math(False)
    with atomic_write(path) as temporary:
        # a third of the time, and a file 7 % larger
        figure.savefig(temporary, dpi=100, format="png", pil_kwargs={"compress_level": 1})


def check_not_foreign(path: Path) -> None:
    """Check that no file would be replaced that `keep_files_of_others` keeps.

    Raises:
        FileExistsError: it would be.
    """
    if _is_foreign(path):
        raise FileExistsError(f"{path} was written by another program meanwhile and is kept")


def _is_foreign(path: Path) -> bool:
    """Whether another program has written a file since `keep_files_of_others` began."""
    command = _COMMAND.get()
    if command is None or path.resolve() in command.written or not path.is_file():
        return False
    status = path.stat()
    return max(status.st_mtime, status.st_ctime) > command.began


def _find_free_names(paths: Sequence[Path]) -> list[Path]:
    """Add the first number to names by which none of them exists."""
    numbered = ([p.with_stem(f"{p.stem}-{number}") for p in paths] for number in count(2))
    return next(names for names in numbered if not any(path.exists() for path in names))


def _flush(path: Path) -> None:
    """Make sure that a file is on the disk, so that no power cut leaves an empty one."""
    with path.open("rb+") as file:
        os.fsync(file.fileno())


@contextmanager
def _name_in_errors(path: Path) -> Iterator[None]:
    """Name what is written in errors that name no file, such as that of a full disk."""
    try:
        yield
    except OSError as error:
        if error.errno is None or error.filename is not None:
            raise
        raise OSError(error.errno, error.strerror, str(path)) from error


@contextmanager
def _make_temporary_folder(parent: Path) -> Iterator[Path]:
    """Yield a new folder that no other run uses; remove it afterwards unless it was renamed."""
    parent.mkdir(parents=True, exist_ok=True)
    _remove_leftovers(parent)
    while True:
        folder = parent / f"{TEMPORARY}{uuid.uuid4().hex}"
        folder.mkdir()
        with _lock(folder, wait=True):
            if not folder.exists():  # another run took it for a leftover before it was locked
                continue
            try:
                yield folder
            finally:
                shutil.rmtree(folder, ignore_errors=True)
            return


def _remove_leftovers(parent: Path) -> None:
    """Remove the temporary folders of runs that were killed: those that no process has locked."""
    for folder in parent.glob(TEMPORARY + "[0-9a-f]" * 32):
        with suppress(BlockingIOError), _lock(folder, wait=False) as is_locked:
            if is_locked:
                shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def _lock(folder: Path, *, wait: bool) -> Iterator[bool]:
    """Lock a folder until the block or the process ends; yield whether that was possible."""
    with ExitStack() as stack:
        is_locked = False
        if sys.platform != "win32":
            try:
                descriptor = os.open(folder, os.O_RDONLY)
                stack.callback(os.close, descriptor)
                fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
                is_locked = True
            except BlockingIOError:
                raise
            except OSError:
                pass
        yield is_locked
