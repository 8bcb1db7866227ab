"""Small valid files in every format that geoaim reads, to be mutated."""

import gzip
import json
import sqlite3
from contextlib import closing
from pathlib import Path

import av
import cv2
import numpy as np
import rasterio
from PIL import Image
from rasterio.transform import from_origin

from geoaim.aim.aim import AIM
from geoaim.aim.files import write_aim
from geoaim.base.world import World
from geoaim.mapping.texture import export_texture
from geoaim.prediction.checkpoints import write_model
from geoaim.prediction.config import TrainConfig
from geoaim.prediction.dataset import Dataset
from geoaim.prediction.training import init_model, train
from geoaim.tracks.files import write_tracks
from geoaim.tracks.formats import write_geopackage
from geoaim.tracks.tracks import Tracks
from tests.prediction.tiny import TINY, drive, hill
from tests.tracks.formats import scenarionet_files, test_argoverse

SAMPLES = Path(__file__).parents[2] / "samples"
ORIGIN = 583000.0, 6062000.0
WORLD = World("EPSG:32635", ORIGIN)
BRACKETED = (
    "{0}\n00:00:0{0},000 --> 00:00:0{0},040\n[iso: 100] [focal_len: 24.00] [latitude: 54.700600] "
    "[longitude: 28.290769] [rel_alt: 112.897 abs_alt: 293.897] [gb_yaw: 61.0 gb_pitch: -90.0]\n\n"
)
OLDER = (
    "{0}\n00:00:0{0},000 --> 00:00:0{0},040\nHOME(28.2907,54.7006) 2019.05.01 12:00:00\n"
    "GPS(28.290769,54.700600,17) BAROMETER:112.9\nISO:100 Shutter:240 Fnum:F2.8\n\n"
)
TABLES = {
    "sdd.txt": "\n".join(
        f'{i} {9 * k} 100 {9 * k + 20} 140 {6 * k} 0 0 0 "Biker"' for i in (0, 1) for k in range(6)
    ),
    "trajnet.csv": "frame,track,u_px,v_px\n"
    + "".join(f"{12 * k},{i},{10 * k},{5 * k}\n" for i in (1, 2) for k in range(20)),
    "pixels.csv": "id,frame,x,y,type\n"
    + "".join(f"{i},{6 * k},{10 * k},{5 * k},car\n" for i in (1, 2) for k in range(20)),
    "phases.csv": "signal_group_id,timestamp_ms,movement_state\n"
    "1,0,STOP_AND_REMAIN\n1,900,PROTECTED_MOVEMENT_ALLOWED\n1,2000,PROTECTED_CLEARANCE\n",
    "interaction.csv": "track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width\n"
    + "".join(f"{i},{k},{100 * k},car,{k},{i},10,0,0,4.5,1.8\n" for i in (1, 2) for k in range(5)),
    "sind.csv": "track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,yaw_rad,length,width,ax,ay\n"
    + "".join(
        f"{i},{k},{100 * k},car,{k},{i},9,0,0,4.5,1.8,0,0\n" for i in (1, 2) for k in range(5)
    ),
    "00_tracks.csv": "recordingId,trackId,frame,xCenter,yCenter,heading,width,length,xVelocity,"
    "yVelocity\n"
    + "".join(f"0,{i},{k},{k},{i},0,1.8,4.5,25,0\n" for i in (1, 2) for k in range(5)),
    "00_tracksMeta.csv": "trackId,class\n1,car\n2,truck_bus\n",
    "00_recordingMeta.csv": "frameRate,latLocation,lonLocation,xUtmOrigin,yUtmOrigin\n"
    "25,50.78,6.13,297631.3,5629917.3\n",
    "01_tracks.csv": "frame,id,x,y,width,height,xVelocity,yVelocity\n"
    + "".join(f"{k},{i},{k},{i},4.5,1.8,25,0\n" for i in (1, 2) for k in range(5)),
    "01_tracksMeta.csv": "id,class,drivingDirection\n1,Car,1\n2,Truck,2\n",
    "01_recordingMeta.csv": "frameRate\n25\n",
    "geotrax.csv": "Vehicle_ID,Timestamp,Frame_Number,Ortho_X,Ortho_Y,Local_X,Local_Y,Latitude,"
    "Longitude,Vehicle_Length,Vehicle_Width,Vehicle_Class\n"
    + "".join(
        f"{i},2022-10-07 17:52:13.{k}00,{k},0,0,{170000 + k},532000.0,37,126,4.9,1.9,0\n"
        for i in (1, 2)
        for k in range(5)
    ),
    "geotrax.txt": "".join(
        f"{k},{i},{9 * k},50,40,20,{9 * k},50,40,20,0,0.9,45,18\n" for i in (1, 2) for k in range(6)
    ),
    "lights.csv": "time,signal,state\n0,east,green\n0,west,red\n5,east,yellow\n8,east,red\n",
    "sind_lights.csv": "RawFrameID,timestamp(ms),Traffic light 1,Traffic light 2\n0,0,1,0\n"
    "9,300,3,0\n",
    "gcps.csv": "name,u,v,x,y,crs\na,10,20,583180,6062240,EPSG:32635\nb,600,25,583260,6062241,"
    "EPSG:32635\nc,590,400,583258,6062190,EPSG:32635\nd,15,410,583181,6062189,EPSG:32635\n",
    "gcp_list.txt": "WGS84 UTM 35N\n583180 6062240 0 10 20 a.jpg p1\n"
    "583260 6062241 0 600 25 a.jpg\n"
    "583258 6062190 0 590 400 a.jpg\n583181 6062189 0 15 410 a.jpg\n",
    "qgis.points": "#CRS: EPSG:32635\nmapX,mapY,sourceX,sourceY,enable,dX,dY,residual\n"
    "583180,6062240,10,-20,1,0,0,0\n583260,6062241,600,-25,1,0,0,0\n"
    "583258,6062190,590,-400,1,0,0,0\n583181,6062189,15,-410,1,0,0,0\n",
    "bracketed.srt": "".join(BRACKETED.format(k) for k in range(1, 5)),
    "older.srt": "".join(OLDER.format(k) for k in range(1, 5)),
    "boxes/0.txt": "0 0.5 0.5 0.1 0.2\n2 0.25 0.3 0.05 0.04 0.9\n",
    "detections.csv": "frame,left,top,right,bottom,score,class\n"
    + "".join(f"{k},{5 + k},10,{15 + k},20,0.9,car\n" for k in range(6)),
    "semicolons.csv": "frame;x;y;w;h\n" + "".join(f"{k};{5 + k},5;10;8;8\n" for k in range(6)),
    "mot.txt": "".join(f"{k},1,{5 + k},10,10,10,0.9,-1,-1,-1\n" for k in range(1, 7)),
    "coco.json": json.dumps(
        {
            "images": [
                {"id": k, "file_name": f"{k}.jpg", "width": 64, "height": 48} for k in range(4)
            ],
            "annotations": [
                {"id": k, "image_id": k, "category_id": 3, "bbox": [5 + k, 10, 10, 10]}
                for k in range(4)
            ],
            "categories": [{"id": 3, "name": "car"}],
        }
    ),
    "results.json": json.dumps(
        [
            {"image_id": k, "category_id": 3, "bbox": [5.0 + k, 10, 10, 10], "score": 0.9}
            for k in range(4)
        ]
    ),
    "futures.csv": "sample,time,id,x,y\n"
    + "".join(f"{s},{k / 10},1,{185 + k},{235 + s}\n" for s in (0, 1) for k in range(4)),
    "catalog.csv": "video,name,datetime\nvideo.mp4,a,2024-05-01T10:00:00Z\nvideo.mkv,b,\n",
    "lines.geojson": '{"type": "FeatureCollection", "features": [{"type": "Feature", "properties": '
    '{"signal": "east"}, "geometry": {"type": "LineString", "coordinates": [[28.2909, 54.7004], '
    "[28.2908, 54.7005]]}}]}",
    "area.geojson": '{"type": "FeatureCollection", "features": [{"type": "Feature", "properties": '
    '{}, "geometry": {"type": "Polygon", "coordinates": [[[28.2909, 54.7004], [28.2908, 54.7005], '
    "[28.2901, 54.7003], [28.2909, 54.7004]]]}}]}",
    "map.osm": """<osm version="0.6">
<node id="1" lat="54.7000" lon="28.2900"/>
<node id="2" lat="54.7003" lon="28.2900"/>
<node id="3" lat="54.7000" lon="28.29005"/>
<node id="4" lat="54.7003" lon="28.29005"/>
<way id="5"><nd ref="1"/><nd ref="2"/><tag k="type" v="curbstone"/></way>
<way id="6"><nd ref="3"/><nd ref="4"/><tag k="type" v="line_thin"/>
<tag k="subtype" v="dashed"/></way>
<way id="7"><nd ref="2"/><nd ref="4"/><tag k="type" v="stop_line"/></way>
<relation id="8"><member type="way" ref="5" role="left"/><member type="way" ref="6" role="right"/>
<tag k="type" v="lanelet"/><tag k="subtype" v="road"/></relation>
<relation id="9"><member type="way" ref="5" role="outer"/><member type="way" ref="6" role="outer"/>
<member type="way" ref="7" role="outer"/><member type="way" ref="10" role="outer"/>
<tag k="type" v="multipolygon"/><tag k="subtype" v="parking"/></relation>
<way id="10"><nd ref="1"/><nd ref="3"/><tag k="type" v="virtual"/></way>
<relation id="11"><member type="way" ref="7" role="ref_line"/><tag k="subtype" v="traffic_light"/>
<tag k="type" v="regulatory_element"/><tag k="name" v="east"/></relation>
</osm>
""",
}


