"""Pages by axe-core, light and dark: names, roles and contrasts."""

from contextlib import ExitStack
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import pytest

from geoaim.catalog.building import make_record
from geoaim.catalog.recordings import Recording
from geoaim.catalog.report import format_page
from geoaim.web.explore import make_map_view
from geoaim.web.map_view import make_page
from geoaim.web.picking.page import make_picking_view
from geoaim.web.picking.session import PickingTask
from tests.web.browser import open_view, serve, wait_for

VIDEO = Path(__file__).parents[2] / "samples/hover.mp4"
ALL = "{runOnly: ['wcag2a', 'wcag2aa', 'wcag21a', 'wcag21aa', 'wcag22aa', 'best-practice']}"


@pytest.fixture(scope="module")
def axe():
    pytest.importorskip("axe_playwright_python", reason="axe-playwright-python is not installed")
    return (files("axe_playwright_python") / "axe.min.js").read_text(encoding="utf-8")


def list_violations(page, axe, scheme):
    page.emulate_media(color_scheme=scheme)
    page.evaluate(axe)
    return page.evaluate(
        f"axe.run(document, {ALL}).then(({{violations}}) => violations.flatMap((rule) =>"
        "rule.nodes.map((node) => `${rule.id}: ${node.html} ${node.failureSummary}`)))"
    )


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_the_viewer_has_names_and_contrasts(page, aim, contents, axe, scheme):
    view = make_map_view(aim, replace(contents, video=VIDEO), ExitStack())
    with serve(view) as address:
        page.set_viewport_size({"width": 1280, "height": 720})
        open_view(page, address)
        wait_for(page, "Boolean(geoaim.marks)")
        page.locator("summary", has_text="Keys").click()
        page.get_by_label("count over a line").check()
        page.get_by_label("frames per pixel").check()
        page.evaluate("geoaim.select(geoaim.state.tracks.agents[0].id); geoaim.colour('speed')")
        assert list_violations(page, axe, scheme) == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_picking_has_names_and_contrasts(page, aim, axe, scheme):
    picking = make_picking_view(PickingTask(aim.image, imagery=aim), "points")
    with serve(picking) as address:
        open_view(page, address)
        page.evaluate("geoaim.ask({action: 'add', name: 'A', u: 30, v: 20})")
        wait_for(page, "document.querySelectorAll('.points tr').length === 2")
        assert list_violations(page, axe, scheme) == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_catalogue_has_names_and_contrasts(page, axe, scheme, tmp_path):
    records = [
        make_record(Recording(name, f"{name}.mp4"), status, "why")
        for name, status in (("a", "built"), ("b", "refused"), ("c", "failed"))
    ]
    (tmp_path / "report.html").write_text(format_page(records))
    page.goto((tmp_path / "report.html").as_uri())
    assert list_violations(page, axe, scheme) == []


def test_violations_are_found(page, axe, tmp_path):
    (tmp_path / "page.html").write_text(
        make_page("t").replace("</main>", "<button></button></main>")
    )
    page.goto((tmp_path / "page.html").as_uri())
    assert any(text.startswith("button-name") for text in list_violations(page, axe, "light"))
