"""Each reader of geoaim, with the file that is mutated and the mutations that suit its format."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from geoaim.aim.files import read_aim
from geoaim.aim.texture_files import read_texture
from geoaim.base.errors import GeoaimError
from geoaim.catalog.recordings import read_recordings
from geoaim.hdmap.drivable import find_drivable_area, read_drivable_area
from geoaim.hdmap.lanelet2 import read_hdmap
from geoaim.imagery.mosaic import read_imagery
from geoaim.mapping.georeference.control_points import read_control_points
from geoaim.mapping.georeference.estimate import estimate_georeference
from geoaim.mapping.video.detections import read_detections
from geoaim.mapping.video.exif import read_exif
from geoaim.mapping.video.frames import Frame
from geoaim.mapping.video.srt import read_srt
from geoaim.mapping.video.video import open_video
from geoaim.prediction.checkpoints import read_model
from geoaim.tracks.formats import read_tracks
from geoaim.tracks.lights import StopLine, read_lights, read_stop_lines
from geoaim.web.moving_layers import describe_futures_file
from tests.faults import mutations as by
from tests.faults.seeds import WORLD, resume_training

TEXT = (by.mutate_fields, by.mutate_lines)
JSON = (*TEXT, by.mutate_json)
BINARY = (by.mutate_numbers,)
PNG = (by.mutate_numbers, by.mutate_chunks)
PICKLE = (by.mutate_numbers, by.mutate_pickle)
STATE = (by.mutate_state,)
KIT_LINES = [StopLine("1", np.array([[0.0, 0.0], [3.0, 0.0]]))]
SIND_LINES = [StopLine("Traffic light 1", np.array([[0.0, 0.0], [3.0, 0.0]]))]


@dataclass(frozen=True)
class Reader:
    """A reader: it takes the folder of the files, of which one is mutated."""

    file: str
    mutations: tuple[by.Mutation, ...]
    read: Callable[[Path], object]
    names_file: bool = True  # in its errors; those of control points name the points instead


def _read_lines(folder: Path):
    return read_stop_lines(folder / "lines.geojson", WORLD)


def _points(name: str) -> Reader:
    def read(folder: Path) -> object:
        return estimate_georeference(read_control_points(folder / name), height=430, width=620)

    return Reader(name, TEXT, read, names_file=False)


def _read_video(name: str) -> Callable[[Path], object]:
    def read(folder: Path) -> object:
        video = open_video(folder / name, threads=1)
        times = []
        for frame in (*video, *video.frames_at([0.3, 0.9])):
            assert frame.grey.size
            times.append(frame.time)
        return {"video": times}

    return read


def _detections(file: str, mutations: tuple[by.Mutation, ...] = TEXT) -> Reader:
    def read(folder: Path) -> object:
        source = folder / Path(file).parts[0]  # the file, or the folder that holds it
        return read_detections(source)(Frame(0, 0.0, None, np.zeros((48, 64), np.uint8)))

    return Reader(file, mutations, read)


def _resume(folder: Path) -> object:
    try:
        return resume_training(folder / "training")
    except ValueError as error:
        if "another training" in str(error):  # of the call, not of the file
            raise GeoaimError(str(error)) from error
        raise


def _tracks(name: str, mutations: tuple[by.Mutation, ...] = TEXT, **options) -> Reader:
    reading = name.replace("Meta", "s").replace("recordings", "tracks").replace("trackss", "tracks")
    return Reader(name, mutations, lambda folder: read_tracks(folder / reading, **options))


READERS = {
    "AIM": Reader(
        "aim.tif", (*BINARY, by.mutate_geotiff_tags), lambda folder: read_aim(folder / "aim.tif")
    ),
    "texture: corner frame": Reader("texture.json", JSON, read_texture),
    "texture: picture": Reader("texture.png", PNG, read_texture),
    "tracks: plain CSV": _tracks("plain.csv"),
    "tracks: Parquet": _tracks("plain.parquet", (*BINARY, by.mutate_parquet)),
    "tracks: SDD": _tracks("sdd.txt", resolution=0.04),
    "tracks: SDD, gzipped": _tracks("sdd.txt.gz", (by.mutate_gzipped,), resolution=0.04),
    "tracks: TrajNet": _tracks("trajnet.csv", resolution=0.04),
    "tracks: pixel": _tracks("pixels.csv", resolution=0.04, frame_rate=24.0),
    "tracks: INTERACTION": _tracks("interaction.csv"),
    "tracks: SinD": _tracks("sind.csv"),
    "tracks: inD": _tracks("00_tracks.csv"),
    "tracks: inD, agents": _tracks("00_tracksMeta.csv"),
    "tracks: inD, recording": _tracks("00_recordingMeta.csv"),
    "tracks: highD": _tracks("01_tracks.csv"),
    "tracks: highD, agents": _tracks("01_tracksMeta.csv"),
    "tracks: geo-trax": _tracks("geotrax.csv"),
    "tracks: geo-trax pixels": _tracks("geotrax.txt", resolution=0.05),
    "tracks: Argoverse 2": _tracks("argoverse.parquet", (*BINARY, by.mutate_parquet)),
    "tracks: GeoPackage": _tracks("tracks.gpkg", (*BINARY, by.mutate_geopackage)),
    "tracks: ScenarioNet": _tracks("scenario.pkl", PICKLE),
    "lights: plain": Reader(
        "lights.csv", TEXT, lambda f: read_lights(f / "lights.csv", _read_lines(f), WORLD)
    ),
    "lights: KIT": Reader(
        "phases.csv", TEXT, lambda f: read_lights(f / "phases.csv", KIT_LINES, WORLD)
    ),
    "lights: SinD": Reader(
        "sind_lights.csv", TEXT, lambda f: read_lights(f / "sind_lights.csv", SIND_LINES, WORLD)
    ),
    "stop lines": Reader("lines.geojson", JSON, _read_lines),
    "drivable area": Reader(
        "area.geojson", JSON, lambda f: read_drivable_area(f / "area.geojson", WORLD)
    ),
    "HD map": Reader(
        "map.osm", (*TEXT, by.mutate_xml), lambda f: find_drivable_area(read_hdmap(f / "map.osm"))
    ),
    "control points: CSV": _points("gcps.csv"),
    "control points: ODM": _points("gcp_list.txt"),
    "control points: QGIS": _points("qgis.points"),
    "SRT": Reader("bracketed.srt", TEXT, lambda f: read_srt(f / "bracketed.srt")),
    "SRT, older": Reader("older.srt", TEXT, lambda f: read_srt(f / "older.srt")),
    "photo": Reader("photo.jpg", BINARY, lambda f: read_exif([f / "photo.jpg"])),
    "detections": _detections("boxes/0.txt"),
    "detections: CSV": _detections("detections.csv"),
    "detections: semicolons": _detections("semicolons.csv"),
    "detections: MOT": _detections("mot.txt"),
    "detections: COCO": _detections("coco.json", JSON),
    "detections: COCO results": _detections("results.json", JSON),
    "futures": Reader("futures.csv", TEXT, lambda f: describe_futures_file(f / "futures.csv")),
    "catalogue": Reader("catalog.csv", TEXT, lambda f: read_recordings(f / "catalog.csv")),
    "video: MP4": Reader("video.mp4", BINARY, _read_video("video.mp4")),
    "video: Matroska": Reader("video.mkv", BINARY, _read_video("video.mkv")),
    "video: AVI": Reader("video.avi", BINARY, _read_video("video.avi")),
    "image: PNG": Reader("image.png", PNG, _read_video("image.png")),
    "image: JPEG": Reader("image.jpg", BINARY, _read_video("image.jpg")),
    "image: TIFF": Reader("image.tif", BINARY, _read_video("image.tif")),
    "imagery: GeoTIFF": Reader(
        "ortho.tif", (*BINARY, by.mutate_geotiff_tags), lambda f: read_imagery(f / "ortho.tif")
    ),
    "imagery: GeoTIFF of JPEG": Reader(
        "ortho_jpeg.tif", BINARY, lambda f: read_imagery(f / "ortho_jpeg.tif")
    ),
    "imagery: tiles": Reader(
        "tiles/18/151671/84000.png", PNG, lambda f: read_imagery(f / "tiles", resolution=0.5)
    ),
    "imagery: MBTiles": Reader(
        "tiles.mbtiles", (by.mutate_mbtiles,), lambda f: read_imagery(f / "tiles.mbtiles")
    ),
    "model": Reader("model.pt", STATE, lambda f: read_model(f / "model.pt")),
    "checkpoint": Reader("training/checkpoint.pt", STATE, _resume),
}
