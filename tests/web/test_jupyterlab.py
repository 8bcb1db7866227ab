"""The widget in a real JupyterLab, where that is installed (`pip install jupyterlab`)."""

import json
import os
import socket
import subprocess
import sys
import urllib.request
from pathlib import Path

import pytest

from geoaim.aim.files import write_aim
from tests.waiting import LIMIT_S, wait_until
from tests.web.browser import wait_for

ROOT = Path(__file__).parents[2]
CODE = """import geoaim
tracks = geoaim.read_tracks({tracks!r})
geoaim.explore("aim.tif", tracks=tracks)"""
IDLE = ".jp-Notebook-ExecutionIndicator[data-status='idle']"  # the kernel is there


def make_notebook(code):
    cell = {"cell_type": "code", "execution_count": None, "metadata": {}, "outputs": []}
    kernel = {"name": "python3", "display_name": "Python 3", "language": "python"}
    cells = [{**cell, "id": "explore", "source": code}]
    return {"cells": cells, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}


def answers(address):
    try:
        urllib.request.urlopen(address, timeout=LIMIT_S).close()
    except OSError:
        return False
    return True


@pytest.fixture
def lab(aim, tmp_path):
    """Address of a JupyterLab whose folder has a notebook that explores a map."""
    pytest.importorskip("jupyterlab", reason="JupyterLab is not installed")
    write_aim(aim, tmp_path / "aim.tif")
    code = CODE.format(tracks=str(ROOT / "samples/tracks.csv"))
    (tmp_path / "explore.ipynb").write_text(json.dumps(make_notebook(code)))
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    options = ["--no-browser", "--allow-root", f"--port={port}", "--IdentityProvider.token="]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path])}
    address = f"http://127.0.0.1:{port}"
    with open(tmp_path / "log", "wb") as log:
        server = subprocess.Popen(
            [sys.executable, "-m", "jupyterlab", *options],
            cwd=tmp_path,
            env=environment,
            stdout=log,
            stderr=log,
        )
        try:
            wait_until(lambda: answers(f"{address}/api"), "JupyterLab answers")
            yield address
        finally:
            server.terminate()
            server.wait(LIMIT_S)


@pytest.mark.slow
def test_the_widget_shows_and_plays_in_jupyterlab(lab, page):
    page.goto(f"{lab}/lab/tree/explore.ipynb?reset")
    page.locator(".jp-CodeCell").first.click()
    page.locator(IDLE).wait_for()
    page.keyboard.press("Shift+Enter")
    page.locator(".geoaim .timeline").wait_for()
    wait_for(page, "performance.getEntriesByName('geoaim-painted').length > 0")
    page.locator(".geoaim .play").click()
    wait_for(page, "parseFloat(document.querySelector('.geoaim .time').value) > 0.3")
    page.screenshot(path=os.environ.get("SCREENSHOT", os.devnull), type="png")
