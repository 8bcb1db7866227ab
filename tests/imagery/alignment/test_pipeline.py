import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

import geoaim
from geoaim.base.errors import (
    AlignmentError,
    GeoaimWarning,
    GeoreferenceError,
    ImageryError,
    TracksError,
)
from geoaim.base.geometry import make_similarity, transform_points
from geoaim.base.world import World, lonlat_from_world
from geoaim.hdmap.lanelet2 import read_hdmap
from geoaim.hdmap.rasterize import draw_hdmap
from geoaim.imagery.alignment.before_after import draw_alignment
from geoaim.imagery.alignment.pipeline import Shift, align_tiles
from geoaim.imagery.alignment.result import Prior
from geoaim.tracks.changes import to_world
from tests.imagery.alignment.alignment_pairs import as_aim

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


def test_aim_corrects_the_position_of_the_sample_orthophoto(aim):
    found = align_tiles("samples/ortho.tif", aim=aim, resolution=0.3)
    said = found.report["alignment"]["aim"]
    np.testing.assert_allclose(said["shift_m"], -OFFSET, atol=0.1)
    assert said["model"] == "translation"
    assert found.world == aim.world
    assert "alignment by aim" in found.summarize()
    assert "position" not in found.summarize()


def test_a_map_of_a_video_keeps_its_coverage_doubt_and_report(aim, tmp_path):
    generator = np.random.default_rng(2)
    ground = geoaim.rectify(aim, 0.2)
    size = ground.coverage.shape
    moved = make_similarity(ground.corners.mean(axis=0), 0.02, 1.01) @ ground.world_from_image
    moved[:2, 2] += (2.0, -3.0)
    georeference = {"corner_uncertainty_m": [4.0] * 4}
    built = replace(
        ground,
        world_from_image=moved,
        coverage=generator.integers(1, 64, size).astype(np.uint16),
        contested=generator.random(size) < 0.01,
        report={"background": {"frames_used": 64}, "georeference": georeference},
    )
    geoaim.write_aim(built, tmp_path / "map.tif")
    found = align_tiles(tmp_path / "map.tif", aim=aim)
    np.testing.assert_allclose(found.corners, ground.corners, atol=0.3)
    for name in ("image", "coverage", "contested"):
        np.testing.assert_array_equal(getattr(found, name), getattr(built, name))
    assert found.report["background"] == {"frames_used": 64}
    assert found.report["before_alignment"] == {"georeference": georeference}
    assert "georeference" not in found.report
    by_hand = align_tiles(tmp_path / "map.tif", shift=Shift(1.0, 2.0))
    np.testing.assert_allclose(by_hand.corners, built.corners + np.array([1.0, 2.0]), atol=1e-6)
    coarse = align_tiles(tmp_path / "map.tif", aim=aim, resolution=0.5)  # as any imagery
    assert coarse.resolution == pytest.approx(0.5, rel=0.02)


@pytest.mark.slow
def test_tracks_check_an_alignment_by_an_aim(aim):
    tracks = geoaim.read_tracks(TRACKS)
    found = align_tiles("samples/ortho.tif", aim=aim, tracks=tracks, resolution=0.3)
    said = found.report["alignment"]["tracks"]
    assert said["checked"]
    assert said["agrees"]
    figure = draw_alignment(found, aim=aim, tracks=to_world(tracks, found.world))
    assert [axes.get_title() for axes in figure.axes[:2]] == ["as stated", "aligned"]
    assert figure.axes[2].get_title("left").startswith("residuals of")


def test_tracks_alone_correct_the_position_of_the_sample_tiles():
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
    """A screenshot: an orthophoto that does not say where it lies, but aligned by us."""
    aligned = align_tiles("samples/ortho.tif", aim=aim, resolution=0.5)
    path = tmp_path_factory.mktemp("shot") / "shot.png"
    Image.fromarray(aligned.image).save(path)
    return path, aligned


def test_control_points_place_a_picture_and_an_aim_checks_them(picture, aim, tmp_path):
    path, aligned = picture
    gcps = _picked(tmp_path, aligned.world_from_image, aligned.world)
    found = align_tiles(str(path), gcps=gcps, aim=aim)
    np.testing.assert_allclose(found.corners, aligned.corners, atol=0.1)
    assert found.report["alignment"]["aim"]["agrees"]
    assert found.summarize()["check by aim"].startswith("agrees: corners 0.0")
    assert found.report["georeference"]["points"]
    wrong = _picked(tmp_path, aligned.world_from_image, aligned.world, wrong=6.0)
    with pytest.warns(GeoaimWarning, match="its middle -6.0. m east"):
        found = align_tiles(str(path), gcps=wrong, aim=aim)
    assert not found.report["alignment"]["aim"]["agrees"]
    assert found.summarize()["check by aim"].startswith("DISAGREES: corners 6.")
    np.testing.assert_allclose(found.corners, aligned.corners + np.array([6.0, 0.0]), atol=0.1)


