"""A sample as files: what one would have of a real place, and the truth of each."""

import json
import os
import shutil
from fnmatch import fnmatch
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from geoaim.geometry import transform_points
from geoaim.lights import STATES
from geoaim.progress import Progress, no_progress
from geoaim.synthetic.imagery import make_other_day
from geoaim.synthetic.map_files import ZOOM, write_imagery, write_maps
from geoaim.synthetic.place import RESOLUTION
from geoaim.synthetic.roads.markings import list_landmarks
from geoaim.synthetic.sample import HOVER, VIDEOS, Sample, tracks_of
from geoaim.synthetic.traffic.signals import light_states_at
from geoaim.synthetic.video_files import write_video_files
from geoaim.track_files import write_tracks

TITLE = "# Sample\n\nA synthetic place"  # how the README begins
# names of all files that a sample's folder may hold
SAMPLE_FILES = (
    *("hover.mp4", "hover.SRT", "gcps.csv", "boxes", "background.jpg", "tracks*.csv"),
    *("lights*.csv", "map.osm", "map_full.osm", "surfaces.geojson", "ortho.tif", "tiles"),
    *("truth.json", "truth.npz", "README.md", ".part"),
)


def write_sample(
    sample: Sample, folder: str | os.PathLike[str], *, progress: Progress = no_progress
) -> None:
    """Write the files of a sample and their truth; the folder's `README.md` explains each file.

    An existing sample is replaced when the new one is complete.

    Args:
        sample: what is written.
        folder: a new folder, or one that holds a sample.
        progress: called with the stage, the steps done and in all.

    Raises:
        ValueError: the folder holds other files.
    """
    folder = Path(folder)
    check_folder(folder)
    part = folder / ".part"
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    try:
        _write_all(sample, part, progress)
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        raise
    for old in [path for path in folder.iterdir() if path != part]:
        shutil.rmtree(old) if old.is_dir() else old.unlink()
    for new in list(part.iterdir()):
        new.replace(folder / new.name)
    part.rmdir()


def check_folder(folder: Path) -> None:
    """Check that a sample can be written to a folder: it is new, empty or holds a sample.

    Raises:
        ValueError: the folder holds other files, or is a file.
    """
    nearest = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    if not nearest.is_dir():
        raise ValueError(f"{nearest} is a file; a folder is needed")
    names = sorted(path.name for path in folder.iterdir()) if folder.exists() else []
    other = [name for name in names if not any(fnmatch(name, own) for own in SAMPLE_FILES)]
    if other or (set(names) - {".part"} and not _is_sample(folder)):
        listed = ", ".join((other or names)[:3])
        raise ValueError(f"{folder} holds {listed} and is not a sample; name a new folder")


def _is_sample(folder: Path) -> bool:
    """Whether a folder holds a sample that `write_sample` wrote."""
    try:
        truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
        text = (folder / "README.md").read_text(encoding="utf-8")
    except (OSError, ValueError):
        return False
    return isinstance(truth, dict) and "seed" in truth and text.startswith(TITLE)


def _write_all(sample: Sample, folder: Path, report: Progress) -> None:
    for number in range(len(sample.recordings)):
        report("tracks", number, len(sample.recordings))
        _write_traffic(sample, folder, number)
    report("maps", 0, 3)
    write_maps(sample, folder)
    report("maps", 1, 3)
    offset = write_imagery(sample, folder)
    _write_truth(sample, folder, offset)
    report("maps", 3, 3)
    if sample.clip is not None:
        write_video_files(sample, sample.clip, folder, report)
    (folder / "README.md").write_bytes(_format_readme(sample).encode())


def _format_name(stem: str, number: int, ending: str) -> str:
    return f"{stem}{ending}" if number == 0 else f"{stem}_{number:03d}{ending}"


def _write_traffic(sample: Sample, folder: Path, number: int) -> None:
    """Write a recording's tracks and the changes of its traffic lights."""
    tracks = tracks_of(sample, number)
    write_tracks(tracks, folder / _format_name("tracks", number, ".csv"))
    signals = sample.recordings[number].signals
    states = light_states_at(signals, tracks.times)
    before = np.vstack([np.full((1, len(signals.names)), -1), states[:-1]])
    lines = ["time,signal,state"]
    for step, light in np.argwhere(states != before):
        state = STATES[states[step, light]]
        lines.append(f"{tracks.times[step]:.1f},{signals.names[light]},{state}")
    if signals.names:
        path = folder / _format_name("lights", number, ".csv")
        path.write_bytes(("\n".join(lines) + "\n").encode())


def _write_truth(sample: Sample, folder: Path, offset: tuple[float, float]) -> None:
    """Write what else is known: the place, its lights and the imagery's offset."""
    place, day, signals = sample.place, make_other_day(sample.place), sample.recordings[0].signals
    names, marks = list_landmarks(place.roads)
    world = np.round(transform_points(place.world_from_plan, marks), 4).tolist()
    content: dict[str, Any] = {
        "seed": place.seed,
        "kind": place.roads.layout.kind,
        "crs": place.world.crs,
        "origin": place.world.origin,
        "world_from_plan": place.world_from_plan.tolist(),
        "imagery": {"offset_east_north_m": offset, "season": day.season, "changes": day.changes},
        "lights": {
            "cycle_s": signals.cycle,
            "phase_s": signals.phase,
            "green_s": dict(zip(signals.names, signals.green, strict=True)),
        },
        "landmarks": dict(zip(names, world, strict=True)),
    }
    (folder / "truth.json").write_bytes((json.dumps(content, indent=1) + "\n").encode())


def _format_readme(sample: Sample) -> str:
    """Fill the README's template, without the blocks that do not apply."""
    clip = sample.clip
    seconds = sum(float(recording.times[-1]) for recording in sample.recordings)
    values: dict[str, object] = {
        "command": _format_command(sample, seconds / 60),
        "traffic": f"{seconds:g}",
        "zoom": ZOOM,
        "start": "" if clip is None else ". Time 0 is the video's first frame",
    }
    if clip is not None:
        values |= {"width": clip.width, "height": clip.height, "rate": f"{clip.hover.frame_rate:g}"}
        values |= {"seconds": f"{len(clip.times) / clip.hover.frame_rate:g}"}
    text = Path(__file__).with_name("sample_readme.md").read_text(encoding="utf-8")
    given = {"film": clip is not None, "lights": bool(sample.recordings[0].signals.names)}
    for block, there in given.items():
        before, _, rest = text.partition(f"<{block}>\n")
        inside, _, after = rest.partition(f"</{block}>\n")
        text = before + (inside if there else "") + after
    return Template(text).substitute(values)


def _format_command(sample: Sample, minutes: float) -> str:
    """Format the command that makes the sample, or the Python call if no command does."""
    kind, seed, clip = sample.place.roads.layout.kind, sample.place.seed, sample.clip
    sizes = {size: name for name, size in VIDEOS.items()}
    video = "none" if clip is None else sizes.get((clip.height, clip.width))
    usual = clip is None or clip.hover == HOVER
    if video and usual and sample.resolution == RESOLUTION:
        options = f"--seed {seed} --kind {kind} --minutes {minutes:g} --video {video}"
        return f"geoaim sample FOLDER {options}"
    given = "None" if clip is None else f"({clip.height}, {clip.width}), hover={clip.hover}"
    given = f"{given}, resolution={sample.resolution:g}"
    return f'make_sample({seed}, kind="{kind}", minutes={minutes:g}, video={given})'
