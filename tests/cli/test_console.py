import os
import signal
import sys

import pytest
import rich.progress
from typer.testing import CliRunner

from geoaim.cli import app
from geoaim.cli.console import Count, console, report_errors, stop_when_terminated, stopping

run = CliRunner().invoke


def test_names_in_square_brackets_are_not_read_as_markup(tmp_path):
    result = run(app, ["info", str(tmp_path / "no[b]where[/b].tif")])
    assert result.exit_code == 1
    assert "no[b]where[/b].tif" in result.output.replace("\n", "")


def test_messages_are_not_wrapped_in_a_file(tmp_path):
    name = "very_long_" * 20 + ".mp4"
    result = run(app, ["frame", name, "-o", str(tmp_path / "a.png")])
    assert result.stderr.strip().splitlines() == [
        f"VideoError: {name}: there is no such file or folder"
    ]


def test_any_failure_is_one_line_and_has_a_traceback_with_debug(tmp_path, monkeypatch):
    def fail(path):
        raise KeyError("of\nsome library")

    monkeypatch.setattr(sys.modules["geoaim.cli.info"], "describe_file", fail)
    result = run(app, ["info", "a.tif"])
    assert result.exit_code == 1
    assert "KeyError: " in result.output
    assert "geoaim --debug COMMAND" in " ".join(result.output.split())
    assert "Traceback" not in result.output
    with pytest.raises(KeyError):
        run(app, ["--debug", "info", "a.tif"], catch_exceptions=False)


def test_result_with_brackets_in_its_name_is_printed(tmp_path):
    output = tmp_path / "x[/y].tif"
    result = run(app, ["draw", "samples/map.osm", "--resolution", "2", "-o", str(output)])
    assert result.exit_code == 0, result.output
    assert output.exists()
    assert "x[/y].tif" in result.output.replace("\n", "")


def test_name_that_is_not_utf8_is_printed():
    result = run(app, ["info", "a\udcff.tif"])
    assert result.exit_code == 1
    assert "FileNotFoundError: a\\udcff.tif" in result.output


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGTERM")
def test_nothing_is_printed_while_the_signal_is_handled(monkeypatch):
    """It may interrupt an import that printing needs."""
    before = signal.getsignal(signal.SIGTERM)
    handled = []

    def record(text):
        handled.append((text.split(";")[0], sys.exc_info()[0]))

    monkeypatch.setattr(console, "print", record)
    stop_when_terminated()
    try:
        with pytest.raises(SystemExit, match="143"), report_errors():
            os.kill(os.getpid(), signal.SIGTERM)
        with pytest.raises(SystemExit, match="143"), report_errors():
            raise ImportError("initialization failed")  # what imports in C make of it
    finally:
        stopping.clear()
        signal.signal(signal.SIGTERM, before)
    assert handled == [("stopped", SystemExit), ("stopped", ImportError)]


def test_progress_counts_steps():
    with rich.progress.Progress() as bars:
        train, other, whole = (bars.add_task("a", total=total) for total in (200, None, 1))
        bars.update(train, completed=50)
        texts = [Count().render(bars.tasks[task]).plain for task in (train, other, whole)]
    assert texts[0].startswith("50 of 200")
    assert texts[1:] == ["", ""]
