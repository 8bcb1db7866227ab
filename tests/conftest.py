"""Fixtures for all tests; `make test-slow` and `make check` check shapes, too (see Makefile)."""

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import cv2
import jaxtyping
import numpy as np
import pytest
from hypothesis import HealthCheck, settings

from benchmarks.synthetic.camera import Hover, HoverClip, SpriteTracks, film

# examples of property tests: the same in each run, and however long they take
for name, count in (("few", 10), ("many", 100)):
    settings.register_profile(
        name,
        max_examples=count,
        deadline=None,
        derandomize=True,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
    )
settings.load_profile("few")


@pytest.fixture
def unchecked() -> Iterator[None]:
    """Turn the shape checks off, to see how the package itself refuses a wrong argument."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


@pytest.fixture
def decoded_packets(monkeypatch: pytest.MonkeyPatch) -> list[object]:
    """The packets of videos that are decoded from now on."""
    from geoaim.mapping.video import decoding

    decoded: list[object] = []
    original = decoding._decode

    def note(codec: object, packets: Iterator[object]) -> Iterator[object]:
        return original(codec, (decoded.append(packet) or packet for packet in packets))

    monkeypatch.setattr(decoding, "_decode", note)
    return decoded


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """The folder of real data; a test that asks for it is skipped where there is none."""
    from benchmarks.data import find_data

    folder = find_data()
    if folder is None:
        pytest.skip("no real data: GEOAIM_DATA is not set")
    return folder


def textured(generator: np.random.Generator, height: int, width: int) -> np.ndarray:
    """A still with structure at all scales, like the ground."""
    image = np.zeros((height, width, 3), np.float32)
    for octave in range(1, 7):
        shape = (max(height >> octave, 2), max(width >> octave, 2), 3)
        noise = generator.standard_normal(shape, dtype=np.float32)
        image += cv2.resize(noise, (width, height), interpolation=cv2.INTER_CUBIC) * 2**octave / 8
    return np.clip(128 + 20 * image, 0, 255).astype(np.uint8)


def no_traffic(count: int) -> SpriteTracks:
    return SpriteTracks((), np.empty((0, 2)), np.empty((count, 0, 3)))


@pytest.fixture(scope="session")
def clip() -> HoverClip:
    generator = np.random.default_rng(7)
    hover = Hover(count=12, drift=8, perspective=1.0, noise=2.0, blur=0.6)
    still = textured(generator, 500, 800)
    return film(still, no_traffic(12), hover, height=360, width=640, generator=generator)


@pytest.fixture(scope="session")
def chromium() -> str:
    """Path of a browser that Playwright can drive."""
    pytest.importorskip("playwright", reason="Playwright is not installed")
    path = os.environ.get("CHROMIUM") or shutil.which("chromium")
    if path is None:
        pytest.skip("no browser: install chromium, or name one by CHROMIUM")
    return path
