r"""Which parts of the drawn scenery are felt: each is replaced by its plainest form in turn.

    python -m geoaim.bench.scenery_ablation --only "nothing,other textures" \
        --together "wear of tar,lamps" --together "hedges,lamps"

The published run is the command in docs/bench/scenery_ablation.json, with that file as `--json`.
New places of four kinds, each drawn with and without a part. Measured is what uses the scenery:
alignment of a picture of another day by image and by tracks, registration of a hover video, and
the two pretrained models on views of the place. Two rows tell how far figures scatter: textures by
another random seed, and other parked cars.
"""

from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any
from unittest.mock import patch

import cv2
import numpy as np
import torch
import typer
from numpy import ndarray as Array
from shapely import Polygon

from geoaim.aim import AIM
from geoaim.bench.alignment_pairs import Pair, measure_error, misplace_picture
from geoaim.bench.alignment_real import _measure_tracks
from geoaim.bench.hover_videos import HoverVideo
from geoaim.bench.registration import measure
from geoaim.bench.registration_methods import register_with_geoaim
from geoaim.bench.report import format_table, write_rows
from geoaim.errors import AlignmentError, TracksError
from geoaim.imagery.alignment.by_image import align_image
from geoaim.prediction.checkpoints import read_pretrained
from geoaim.prediction.config import MAX_HISTORY_STEPS, SEGMENT_STEPS
from geoaim.prediction.cutting import cut_segments
from geoaim.prediction.evaluation import EvalConfig, evaluate
from geoaim.simulation.ground import prefilter_ground
from geoaim.simulation.scene import make_scene
from geoaim.synthetic import (
    Hover,
    SpriteTracks,
    draw_place,
    film,
    make_place,
    make_sample,
    place,
    tracks_of,
    world_from_image,
)
from geoaim.synthetic.compositing import compute_image_poses, draw_agents
from geoaim.synthetic.imagery import Sensor, make_other_day, photograph
from geoaim.synthetic.roads import markings
from geoaim.synthetic.roads.layouts import PlaceKind
from geoaim.synthetic.scenery import canvas, ground, objects, plots, sprites
from geoaim.synthetic.scenery.canvas import fill, make_rectangle
from geoaim.synthetic.scenery.day import PALETTES
from geoaim.track_changes import resample_tracks
from geoaim.tracks import Tracks

SEEDS: Mapping[PlaceKind, int] = {"junction": 911, "t": 912, "roundabout": 913, "street": 914}
RESOLUTION = 0.2  # metres per pixel at which places are drawn
PICTURE_RESOLUTION = 0.4  # metres per pixel of the picture that is aligned
TRIALS = 2  # misplacements of each picture
MINUTES = 2.0
HOVER = Hover(count=10, frame_rate=10.0)
Patch = tuple[Any, str, Any]  # module, name and replacement


def _nothing(*_: Any, **__: Any) -> None:
    """Draw nothing."""


def _drop_shrubs(*given: Any) -> Any:
    scenery = plots.place_scenery(*given)
    return replace(scenery, trees=tuple(t for t in scenery.trees if t.radius > 1.15))


def _draw_plain_tar(to: Any, roads: Any) -> None:
    paving = roads.paving
    for area in (paving.carriageway, paving.driveway, paving.parking_lot):
        fill(to, area, ground.TAR, grain=[(canvas.GRAIN, 5.5)])


def _draw_plain_roof(to: Any, building: Any, day: Any) -> None:
    outline = make_rectangle(np.array(building.centre), building.size, building.angle)
    fill(to, outline, (150, 130, 120), grain=[(canvas.GRAIN, 6)])


def _draw_disc(radius: int, colour: Any, *_: Any) -> Array:
    side = 2 * int(radius * 1.2) + 1
    axis = np.arange(side) - side // 2
    alpha = 255 * (np.hypot(axis[:, None], axis) < radius)
    return np.dstack([np.broadcast_to(colour, (side, side, 3)), alpha]).astype(np.uint8)


