"""The benchmarks of catalogues on tiny input."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

pytest.importorskip("distributed", reason="the extra catalog is not installed")

from benchmarks.catalog import benchmark as catalog
from benchmarks.catalog import days, unit_costs
from benchmarks.catalog import losses as catalog_losses
from geoaim.aim.aim import AIM
from geoaim.base.geometry import translation
from geoaim.base.world import World

pytestmark = pytest.mark.slow


def test_recordings_have_the_planted_bad_ones(tmp_path):
    table = catalog.write_recordings(tmp_path / "clips", catalog.BAD + 1)
    assert len(table.read_text().splitlines()) == catalog.BAD + 2
    assert len(list(table.parent.glob("clip_*.mp4"))) == catalog.DISTINCT_CLIPS


def test_many_rows_are_listed_hashed_and_refused(tmp_path):
    row = catalog.measure_rows(tmp_path / "rows", 10)
    assert row["rows"] == 10
    assert row["listed, s"] + row["hashed, s"] < row["all done (refused), s"]


def test_losses_watch_records_for_a_second_build(tmp_path):
    record = tmp_path / "recordings" / "place" / "record.json"
    record.parent.mkdir(parents=True)
    watch = catalog_losses.RecordWatch(tmp_path)
    for content in ("a", "ab"):
        record.write_text(content)
        watch.look()
        watch.look()
    assert watch.count_twice() == 1


def test_plans_multiply_the_costs():
    costs = unit_costs.Costs(
        build_s=3600.0,
        build_bytes=1e9,
        align_s_per_km2=3600.0,
        imagery_bytes_per_pixel=2.0,
        hash_bytes_per_s=1e9,
    )
    assumed = unit_costs.Assumptions(country_km2=100.0, road_share=0.1, recordings_per_day=24)
    whole, roads = unit_costs.plan_country(costs, assumed)
    assert (whole["core hours"], roads["core hours"]) == (100, 10)
    assert whole["maps, TB"] == pytest.approx(100e6 / 0.04 * 2 / 1e12, abs=0.1)
    day = unit_costs.plan_recordings(costs, assumed)[0]
    assert day["core hours"] == pytest.approx(24.0, abs=0.1)
    assert day["binds first"] == "cores"


def test_days_are_measured_apart(tmp_path):
    generator = np.random.default_rng(0)
    ground = cv2.GaussianBlur(generator.integers(0, 256, (400, 600, 3), np.uint8), (0, 0), 2)
    ground = cv2.normalize(ground, None, 0, 255, cv2.NORM_MINMAX)
    first = AIM.from_image(ground, np.diag([0.1, -0.1, 1.0]), World(None), "ground")
    moved = replace(first, world_from_image=translation(0.3, 0.1) @ first.world_from_image)
    apart = days.measure_distances(moved, first)
    assert len(apart) > 20
    np.testing.assert_allclose(np.abs(np.median(apart, axis=0)), [0.3, 0.1], atol=0.01)
