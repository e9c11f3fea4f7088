"""Lays out `antdsl --help`: commands in groups, each with its whole sentence."""

from __future__ import annotations

import click
from typer.core import TyperGroup

GROUPS: dict[str, tuple[str, ...]] = {
    "Write programs": ("new", "check", "fmt", "graph", "lsp"),
    "Simulate": ("run", "preview", "test", "sweep", "jobs"),
    "Use results": ("render", "export", "edit", "info", "explain"),
    "Look inside": ("body", "plan", "bench", "doctor"),
}


class GroupedHelp(TyperGroup):
    """A group of commands that lists them under headings. No line is cut."""

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands of each group."""
        width = max(map(len, self.commands))
        for heading, names in GROUPS.items():
            with formatter.section(heading):
                formatter.write_dl([(name.ljust(width), _first_sentence(self.commands[name])) for name in names])


def _first_sentence(command: click.Command) -> str:
    text = " ".join((command.help or "").split())
    return text.partition(". ")[0].rstrip(".") + "."
