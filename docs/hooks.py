"""What the documentation builds from the code: mkdocs calls these functions.

- A page of the API reference for each package, and a list of them on the page of the reference.
- A formula between `$$` becomes a picture, so that pages need no script from another server.

Tables stand in their pages; `python docs/tables.py` writes them.
"""

import ast
import io
import re
from functools import cache
from pathlib import Path

from matplotlib import mathtext, rc_context
from matplotlib.font_manager import FontProperties
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

PACKAGE = Path(__file__).parents[1] / "geoaim"
# weight of a folder's pages in a search; a word in a title counts 1000 times as much as in a text,
# so that titles of the API reference and of decisions count as texts
SEARCH_BOOST = {
    "formats": 1.5,
    "methods": 0.5,
    "benchmarks": 0.01,
    "decisions": 0.001,
    "reference": 0.001,
}


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Add the packages to the menu."""
    for section in config.nav or []:
        if "API reference" in section:
            section["API reference"] += [
                {package: f"reference/{package}.md"} for package in list_modules()
            ]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add a page of the API reference for each package."""
    for package, modules in list_modules().items():
        text = f"# {package}\n\n" + "\n\n".join(f"::: {module}" for module in modules)
        files.append(File.generated(config, f"reference/{package}.md", content=text + "\n"))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """List the packages, draw formulas; in a search, guides come before records and figures."""
    source = page.file.src_uri
    page.meta["search"] = {"boost": SEARCH_BOOST.get(source.split("/")[0], 1.0)}
    if source == "reference/index.md":
        markdown += f"\n## Packages\n\n{write_packages()}\n"
    return re.sub(r"^\$\$\n(.+?)\n\$\$$", lambda m: draw_formula(m[1]), markdown, flags=re.M | re.S)


def list_modules() -> dict[str, list[str]]:
    """Public modules by the package that holds them; nothing is imported."""
    modules: dict[str, list[str]] = {}
    for path in sorted(PACKAGE.rglob("*.py"), key=lambda path: (path.parent, path)):
        parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
        if not any(part.startswith("_") and part != "__init__" for part in parts):
            name = ".".join(part for part in parts if part != "__init__")
            modules.setdefault(".".join(parts[:-1]), []).append(name)
    return modules


def write_packages() -> str:
    """A table of the modules of each package, with the first line of their docstrings."""
    parts = []
    for package, modules in list_modules().items():
        rows = [f"### [{package}]({package}.md)", "", "| module | duty |", "|---|---|"]
        for name in modules:
            if name != package:
                path = PACKAGE.parent / f"{name.replace('.', '/')}.py"
                text = ast.get_docstring(ast.parse(path.read_text("utf-8"))) or ""
                duty = _one_line(text.partition("\n")[0])
                rows.append(f"| `{name.rpartition('.')[2]}` | {duty} |")
        parts.append("\n".join(rows))
    return "\n\n".join(parts)


def _one_line(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|").replace("<", "&lt;").replace("{", "&#123;")


@cache
def draw_formula(text: str) -> str:
    """One picture for each line of a formula in matplotlib's part of TeX."""
    return "\n\n".join(_draw_line(line) for line in text.split("\n"))


def _draw_line(line: str) -> str:
    buffer = io.BytesIO()
    with rc_context({"mathtext.fontset": "cm", "svg.hashsalt": "geoaim", "svg.fonttype": "path"}):
        font = FontProperties(size=15)
        mathtext.math_to_image(f"${line}$", buffer, prop=font, format="svg", color="#010203")
    picture = buffer.getvalue().decode()
    picture = re.sub(
        r"<(\?xml|!DOCTYPE).*?>\s*|<metadata>.*?</metadata>\s*", "", picture, flags=re.S
    )
    picture = re.sub(r'<g id="patch_1">.*?</g>', "", picture, count=1, flags=re.S)
    picture = picture.replace("#010203", "currentColor").replace("<svg", '<svg role="img"', 1)
    label = line.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")
    flat = re.sub(r"\s*\n\s*", " ", picture).strip()
    return f'<p class="formula" aria-label="{label}">{flat}</p>'
