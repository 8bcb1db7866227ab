"""The help of each command."""

import shlex
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from geoaim.cli import COMMANDS, app

NAMES = [command.__name__ for command in COMMANDS]


@pytest.mark.parametrize("name", NAMES)
def test_the_example_in_the_help_can_be_parsed_and_its_samples_exist(name):
    command = typer.main.get_command(app).commands[name]
    example = shlex.split(command.help.split("Example: ")[1])
    assert example[:2] == ["geoaim", name]
    command.make_context(name, example[2:]).close()
    samples = [Path(word) for word in example if word.startswith("samples/")]
    assert all(path.exists() for path in samples)


@pytest.mark.parametrize("name", NAMES)
def test_every_option_has_a_help_text(name):
    command = typer.main.get_command(app).commands[name]
    assert all(getattr(option, "help", None) for option in command.params if option.name != "help")


def test_the_examples_in_the_help_run(tmp_path, monkeypatch):
    """Those that need no browser and few seconds; `make demo` runs build, render and predict."""
    (tmp_path / "samples").symlink_to(Path("samples").absolute())
    monkeypatch.chdir(tmp_path)
    commands = typer.main.get_command(app).commands
    names = "draw frame align register info convert texture simulate doctor"
    for name in names.split():
        example = shlex.split(commands[name].help.split("Example: ")[1])
        result = CliRunner().invoke(app, example[1:])
        assert result.exit_code == 0, f"{' '.join(example)}: {result.output}"