def _draw_plain_paint(to: Any, shapes: Any, colour: Any, cover: float, only: Any) -> None:
    fill(to, shapes, colour, strength=cover, only=only)


def _draw_plain_grass(to: Any, day: Any) -> None:
    to.image[:] = PALETTES[day.season].grass
    to.image[:] += (11 * canvas.sample_noise(to, canvas.GRAIN))[..., None]


def _draw_plain_plots(to: Any, scenery: Any) -> None:
    fill(to, scenery.slabs, (166, 160, 151), grain=[(canvas.GRAIN, 4.5)])


PARTS: Mapping[str, list[Patch]] = {
    "nothing": [],
    "other textures": [(place, "GROUND", 77)],
    "other parked cars": [(place, "DAY", 78)],
    "wear of tar": [(ground, "_draw_tar", _draw_plain_tar)],
    "wear of paint": [(ground, "_draw_paint_with_wear", _draw_plain_paint)],
    "dry grass": [(ground, "_draw_grass", _draw_plain_grass)],
    "ground of plots": [(ground, "_draw_plots", _draw_plain_plots)],
    "joints of slabs": [(ground, "_draw_joints", _nothing)],
    "tactile and cycle strips": [
        (ground, "make_tactile_strips", lambda _: []),
        (ground, "make_cycle_strips", lambda _: []),
    ],
    "arrows": [(markings, "_make_arrows", lambda *_: [])],
    "kerbstones": [(ground, "_draw_kerbs", _nothing)],
    "fresh tar": [(ground, "_draw_fresh_tar", _nothing)],
    "details of roofs": [
        (objects, "_draw_flat_roof", _draw_plain_roof),
        (objects, "_draw_pitched_roof", _draw_plain_roof),
    ],
    "crowns of trees": [
        (objects, "draw_tree", _draw_disc),
        (objects, "draw_bare_tree", lambda radius, _: _draw_disc(radius, sprites.BARK)),
    ],
    "bare trees": [(objects, "draw_bare_tree", lambda radius, _: _draw_disc(radius, sprites.BARK))],
    "shrubs": [(place, "place_scenery", _drop_shrubs)],
    "hedges": [(plots, "_make_hedges", lambda *_: [])],
    "lamps": [(plots, "_make_lamps", lambda _: np.empty((0, 2, 2)))],
    "containers": [(plots, "_make_container_areas", lambda *_: [])],
    "parked cars": [(objects, "_park_cars", lambda *_: [])],
    "verges": [(plots, "_make_verges", lambda _: Polygon())],
    "parks and plazas": [
        (plots, "USES", ("block", "houses", "field", "block", "field", "houses", "block"))
    ],
    "details of vehicles": [
        (sprites, name, lambda *_: [])
        for name in ("_outline_car", "_outline_bus", "_outline_lorry")
    ],
    "shadows": [(objects, "_cast_shadows", _nothing)],
    "tone curve and haze": [(place, "grade_colours", _nothing)],
    "slopes of noise": [(canvas, "SLOPES", (0.9,) * 4)],
}


def measure_place(kind: PlaceKind, seed: int, tracks: Tracks) -> dict[str, float]:
    """Measure all that uses the scenery at one place.

    Args:
        kind: of the place.
        seed: of the place.
        tracks: a few minutes of its traffic.

    Returns:
        Errors by name, in the unit that the name states.
    """
    made = make_place(seed, kind=kind)
    image = draw_place(made, resolution=RESOLUTION)
    aim = AIM.from_image(image, world_from_image(made, RESOLUTION), made.world, "drawn")
    sensor = Sensor(resolution=PICTURE_RESOLUTION)
    photo = photograph(made, make_other_day(made), tracks, sensor, resolution=RESOLUTION)
    matrix = world_from_image(made, PICTURE_RESOLUTION)
    picture = AIM.from_image(photo, matrix, made.world, "drawn")
    return {
        **_measure_alignment(Pair(kind, aim, picture, np.eye(3)), tracks),
        "registration, px": _measure_registration(made, image, tracks),
        **{f"{k}s' minADE, m": _measure_model(k, aim, tracks) for k in SEGMENT_STEPS},
    }


