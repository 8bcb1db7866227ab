"""The help of each command."""

import shlex
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from geoaim.cli import COMMANDS, GROUPS, app

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


@pytest.mark.slow
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


@pytest.mark.parametrize(
    ("words", "usage"),
    [
        ("predict", "predict AIM -o OUTPUT [OPTIONS]"),
        ("align", "align IMAGERY... -o OUTPUT [OPTIONS]"),
        ("bench", "bench STAGE VIDEO [OPTIONS]"),
        ("catalog build", "catalog build RECORDINGS -o OUTPUT [OPTIONS]"),
    ],
)
def test_the_usage_line_names_all_that_must_be_given(words, usage):
    result = CliRunner().invoke(app, [*words.split(), "--help"], prog_name="geoaim")
    assert f"Usage: geoaim {usage}" in result.output


def test_the_commands_are_listed_in_groups_with_whole_sentences():
    output = CliRunner().invoke(app, ["--help"], prog_name="geoaim").output
    listed = " ".join(output.split())
    positions = [listed.index(f"{title}:") for title in GROUPS]
    assert positions == sorted(positions)
    assert "..." not in listed.split("Make a map:")[1]
    commands = typer.main.get_command(app).commands
    for name, command in commands.items():
        sentence = " ".join(command.help.split("\n\n")[0].split())
        assert f" {name} {sentence}" in listed
