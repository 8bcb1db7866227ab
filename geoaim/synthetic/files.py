"""The files of a sample, as a person has them of a real place, and the truth of each."""

import json
import os
import shutil
from collections.abc import Iterator
from dataclasses import replace
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rasterio
import shapely
from jaxtyping import Float, UInt8
from numpy import ndarray as Array
from rasterio.enums import ColorInterp
from shapely import Point, Polygon

from geoaim.encode import write_video
from geoaim.geometry import transform_points
from geoaim.lights import STATES
from geoaim.progress import Progress, no_progress
from geoaim.synthetic.camera import HoverClip, list_boxed_agents, render_background, render_frames
from geoaim.synthetic.imagery import (
    WEB,
    Imagery,
    cut_tiles,
    draw_offset,
    georeference_photo,
    make_other_day,
    photograph,
)
from geoaim.synthetic.place import Place, world_from_image
from geoaim.synthetic.readme import TITLE, ZOOM, describe
from geoaim.synthetic.roads.lanelet import make_lanelet_map
from geoaim.synthetic.roads.markings import list_landmarks
from geoaim.synthetic.roads.paving import outline_crossing
from geoaim.synthetic.sample import Sample, tracks_of
from geoaim.synthetic.traffic.signals import light_states_at
from geoaim.track_files import write_tracks
from geoaim.world import lonlat_from_world

CLASSES = ("car", "van", "truck", "bus", "pedestrian", "cyclist")  # numbers in YOLO files
SENSOR = 36.0  # mm, width of the film that focal lengths are given for
FOCAL_LENGTH = 24.0  # mm
CLOCK = "2026-05-14 10:{minute:02d}:{second:02d}.{milli:03d}"
# all that a sample's folder may hold
OWN = (
    *("hover.mp4", "hover.SRT", "gcps.csv", "boxes", "background.jpg", "tracks*.csv"),
    *("lights*.csv", "map.osm", "map_full.osm", "surfaces.geojson", "ortho.tif", "tiles"),
    *("truth.json", "truth.npz", "README.md", ".part"),
)


