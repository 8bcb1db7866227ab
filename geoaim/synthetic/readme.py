"""The README of a sample: what each file is, and the command that makes it."""

from pathlib import Path
from string import Template

from geoaim.synthetic.place import RESOLUTION
from geoaim.synthetic.sample import HOVER, VIDEOS, Sample

TITLE = "# Sample\n\nA synthetic place"  # how it begins
ZOOM = 19  # of the tiles


def format_readme(sample: Sample) -> str:
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
