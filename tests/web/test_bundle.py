"""The viewer's bundle is made from its sources."""

import hashlib
from importlib.resources import files
from pathlib import Path

import geoaim

WEB = Path(geoaim.__file__).parent / "web"


def test_the_bundle_is_that_of_the_sources():
    names = [f"src/{name}" for name in sorted(path.name for path in (WEB / "src").iterdir())]
    digest = hashlib.sha256()
    for name in [*names, "../base/page.css", "build.mjs", "package-lock.json"]:
        text = (WEB / name).read_text(encoding="utf-8")
        digest.update(f"{name}\n{text}".encode())
    first = (WEB / "geoaim.js").read_text(encoding="utf-8").split("\n", 1)[0]
    assert digest.hexdigest() in first, "run `npm ci && npm run build` in geoaim/web"


def test_the_bundle_is_small_asks_no_network_and_can_stand_in_a_page():
    text = (files("geoaim.web") / "geoaim.js").read_text(encoding="utf-8")
    assert len(text.encode()) < 600_000
    assert "</script" not in text
    assert "cdn." not in text


def test_the_licences_of_what_is_bundled_are_there():
    text = (files("geoaim.web") / "LICENCES.txt").read_text(encoding="utf-8")
    assert "ol 10" in text
    assert "Redistribution" in text
