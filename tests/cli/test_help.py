"""The help of each command."""

import shlex
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from geoaim.cli import COMMANDS, GROUPS, app

NAMES = [command.__name__ for command in COMMANDS]


def test_examples_in_the_help_can_be_parsed_and_every_option_has_a_text():
    commands = typer.main.get_command(app).commands
    for name in NAMES:
        command = commands[name]
        example = shlex.split(command.help.split("Example: ")[1])
        assert example[:2] == ["geoaim", name]
        command.make_context(name, example[2:]).close()
        samples = [Path(word) for word in example if word.startswith("samples/")]
        assert [path for path in samples if not path.exists()] == []
        options = [option for option in command.params if option.name != "help"]
        assert [x.name for x in options if not getattr(x, "help", None)] == [], name


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


def test_the_usage_line_names_all_that_must_be_given():
    for usage in (
        "predict AIM -o OUTPUT [OPTIONS]",
        "align IMAGERY... -o OUTPUT [OPTIONS]",
        "bench VIDEO [OPTIONS]",
        "catalog build RECORDINGS -o OUTPUT [OPTIONS]",
    ):
        words = [word for word in usage.split() if word.islower()]
        words = words[: words.index("-o")] if "-o" in words else words
        result = CliRunner().invoke(app, [*words, "--help"], prog_name="geoaim")
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
