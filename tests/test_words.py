"""The words of docs/vocabulary.md that a program can check: forbidden words, names as verbs."""

import ast
import json
import re
from collections import Counter
from functools import cache
from pathlib import Path

import pytest

import geoaim

PACKAGE = Path(geoaim.__file__).parent
ROOT = PACKAGE.parent
SOURCES = sorted(PACKAGE.rglob("*.py"))
TEXTS = [
    *SOURCES,
    *sorted((ROOT / "tests").rglob("*.py")),
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "notebooks").glob("*.ipynb")),
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "Makefile", "samples/README.md")),
]
NOT_SOURCES = {Path(__file__), ROOT / "docs" / "vocabulary.md"}  # they list the words

# word: what to say instead
FORBIDDEN = {
    r"ghosts?": "traffic removal",
    r"lessons?": "dataset",
    r"comings": "spawning",
    r"fleets?": "vehicles",
    r"crowds?": "pedestrians",
    r"walkers?": "pedestrians",
    r"on_foot": "pedestrian",
    r"settle[ds]?": "round_reproducibly, converge",
    r"lever": "heading_scale",
    r"haste|hasty": "heading_scale; impatient",
    r"Asked": "EvalConfig",
    r"Sight|egos_see": "observation",
    r"Mind|Moment": "hidden",
    r"egos": "controlled",
    r"winners": "anchors",
    r"pooled": "average_seeds",
    r"cutouts?": "sprites",
    r"pixel_size": "resolution",
    r"ground_fit": "transform models",
    r"point_layout": "point checks",
    r"usual actions?": "ground-truth actions, normalised",
    r"nobody|everybody|somebody|whoever": "the thing itself as the subject",
    r"laid": "registered, aligned, placed",
    r"taught": "trained",
}
VERBS = {"embed", "feed", "need", "seed", "speed", "exceed", "shed"}  # and nouns in -ed
VERBS |= {
    "apply",
    "multiply",
    "premultiply",
    "unpremultiply",
    "supply",
    "shapely",  # a library
    "reproducibly",  # round_reproducibly, a word of the vocabulary
}
PARTICIPLES = {
    *("found", "judged", "made", "seen", "known", "kept", "left", "said", "told", "laid", "heard"),
    *("brought", "drawn", "held", "shown", "worn", "swept", "shrunk", "sought", "apart", "about"),
    *("beside", "given", "taken", "chosen", "written", "driven", "stood", "built"),
}


@cache
def read_text(path: Path) -> str:
    """The text of a file; of a notebook its cells, without what they printed."""
    text = path.read_text(encoding="utf-8")
    if path.suffix != ".ipynb":
        return text
    return "\n".join("".join(cell["source"]) for cell in json.loads(text)["cells"])


def find_definitions(path: Path, kind: type[ast.AST]) -> list[ast.AST]:
    return [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, kind)]


def find_forbidden(text: str, word: str) -> list[str]:
    """Lines that hold the word: as it stands where it has capitals, else in any case."""
    flags = 0 if re.search("[A-Z]", word) else re.IGNORECASE
    pattern = re.compile(rf"(?<![A-Za-z])(?:{word})(?![A-Za-z])", flags)
    return [line.strip() for line in text.splitlines() if pattern.search(line)]


def is_property(node: ast.FunctionDef) -> bool:
    return "property" in " ".join(ast.unparse(decorator) for decorator in node.decorator_list)


def is_verb_phrase(name: str) -> bool:
    words = name.strip("_").split("_")
    first, last = words[0], words[-1]
    participle = first in PARTICIPLES or (first.endswith("ed") and first not in VERBS)
    adverb = (last.endswith("ly") and last not in VERBS) or last in {"about", "apart", "beside"}
    return not (participle or adverb)


@pytest.mark.parametrize("word", FORBIDDEN)
def test_no_text_uses_a_word_that_the_vocabulary_forbids(word):
    uses = {
        f"{path.relative_to(ROOT)}: {line}"
        for path in TEXTS
        if path.exists() and path not in NOT_SOURCES
        for line in find_forbidden(read_text(path), word)
    }
    assert uses == set(), f"say: {FORBIDDEN[word]}"


def test_search_finds_words_inside_names_and_not_inside_other_words():
    assert find_forbidden("def make_fleet():\n    pass", "fleets?") == ["def make_fleet():"]
    assert find_forbidden("leverage", "lever") == []
    assert find_forbidden("a sighting; insight", "Sight") == []


def test_functions_are_named_by_verb_phrases():
    names = {
        f"{path.relative_to(ROOT)}: {node.name}"
        for path in SOURCES
        for node in find_definitions(path, ast.FunctionDef)
        if not is_property(node) and not is_verb_phrase(node.name)
    }
    assert names == set()


@pytest.mark.parametrize("name", ["average_frames", "read_speed", "_apply", "__init__", "embed"])
def test_a_verb_phrase_is_accepted(name):
    assert is_verb_phrase(name)


@pytest.mark.parametrize("name", ["averaged", "_judged", "predict_plainly", "_look_beside"])
def test_a_participle_or_an_adverb_is_refused(name):
    assert not is_verb_phrase(name)


def test_resolution_is_no_parameter_of_another_name():
    """A column `metres_per_pixel` in other people's tables is read; no name of ours is that."""
    arguments = {
        f"{path.relative_to(ROOT)}: {node.arg}"
        for path in SOURCES
        for kind in (ast.arg, ast.keyword)
        for node in find_definitions(path, kind)
        if node.arg in {"metres_per_pixel", "pixel_size"}
    }
    assert arguments == set()


def test_no_class_name_occurs_twice():
    counts = Counter(node.name for path in SOURCES for node in find_definitions(path, ast.ClassDef))
    assert [name for name, count in counts.items() if count > 1] == []
