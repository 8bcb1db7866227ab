"""The documentation builds without warnings and agrees with the code."""

import ast
import json
import os
import re
import subprocess
import sys
from importlib import import_module
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Literal

import jsonschema
import numpy as np
import pytest

import geoaim
from benchmarks.prediction import EXPERIMENTS
from geoaim.aim.aim import AIM
from geoaim.base.world import World
from tests.waiting import wait_until

if TYPE_CHECKING:
    from playwright.sync_api import Page

ROOT = Path(__file__).parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md"), ROOT / "samples" / "README.md"])
FENCE = re.compile(r"^```(\w*)\n(.*?)^```", flags=re.M | re.S)


@pytest.fixture(scope="module")
def tables() -> ModuleType:
    """The functions that write the tables of the pages."""
    return _import_beside_pages("tables")


def _import_beside_pages(name: str) -> ModuleType:
    sys.path.insert(0, str(ROOT / "docs"))
    try:
        return import_module(name)
    finally:
        sys.path.remove(str(ROOT / "docs"))


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The documentation, built with every warning as an error."""
    folder = tmp_path_factory.mktemp("site")
    # with --quiet, --strict counts no warnings
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "-d", str(folder)]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1", "PYTHONPATH": str(ROOT)}
    result = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    return folder


@pytest.mark.slow
def test_site_shows_modules_commands_fields_and_decisions(site: Path, tables: ModuleType) -> None:
    for package, modules in _import_beside_pages("hooks").list_modules().items():
        page = _read_page(site, f"reference/{package}.html")
        assert [name for name in modules if f'id="{name}"' not in page] == []
    for command in tables.list_commands():
        page = _read_page(site, f"guides/{command.split()[0]}.html")
        for parameter in tables.list_parameters(command):
            assert all(f"<code>{name}</code>" in page for name in parameter.names), command
    page = _read_page(site, "reference/geoaim.prediction.html")
    assert "the highest one, of one cycle (Smith 2018)" in page  # beside a field of TrainConfig
    assert "share of the steps in which that weight rises from zero" in page  # above a field
    page = _read_page(site, "decisions/index.html")
    names = [path.with_suffix(".html").name for path in ROOT.glob("docs/decisions/0*.md")]
    assert [name for name in names if f'<a href="{name}">' not in page] == []


def test_tables_in_pages_are_those_of_the_results(tables: ModuleType) -> None:
    """To write them anew: python docs/tables.py."""
    pages = {page: page.read_text("utf-8") for page in (ROOT / "docs").rglob("*.md")}
    assert [page.name for page, text in pages.items() if tables.fill(text) != text] == []
    open_marks = [
        page.name for page, text in pages.items() if text.count("<!-- ") != 2 * _count(tables, text)
    ]
    assert open_marks == [], "a table's comment has no end"


def test_relative_links_lead_to_files() -> None:
    dead = []
    for page in PAGES:
        links = re.findall(r"\]\(([^)#\s]+)", re.sub(FENCE, "", page.read_text("utf-8")))
        local = [link for link in links if not re.match(r"[a-z]+:", link)]
        dead += [(str(page), link) for link in local if not _exists(page.parent / link)]
    assert dead == []


def test_commands_in_pages_exist_with_their_options(tables: ModuleType) -> None:
    _check_command_lines(_read("Makefile").replace("\t$(BIN)/", ""), tables)
    for page in PAGES:
        text = page.read_text("utf-8")
        blocks = [code for kind, code in FENCE.findall(text) if kind in ("", "sh")]
        _check_command_lines("\n".join(blocks), tables)
        experiments = set(re.findall(r"python -m benchmarks.prediction ([a-z_]+)", text))
        assert experiments <= {*EXPERIMENTS, "list"}, page
        for module in set(re.findall(r"python -m (benchmarks(?:\.[a-z]\w*)*)", text)):
            assert find_spec(module), f"{page}: {module}"


def test_names_in_pages_exist() -> None:
    for page in PAGES:
        if page.name == "CHANGELOG.md":  # which names what is gone
            continue
        text = page.read_text("utf-8")
        for language, code in FENCE.findall(text):
            if language == "python":
                _check_names(code, page)
        for dotted in set(re.findall(r"\b(geoaim(?:\.[a-z]\w*)+)", re.sub(FENCE, "", text))):
            if not (ROOT / f"{dotted.replace('.', '/')}.py").exists():
                _find_attribute(dotted)


def test_nothing_installs_geoaim_from_an_index_that_lacks_it() -> None:
    files = [*PAGES, ROOT / "Makefile", *ROOT.glob("geoaim/**/*.py")]
    pattern = re.compile(r"pip install [^`\n]*\bgeoaim\b")
    assert [file.name for file in files if pattern.search(file.read_text("utf-8"))] == []


@pytest.mark.slow
def test_the_search_of_pages_on_the_disk_finds_guides_first(site: Path, chromium: str) -> None:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page()
        asked: list[str] = []
        page.on("request", lambda request: asked.append(request.url))
        for words, first in (
            ("tracks in pixels", "formats/tracks.html"),
            ("how to predict", "guides/predict.html"),
            ("control points", "formats/control_points.html"),
        ):
            page.goto((site / "index.html").as_uri())
            page.locator("input[name=query]").click()
            page.keyboard.type(words)
            _wait_for_result(page, first)
        browser.close()
    assert all(url.startswith("file:") for url in asked), asked


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_pages_have_names_and_contrasts(
    site: Path, chromium: str, scheme: Literal["light", "dark"]
) -> None:
    from playwright.sync_api import sync_playwright

    pytest.importorskip("axe_playwright_python", reason="axe-playwright-python is not installed")
    axe = (files("axe_playwright_python") / "axe.min.js").read_text("utf-8")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page(color_scheme=scheme)
        for name in ("index", "tutorials/own_video", "guides/view"):
            page.goto((site / f"{name}.html").as_uri())
            page.evaluate(axe)
            found = page.evaluate(
                "axe.run(document, {runOnly: ['wcag2a', 'wcag2aa', 'wcag21aa']}).then("
                "({violations}) => violations.map(({id, nodes}) => `${id}: ${nodes[0].html}`))"
            )
            assert found == [], name
        browser.close()


def _wait_for_result(page: "Page", address: str) -> None:
    """Wait until a search shows a page as its first result."""
    links = page.locator(".md-search-result__link")

    def shows() -> bool:
        return links.count() > 0 and address in str(links.first.get_attribute("href"))

    wait_until(shows, f"{address} is the first result")


def test_readme_example_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code = "\n".join(c for kind, c in FENCE.findall(_read("README.md")) if kind == "python")
    assert len([line for line in code.splitlines() if line.strip()]) <= 10
    (tmp_path / "samples").symlink_to(ROOT / "samples")
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "README.md", "exec"), {})


def test_first_pages_are_short() -> None:
    assert len(_read("README.md").split()) <= 700
    assert len(_read("CONTRIBUTING.md").split()) <= 600


def test_written_corner_frame_follows_its_schema(tmp_path: Path) -> None:
    size = (4, 6)
    aim = AIM(
        image=np.zeros((*size, 3), np.uint8),
        world_from_image=np.array([[0.1, 0, 5.0], [0, -0.1, 7.0], [0, 0, 1.0]]),
        world=World("EPSG:32635", (500_000.0, 5_900_000.0)),
        coverage=np.ones(size, np.uint16),
        contested=np.zeros(size, bool),
    )
    geoaim.export_texture(aim, tmp_path)
    schema = json.loads(_read("docs/schemas/corner_frame-1.json"))
    jsonschema.Draft202012Validator.check_schema(schema)
    jsonschema.validate(json.loads((tmp_path / "texture.json").read_text("utf-8")), schema)


def _read(name: str) -> str:
    return (ROOT / name).read_text("utf-8")


def _count(tables: ModuleType, text: str) -> int:
    return len(tables.MARKED.findall(text))


def _read_page(site: Path, name: str) -> str:
    return (site / name).read_text("utf-8")


def _exists(path: Path) -> bool:
    """Whether a link leads to a file, or to a page that the build makes from a package."""
    made = path.parent.name == "reference" and path.stem.startswith("geoaim")
    return made or path.exists()


def _check_command_lines(text: str, tables: ModuleType) -> None:
    """Compare calls of geoaim, continuation lines joined, with the commands' options."""
    commands = tables.list_commands()
    lines = text.replace("\\\n", " ").splitlines()
    for line in [line.split(" #")[0] for line in lines if line.startswith("geoaim ")]:
        name, *rest = line.split()[1:]
        name = f"{name} {rest[0]}" if rest and f"{name} {rest[0]}" in commands else name
        assert name in commands or name == "COMMAND" or name.startswith("--"), line
        if name in commands:
            known = {option for p in tables.list_parameters(name) for option in p.names}
            used = re.findall(r"(?<=\s)(--?[a-z][\w-]*)", line)
            assert set(used) <= known | {"--help"}, line


def _check_names(code: str, page: Path) -> None:
    """Check that code uses names of geoaim that exist."""
    for node in ast.walk(ast.parse(code)):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("geoaim"):
            module = import_module(str(node.module))
            assert [a.name for a in node.names if not hasattr(module, a.name)] == [], page
        elif isinstance(node, ast.Attribute) and ast.unparse(node).startswith("geoaim."):
            _find_attribute(ast.unparse(node))


def _find_attribute(dotted: str) -> None:
    """Look up a dotted name of geoaim as far as modules and their members go."""
    value: object = geoaim
    for name in dotted.split("(")[0].split(".")[1:]:
        if isinstance(value, ModuleType) and find_spec(f"{value.__name__}.{name}"):
            import_module(f"{value.__name__}.{name}")
        if isinstance(value, ModuleType):
            value = getattr(value, name)