@pytest.mark.parametrize(("name", "degrees", "zoom"), [("aim", 2.0, 1.03), ("tracks", 3.0, 1.0)])
def test_control_points_that_rotate_or_scale_the_picture_are_doubted(
    picture, aim, tmp_path, name, degrees, zoom
):
    """The middle stays where it is; only the corners tell."""
    path, aligned = picture
    turned = make_similarity(aligned.corners.mean(axis=0), np.radians(degrees), zoom)
    gcps = _picked(tmp_path, turned @ aligned.world_from_image, aligned.world)
    given = {"aim": aim, "tracks": geoaim.read_tracks(TRACKS)}
    with pytest.warns(GeoaimWarning, match=f"by the {name} the imagery's corners"):
        found = align_tiles(str(path), gcps=gcps, **{name: given[name]})
    said = found.report["alignment"][name]
    assert not said["agrees"]
    assert np.linalg.norm(said["shift_m"]) < 1
    assert said["corner_offset_m"] > 3
    assert said["corner_uncertainty_m"] < said["corner_offset_m"]


def test_tracks_do_not_doubt_right_control_points(picture, tmp_path):
    path, aligned = picture
    gcps = _picked(tmp_path, aligned.world_from_image, aligned.world)
    found = align_tiles(str(path), gcps=gcps, tracks=geoaim.read_tracks(TRACKS))
    assert found.report["alignment"]["tracks"]["agrees"]


def test_failed_check_is_reported(picture, aim, tmp_path):
    path, aligned = picture
    gcps = _picked(tmp_path, aligned.world_from_image, aligned.world)
    noise = np.random.default_rng(0).integers(0, 255, aim.image.shape, np.uint8)
    with pytest.warns(GeoaimWarning, match="could not check the place"):
        found = align_tiles(str(path), gcps=gcps, aim=replace(aim, image=noise))
    assert not found.report["alignment"]["aim"]["checked"]
    assert found.summarize()["check by aim"].startswith("not possible: ")


def test_without_evidence_imagery_keeps_its_georeference():
    found = align_tiles("samples/ortho.tif", resolution=0.5)
    assert "alignment" not in found.report
    assert found.world.crs == TRUTH["crs"]
    assert found.summarize()["position"].startswith("not aligned")


@pytest.mark.slow
def test_imagery_is_not_misplaced_by_a_drawn_hd_map(aim):
    """Drawn lines have little in common with a picture: refused, or right, but never wrong."""
    world = aim.world
    drawn = draw_hdmap(read_hdmap("samples/map_full.osm", world), resolution=0.3)
    try:
        found = align_tiles("samples/ortho.tif", aim=drawn, resolution=0.5)
    except AlignmentError:
        return
    np.testing.assert_allclose(found.report["alignment"]["aim"]["shift_m"], -OFFSET, atol=1.0)


def test_control_points_need_one_picture():
    with pytest.raises(ValueError, match="pixels of one image; give one file"):
        align_tiles(["a.tif", "b.tif"], gcps="gcps.csv")
    with pytest.raises(GeoreferenceError):
        align_tiles("samples/background.jpg", gcps=[])
    with pytest.raises(ImageryError, match=r"absent\.jpg: there is no such file"):
        align_tiles("absent.jpg", gcps="samples/gcps.csv")
    with pytest.raises(ImageryError, match="tiles is a folder; control points refer"):
        align_tiles("samples/tiles", gcps="samples/gcps.csv")
    with pytest.raises(GeoreferenceError, match=r"absent\.csv: cannot be read"):
        align_tiles("samples/background.jpg", gcps="absent.csv")


