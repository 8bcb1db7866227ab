"""Build the map of one recording, on a worker, and put it into the catalogue."""

import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Lock
from typing import Any

import av
import cv2
import numpy as np

from geoaim.aim.aim import AIM
from geoaim.aim.files import read_aim
from geoaim.base.errors import (
    AimError,
    CatalogError,
    GeoaimError,
    GeoaimWarning,
    GeoreferenceError,
    warn,
)
from geoaim.base.progress import Progress, no_progress
from geoaim.base.world import lonlat_from_world
from geoaim.catalog.days import collect_tracks, draw_changes, place_day
from geoaim.catalog.recordings import (
    VERSION,
    InputFile,
    Recording,
    compute_content_hash,
    fetch_inputs,
)
from geoaim.catalog.records import (
    CHANGES,
    ITEM,
    MAP,
    RECORD,
    TRACKS,
    OutputFile,
    Record,
    Status,
    get_folder,
    has_files,
    parse_record,
    write_record,
)
from geoaim.catalog.stac import format_item
from geoaim.catalog.storage import (
    get_modified,
    hash_bytes,
    hash_file,
    join_address,
    list_folder,
    read_files,
    remove_file,
    upload,
    write_file,
)
from geoaim.detection.scale import FRAMES, propose_scale
from geoaim.mapping.build_map import MapSettings, build_map
from geoaim.mapping.video.video import IMAGE_SUFFIXES, open_video
from geoaim.tracks.files import write_tracks

# one build at a time in a process, since caught warnings and OpenCV's threads belong to all of it
ONE_AT_A_TIME = Lock()


@dataclass(frozen=True)
class Task:
    """A recording to be built.

    Attributes:
        recording: the recording.
        inputs: its files.
        folder: address of its folder in the catalogue.
        reference: name of the first day of its place, whose map is among the inputs; empty: it is
            the first, or for itself.
    """

    recording: Recording
    inputs: tuple[InputFile, ...]
    folder: str
    reference: str = ""


def make_task(
    recording: Recording, inputs: Sequence[InputFile], catalog: str, reference: str = ""
) -> Task:
    """Make the task of a recording."""
    return Task(recording, tuple(inputs), get_folder(catalog, recording.name), reference)


def build_recording(
    task: Task, scratch: Path | None = None, progress: Progress = no_progress
) -> Record:
    """Build the map of a recording, unless it is there, and put it into the catalogue."""
    record = make_record(task.recording, "failed", "", task.inputs)
    with ONE_AT_A_TIME, TemporaryDirectory(dir=scratch) as folder:
        try:
            local, paths = fetch_inputs(task.recording, task.inputs, Path(folder))
            hashes = [hash_file(path) for path in paths]
            content_hash = compute_content_hash(task.inputs, hashes, task.recording)
            record = replace(record, content_hash=content_hash, input_hashes=tuple(hashes))
            earlier = _find_earlier(task, content_hash)
            if earlier is not None:
                record = replace(earlier, inputs=task.inputs)
            else:
                stated, video = task.recording.datetime, task.inputs[0].address
                when, source = find_datetime(stated, video, paths[0])
                record = replace(record, datetime=when, datetime_source=source)
                by_role = dict(zip((file.role for file in task.inputs), paths, strict=True))
                first = by_role.get("reference")
                reference = None if first is None else (task.reference, read_aim(first))
                record = _build(record, local, reference, Path(folder), progress)
                record = _upload_map(record, Path(folder), task.folder)
            if record != earlier:
                write_record(record, task.folder)
        # an error of a store or of geoaim; the other recordings are built all the same
        except Exception as error:
            kind = "" if isinstance(error, GeoaimError | OSError) else f"{type(error).__name__}: "
            reason = f"{kind}{error}"
            record = replace(
                record, status="failed", reason=reason, files={}, item=None, report={}, grid={}
            )
    return record


def make_record(
    recording: Recording, status: Status, reason: str, inputs: Sequence[InputFile] = ()
) -> Record:
    """Make the record of a recording of which nothing else is known."""
    started = datetime.now(UTC).isoformat(timespec="seconds")
    return Record(
        recording.name,
        status,
        reason,
        VERSION,
        recording.settings,
        recording.list_choices(),
        inputs=tuple(inputs),
        started=started,
    )


