"""The files from which a recording's map is built: listed, copied to this machine and hashed."""

import json
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from fnmatch import fnmatchcase
from importlib.metadata import version
from pathlib import Path
from typing import Any

from geoaim.base.errors import CatalogError
from geoaim.catalog.recordings import Recording
from geoaim.catalog.storage import (
    StoredFile,
    download,
    get_local_path,
    get_name,
    hash_bytes,
    is_local,
    list_folder,
    split_address,
)
from geoaim.mapping.build_map import MapSettings
from geoaim.mapping.video.video import IMAGE_SUFFIXES

VERSION = version("geoaim")
ROLES = ("video", "telemetry", "gcps", "detections")
TELEMETRY_SUFFIXES = (".SRT", ".srt")
ListFolder = Callable[[str], dict[str, StoredFile]]


@dataclass(frozen=True)
class InputFile:
    """A file from which a map is built."""

    role: str  # one of ROLES
    name: str  # name of the file
    address: str
    size: int
    stamp: str  # stamp, as in StoredFile


def list_inputs(recording: Recording, list_files: ListFolder = list_folder) -> list[InputFile]:
    """List the files of a recording, with the telemetry beside its video.

    Args:
        recording: the recording.
        list_files: lists a folder; one that remembers them lists each once for many recordings.

    Returns:
        The files by role, then by name.

    Raises:
        CatalogError: a file does not exist, or a folder has none.
    """
    files = [("video", file) for file in _find_files(recording.video, list_files)]
    folder, name = split_address(recording.video)
    stem = name.rsplit(".", 1)[0]
    beside = list_files(folder)
    telemetry = (beside.get(stem + suffix) for suffix in TELEMETRY_SUFFIXES)
    files += [("telemetry", file) for file in telemetry if file and file.address != recording.video]
    for role, address in (("gcps", recording.gcps), ("detections", recording.detections)):
        if address is not None:
            files += [(role, file) for file in _find_files(address, list_files)]
    return [
        InputFile(role, get_name(file.address), file.address, file.size, file.stamp)
        for role, file in files
    ]


def fetch_inputs(
    recording: Recording, inputs: Sequence[InputFile], folder: Path
) -> tuple[Recording, list[Path]]:
    """Copy the files that lie elsewhere to this machine.

    Args:
        recording: the recording.
        inputs: its files.
        folder: folder for the copies.

    Returns:
        The recording with the paths of its files on this machine; and the path of each file.
    """
    paths = []
    for file in inputs:
        if is_local(file.address):
            paths.append(get_local_path(file.address))
            continue
        # telemetry is looked for beside the video
        path = folder / file.role.replace("telemetry", "video") / file.name
        download(file.address, path)
        paths.append(path)
    sources: dict[str, Any] = {
        role: _get_local_source(address, role, inputs, folder)
        for role in ("video", "gcps", "detections")
        if (address := getattr(recording, role)) is not None
    }
    return replace(recording, **sources), paths


def _get_local_source(address: str, role: str, inputs: Sequence[InputFile], folder: Path) -> str:
    """The path of a file, folder or glob on this machine, after its files were copied."""
    if is_local(address):
        return str(get_local_path(address))
    names = get_name(address)
    is_folder = not any(file.address == address for file in inputs) and not _is_pattern(names)
    return str(folder / role if is_folder else folder / role / names)


def compute_content_hash(
    inputs: Sequence[InputFile], hashes: Sequence[str], settings: MapSettings
) -> str:
    """Compute what identifies a map: a hash of its inputs, its settings and geoaim's version.

    Args:
        inputs: the files; their roles and names count, not where they lie.
        hashes: SHA-256 of each.
        settings: the options of the map.

    Returns:
        64 hexadecimal digits.
    """
    files = [[file.role, file.name, digest] for file, digest in zip(inputs, hashes, strict=True)]
    content = {"version": VERSION, "settings": asdict(settings), "inputs": sorted(files)}
    return hash_bytes(json.dumps(content, sort_keys=True).encode())


def _find_files(address: str, list_files: ListFolder) -> list[StoredFile]:
    """A file, the images of a glob, or the files of a folder."""
    folder, name = split_address(address)
    beside = list_files(folder)
    if name in beside:
        return [beside[name]]
    if _is_pattern(name):
        files = [file for key, file in beside.items() if fnmatchcase(key, name)]
    else:
        files = [
            file
            for key, file in list_files(address).items()
            if f".{key.rsplit('.', 1)[-1].lower()}" in {*IMAGE_SUFFIXES, ".txt"}
        ]
    if not files:
        raise CatalogError(
            f"{address}: there is no such file, and no image or box in such a folder"
        )
    return sorted(files, key=lambda file: file.address)


def _is_pattern(name: str) -> bool:
    return any(sign in name for sign in "*?[")
