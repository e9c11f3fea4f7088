"""`antdsl examples`: lists the examples that come with antdsl, or copies one into a folder."""

from __future__ import annotations

from pathlib import Path

import typer

from antdsl.cli.exits import CommandError, ExitCode
from antdsl.cli.new_folders import check_new_folder, describe_example, read_example_files, write_files
from antdsl.cli.printing.messages import print_note, print_result
from antdsl.diagnostics.suggestion import find_nearest_name
from antdsl.resources import list_example_names


def examples(
    name: str | None = typer.Argument(None, metavar="NAME", help="An example to copy; without it, all are listed."),
    folder: Path | None = typer.Argument(None, metavar="DIR", help="A new or empty folder. [default: NAME]"),
) -> None:
    """List the examples that come with antdsl, or copy one into a folder."""
    names = list_example_names()
    if name is None:
        width = max(map(len, names), default=0)
        for each in names:
            print_result(f"{each:<{width}}  {describe_example(each)}")
        print_note("`antdsl examples NAME` copies one into a folder of its name")
        return
    if name not in names:
        near = find_nearest_name(name, names)
        advice = f"did you mean `{near}`?" if near else "`antdsl examples` lists all"
        raise CommandError(ExitCode.USAGE, f"error: there is no example `{name}`", advice)
    folder = folder or Path(name)
    check_new_folder(folder)
    files = read_example_files(name)
    write_files(folder, files)
    scene = next(file for file in sorted(files, key=lambda file: (file != "scene.yaml", file)) if file.endswith(".yaml"))
    print_note(f"{len(files)} files are in {folder}; now:")
    print_note(f"  antdsl run {folder / scene}")
