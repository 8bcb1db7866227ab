"""What is written is read back: exactly, or to the precision that the format states.

AIMs are in tests/aim/test_files.py.
"""

import json
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
import pandas as pd
import torch
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from geoaim.aim.aim import AIM
from geoaim.base.world import World, lonlat_from_world
from geoaim.hdmap.lanelet2 import read_hdmap
from geoaim.mapping.georeference.point_files import read_point_file
from geoaim.mapping.texture import export_texture
from geoaim.prediction.checkpoints import read_model, read_state, write_model, write_state
from geoaim.prediction.training import init_model
from geoaim.tracks.files import CSV_DECIMALS, read_plain_tracks, write_tracks
from geoaim.tracks.lights import STATES, StopLine, find_light_states, read_lights, read_stop_lines
from geoaim.tracks.tracks import Tracks
from tests.prediction.tiny import TINY

WORLDS = st.sampled_from(
    [World(None), World(None, (3.5, -4.25)), World("EPSG:32635", (583000.0, 6062000.0))]
)
# spaces at both ends and line breaks are no part of a name
NAMES = st.text(st.characters(exclude_categories=["C", "Z"]), min_size=1, max_size=8)
METRES = st.floats(-1e5, 1e5)
LONGITUDES, LATITUDES = st.floats(-179, 179), st.floats(-84, 84)


@st.composite
def draw_tracks(draw) -> dict:
    """Fields of up to four agents at up to five times, each present at some time."""
    ids = draw(st.lists(NAMES, min_size=1, max_size=4, unique=True))
    count, steps = len(ids), draw(st.integers(1, 5))
    ticks = draw(st.lists(st.integers(0, 10**6), min_size=steps, max_size=steps, unique=True))
    present = draw(arrays(bool, (count, steps)))
    index = np.arange(max(count, steps))
    present[index % count, index % steps] = True  # each agent and each time has a state
    states = draw(arrays(np.float64, (count, steps, 4), elements=METRES))
    states[..., 2] = np.arctan2(states[..., 2], states[..., 3])
    return {
        "times": np.sort(ticks) / 1000,
        "states": np.where(present[..., None], states, np.nan),
        "present": present,
        "sizes": draw(arrays(np.float64, (count, 2), elements=st.floats(0.1, 50))),
        "types": tuple(draw(st.lists(NAMES, min_size=count, max_size=count))),
        "ids": tuple(ids),
        "world": draw(WORLDS),
    }


@given(fields=draw_tracks(), suffix=st.sampled_from([".csv", ".parquet"]))
def test_tracks(fields, suffix):
    tracks = Tracks(**fields)
    with TemporaryDirectory() as folder:
        path = Path(folder, f"tracks{suffix}")
        write_tracks(tracks, path)
        again = read_plain_tracks(path)
    order = [again.ids.index(name) for name in tracks.ids]
    assert again.world == tracks.world
    assert tuple(again.types[k] for k in order) == tracks.types
    np.testing.assert_array_equal(again.times, tracks.times)
    np.testing.assert_array_equal(again.present[order], tracks.present)
    half = 0.0 if suffix == ".parquet" else 0.5001
    for number, name in enumerate(("x", "y", "heading", "speed")):
        found, wanted = again.states[order][..., number], tracks.states[..., number]
        step = half * 10.0 ** -CSV_DECIMALS[name]
        if name == "heading":
            found = wanted + (found - wanted + 1) % (2 * np.pi) - 1
        np.testing.assert_allclose(found, wanted, rtol=1e-15, atol=step + 1e-14)
    step = half * 10.0 ** -CSV_DECIMALS["length"]
    np.testing.assert_allclose(again.sizes[order], tracks.sizes, rtol=1e-15, atol=step + 1e-14)


