"""Numbers of frames in files of detections: whether they count from 0 or from 1."""

import re
from collections.abc import Collection, Sequence
from pathlib import Path

from geoaim.base.errors import GeoaimError, warn
from geoaim.mapping.video.video import Video

NUMBERED = re.compile(r"(.*?)(\d+)")
MAX_LISTED = 3  # names that a message lists


def number_names(
    stems: Sequence[str], video: Video | None, source: str | Path, first: int | None = None
) -> dict[str, int] | None:
    """Find the frames that files are named by: `000012`, or `hover_13` as ultralytics names them.

    Ultralytics counts the frames of a video from 1, and puts its name before the number.
    """
    parts = [NUMBERED.fullmatch(stem) for stem in stems]
    found = [part for part in parts if part is not None]
    if len(found) < len(parts) or len({part[1] for part in found}) != 1:
        return None
    numbers = [int(part[2]) for part in found]
    is_padded = any(part[2].startswith("0") and len(part[2]) > 1 for part in found)
    prefix = found[0][1].removesuffix("_")
    is_of_video = video is None or prefix == Path(video.source).stem
    by_ultralytics = found[0][1] != prefix and is_of_video and not is_padded
    if first is None:
        first = find_first(numbers, video, source, usual=1 if by_ultralytics else None)
    return {stem: number - first for stem, number in zip(stems, numbers, strict=True)}


def match_names(
    names: Sequence[str], video: Video | None, source: str | Path, first: int | None = None
) -> dict[str, int] | None:
    """Number the names of frames of a video; refuse those of which none is that of a frame."""
    if video is not None and video.names is not None:
        images = [Path(name).stem for name in video.names]
        if not {name.lstrip("0") for name in images} & {name.lstrip("0") for name in names}:
            refuse_other_names(names, images, video, source)
        return None
    numbers = number_names(names, video, source, first)
    if numbers is None and video is not None:
        refuse_other_names(names, (), video, source)
    return numbers


def find_first(
    numbers: Collection[int], video: Video | None, source: str | Path, *, usual: int | None = None
) -> int:
    """Find the number of the first frame, 0 or 1, by the numbers that are there."""
    if not numbers:
        return 0
    least, greatest = min(numbers), max(numbers)
    count = None if video is None else video.count_frames()
    if least == 0:
        first = 0
    elif count is not None and greatest == count:
        first = 1
    else:
        first = usual or 0
    if count is not None and greatest - first >= count:
        raise GeoaimError(
            f"{source} has boxes of frame number {greatest}, but {video and video.source} has "
            f"{count} frames; are they of another video, or of one at another rate?"
        )
    if usual is None and least > 0 and first == 0 and video is not None:
        warn(
            f"{source} has no boxes of a frame number 0, so that nothing shows whether its numbers "
            f"({least} to {greatest}) count from 0 or from 1; they are taken to count from 0"
        )
    return first


def refuse_other_names(
    stems: Collection[str], wanted: Collection[str], video: Video, source: str | Path
) -> None:
    """Refuse names of which none is that of a frame."""
    found = ", ".join(sorted(stems)[:MAX_LISTED])
    if wanted:
        looked_for = f"the names of its images ({', '.join(sorted(wanted)[:MAX_LISTED])}, ...)"
    else:
        stem = Path(video.source).stem
        looked_for = f"frame numbers from 0 (000000, 000001, ...), or {stem}_1, {stem}_2, ..."
    raise GeoaimError(
        f"{source} has boxes of {found}, ..., of which none is a frame of {video.source}; needed "
        f"are {looked_for}"
    )
