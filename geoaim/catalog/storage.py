"""Files on disks and in object stores, by fsspec's addresses."""

import hashlib
import os
import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import fsspec
from fsspec.implementations.local import LocalFileSystem

from geoaim.base.errors import CatalogError, GeoaimError
from geoaim.base.files import atomic_write
from geoaim.base.texts import hide_credentials

# what a file system tells of a file's version, the surest first
STAMPS = ("ETag", "etag", "md5Hash", "content_md5", "mtime", "LastModified", "last_modified")


@dataclass(frozen=True)
class StoredFile:
    """A file in a folder, as its listing shows it."""

    address: str
    size: int
    stamp: str  # changes when the file does: a checksum of the store, or its time


def make_address(path: str | os.PathLike[str]) -> str:
    """Make an absolute address of a path; an address stays as it is."""
    text = os.fspath(path)
    return text if "://" in text else Path(text).absolute().as_posix()


def join_address(folder: str, *names: str) -> str:
    """Join the address of a folder and relative names; a single absolute name stays as it is."""
    if "://" in names[0] or Path(names[0]).is_absolute():
        return names[0]
    return "/".join([folder.rstrip("/"), *names])


def split_address(address: str) -> tuple[str, str]:
    """Split an address into its folder and its last part."""
    name = get_name(address)
    return address.rstrip("/")[: -len(name)].rstrip("/") or "/", name


def get_store(address: str) -> str:
    """Get the part of an address that names its store: protocol and host, without credentials."""
    protocol, _, rest = hide_credentials(address).partition("://")
    return f"{protocol}://{rest.split('/', 1)[0]}"


def get_name(address: str) -> str:
    """Get the last part of an address."""
    return address.rstrip("/").rsplit("/", 1)[-1]


def is_local(address: str) -> bool:
    """Tell whether an address lies on a disk of this machine."""
    return isinstance(_open(address)[0], LocalFileSystem)


def get_local_path(address: str) -> Path:
    """Get the path of a local address."""
    return Path(_open(address)[1])


def list_folder(address: str) -> dict[str, StoredFile]:
    """List the files of a folder by name; a missing folder has none."""
    with report_storage(address):
        system, path = _open(address)
        try:
            entries = system.ls(path, detail=True, refresh=True)
        except (FileNotFoundError, NotADirectoryError):
            return {}
    return {
        name: StoredFile(join_address(address, name), *_get_version(entry))
        for name, entry in ((get_name(entry["name"]), _follow(entry)) for entry in entries)
        if entry["type"] == "file" and entry["name"].rstrip("/") != path.rstrip("/")
    }


def list_tree(address: str) -> dict[str, StoredFile]:
    """List all files below a folder, by their path in it; a missing folder has none."""
    with report_storage(address):
        system, path = _open(address)
        system.invalidate_cache()
        found = system.find(path, detail=True)
    start = len(path.rstrip("/")) + 1
    return {
        name[start:]: StoredFile(join_address(address, name[start:]), *_get_version(entry))
        for name, entry in found.items()
    }


def get_modified(address: str) -> datetime:
    """Get the time at which a file was last changed."""
    with report_storage(address):
        system, path = _open(address)
        modified: datetime = system.modified(path)
    return modified if modified.tzinfo else modified.replace(tzinfo=UTC)


def read_files(addresses: list[str]) -> list[bytes]:
    """Read small files, at the same time where the store allows that."""
    if not addresses:
        return []
    with report_storage(addresses[0]):
        system, _ = _open(addresses[0])
        paths = [_open(address)[1] for address in addresses]
        contents = system.cat(paths, on_error="raise")
    return [contents[path] for path in paths] if isinstance(contents, dict) else [contents]


def write_file(address: str, content: bytes) -> None:
    """Write a file as a whole; folders are made."""
    with report_storage(address):
        system, path = _open(address)
        if isinstance(system, LocalFileSystem):
            with atomic_write(path, shared=True) as temporary:
                temporary.write_bytes(content)
        else:
            system.pipe_file(path, content)


def check_output(folder: str) -> None:
    """Check that files can be written into a folder, by a file that is removed again.

    Raises:
        OSError: they cannot be.
    """
    address = join_address(folder, f".geoaim-check-{uuid.uuid4().hex}")
    write_file(address, b"check")
    remove_file(address)


def remove_file(address: str) -> None:
    """Remove a file, if it exists."""
    with report_storage(address):
        system, path = _open(address)
        if system.exists(path):
            system.rm_file(path)


def upload(path: Path, address: str) -> None:
    """Copy a local file to an address; folders are made."""
    with report_storage(address):
        system, target = _open(address)
        if isinstance(system, LocalFileSystem):
            with atomic_write(target, shared=True) as temporary:
                shutil.copyfile(path, temporary)
        else:
            system.put_file(os.fspath(path), target)


def download(address: str, path: Path) -> None:
    """Copy a file to a local path; folders are made."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with report_storage(address):
        system, source = _open(address)
        system.get_file(source, os.fspath(path))


def hash_bytes(content: bytes) -> str:
    """Compute the SHA-256 of a content, 64 hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()


def hash_file(path: Path) -> str:
    """Compute the SHA-256 of a local file, in hexadecimal digits."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


@contextmanager
def report_storage(address: str) -> Iterator[None]:
    """Name the address in errors of its store."""
    try:
        yield
    except OSError as error:
        if address in str(error):
            raise
        raise type(error)(f"{address}: {error}") from error
    except GeoaimError:
        raise
    except Exception as error:  # stores have errors of their own, such as missing credentials
        raise OSError(f"{address}: {type(error).__name__}: {error}") from error


def _open(address: str) -> tuple[Any, str]:
    """The file system of an address, and the path in it."""
    try:
        return fsspec.core.url_to_fs(address)
    except (ImportError, ValueError) as error:  # the message names the package
        raise CatalogError(f"{address} cannot be opened: {error}") from error


def _follow(entry: dict[str, Any]) -> dict[str, Any]:
    """The entry of the file to which a symbolic link points; fsspec has that of the link."""
    if not entry.get("islink") or not os.path.isfile(entry["name"]):
        return entry
    target = os.stat(entry["name"])
    return {**entry, "type": "file", "size": target.st_size, "mtime": target.st_mtime}


def _get_version(entry: dict[str, Any]) -> tuple[int, str]:
    stamp = next((entry[key] for key in STAMPS if entry.get(key) is not None), "")
    return int(entry["size"]), str(stamp).strip('"')
