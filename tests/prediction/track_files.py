"""Files of the same motion in every track format, with noise after a time where asked."""

import pickle
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd

from geoaim.base.world import World
from geoaim.tracks.files import write_tracks
from geoaim.tracks.formats import write_geopackage
from geoaim.tracks.tables import make_tracks
from tests.tracks.formats import scenarionet_files

AGENTS = 4
MARGIN_M = 20.0  # of the positions from the origin: boxes in pixels are positive
RESOLUTION = 0.05  # metres per pixel


@dataclass(frozen=True)
class Form:
    """A format, as the test writes it."""

    write: Callable[[pd.DataFrame, Path], Path]  # rows of `make_rows` -> the file
    rate: float = 10.0  # of its rows, Hz
    kind: str = "vehicle"
    options: dict = field(default_factory=dict)  # of `read_tracks`


def make_rows(form: Form, *, duration: float, noise_after: float | None = None) -> pd.DataFrame:
    """One row for each agent and time: agents that turn, and the last one waits at first.

    All columns are noise after `noise_after` seconds: positions, velocities, headings and sizes.
    """
    rows = []
    for agent in range(AGENTS):
        time = np.arange(round(duration * form.rate) + 1) / form.rate
        driven = np.maximum(time - (0.6 * duration if agent == AGENTS - 1 else 0.0), 0.0)
        speed, turn = 4.0 + agent, 0.3 * driven
        x = MARGIN_M + speed * driven * np.cos(turn)
        y = -MARGIN_M - 6 * agent + speed * driven * np.sin(turn)
        part = pd.DataFrame({"id": agent + 1, "time": time, "x": x, "y": y})
        part["vx"], part["vy"] = (np.gradient(part[name], time) for name in ("x", "y"))
        part["heading"] = np.arctan2(part["vy"], part["vx"])
        rows.append(part.assign(length=4.5 + 0.2 * agent, width=1.8))
    table = pd.concat(rows, ignore_index=True)
    if noise_after is not None:
        late = table["time"].to_numpy() > noise_after + 1e-6
        generator = np.random.default_rng(0)
        for name, size in {"x": 4, "y": 4, "vx": 5, "vy": 5, "heading": 1, "length": 3}.items():
            offset = generator.uniform(0.2 * size, size, late.sum())
            table.loc[late, name] += offset * (1 if name == "length" else generator.choice([-1, 1]))
    table["frame"] = np.round(table["time"] * form.rate).astype(int)
    return table


def _write_table(
    name: str, type_name: str, columns: dict[str, str], **more
) -> Callable[[pd.DataFrame, Path], Path]:
    """A writer of a CSV whose columns are renamed columns of the rows, or constants."""

    def write(rows: pd.DataFrame, folder: Path) -> Path:
        rows = rows.assign(type=type_name, milliseconds=1000 * rows["time"])
        table = rows[list(columns)].rename(columns=columns).assign(**more)
        table.to_csv(folder / name, index=False)
        return folder / name

    return write


def _make_plain(rows: pd.DataFrame):
    speed = np.hypot(rows["vx"], rows["vy"])
    return make_tracks(rows.assign(type="car", speed=speed), World("EPSG:32635", (583000, 6062000)))


def _write_plain(name: str, write=write_tracks) -> Callable[[pd.DataFrame, Path], Path]:
    def write_rows(rows: pd.DataFrame, folder: Path) -> Path:
        write(_make_plain(rows), folder / name)
        return folder / name

    return write_rows


def _write_argoverse(rows: pd.DataFrame, folder: Path) -> Path:
    names = {"id": "track_id", "frame": "timestep", "x": "position_x", "y": "position_y"}
    names |= {"vx": "velocity_x", "vy": "velocity_y"}
    table = rows.rename(columns=names).astype({"track_id": str})
    end = int(1e9 * rows["time"].max())
    more = {
        "object_type": "vehicle",
        "city": "pittsburgh",
        "start_timestamp": 0,
        "end_timestamp": end,
    }
    table = table.assign(**more, num_timestamps=rows["frame"].max() + 1)
    table.to_parquet(folder / "scenario_a.parquet")
    return folder / "scenario_a.parquet"


def _write_scenarionet(rows: pd.DataFrame, folder: Path) -> Path:
    tracks = {}
    for agent, part in rows.groupby("id"):
        state = {name: part[name].to_numpy() for name in ("heading", "length", "width")}
        state["position"], state["velocity"] = (
            part[list(names)].to_numpy() for names in (("x", "y"), ("vx", "vy"))
        )
        state["valid"] = np.ones(len(part))
        tracks[str(agent)] = {"type": "VEHICLE", "state": state, "metadata": {}}
    times = np.array(sorted(set(rows["time"])))
    scenario = scenarionet_files.make_scenario(tracks=tracks, metadata={"ts": times})
    (folder / "sd_a.pkl").write_bytes(pickle.dumps(scenario))
    return folder / "sd_a.pkl"


