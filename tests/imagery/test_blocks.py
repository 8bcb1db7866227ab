import numpy as np

from geoaim.imagery.mosaic import read_imagery
from tests.imagery.painted_ground import WORLD, misplaced, ortho, painted, place_around, write


def test_coarse_grids_follow_curved_projections(tmp_path):
    place = place_around("EPSG:4326", 80.0, (250, 250))
    path = write(
        tmp_path / "a.tif", painted("EPSG:4326", place, (250, 250), 3000.0), "EPSG:4326", place
    )
    assert misplaced(read_imagery(path, world=WORLD, resolution=100.0), 3000.0, 6) < 0.03


def test_blocks_meet_without_a_seam(tmp_path, monkeypatch):
    path = ortho(tmp_path / "a.tif", "EPSG:4326")
    for resolution in (0.4, 1.3):
        whole = read_imagery(path, world=WORLD, resolution=resolution)
        with monkeypatch.context() as small:
            small.setattr("geoaim.imagery.blocks.BLOCK_PX", 64)
            parts = read_imagery(path, world=WORLD, resolution=resolution)
        both = (whole.coverage > 0) & (parts.coverage > 0)
        assert both.sum() > whole.coverage.sum() - 9  # on the very edge either may be right
        assert np.abs(whole.image[both].astype(int) - parts.image[both]).max() <= 2
