"""Register the frames of a video."""

from pathlib import Path
from typing import Annotated

import typer

from geoaim.cli import options
from geoaim.cli.console import print_result, report_errors, show_progress
from geoaim.cli.outputs import TRACKS, check_output


def register(
    video: options.VideoSource,
    output: Annotated[Path, options.output(".csv or .parquet to write")],
    detections: options.DetectionsFolder = None,
    reference_time: Annotated[
        float | None,
        typer.Option(help="time of the reference frame, s; chosen automatically if omitted"),
    ] = None,
    fixed_camera: options.FixedCamera = False,
    as_json: options.AsJson = False,
) -> None:
    """Register the frames of a video to a reference frame.

    The table has a row for each frame; its matrix m00 to m22 maps pixels of the frame to pixels
    of the reference. With --reference-time 0 the reference is the first frame, in which control
    points are usually picked.

    Example: geoaim register samples/hover.mp4 -o registration.csv
    """
    from geoaim.mapping.registration.register import count_reasons, write_registration
    from geoaim.mapping.registration.register import register as register_frames

    with show_progress() as progress, report_errors():
        check_output(output, TRACKS)
        result = register_frames(
            video,
            detections=detections,
            model="rest" if fixed_camera else None,
            reference_time=reference_time,
            progress=progress,
        )
        write_registration(result, output)
    lines = {
        "motion model": result.reference.model,
        "reference": f"frame {result.reference.index}, {result.reference.time:.2f} s",
        "registered frames": f"{result.valid.sum()} of {len(result.valid)}",
    }
    for reason, count in count_reasons(result.reason).items():
        lines[f"rejected: {reason}"] = str(count)
    print_result([output], lines, as_json)
