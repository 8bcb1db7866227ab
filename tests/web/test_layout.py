"""The pages of the documentation's pictures: what they say, and that nothing covers a control."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

import geoaim
from geoaim.aim.files import write_aim
from geoaim.base.geometry import transform_points
from geoaim.base.world import world_from_lonlat
from tests.web.browser import wait_for

ROOT = Path(__file__).parents[2]
SIZES = ({"width": 1280, "height": 720}, {"width": 900, "height": 700})
# controls that are off the page, narrower than their text, or lie under something else
FAULTS = """[...document.querySelectorAll("button, input, select, summary, label")]
    .filter((item) => item.checkVisibility() && !item.matches(".mark, .scroll *, .ol-control *"))
    .filter((item) => {
        item.scrollIntoView({ block: "nearest" });
        const box = item.getBoundingClientRect();
        const [x, y] = [(box.left + box.right) / 2, (box.top + box.bottom) / 2];
        const top = document.elementFromPoint(x, y);
        const inside = box.left >= 0 && box.top >= 0
            && box.right <= innerWidth && box.bottom <= innerHeight;
        const fits = item.matches("input, select") || item.scrollWidth <= item.clientWidth + 1
            || getComputedStyle(item).display === "inline";
        return !inside || !fits || box.width < 1 || !(item.contains(top) || top.contains(item));
    }).map((item) => item.outerHTML)"""


@pytest.fixture
def pages(chromium):
    """The script of the documentation's pictures; its pages are judged instead of saved."""
    spec = importlib.util.spec_from_file_location("screenshots", ROOT / "docs/screenshots.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def count_shapes(page, name, place):
    """How many shapes a map of the page shows at a place."""
    x, y = place
    page.evaluate(f"geoaim.{name}.renderSync()")
    pixel = f"geoaim.{name}.getPixelFromCoordinate([{x}, {y}])"
    return page.evaluate(f"geoaim.{name}.getFeaturesAtPixel({pixel}, {{hitTolerance: 2}}).length")


def find_faults(page):
    found = []
    for size in SIZES:
        page.set_viewport_size(size)
        found += page.evaluate(FAULTS)
    return found


def test_every_control_of_the_viewer_can_be_reached(pages, aim, contents, tmp_path, monkeypatch):
    def judge(page, _):
        wait_for(page, pages.LOADED)
        assert find_faults(page) == []
        panel = page.locator(".panel").inner_text()
        assert [
            name for name in ("AIM", "drivable area", "tracks", "lights") if name not in panel
        ] == []
        chosen = page.evaluate("geoaim.state.selected.id")
        assert chosen in page.locator(".selection").inner_text()
        middle = page.evaluate("geoaim.view.getCenter()")
        vertices = np.vstack([line.points for line in contents.hdmap.lines])
        nearest = vertices[np.argmin(np.linalg.norm(vertices - middle, axis=1))]
        assert count_shapes(page, "map", nearest) > 0, "lines of the HD map are drawn"
        assert page.locator(".agent-view").evaluate("(image) => image.naturalWidth") > 0

    monkeypatch.setattr(pages, "save", judge)
    write_aim(aim, tmp_path / "aim.tif")
    pages.show_view(tmp_path / "aim.tif", tmp_path)


def test_picked_points_are_listed_and_marked_on_both_pictures(pages, tmp_path, monkeypatch):
    points = geoaim.read_control_points(ROOT / "samples/gcps.csv")
    imagery = geoaim.read_imagery(ROOT / "samples/ortho.tif")
    places = world_from_lonlat(imagery.world, points.coordinates)
    pixels = transform_points(np.linalg.inv(imagery.world_from_image), places)

    def judge(page, _):
        wait_for(
            page, f"document.querySelectorAll('.points tr').length === {len(pages.PICKED) + 1}"
        )
        assert find_faults(page) == []
        names = page.evaluate(
            "[...document.querySelectorAll('.points tr')].slice(1)"
            ".map((row) => row.querySelector('input').value)"
        )
        assert names == [points.names[index] for index in pages.PICKED]
        assert "Fitted" in page.locator(".message").inner_text()
        for index, name in enumerate(points.names):
            for side, (u, v) in (("frame", points.pixels[index]), ("imagery", pixels[index])):
                marked = count_shapes(page, f"{side}.map", (u, -v)) > 0
                assert marked or index not in pages.PICKED, (side, name)

    monkeypatch.setattr(pages, "save", judge)
    pages.show_picking(tmp_path)