def _measure_alignment(pair: Pair, tracks: Tracks) -> dict[str, float]:
    """Align misplaced pictures by image and by tracks; errors over the place, m, and refusals."""
    generator, errors = np.random.default_rng(5), []
    for _ in range(TRIALS):
        case = misplace_picture(pair, generator)
        with suppress(AlignmentError):
            matrix = align_image(case.picture, case.aim).true_from_stated
            errors.append(measure_error(case, matrix))
    by_tracks = _measure_tracks(pair.name, pair.picture, tracks, TRIALS)
    return {
        "by image, m": float(np.mean(errors)) if errors else np.nan,
        "by tracks, m": by_tracks["error, m, median"] or np.nan,
        "refused": TRIALS - len(errors) + by_tracks["refused"],
    }


def _measure_registration(made: Any, image: Array, tracks: Tracks) -> float:
    generator = np.random.default_rng(1)
    poses = compute_image_poses(made, tracks, RESOLUTION)[: HOVER.count]
    agents = draw_agents(tracks, RESOLUTION, generator)
    traffic = SpriteTracks(agents, tracks.sizes / RESOLUTION, poses)
    clip = film(image, traffic, HOVER, height=480, width=854, generator=generator)
    video = HoverVideo(clip, "plain", np.ones(HOVER.count, bool))
    return float(measure(register_with_geoaim, video, list(video))["error_mean_px"])


def _measure_model(kind: str, aim: AIM, tracks: Tracks) -> float:
    """The mean minADE of a pretrained model, NaN without agents of its kind."""
    model = read_pretrained(kind)
    scene = make_scene(aim, resample_tracks(tracks, 1 / model.config.dt))
    steps = SEGMENT_STEPS[kind]
    try:
        segments = cut_segments(scene, kind, steps=steps, stride=steps, joint=True)
    except TracksError:
        return np.nan
    seen = prefilter_ground(scene.ground, model.config.resolution)
    return evaluate(model.sample, segments, seen, EvalConfig(MAX_HISTORY_STEPS, 6))["minADE"].mean


def measure_without(parts: Sequence[str], tracks: Mapping[PlaceKind, Tracks]) -> dict[str, Any]:
    """Measure with some parts plain; means over the places, whose tracks are given by kind."""
    with ExitStack() as stack:
        for change in [change for part in parts for change in PARTS[part]]:
            stack.enter_context(patch.object(*change))
        rows = [measure_place(kind, SEEDS[kind], own) for kind, own in tracks.items()]
    means = {name: float(np.nanmean([row[name] for row in rows])) for name in rows[0]}
    return {"plain": ", ".join(parts), **means}


def main(
    json: Annotated[Path | None, typer.Option(help="JSON to write")] = None,
    together: Annotated[
        list[str] | None,
        typer.Option(help="parts replaced together, comma-separated; repeat for more rows"),
    ] = None,
    only: Annotated[str, typer.Option(help="parts replaced one by one; all without it")] = "",
) -> None:
    """Measure each part, then some of them together."""
    cv2.setNumThreads(1)
    torch.set_num_threads(1)
    tracks = {
        kind: tracks_of(make_sample(seed, kind=kind, minutes=MINUTES, video=None))
        for kind, seed in SEEDS.items()
    }
    groups = [[part] for part in (only.split(",") if only else PARTS)]
    groups += [group.split(",") for group in together or []]
    rows = []
    for group in groups:
        rows.append(measure_without(group, tracks))
        print(format_table(rows[-1:]).splitlines()[-1], flush=True)
    options = [f'--only "{only}"', *(f'--together "{group}"' for group in together or [])]
    command = " ".join(["python -m geoaim.bench.scenery_ablation", *options])
    write_rows(rows, json, command=command)


if __name__ == "__main__":
    typer.run(main)