def write_sample(
    sample: Sample, folder: str | os.PathLike[str], *, progress: Progress = no_progress
) -> None:
    """Write the files of a sample and their truth; `README.md` in the folder says what each is.

    A sample that is there already is replaced once the new one is whole.

    Raises:
        ValueError: the folder holds something else than a sample.
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
    """Refuse to write a sample among other files, or in the place of anything but a sample.

    Raises:
        ValueError: the folder holds something else than a sample, or is none.
    """
    there = next(path for path in (folder, *folder.absolute().parents) if path.exists())
    if not there.is_dir():
        raise ValueError(f"{there} is a file; a folder is needed")
    names = sorted(path.name for path in folder.iterdir()) if folder.exists() else []
    other = [name for name in names if not any(fnmatch(name, own) for own in OWN)]
    if other or (set(names) - {".part"} and not _is_sample(folder)):
        found = ", ".join((other or names)[:3])
        raise ValueError(f"{folder} holds {found} and is no sample; name a new folder")


def _is_sample(folder: Path) -> bool:
    """Whether what is there was written here."""
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
    _write_maps(sample, folder)
    report("maps", 1, 3)
    offset = _write_imagery(sample, folder)
    _write_truth(sample, folder, offset)
    report("maps", 3, 3)
    if sample.clip is not None:
        _write_film(sample, sample.clip, folder, report)
    _write_text(folder / "README.md", describe(sample))


def _name(stem: str, number: int, ending: str) -> str:
    return f"{stem}{ending}" if number == 0 else f"{stem}_{number:03d}{ending}"


def _write_traffic(sample: Sample, folder: Path, number: int) -> None:
    """Tracks, and the changes of the lights."""
    tracks = tracks_of(sample, number)
    write_tracks(tracks, folder / _name("tracks", number, ".csv"))
    signals = sample.recordings[number].signals
    states = light_states_at(signals, tracks.times)
    before = np.vstack([np.full((1, len(signals.names)), -1), states[:-1]])
    lines = ["time,signal,state"]
    for step, light in np.argwhere(states != before):
        state = STATES[states[step, light]]
        lines.append(f"{tracks.times[step]:.1f},{signals.names[light]},{state}")
    if signals.names:
        _write_text(folder / _name("lights", number, ".csv"), "\n".join(lines) + "\n")


def _write_maps(sample: Sample, folder: Path) -> None:
    """The HD map as such maps often are, one with everything, and all surfaces."""
    place = sample.place
    given = place.roads, place.world_from_plan, place.world
    _write_bytes(folder / "map.osm", make_lanelet_map(*given))
    _write_bytes(folder / "map_full.osm", make_lanelet_map(*given, complete=True))
    paving = place.roads.paving
    surfaces = {
        "carriageway": paving.carriageway,
        "island": paving.islands,
        "pavement": shapely.union_all([paving.pavement, place.roads.footpaths.surface]),
        "drive": paving.drive,
        "car park": paving.lot,
    }
    features = [_feature(place, geometry, {"kind": kind}) for kind, geometry in surfaces.items()]
    for crossing in place.roads.crossings:
        about = {"kind": "crossing", "name": crossing.name, "marked": crossing.marked}
        features.append(_feature(place, outline_crossing(crossing), about))
    features = [feature for feature in features if feature["geometry"]["coordinates"]]
    content = {"type": "FeatureCollection", "features": features}
    _write_text(folder / "surfaces.geojson", json.dumps(content, indent=None) + "\n")


def _feature(place: Place, geometry: shapely.Geometry, about: dict[str, Any]) -> dict[str, Any]:
    """A polygon in longitude and latitude, of what lies on the page."""
    parts = shapely.get_parts(geometry.intersection(place.roads.extent))
    polygons = [
        Polygon(*_rings(place, part)) for part in parts if part.geom_type == "Polygon" and part.area
    ]
    whole = shapely.make_valid(shapely.MultiPolygon(polygons), method="structure")
    parts = shapely.get_parts(shapely.set_precision(whole, 1e-9))  # rounded, and valid for good
    shape = shapely.MultiPolygon([part for part in parts if part.geom_type == "Polygon"])
    return {"type": "Feature", "properties": about, "geometry": shapely.geometry.mapping(shape)}


def _rings(place: Place, part: Polygon) -> tuple[list[list[float]], list[list[list[float]]]]:
    """Outline and holes of a polygon in longitude and latitude."""
    first, *holes = (
        _lonlat(place, np.array(ring.coords)) for ring in (part.exterior, *part.interiors)
    )
    return first, holes


def _lonlat(place: Place, points: Float[Array, "m 2"]) -> list[list[float]]:
    world = transform_points(place.world_from_plan, points)
    return np.round(lonlat_from_world(place.world, world), 9).tolist()


def _write_imagery(sample: Sample, folder: Path) -> tuple[float, float]:
    """An orthophoto and tiles of another day; gives by how much they are misplaced."""
    place = sample.place
    tracks = tracks_of(sample, len(sample.recordings) - 1)
    last = replace(
        tracks,
        times=tracks.times[-1:],
        states=tracks.states[:, -1:],
        present=tracks.present[:, -1:],
    )
    offset = draw_offset(place)
    day, m = make_other_day(place), sample.resolution
    photo = photograph(place, day, last, resolution=m)
    _write_geotiff(
        georeference_photo(place, photo, "EPSG:3035", offset=offset), folder / "ortho.tif"
    )
    web = georeference_photo(place, photo, WEB, offset=offset)
    for column, row, tile in cut_tiles(web, ZOOM):
        _write_image(tile, folder / "tiles" / str(ZOOM) / str(column) / f"{row}.jpg", quality=85)
    return offset


def _write_geotiff(imagery: Imagery, path: Path) -> None:
    """RGB and alpha, as map services deliver them."""
    height, width = imagery.covered.shape
    profile = {
        "driver": "GTiff",
        "height": height,
        "width": width,
        "count": 4,
        "dtype": "uint8",
        "crs": imagery.crs,
        "transform": rasterio.Affine(*imagery.crs_from_image[:2].flat),
        "compress": "deflate",
        "predictor": 2,
        "tiled": True,
        "blockxsize": 256,
        "blockysize": 256,
    }
    with rasterio.open(path, "w", **profile) as dataset:
        dataset.write(np.moveaxis(imagery.image, -1, 0), [1, 2, 3])
        dataset.write(np.where(imagery.covered, 255, 0).astype(np.uint8), 4)
        names = (ColorInterp.red, ColorInterp.green, ColorInterp.blue, ColorInterp.alpha)
        dataset.colorinterp = names


def _write_film(sample: Sample, clip: HoverClip, folder: Path, report: Progress) -> None:
    """The video, what a surveyor and a detector would add, and the truth."""
    place, total = sample.place, len(clip.times)

    def frames() -> Iterator[UInt8[Array, "H W 3"]]:
        for number, frame in enumerate(render_frames(clip)):
            report("film", number, total)
            yield frame

    write_video(frames(), folder / "hover.mp4", frame_rate=clip.hover.frame_rate, crf=26)
    world_from_still = world_from_image(place, sample.resolution)
    world_from_frame = world_from_still @ np.linalg.inv(clip.frame_from_background)
    _write_control_points(place, clip, world_from_frame, folder / "gcps.csv")
    _write_boxes(clip, folder / "boxes")
    _write_telemetry(place, world_from_frame, clip, folder / "hover.SRT")
    _write_image(render_background(clip), folder / "background.jpg", quality=95)
    np.savez_compressed(
        folder / "truth.npz",
        times=clip.times,
        frame_from_world=np.linalg.inv(world_from_frame),
        world_from_frame=world_from_frame,
        crs=np.array(place.world.crs),
        origin=np.array(place.world.origin),
    )


def _write_control_points(
    place: Place, clip: HoverClip, world_from_frame: Float[Array, "T 3 3"], path: Path
) -> None:
    """Surveyed points: name, pixel in frame 0 (corner origin), longitude and latitude (WGS 84)."""
    names, marks = list_landmarks(place.roads)
    world = transform_points(place.world_from_plan, marks)
    pixels = transform_points(np.linalg.inv(world_from_frame[0]), world)
    lines = ["name,u,v,lon,lat"]
    places = lonlat_from_world(place.world, world)
    crowns = [Point(tree.place).buffer(tree.radius) for tree in place.scenery.trees]
    hidden = shapely.contains_xy(shapely.union_all(crowns), *marks.T)
    for name, (u, v), (lon, lat), unseen in zip(names, pixels, places, hidden, strict=True):
        if 0 <= u < clip.width and 0 <= v < clip.height and not unseen:
            lines.append(f"{name},{u:.3f},{v:.3f},{lon:.9f},{lat:.9f}")
    _write_text(path, "\n".join(lines) + "\n")


def _write_boxes(clip: HoverClip, folder: Path) -> None:
    """A YOLO text file for each frame, named by its index: class, centre x and y, width, height."""
    folder.mkdir(exist_ok=True)
    size = np.array([clip.width, clip.height, clip.width, clip.height])
    for index in range(len(clip.times)):
        agents, boxes = list_boxed_agents(clip, index)
        boxes = boxes / size
        middle, extent = (boxes[:, :2] + boxes[:, 2:]) / 2, boxes[:, 2:] - boxes[:, :2]
        lines = []
        for agent, row in zip(agents.tolist(), np.hstack([middle, extent]), strict=True):
            number = CLASSES.index(clip.traffic.types[agent])
            lines.append(f"{number} " + " ".join(f"{value:.5f}" for value in row) + "\n")
        _write_text(folder / f"{index:06d}.txt", "".join(lines))


def _write_telemetry(
    place: Place, world_from_frame: Float[Array, "T 3 3"], clip: HoverClip, path: Path
) -> None:
    """Subtitles as DJI writes them: where the camera is above the ground, and where it looks."""
    middle = np.array([clip.width, clip.height]) / 2
    spots = middle + np.array([[0, 0], [0, -1], [-middle[0], 0], [middle[0], 0]])
    centre, above, left, right = np.moveaxis(transform_points(world_from_frame, spots), -2, 0)
    heights = np.hypot(*(right - left).T) * FOCAL_LENGTH / SENSOR
    yaws = np.degrees(np.arctan2(*(above - centre).T))
    places = lonlat_from_world(place.world, centre)
    entries = []
    for index, time in enumerate(clip.times.tolist()):
        step = round(1000 / clip.hover.frame_rate)
        start, end = (round(1000 * time) + late for late in (0, step))
        second, milli = divmod(start, 1000)
        clock = CLOCK.format(minute=second // 60 + 21, second=second % 60, milli=milli)
        (lon, lat), height = places[index], heights[index]
        entries.append(
            f"{index + 1}\n{_srt_time(start)} --> {_srt_time(end)}\n"
            f'<font size="28">FrameCnt: {index + 1}, DiffTime: {step}ms\n{clock}\n'
            f"[iso: 100] [shutter: 1/1000.0] [fnum: 2.8] [ev: 0] [focal_len: {FOCAL_LENGTH:.2f}] "
            f"[latitude: {lat:.6f}] [longitude: {lon:.6f}] "
            f"[rel_alt: {height:.3f} abs_alt: {height + 181:.3f}] "
            f"[gb_yaw: {yaws[index]:.1f} gb_pitch: -90.0 gb_roll: 0.0] </font>\n"
        )
    _write_text(path, "\n".join(entries))


def _srt_time(milliseconds: int) -> str:
    seconds, milli = divmod(milliseconds, 1000)
    return f"{seconds // 3600:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d},{milli:03d}"


def _write_truth(sample: Sample, folder: Path, offset: tuple[float, float]) -> None:
    """What else is known: the place, its lights, and by how much the imagery is misplaced."""
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
    _write_text(folder / "truth.json", json.dumps(content, indent=1) + "\n")


def _write_image(image: UInt8[Array, "H W 3"], path: Path, *, quality: int) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    bgr = np.ascontiguousarray(image[..., ::-1])
    done, data = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, quality])
    if not done:
        raise OSError(f"{path}: the picture could not be encoded")
    _write_bytes(path, data.tobytes())


def _write_text(path: Path, text: str) -> None:
    _write_bytes(path, text.encode())


def _write_bytes(path: Path, content: bytes) -> None:
    path.write_bytes(content)
