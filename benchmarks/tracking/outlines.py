"""Pictures of a band of a video's frames with the outlines of tracks, to be counted by hand.

    geoaim place drone.mp4 -o place/
    python -m benchmarks.tracking.outlines drone.mp4 place/ pictures/ \
        --frames 20,55,90,125,160 --rows 558,656

Each picture is a part of a frame, plain and below it with the outlines, which are numbered from
the left; cyclists are red.
"""

from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import torch
import typer

from geoaim.aim.files import read_aim
from geoaim.base.geometry import transform_points
from geoaim.base.progress import no_progress
from geoaim.mapping.video.video import open_video
from geoaim.simulation.overlap import compute_box_corners
from geoaim.tracking.frame_poses import locate_frames
from geoaim.tracks.formats.formats import read_tracks

PART_PX, SCALE = 480, 3.2  # columns of the frame in a picture; enlargement
RED, GREEN = (0, 0, 255), (0, 255, 0)


def main(
    video: Path,
    place: Annotated[Path, typer.Argument(help="folder of geoaim place")],
    output: Path,
    frames: Annotated[str, typer.Option(help="numbers of frames")],
    rows: Annotated[str, typer.Option(help="first and last row of the band")],
) -> None:
    """Draw the outlines of tracks on frames."""
    output.mkdir(exist_ok=True)
    low, high = map(int, rows.split(","))
    clip, tracks = open_video(video), read_tracks(place / "tracks.csv")
    poses = locate_frames(clip, read_aim(place / "map.tif"), None, no_progress)
    indices = poses.registration.index.tolist()
    for frame in clip.read_all():
        if str(frame.index) not in frames.split(","):
            continue
        row = indices.index(frame.index)
        step = int(np.abs(tracks.times - poses.times[row]).argmin())
        frame_from_world = np.linalg.inv(poses.world_from_frame[row])
        there = np.flatnonzero(tracks.present[:, step])
        states, sizes = tracks.states[there, step, :3], tracks.sizes[there]
        boxes = compute_box_corners(torch.from_numpy(states), torch.from_numpy(sizes)).numpy()
        colors = [RED if tracks.types[agent] == "cyclist" else GREEN for agent in there]
        placed = transform_points(frame_from_world, boxes)
        outlines = list(zip(placed, colors, strict=True))
        outlines.sort(key=lambda outline: outline[0][:, 0].min())
        for left in range(0, clip.width, PART_PX):
            part = frame.image[low:high, left : left + PART_PX, ::-1]
            plain = cv2.resize(part, None, fx=SCALE, fy=SCALE, interpolation=cv2.INTER_CUBIC)
            drawn, number = plain.copy(), 0
            for corners, color in outlines:
                place_px = np.rint((corners - [left, low]) * SCALE).astype(int)
                if (place_px >= 0).all() and (place_px < drawn.shape[1::-1]).all():
                    number += 1
                    cv2.polylines(drawn, [place_px], True, color)
                    cv2.putText(drawn, str(number), place_px.max(axis=0), 0, 0.4, color)
            cv2.imwrite(str(output / f"{frame.index}-{left}.png"), np.vstack([plain, drawn]))


if __name__ == "__main__":
    typer.run(main)
