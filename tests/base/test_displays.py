"""What objects show of themselves: repr, HTML and plots."""

import base64
import re
from dataclasses import replace
from itertools import combinations

import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure
from mpl_toolkits.axes_grid1.anchored_artists import AnchoredSizeBar

import geoaim
from geoaim.base.displays import Display
from geoaim.base.errors import GeoreferenceError
from geoaim.base.geometry import translation
from geoaim.base.labels import label_points
from geoaim.base.map_axes import add_legend, add_scale_bar, draw_drift, draw_lines, move_to_axes
from geoaim.base.world import World, change_world, world_from_lonlat
from geoaim.mapping.georeference.estimate import estimate_georeference
from geoaim.mapping.georeference.georeference import world_from_pixels
from geoaim.mapping.registration.register import register
from tests.aim.test_aim import make_aim

matplotlib.use("Agg")


@pytest.fixture(scope="module")
def shown() -> dict[str, Display]:
    tracks = geoaim.read_tracks("samples/tracks.csv")
    hdmap = geoaim.read_hdmap("samples/map.osm")
    lights = geoaim.read_lights("samples/lights.csv", hdmap.stop_lines, hdmap.world)
    aim = geoaim.draw_hdmap(hdmap, resolution=0.5)
    images = [frame.image for frame in geoaim.open_video("samples/hover.mp4").sample(2)]
    scene = geoaim.make_scene(aim, tracks, lights)
    found = [aim, tracks, hdmap, lights, register(images), scene]
    return {type(one).__name__: one for one in found}


KINDS = ["AIM", "HDMap", "Lights", "Registration", "Scene", "Tracks"]


@pytest.mark.parametrize("kind", KINDS)
def test_repr_is_a_line_and_html_has_a_picture_and_all_facts(shown, kind):
    display = shown[kind]
    text = repr(display)
    assert text.startswith(f"<{kind}: ")
    assert len(text) < 300
    assert "\n" not in text
    html = display._repr_html_()
    picture = base64.b64decode(re.search('base64,([^"]+)', html)[1])
    assert picture.startswith(b"\x89PNG")
    assert int.from_bytes(picture[16:20]) < 600
    assert all(f"{name}</td>" in html for name in display.summarize())


def test_georeference_shows_the_outline_of_its_image_and_its_errors():
    points = geoaim.read_control_points("samples/gcps.csv")
    georeference = estimate_georeference(points, height=720, width=1280)
    assert "control points 16 of 16 used" in repr(georeference)
    axes = georeference.plot(Figure().add_subplot())
    lines, crosses = axes.collections
    np.testing.assert_allclose(
        lines.get_paths()[0].vertices[0], world_from_pixels(georeference, np.zeros((1, 2)))[0]
    )
    places = np.asarray(crosses.get_offsets())
    given = world_from_lonlat(georeference.world, points.coordinates)
    np.testing.assert_allclose(places, given, atol=1e-6)
    assert np.linalg.norm(georeference.residuals, axis=1).max() > 1e-5  # a sign would show
    labels = [text.get_text() for text in axes.get_legend().get_texts()]
    assert labels == ["outline of the image", "control points, used"]
    [middle] = [text for text in axes.texts if text.get_text().startswith("middle")]
    assert middle.xy == pytest.approx(world_from_pixels(georeference, np.array([[640, 360.0]]))[0])


def test_facts_are_escaped_in_html():
    assert "<script>" not in make_aim(report={"registration": SCRIPT})._repr_html_()


SCRIPT = {"model": "<script>", "valid": 1, "frames": 1, "uncertainty_px": 0.1}


def test_tracks_on_the_axes_of_an_aim_with_another_origin_lie_where_they_belong(shown):
    tracks, aim = shown["Tracks"], shown["AIM"]
    assert tracks.world.origin != aim.world.origin
    axes = aim.plot(Figure().add_subplot())
    assert tracks.plot(axes) is axes
    drawn = np.concatenate(
        [path.vertices for lines in axes.collections for path in lines.get_paths()]
    )
    moved = tracks.states[tracks.present, :2] + tracks.world.origin - np.array(aim.world.origin)
    np.testing.assert_allclose(np.nanmin(drawn, axis=0), moved.min(axis=0), atol=1e-6)
    assert axes.get_aspect() == 1.0
    assert "m" in axes.get_xlabel()


def test_image_and_corners_agree_also_with_perspective():
    tilted = translation(0.0, 0.0)
    tilted[2, 0] = 1e-4
    aim = replace(make_aim(), world_from_image=make_aim().world_from_image @ tilted)
    [image] = aim.plot(Figure().add_subplot()).images
    left, right, bottom, top = image.get_extent()
    low, high = aim.corners.min(axis=0), aim.corners.max(axis=0)
    np.testing.assert_allclose([left, bottom, right, top], [*low, *high], atol=aim.resolution)