def _build(
    record: Record,
    local: Recording,
    reference: tuple[str, AIM] | None,
    folder: Path,
    progress: Progress,
) -> Record:
    """Write map, quick look and tracks into a folder; refuse data that give no map."""
    cv2.setNumThreads(1)  # other workers use the other cores
    start, processor_start = time.perf_counter(), time.process_time()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", GeoaimWarning)
        try:
            aim = _build_map(local, reference, folder, progress)
            report = dict(aim.report)
            if reference is not None:
                picture, report["changed_share"] = draw_changes(aim, reference[1])
                (folder / CHANGES).write_bytes(
                    cv2.imencode(".jpg", picture[..., ::-1])[1].tobytes()
                )
            record = replace(record, status="built", report=report, grid=describe_grid(aim))
            _write_tracks(local, aim, folder / TRACKS, progress)
        except (GeoaimError, ValueError) as error:
            if _is_of_machine(error):
                raise
            record = replace(record, status="refused", reason=str(error))
    messages = [str(warning.message) for warning in caught]
    files = [] if record.status == "refused" else sorted(folder.glob("*.*"))
    return replace(
        record,
        warnings=tuple(dict.fromkeys(messages)),
        files={file.name: OutputFile(file.stat().st_size, hash_file(file)) for file in files},
        seconds=round(time.perf_counter() - start, 3),
        processor_seconds=round(time.process_time() - processor_start, 3),
    )


def _build_map(
    local: Recording, reference: tuple[str, AIM] | None, folder: Path, progress: Progress
) -> AIM:
    """Build a map in its place; where only imagery or another day places it, by cars' scale."""
    video = open_video(local.video, threads=1)

    def build(settings: MapSettings) -> AIM:
        return build_map(
            video,
            folder / MAP,
            gcps=None if local.gcps is None else Path(local.gcps),
            detections=None if local.detections is None else Path(local.detections),
            settings=settings,
            place=lambda aim: place_day(aim, local, reference, progress),
            progress=progress,
        )

    try:
        return build(local.settings)
    except GeoreferenceError:
        if local.gcps is not None or (local.imagery is None and reference is None):
            raise
    scale = propose_scale([frame.image for frame in video.sample(FRAMES)], progress=progress)
    return build(replace(local.settings, frame_resolution=scale.resolution))


def _write_tracks(local: Recording, aim: AIM, path: Path, progress: Progress) -> None:
    """Write the tracks of a recording; that there are none takes no map away."""
    try:
        tracks = collect_tracks(local, aim, progress)
        if tracks is not None:
            write_tracks(tracks, path)
    except (GeoaimError, ValueError, FileNotFoundError) as error:
        if _is_of_machine(error):
            raise
        warn(f"it has no tracks: {error}")


def _is_of_machine(error: Exception) -> bool:
    """Tell whether the machine is the cause of an error, such as a full disk, and not the data."""
    cause = error.__cause__
    if isinstance(error, AimError) and cause is not None:  # the map could not be written
        return True
    # FFmpeg and GDAL raise OSErrors for damaged files too, GDAL without a number
    return (
        isinstance(cause, OSError) and bool(cause.errno) and not isinstance(cause, av.FFmpegError)
    )


def _upload_map(record: Record, folder: Path, target: str) -> Record:
    """Copy the files of a map; an earlier record goes first, so that none names other files."""
    remove_file(join_address(target, RECORD))
    for name in record.files:
        upload(folder / name, join_address(target, name))
    if not record.files:
        return record
    item = format_item(record)
    write_file(join_address(target, ITEM), item)
    return replace(record, item=OutputFile(len(item), hash_bytes(item)))


def _find_earlier(task: Task, content_hash: str) -> Record | None:
    """The record of the same map, if it and its files are there."""
    stored = list_folder(task.folder)
    if RECORD not in stored:
        return None
    address = stored[RECORD].address
    try:
        record = parse_record(read_files([address])[0], address)
    except CatalogError:
        return None
    is_same = record.content_hash == content_hash and record.status != "failed"
    sizes = {name: file.size for name, file in stored.items()}
    return record if is_same and has_files(record, sizes) else None


def find_datetime(stated: str | None, address: str, path: Path) -> tuple[str, str]:
    """Find when a recording was made, and how that is known."""
    if stated is not None:
        return stated, "table"
    if created := _read_creation_time(path):
        return created, "video"
    return get_modified(address).isoformat(timespec="seconds"), "time of the file"


def describe_grid(aim: AIM) -> Mapping[str, Any]:
    """Describe the grid of a map: its CRS, shape, transform, resolution and corners in degrees."""
    height, width = aim.coverage.shape
    corners = None
    if aim.world.crs is not None:
        corners = np.round(lonlat_from_world(aim.world, aim.corners), 8).tolist()
    return {
        "crs": aim.world.crs,
        "shape": [height, width],
        "transform": aim.grid.crs_from_grid[:2].ravel().tolist(),
        "resolution_m": aim.resolution,
        "corners_lonlat": corners,
    }


def _read_creation_time(path: Path) -> str | None:
    """The time that a video states, ISO 8601; None for images, and where it states none."""
    if path.suffix.lower() in IMAGE_SUFFIXES:
        return None
    try:
        with av.open(f"file:{path}", metadata_errors="replace") as container:
            stated = container.metadata.get("creation_time")
        return datetime.fromisoformat(stated).isoformat() if stated else None
    except (av.FFmpegError, ValueError):
        return None
