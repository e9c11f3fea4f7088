"""Lays out `antdsl --help`: commands in groups, each with its whole sentence."""

from __future__ import annotations

from typing import Any

from typer.core import TyperGroup


class GroupedHelp(TyperGroup):
    """A group of commands that lists them under the headings (`rich_help_panel`) that they name. No line is cut."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands of each heading."""
        width = max(map(len, self.commands))
        rows: dict[str, list[tuple[str, str]]] = {}
        for name, command in self.commands.items():
            rows.setdefault(command.rich_help_panel, []).append((name.ljust(width), _first_sentence(command)))  # type: ignore[attr-defined]
        for heading, commands in rows.items():
            with formatter.section(heading):
                formatter.write_dl(commands)


def _first_sentence(command: Any) -> str:
    text = " ".join((command.help or "").split())
    return text.partition(". ")[0].rstrip(".") + "."