def test_control_points_respect_resolution_and_crs(picture, tmp_path):
    path, aligned = picture
    gcps = _picked(tmp_path, aligned.world_from_image, aligned.world)
    found = align_tiles(str(path), gcps=gcps, resolution=1.0)
    np.testing.assert_allclose(found.world_from_image[:2, :2], [[1, 0], [0, -1]], atol=1e-9)
    pixels = np.array([[40, 50], [330, 60], [310, 290], [60, 300], [180, 170], [250, 120.0]])
    places = transform_points(aligned.world_from_image, pixels) + aligned.world.origin
    rows = np.column_stack([pixels, places])
    np.savetxt(gcps, rows, "%.4f", ",", header="u,v,x,y", comments="")
    with pytest.raises(GeoreferenceError, match="no coordinate reference system"):
        align_tiles(str(path), gcps=gcps)
    found = align_tiles(str(path), gcps=gcps, crs=aligned.world.crs)
    assert found.world.crs == aligned.world.crs
    np.testing.assert_array_equal(found.image, aligned.image)


def test_masked_pixels_are_not_covered_and_16_bits_are_stretched(picture, tmp_path):
    _, aligned = picture
    gcps = _picked(tmp_path, aligned.world_from_image, aligned.world)
    alpha = np.full(aligned.image.shape[:2], 255, np.uint8)
    alpha[:50] = 0
    Image.fromarray(np.dstack([aligned.image, alpha])).save(tmp_path / "holes.png")
    found = align_tiles(str(tmp_path / "holes.png"), gcps=gcps)
    np.testing.assert_array_equal(found.coverage > 0, alpha > 0)
    np.testing.assert_array_equal(found.image[60:], aligned.image[60:])
    deep = aligned.image[..., 1].astype(np.uint16) * 16
    Image.fromarray(deep).save(tmp_path / "deep.png")
    found = align_tiles(str(tmp_path / "deep.png"), gcps=gcps)
    low, high = np.percentile(deep, [1, 99])
    stretched = np.clip((deep - low) * 255 / (high - low), 0, 255)
    np.testing.assert_allclose(found.image[..., 0], stretched, atol=1)
    Image.fromarray(np.dstack([aligned.image, alpha * 0])).save(tmp_path / "nothing.png")
    with pytest.raises(ImageryError, match="nothing but nodata or transparency"):
        align_tiles(str(tmp_path / "nothing.png"), gcps=gcps)


def test_at_most_two_frames_of_a_video_are_read(tmp_path, monkeypatch):
    def frames():
        for index in range(3):
            assert index < 2
            yield SimpleNamespace(image=np.zeros((4, 6, 3), np.uint8))

    monkeypatch.setattr("geoaim.imagery.alignment.by_control_points.open_video", lambda _: frames())
    with pytest.raises(ImageryError, match="has several images"):
        align_tiles(str(tmp_path / "a.mp4"), gcps=[((0, 0), (27.5, 53.9))])


def test_tracks_without_agents_are_refused():
    tracks = geoaim.read_tracks(TRACKS)
    no_agents = replace(tracks, present=np.zeros_like(tracks.present))
    with pytest.raises(TracksError, match="no agent is present"):
        align_tiles("samples/ortho.tif", tracks=no_agents)


def test_picture_that_is_an_orthophoto_is_known_better(picture, tmp_path):
    path, aligned = picture
    gcps = _picked(tmp_path, aligned.world_from_image, aligned.world)
    wide = align_tiles(str(path), gcps=gcps)
    known = align_tiles(str(path), gcps=gcps, similarity=True)
    places = [x.corners + x.world.origin for x in (known, aligned)]
    np.testing.assert_allclose(*places, atol=0.1)
    before, after = (max(x.report["georeference"]["corner_uncertainty_m"]) for x in (wide, known))
    assert after < before / 3
    with pytest.raises(ValueError, match="needs control points"):
        align_tiles("samples/ortho.tif", similarity=True)


def test_control_points_of_imagery_share_its_error(picture, tmp_path):
    path, aligned = picture
    gcps = _picked(tmp_path, aligned.world_from_image, aligned.world)
    alone = align_tiles(str(path), gcps=gcps).report["position"]
    gcps.write_text("# shared covariance: 0.04 0.01 9\n" + gcps.read_text())
    shared = align_tiles(str(path), gcps=gcps)
    position = shared.report["position"]
    added = np.array(position["covariance_m2"]) - alone["covariance_m2"]
    np.testing.assert_allclose(added, [[0.04, 0.01], [0.01, 9.0]], atol=1e-6)
    np.testing.assert_allclose(position["relative_covariance_m2"], alone["covariance_m2"])
    assert "at azimuth" in shared.summarize()["in the world (95 %)"]
    gcps.write_text("# shared covariance: 1 9 1\n" + gcps.read_text().split("\n", 1)[1])
    with pytest.raises(GeoreferenceError, match="the variance east, the covariance"):
        align_tiles(str(path), gcps=gcps)
