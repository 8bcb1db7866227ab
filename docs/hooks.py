"""What the documentation builds from the code and its results: mkdocs calls these functions.

- A page of the API reference for each package, and a table of all decisions.
- `<!-- options: build -->` becomes the table of that command's options.
- `<!-- table: NAME -->` becomes a table made of the results in docs/bench (see tables.py).
- What stands before such a comment on its line, for readers of the sources, is left out.
- A formula between `$$` becomes a picture, so that pages need no script from another server.
"""

import ast
import inspect
import io
import re
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from functools import cache
from pathlib import Path
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from matplotlib import mathtext, rc_context
from matplotlib.font_manager import FontProperties
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page
from tables import write_results
from typer.models import ArgumentInfo

from geoaim.cli import app

DOCS = Path(__file__).parent
PACKAGE = DOCS.parent / "geoaim"
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
    """Fill in tables, lists and formulas; in a search, guides come before records and figures."""
    page.meta["search"] = {"boost": SEARCH_BOOST.get(page.file.src_uri.split("/")[0], 1.0)}
    # what stands before a comment on its line is for readers of the sources
    writers = {"options": write_options, "table": write_results}
    pattern = r"^.*<!-- (options|table): (\w+(?: \w+)?) -->$"
    markdown = re.sub(pattern, lambda m: writers[m[1]](m[2]), markdown, flags=re.M)
    lists = {"decisions": write_decisions, "packages": write_packages}
    pattern = r"^.*<!-- (decisions|packages) -->$"
    markdown = re.sub(pattern, lambda m: lists[m[1]](), markdown, flags=re.M)
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


def list_decisions() -> list[Path]:
    """Files of the decisions, by their numbers."""
    return sorted(DOCS.glob("decisions/[0-9]*.md"))


def write_decisions() -> str:
    """A table of all decisions: number, title with a link, and what was decided."""
    rows = ["| | decision | what |", "|---|---|---|"]
    for path in list_decisions():
        text = path.read_text("utf-8")
        [(number, title)] = re.findall(r"\A# (\d+) (.+)$", text, re.M)
        [what] = re.findall(r"^- \*\*What:\*\* (.+)$", text, re.M)
        rows.append(f"| {number} | [{title}]({path.name}) | {what.replace('|', chr(92) + '|')} |")
    return "\n".join(rows)


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


def write_options(command: str) -> str:
    """The arguments and options of a command as a table."""
    lines = ["| option | value | default | meaning |", "|---|---|---|---|"]
    for parameter in list_parameters(command):
        names = ", ".join(f"`{name}`" for name in parameter.names)
        cells = names, _value(parameter), _default(parameter), _one_line(parameter.info.help or "")
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines)


@dataclass(frozen=True)
class Parameter:
    """An argument or option of a command.

    Attributes:
        names: as they are typed; capitals for an argument.
        kind: the type in the function's signature.
        default: of the function; `inspect.Parameter.empty` when the parameter is required.
        info: what typer was told about it.
    """

    names: list[str]
    kind: Any
    default: Any
    info: Any


def list_commands() -> dict[str, Callable[..., Any]]:
    """The function of each command by the command's name; of a group's, by both names."""
    commands = {}
    groups = [("", app)]
    groups += [(f"{g.typer_instance.info.name} ", g.typer_instance) for g in app.registered_groups]
    for prefix, group in groups:
        for info in group.registered_commands:
            assert info.callback is not None
            name = info.name or info.callback.__name__.replace("_", "-")
            commands[prefix + name] = info.callback
    return commands


def list_parameters(command: str) -> list[Parameter]:
    """Arguments and options of a command, as typer reads them from its function."""
    function = list_commands()[command]
    hints = get_type_hints(function, include_extras=True)
    parameters = []
    for name, parameter in inspect.signature(function).parameters.items():
        kind, info = get_args(hints[name])[:2]
        if isinstance(info, ArgumentInfo):
            names = [name.upper()]
        else:
            long = [f"--{name.replace('_', '-')}"]
            stated = (info.default, *(info.param_decls or ()))  # the first is Option's default
            names = [d for d in stated if isinstance(d, str) and d.startswith("-")]
            names = names if any(d.startswith("--") for d in names) else long + names
        parameters.append(Parameter(names, kind, parameter.default, info))
    return parameters


def _value(parameter: Parameter) -> str:
    kind = parameter.kind
    if isinstance(kind, UnionType) or get_origin(kind) is Union:
        kind = next(k for k in get_args(kind) if k is not type(None))
    if get_origin(kind) is Literal:
        return ", ".join(f"`{choice}`" for choice in get_args(kind))
    if inspect.isclass(kind) and issubclass(kind, Enum):
        return ", ".join(f"`{choice.value}`" for choice in kind)
    name = _KINDS.get(kind, "text")
    low, high = parameter.info.min, parameter.info.max
    if low is not None and high is not None:
        return f"{name}, {low:g} to {high:g}"
    return name if low is None else f"{name}, at least {low:g}"


_KINDS = {bool: "flag", float: "number", int: "whole number", Path: "path"}


def _default(parameter: Parameter) -> str:
    if parameter.default is inspect.Parameter.empty:
        return "required"
    if parameter.default is None or parameter.default is False:
        return ""
    return f"`{getattr(parameter.default, 'value', parameter.default)}`"


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