@given(
    image=arrays(np.uint8, st.tuples(st.integers(1, 9), st.integers(1, 9), st.just(3))),
    matrix=arrays(np.float64, (2, 3), elements=METRES),
    world=WORLDS,
)
def test_texture(image, matrix, world):
    matrix[:, :2] += [[1e6, 0], [0, -1e6]]  # which has an inverse
    aim = AIM.from_image(image, np.vstack([matrix, [0, 0, 1]]), world, "test")
    with TemporaryDirectory() as folder:
        export_texture(aim, folder)
        frame = json.loads(Path(folder, "texture.json").read_text())
        picture = cv2.imread(str(Path(folder, frame["image"])), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(cv2.cvtColor(picture, cv2.COLOR_BGRA2RGB), image)
    assert (picture[..., 3] == 255).all()
    np.testing.assert_array_equal(frame["corners"], aim.corners)
    assert World(frame["world"]["crs"], tuple(frame["world"]["origin"])) == world


@given(seed=st.integers(0, 2**31), rate=st.floats(allow_nan=False), name=st.text())
def test_models_and_checkpoints(seed, rate, name):
    model = init_model(TINY, seed=seed)
    with TemporaryDirectory() as folder:
        path = Path(folder, "model.pt")
        write_model(model, path)
        again = read_model(path)
        state = {"weights": model.state_dict(), "rate": rate, "log": [[seed, name]]}
        write_state(state, path)
        read = read_state(path)
    assert again.config == TINY
    for one, other in zip(model.parameters(), again.parameters(), strict=True):
        assert torch.equal(one.half().float(), other)
    assert (read["rate"], read["log"]) == (rate, [[seed, name]])
    assert all(torch.equal(read["weights"][key], value) for key, value in state["weights"].items())


POINTS = st.lists(
    st.tuples(st.floats(0, 8000), st.floats(0, 8000), LONGITUDES, LATITUDES), min_size=1
)
POINT_FILES = {
    "points.csv": ("name,u,v,lon,lat\n", "p,{u!r},{v!r},{x!r},{y!r}\n", 0.0),
    "gcp_list.txt": ("EPSG:4326\n", "{x!r} {y!r} 0 {u!r} {v!r} a.jpg p\n", 0.5),
    "points.points": (
        "#CRS: EPSG:4326\nmapX,mapY,sourceX,sourceY,enable\n",
        "{x!r},{y!r},{u!r},-{v!r},1\n",
        0.0,
    ),
}


@given(points=POINTS, name=st.sampled_from(sorted(POINT_FILES)))
def test_control_points(points, name):
    header, line, shift = POINT_FILES[name]
    lines = [line.format(u=u, v=v, x=x, y=y) for u, v, x, y in points]
    with TemporaryDirectory() as folder:
        path = Path(folder, name)
        path.write_text(header + "".join(lines))
        rows = read_point_file(path)
    assert [(*row.pixel, *row.coordinates) for row in rows] == [
        (u + shift, v + shift, x, y) for u, v, x, y in points
    ]
    assert {row.crs for row in rows} == {"EPSG:4326"}


@given(
    times=st.lists(st.integers(0, 10**6), min_size=1, max_size=6, unique=True),
    signals=st.lists(NAMES, min_size=1, max_size=3, unique=True),
    data=st.data(),
)
def test_lights(times, signals, data):
    times = np.sort(times) / 1000
    shape = (len(times), len(signals))
    states = data.draw(arrays(np.int8, shape, elements=st.integers(0, 2)))
    rows = [
        {"time": time, "signal": signal, "state": STATES[state]}
        for time, row in zip(times, states, strict=True)
        for signal, state in zip(signals, row, strict=True)
    ]
    lines = [StopLine(signal, np.array([[k, 0.0], [k, 3.0]])) for k, signal in enumerate(signals)]
    with TemporaryDirectory() as folder:
        path = Path(folder, "lights.csv")
        pd.DataFrame(rows).to_csv(path, index=False)
        lights = read_lights(path, lines, World(None))
    assert lights.names == tuple(signals)
    np.testing.assert_array_equal(find_light_states(lights, times), states)


@given(
    ends=st.lists(arrays(np.float64, (2, 2), elements=st.floats(-3000, 3000)), min_size=1),
    signals=st.lists(NAMES, min_size=9, max_size=9),
)
def test_stop_lines(ends, signals):
    """To a tenth of a millimetre, in longitude and latitude of 9 decimals."""
    world = World("EPSG:32635", (583000.0, 6062000.0))
    assume(all(np.ptp(line, axis=0).max() > 1 for line in ends))
    lonlat = [lonlat_from_world(world, line).round(9).tolist() for line in ends[:9]]
    features = [
        {
            "type": "Feature",
            "properties": {"signal": signal},
            "geometry": {"type": "LineString", "coordinates": line},
        }
        for signal, line in zip(signals, lonlat, strict=False)
    ]
    with TemporaryDirectory() as folder:
        path = Path(folder, "lines.geojson")
        path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
        lines = read_stop_lines(path, world)
    assert [line.signal for line in lines] == signals[: len(lonlat)]
    for line, wanted in zip(lines, ends, strict=False):
        np.testing.assert_allclose(line.ends, wanted, atol=2e-4)


@given(points=arrays(np.float64, (6, 2), elements=st.floats(-3000, 3000)))
def test_maps(points):
    """To a tenth of a millimetre, in longitude and latitude of 9 decimals."""
    assume(np.ptp(points, axis=0).max() > 1e-3)  # all nodes at one place are refused
    world = World("EPSG:32635", (583000.0, 6062000.0))
    nodes = "".join(
        f'<node id="{k}" lon="{lon:.9f}" lat="{lat:.9f}"/>'
        for k, (lon, lat) in enumerate(lonlat_from_world(world, points))
    )
    ways = "".join(
        f"<way id='{way}'>{''.join(f'<nd ref={str(k)!r}/>' for k in refs)}</way>"
        for way, refs in (("a", (0, 1, 2)), ("b", (3, 4, 5)))
    )
    lanelet = (
        '<relation id="9"><member role="left" ref="a"/><member role="right" ref="b"/>'
        '<tag k="type" v="lanelet"/></relation>'
    )
    with TemporaryDirectory() as folder:
        path = Path(folder, "map.osm")
        path.write_text(f"<osm>{nodes}{ways}{lanelet}</osm>")
        hdmap = read_hdmap(path, world)
    for line, wanted in zip(hdmap.lines, (points[:3], points[3:]), strict=True):
        np.testing.assert_allclose(line.points, wanted, atol=2e-4)