def make_aim() -> AIM:
    """An AIM of 24 x 32 pixels of half a metre."""
    image = np.random.default_rng(0).integers(0, 255, (24, 32, 3), np.uint8)
    matrix = np.array([[0.5, 0, 180], [0, -0.5, 240], [0, 0, 1]])
    coverage = np.full((24, 32), 7, np.uint16)
    return AIM(image, matrix, WORLD, coverage, np.zeros((24, 32), bool), {"source": "video"})


def make_tracks() -> Tracks:
    """Two agents over five times."""
    states = np.zeros((2, 5, 4))
    states[..., 0], states[..., 3] = np.arange(5) / 2 + 185, 5.0
    states[..., 1] = [[235], [238]]
    return Tracks(
        times=np.arange(5) / 10,
        states=states,
        present=np.ones((2, 5), bool),
        sizes=np.array([[4.5, 1.8], [0.5, 0.5]]),
        types=("car", "pedestrian"),
        ids=("1", "2"),
        world=WORLD,
    )


def resume_training(folder: Path) -> object:
    """Train two steps, or resume from their checkpoint, which is at the end."""
    config = TrainConfig(steps=2, batch_size=2, history=(2, 4), checkpoint_interval=2)
    return train(init_model(TINY), config, Dataset(drive(steps=8), drive(steps=8), hill()), folder)


