"""A sample as files: the data that one has of a real place, and ground truth for each."""

import json
import os
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from benchmarks.synthetic.imagery import make_other_day
from benchmarks.synthetic.map_files import ZOOM, write_imagery, write_maps
from benchmarks.synthetic.place import RESOLUTION
from benchmarks.synthetic.roads.markings import list_landmarks
from benchmarks.synthetic.sample import HOVER, VIDEOS, Sample, tracks_of
from benchmarks.synthetic.traffic.signals import compute_light_states
from benchmarks.synthetic.video_files import write_video_files
from geoaim.base.files import atomic_folder
from geoaim.base.geometry import transform_points
from geoaim.base.progress import Progress, notebook_progress
from geoaim.tracks.files import write_tracks
from geoaim.tracks.lights import STATES


def write_sample(
    sample: Sample, folder: str | os.PathLike[str], *, progress: Progress = notebook_progress
) -> None:
    """Write the files of a sample and their truth; the folder's `README.md` explains each file.

    The folder appears when it is complete; a sample that exists is neither replaced nor changed.

    Args:
        sample: what is written.
        folder: a new or empty folder.
        progress: called with the stage, the number of steps done, and their total.

    Raises:
        ValueError: the folder holds files.
    """
    with atomic_folder(folder) as temporary:
        _write_all(sample, temporary, progress)


def _write_all(sample: Sample, folder: Path, progress: Progress) -> None:
    for number in range(len(sample.recordings)):
        progress("tracks", number, len(sample.recordings))
        _write_traffic(sample, folder, number)
    progress("maps", 0, 3)
    write_maps(sample, folder)
    progress("maps", 1, 3)
    offset = write_imagery(sample, folder)
    _write_truth(sample, folder, offset)
    progress("maps", 3, 3)
    if sample.clip is not None:
        write_video_files(sample, sample.clip, folder, progress)
    (folder / "README.md").write_bytes(_format_readme(sample).encode())


def _format_name(stem: str, number: int, ending: str) -> str:
    return f"{stem}{ending}" if number == 0 else f"{stem}_{number:03d}{ending}"


def _write_traffic(sample: Sample, folder: Path, number: int) -> None:
    """Write a recording's tracks and the changes of its traffic lights."""
    tracks = tracks_of(sample, number)
    write_tracks(tracks, folder / _format_name("tracks", number, ".csv"))
    signals = sample.recordings[number].signals
    states = compute_light_states(signals, tracks.times)
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
        return f"python -m benchmarks.synthetic FOLDER {options}"
    given = "None" if clip is None else f"({clip.height}, {clip.width}), hover={clip.hover}"
    given = f"{given}, resolution={sample.resolution:g}"
    return f'make_sample({seed}, kind="{kind}", minutes={minutes:g}, video={given})'
