import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import geoaim
from geoaim.errors import AlignmentError, GeoaimWarning, GeoreferenceError
from geoaim.geometry import transform_points
from geoaim.mapping.aligning import align_tiles
from geoaim.mapping.alignment import Prior
from geoaim.mapping.hdmap import read_hdmap
from geoaim.mapping.hdmap_image import draw_hdmap
from geoaim.quicklook import draw_alignment, summary
from geoaim.track_changes import tracks_in
from geoaim.world import World, lonlat_from_world
from tests.mapping.alignment_pairs import as_aim

TRUTH = json.loads(Path("samples/truth.json").read_text())
OFFSET = np.array(TRUTH["imagery"]["offset_east_north_m"])
TRACKS = "samples/tracks.csv"


@pytest.fixture(scope="module")
def aim():
    """The sample's clean background where its truth lays it."""
    with Image.open("samples/background.jpg") as file:
        image = np.array(file)
    world = World(TRUTH["crs"], tuple(TRUTH["origin"]))
    return as_aim(image, np.load("samples/truth.npz")["world_from_frame"][0], world)


def test_an_aim_lays_the_samples_orthophoto(aim):
    found = align_tiles("samples/ortho.tif", aim=aim, resolution=0.3)
    said = found.report["alignment"]["aim"]
    np.testing.assert_allclose(said["shift_m"], -OFFSET, atol=0.1)
    assert said["model"] == "translation"
    assert found.world == aim.world
    assert "by aim" in summary(found)


def test_tracks_check_what_an_aim_has_laid(aim):
    tracks = geoaim.read_tracks(TRACKS)
    found = align_tiles("samples/ortho.tif", aim=aim, tracks=tracks, resolution=0.3)
    said = found.report["alignment"]["tracks"]
    assert said["checked"]
    assert said["agrees"]
    figure = draw_alignment(found, aim=aim, tracks=tracks_in(tracks, found.world))
    assert [axes.get_title() for axes in figure.axes] == ["as stated", "aligned"]


def test_tracks_alone_lay_the_samples_tiles():
    tracks = geoaim.read_tracks(TRACKS)
    found = align_tiles("samples/tiles", tracks=tracks, resolution=0.3, prior=Prior(10.0, 0.05))
    said = found.report["alignment"]["tracks"]
    assert np.linalg.norm(said["shift_m"] + OFFSET) < min(said["uncertainty_m"], 0.6)
    assert found.world == tracks.world


def _picked(tmp_path, world_from_image, world, wrong=0.0):
    """Control points of the orthophoto's own pixels, where these truly are."""
    pixels = np.array([[40, 50], [330, 60], [310, 290], [60, 300], [180, 170], [250, 120.0]])
    places = transform_points(world_from_image, pixels) + np.array([wrong, 0.0])
    lonlat = lonlat_from_world(world, places)
    rows = [
        f"p{k},{u},{v},{lon:.9f},{lat:.9f}"
        for k, ((u, v), (lon, lat)) in enumerate(zip(pixels, lonlat, strict=True))
    ]
    path = tmp_path / "gcps.csv"
    path.write_text("name,u,v,lon,lat\n" + "\n".join(rows) + "\n")
    return path


@pytest.fixture(scope="module")
def picture(aim, tmp_path_factory):
    """A screenshot: an orthophoto that does not say where it lies, but laid by us."""
    laid = align_tiles("samples/ortho.tif", aim=aim, resolution=0.5)
    path = tmp_path_factory.mktemp("shot") / "shot.png"
    Image.fromarray(laid.image).save(path)
    return path, laid


def test_control_points_lay_a_picture_and_an_aim_checks_them(picture, aim, tmp_path):
    path, laid = picture
    gcps = _picked(tmp_path, laid.world_from_image, laid.world)
    found = align_tiles(str(path), gcps=gcps, aim=aim)
    np.testing.assert_allclose(found.corners, laid.corners, atol=0.1)
    assert found.report["alignment"]["aim"]["agrees"]
    assert found.report["georeference"]["points"]
    wrong = _picked(tmp_path, laid.world_from_image, laid.world, wrong=6.0)
    with pytest.warns(GeoaimWarning, match="by the aim the imagery would lie -6.0"):
        found = align_tiles(str(path), gcps=wrong, aim=aim)
    assert not found.report["alignment"]["aim"]["agrees"]
    np.testing.assert_allclose(found.corners, laid.corners + np.array([6.0, 0.0]), atol=0.1)


def test_evidence_that_cannot_check_is_said(picture, aim, tmp_path):
    path, laid = picture
    gcps = _picked(tmp_path, laid.world_from_image, laid.world)
    noise = np.random.default_rng(0).integers(0, 255, aim.image.shape, np.uint8)
    with pytest.warns(GeoaimWarning, match="could not check the place"):
        found = align_tiles(str(path), gcps=gcps, aim=replace(aim, image=noise))
    assert not found.report["alignment"]["aim"]["checked"]


def test_without_evidence_imagery_stays_where_it_says():
    found = align_tiles("samples/ortho.tif", resolution=0.5)
    assert "alignment" not in found.report
    assert found.world.crs == TRUTH["crs"]


def test_an_hd_map_is_no_reason_to_lay_imagery_anywhere(aim):
    """Drawn lines have little in common with a picture: refused, or right, but never wrong."""
    world = aim.world
    drawn = draw_hdmap(read_hdmap("samples/map_full.osm", world), resolution=0.3)
    try:
        found = align_tiles("samples/ortho.tif", aim=drawn, resolution=0.5)
    except AlignmentError:
        return
    np.testing.assert_allclose(found.report["alignment"]["aim"]["shift_m"], -OFFSET, atol=1.0)


def test_control_points_are_of_one_picture():
    with pytest.raises(ValueError, match="pixels of one picture; give one file"):
        align_tiles(["a.tif", "b.tif"], gcps="gcps.csv")
    with pytest.raises(GeoreferenceError):
        align_tiles("samples/background.jpg", gcps=[])