def write_seeds(folder: Path) -> None:
    """Write a file in each format into a folder."""
    for name, text in TABLES.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    (folder / "sdd.txt.gz").write_bytes(gzip.compress(TABLES["sdd.txt"].encode()))
    write_aim(make_aim(), folder / "aim.tif")
    export_texture(make_aim(), folder)
    for suffix in ("csv", "parquet"):
        write_tracks(make_tracks(), folder / f"plain.{suffix}")
    write_model(init_model(TINY), folder / "model.pt")
    resume_training(folder / "training")
    test_argoverse.make_table().to_parquet(folder / "argoverse.parquet")
    write_geopackage(make_tracks(), folder / "tracks.gpkg")
    scenarionet_files.write(folder / "scenario.pkl")
    _write_images(folder)
    _write_videos(folder)


def _write_images(folder: Path) -> None:
    pixels = np.random.default_rng(1).integers(0, 255, (64, 64, 3), np.uint8)
    pixels = cv2.GaussianBlur(pixels, (9, 9), 0)
    for name in ("image.png", "image.jpg", "image.tif"):
        cv2.imwrite(str(folder / name), pixels)
    exif = Image.Exif()
    exif[271] = "DJI"
    exif.get_ifd(0x8825).update({1: "N", 2: (54.0, 42.0, 2.1), 3: "E", 4: (28.0, 17.0, 26.7)})
    exif.get_ifd(0x8769).update({41989: 24})
    xmp = b'<x:xmpmeta><rdf:Description drone-dji:RelativeAltitude="+100.0" '
    xmp += b'drone-dji:GimbalYawDegree="61.0" drone-dji:GimbalPitchDegree="-90"/></x:xmpmeta>'
    Image.fromarray(pixels).save(folder / "photo.jpg", exif=exif, xmp=xmp)
    transform = from_origin(ORIGIN[0] + 180, ORIGIN[1] + 240, 0.5, 0.5)
    bands = np.moveaxis(pixels, -1, 0)
    for name, more in {
        "ortho.tif": {"driver": "GTiff", "compress": "deflate", "tiled": True, "blockxsize": 32},
        "ortho_jpeg.tif": {"driver": "GTiff", "compress": "jpeg"},
    }.items():
        shape = {"height": 64, "width": 64, "count": 3, "dtype": "uint8", "blockysize": 32}
        place = {"crs": WORLD.crs, "transform": transform}
        with rasterio.open(folder / name, "w", **shape, **place, **more) as dataset:
            dataset.write(bands)
    tile = folder / "tiles" / "18" / "151671" / "84000.png"
    tile.parent.mkdir(parents=True)
    cv2.imwrite(str(tile), pixels)
    with closing(sqlite3.connect(folder / "tiles.mbtiles")) as connection:
        connection.execute("CREATE TABLE metadata (name text, value text)")
        connection.execute(
            "CREATE TABLE tiles (zoom_level int, tile_column int, tile_row int, tile_data blob)"
        )
        bounds = "0.0,54.342149,0.002747,54.343750"  # of the four tiles
        rows = {"format": "jpg", "minzoom": "18", "maxzoom": "18", "bounds": bounds, "name": "a"}
        connection.executemany("INSERT INTO metadata VALUES (?, ?)", rows.items())
        data = cv2.imencode(".jpg", cv2.resize(pixels, (256, 256)))[1].tobytes()
        tiles = [(18, x, y, data) for x in (131072, 131073) for y in (178400, 178401)]
        connection.executemany("INSERT INTO tiles VALUES (?, ?, ?, ?)", tiles)
        connection.commit()


def _write_videos(folder: Path) -> None:
    generator = np.random.default_rng(2)
    for name, codec in {
        "video.mp4": "libx264",
        "video.mkv": "libx264",
        "video.avi": "mpeg4",
    }.items():
        with av.open(str(folder / name), "w") as container:
            stream = container.add_stream(codec, rate=10, options={"g": "5"})
            stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
            for _ in range(12):
                pixels = cv2.GaussianBlur(
                    generator.integers(0, 255, (48, 64, 3), np.uint8), (0, 0), 4
                )
                for packet in stream.encode(av.VideoFrame.from_ndarray(pixels, "rgb24")):
                    container.mux(packet)
            for packet in stream.encode():
                container.mux(packet)