def _write_sdd(label: str) -> Callable[[pd.DataFrame, Path], Path]:
    def write(rows: pd.DataFrame, folder: Path) -> Path:
        u, v = rows["x"] / RESOLUTION, -rows["y"] / RESOLUTION
        sides = [np.round(side).astype(int) for side in (u - 10, v - 20, u + 10, v + 20)]
        columns = zip(rows["id"], *sides, rows["frame"], strict=True)
        lines = [f'{" ".join(map(str, row))} 0 0 0 "{label}"' for row in columns]
        (folder / "annotations.txt").write_text("\n".join(lines) + "\n")
        return folder / "annotations.txt"

    return write


def _to_pixels(write: Callable[[pd.DataFrame, Path], Path]) -> Callable[[pd.DataFrame, Path], Path]:
    """A writer of positions in pixels, v down."""

    def write_pixels(rows: pd.DataFrame, folder: Path) -> Path:
        return write(rows.assign(x=rows["x"] / RESOLUTION, y=-rows["y"] / RESOLUTION), folder)

    return write_pixels


def _write_ind(rows: pd.DataFrame, folder: Path) -> Path:
    (folder / "00_recordingMeta.csv").write_text(
        "frameRate,latLocation,lonLocation,xUtmOrigin,yUtmOrigin\n25,50.78,6.13,297631,5629917\n"
    )
    lines = "".join(f"{agent},car\n" for agent in sorted(set(rows["id"])))
    (folder / "00_tracksMeta.csv").write_text(f"trackId,class\n{lines}")
    names = {"id": "trackId", "frame": "frame", "x": "xCenter", "y": "yCenter"}
    names |= {"degrees": "heading", "width": "width", "length": "length"}
    names |= {"vx": "xVelocity", "vy": "yVelocity"}
    degrees = np.degrees(rows["heading"])
    return _write_table("00_tracks.csv", "car", names)(rows.assign(degrees=degrees), folder)


def _write_highd(rows: pd.DataFrame, folder: Path) -> Path:
    (folder / "01_recordingMeta.csv").write_text("frameRate\n25\n")
    lines = "".join(f"{agent},Car,2\n" for agent in sorted(set(rows["id"])))
    (folder / "01_tracksMeta.csv").write_text(f"id,class,drivingDirection\n{lines}")
    rows = rows.assign(x=rows["x"] - rows["length"] / 2, y=-rows["y"] - rows["width"] / 2)
    rows = rows.assign(vy=-rows["vy"])
    names = {"frame": "frame", "id": "id", "x": "x", "y": "y", "length": "width"}
    names |= {"width": "height", "vx": "xVelocity", "vy": "yVelocity"}
    return _write_table("01_tracks.csv", "car", names)(rows, folder)


INTERACTION = {"id": "track_id", "frame": "frame_id", "milliseconds": "timestamp_ms"}
INTERACTION |= {"type": "agent_type", "x": "x", "y": "y", "vx": "vx", "vy": "vy"}
BOX = {"length": "length", "width": "width"}
GEOTRAX = {"id": "Vehicle_ID", "time": "Timestamp", "frame": "Frame_Number", "x": "Local_X"}
GEOTRAX |= {"y": "Local_Y", "length": "Vehicle_Length", "width": "Vehicle_Width"}
PIXELS = {"id": "id", "frame": "frame", "x": "x", "y": "y", "type": "type"}
SCALE = {"resolution": RESOLUTION}
FORMS = {  # names begin with that of their `TrackFormat`
    "plain": Form(_write_plain("a.csv")),
    "plain, other rate": Form(_write_plain("a.csv"), rate=7.0),
    "plain, Parquet": Form(_write_plain("a.parquet"), rate=25.0),
    "GeoPackage": Form(_write_plain("a.gpkg", write_geopackage)),
    "Argoverse 2": Form(_write_argoverse),
    "ScenarioNet": Form(_write_scenarionet),
    "SDD": Form(_write_sdd("Car"), rate=30.0, options=SCALE),
    "SDD, pedestrians": Form(_write_sdd("Pedestrian"), 30.0, "pedestrian", SCALE),
    "SinD": Form(_write_table("Veh.csv", "car", INTERACTION | BOX | {"heading": "yaw_rad"})),
    "SinD, pedestrians": Form(
        _write_table("Ped.csv", "pedestrian", INTERACTION, ax=0, ay=0), kind="pedestrian"
    ),
    "INTERACTION": Form(_write_table("a.csv", "car", INTERACTION | BOX | {"heading": "psi_rad"})),
    "INTERACTION, pedestrians": Form(
        _write_table("a.csv", "pedestrian", INTERACTION), kind="pedestrian"
    ),
    "inD": Form(_write_ind, rate=25.0),
    "highD": Form(_write_highd, rate=25.0),
    "geo-trax": Form(_write_table("a.csv", "car", GEOTRAX, Vehicle_Class=0), rate=29.97),
    "pixel": Form(
        _to_pixels(_write_table("a.csv", "car", PIXELS)), 24.0, options={**SCALE, "frame_rate": 24}
    ),
}
