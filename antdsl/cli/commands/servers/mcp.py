"""`antdsl mcp`: the MCP server, for an assistant to start."""

from __future__ import annotations

from pathlib import Path

import typer

from antdsl.cli.arguments import parse_grants
from antdsl.cli.exits import CommandError, ExitCode


def run_mcp_command(
    root: list[str] = typer.Option(
        ...,
        "--root",
        metavar="DIR",
        help="A folder of projects that calls may read and write; NAME=DIR grants scenes a folder of assets.",
    ),
) -> None:
    """Let an assistant check, run, render, test and explain within folders (Model Context Protocol). Needs the extra [mcp]."""
    from antdsl.cli.printing.reports import exit_on_errors
    from antdsl.mcp.folders import GrantedFolders
    from antdsl.packages import check_extra

    grants = [word for word in root if "=" in word and not Path(word).is_dir()]
    parse_grants(grants)
    try:
        folders = GrantedFolders.open([Path(word) for word in root if word not in grants])
    except NotADirectoryError as error:
        raise typer.BadParameter(str(error), param_hint="--root") from None
    if not folders.folders:
        raise typer.BadParameter("name a folder of projects, such as `--root .`", param_hint="--root")
    exit_on_errors(check_extra("the MCP server", "mcp", "mcp"))
    from antdsl.mcp.server import run_server
    from antdsl.mcp.tools import Tools

    try:
        run_server(Tools(folders, tuple(grants)))
    except OSError as problem:
        words = (problem.strerror or str(problem)).lower()
        raise CommandError(ExitCode.INPUT_OUTPUT, f"error: cannot write to standard output: {words}") from None
