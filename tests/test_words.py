"""Names that a program can check: functions are verb phrases, a class name occurs once."""

import ast
from collections import Counter
from pathlib import Path

import pytest

import geoaim

PACKAGE = Path(geoaim.__file__).parent
ROOT = PACKAGE.parent
SOURCES = sorted(PACKAGE.rglob("*.py"))

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


def find_definitions(path: Path, kind: type[ast.AST]) -> list[ast.AST]:
    return [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, kind)]


def is_property(node: ast.FunctionDef) -> bool:
    return "property" in " ".join(ast.unparse(decorator) for decorator in node.decorator_list)


def is_verb_phrase(name: str) -> bool:
    words = name.strip("_").split("_")
    first, last = words[0], words[-1]
    participle = first in PARTICIPLES or (first.endswith("ed") and first not in VERBS)
    adverb = (last.endswith("ly") and last not in VERBS) or last in {"about", "apart", "beside"}
    return not (participle or adverb)


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


def test_no_class_name_occurs_twice():
    counts = Counter(node.name for path in SOURCES for node in find_definitions(path, ast.ClassDef))
    assert [name for name, count in counts.items() if count > 1] == []