def test_plot_makes_axes_of_its_own(shown):
    axes = shown["HDMap"].plot()
    assert axes.get_legend().texts[0].get_text() == "lanes"
    matplotlib.pyplot.close(axes.figure)


def test_axes_refuse_what_has_no_crs():
    axes = Figure().add_subplot()
    move_to_axes(axes, np.zeros((1, 2)), World("EPSG:32635"))
    with pytest.raises(GeoreferenceError, match="give both a CRS"):
        move_to_axes(axes, np.zeros((1, 2)), World(None))


def test_worlds_of_other_origins_and_zones_are_changed_exactly():
    here, there = World("EPSG:32635", (500_000.0, 6e6)), World("EPSG:32634", (900_000.0, 6e6))
    points = np.array([[10.0, 20.0], [30.0, -5.0]])
    np.testing.assert_allclose(
        change_world(there, here, change_world(here, there, points)), points, atol=1e-3
    )
    np.testing.assert_allclose(
        change_world(here, replace(here, origin=(500_001.0, 6e6)), points), points - [1.0, 0.0]
    )


def test_lines_have_one_entry_in_the_legend_and_names_do_not_cover_each_other():
    figure = Figure()
    axes = figure.add_subplot()
    draw_lines(axes, [np.zeros((2, 2)), np.ones((2, 2))], "red", label="lines")
    assert axes.get_legend_handles_labels()[1] == ["lines"]
    first, second = label_points(axes, np.array([[0.5, 0.5], [0.5, 0.51]]), ["one", "two"])
    boxes = [text.get_window_extent() for text in (first, second)]
    assert not boxes[0].overlaps(boxes[1])


def test_the_scale_bar_does_not_cross_its_text():
    for size, dpi in (((9, 6), 100), ((5.6, 3.6), 80), ((8, 8), 200)):
        figure = Figure(figsize=size, dpi=dpi)
        axes = figure.add_subplot(xlim=(0, 165), ylim=(0, 194))
        add_scale_bar(axes)
        figure.draw_without_rendering()
        [bar] = [artist for artist in axes.artists if isinstance(artist, AnchoredSizeBar)]
        bottom = min(child.get_window_extent().y0 for child in bar.size_bar.get_children())
        text = bar.txt_label.get_children()[0]
        top = text.get_window_extent().y1
        assert bottom > top


def test_north_is_named_where_the_world_has_a_crs():
    for crs, label, text in (
        ("EPSG:32635", "y (north), m", "0.2 m, north up"),
        (None, "y, m", "0.2 m"),
    ):
        axes = Figure().add_subplot()
        move_to_axes(axes, np.zeros((1, 2)), World(crs, (0.0, 0.0)))
        add_scale_bar(axes)
        [bar] = [artist for artist in axes.artists if isinstance(artist, AnchoredSizeBar)]
        assert (axes.get_ylabel(), bar.txt_label.get_text()) == (label, text)


def test_pale_lines_are_outlined_on_the_map_and_in_the_legend():
    axes = Figure().add_subplot()
    draw_lines(axes, [np.zeros((2, 2))], "white", label="recorded", outlined=True)
    draw_lines(axes, [np.ones((2, 2))], "red", label="futures")
    add_legend(axes)
    outlined, plain = axes.get_legend().legend_handles
    assert len(outlined.get_path_effects()) == 1
    assert not plain.get_path_effects()


def test_names_of_many_near_points_cover_neither_each_other_nor_marks():
    figure = Figure(figsize=(4.6, 3.8), layout="constrained")
    axes = figure.add_subplot(xlim=(2, 400), ylim=(0.003, 12), xscale="log", yscale="log")
    points = np.array([[22, 4.1], [10.2, 0.33], [43, 0.46], [45.5, 0.285], [55, 0.28], [160, 0.17]])
    names = [
        "phase correlation",
        "ECC quarter",
        "stabilo",
        "stabilo with boxes",
        "ORB",
        "SIFT half",
    ]
    figure.draw_without_rendering()
    boxes = [text.get_window_extent() for text in label_points(axes, points, names)]
    assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))
    assert not any(
        box.contains(*mark) for box in boxes for mark in axes.transData.transform(points)
    )


def test_drift_is_drawn_from_its_origin():
    axes = Figure().add_subplot()
    draw_drift(axes, np.arange(2.0), np.array([[0.0, 0.0], [5.0, 1.0]]), "first frame")
    assert "up to 5 px" in axes.get_title(loc="left")
