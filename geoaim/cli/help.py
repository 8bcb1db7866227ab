"""Help texts: usage lines with all that must be given, and commands in groups."""

from typing import Any

from typer.core import TyperArgument, TyperCommand, TyperGroup, TyperOption


class Command(TyperCommand):
    """A command whose usage line names its arguments and its required options."""

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """Collect the parts of the usage line, such as AIM --tracks TRACKS [OPTIONS]."""
        pieces = []
        for parameter in self.get_params(ctx):
            name = str(parameter.name).upper()
            if isinstance(parameter, TyperArgument):
                name += "..." if parameter.nargs == -1 else ""
                pieces.append(name if parameter.required else f"[{name}]")
            elif isinstance(parameter, TyperOption) and parameter.required:
                pieces.append(f"{min(parameter.opts, key=len)} {name}")
        return [*pieces, "[OPTIONS]"]


class CommandGroup(TyperGroup):
    """Commands in groups, in plain help as well as in that of a terminal."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write each group's commands with the whole first sentence of their help."""
        groups: dict[str, list[tuple[str, str]]] = {}
        for name in self.list_commands(ctx):
            command: Any = self.get_command(ctx, name)
            sentence = " ".join(command.help.split("\n\n")[0].split())
            groups.setdefault(command.rich_help_panel or "Commands", []).append((name, sentence))
        for title, rows in groups.items():
            with formatter.section(title):
                formatter.write_dl(rows)
