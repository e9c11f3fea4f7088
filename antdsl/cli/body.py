"""`antdsl body FILE`: what is in an agent definition: joints, shapes, layers, clips, transform groups, metadata."""

from __future__ import annotations

from pathlib import Path

import typer

from antdsl.cli.exits import Exit, Stop


def body(
    file: Path = typer.Argument(..., help="A definition file (.json), a glTF file (.glb, .gltf) or a USD file."),
    as_json: bool = typer.Option(False, "--json", help="Print it as JSON for other programs, complaints among it."),
    prim: str = typer.Option("", "--prim", metavar="PATH", help="Of a USD file: read what lies at and below this prim."),
    rate: float = typer.Option(
        0.0, "--rate", min=0.0, max=1000.0, help="Samples a second of animations; 0: the frames of a USD file, 30 of a glTF file."
    ),
    quiet: bool = typer.Option(False, "--quiet", "-q", help="Print nothing but complaints."),
    root: list[str] = typer.Option([], "--root", metavar="NAME=DIR", help="Grant a folder outside the file's own."),
) -> None:
    """Say what is in the body of an agent: joints, shapes, layers, clips, groups, metadata, and what is wrong with it."""
    from antdsl.bodies.agents.reading import read_definition
    from antdsl.cli.arguments import grants
    from antdsl.cli.printing.body_tables import body_document, body_lines
    from antdsl.cli.printing.reports import show, verdict
    from antdsl.scene.paths import Roots

    roots = Roots(file.resolve().parent, grants(root))
    found, report = read_definition(file, roots, prim=prim, rate=rate)
    if as_json:
        typer.echo(body_document(found, report), nl=False)
    else:
        show(report)
        for line in body_lines(found) if found is not None and not quiet else ():
            typer.echo(line)
    if not report.ok:
        raise Stop(Exit.FINDINGS if as_json and verdict(report) is not Exit.INPUT_OUTPUT else verdict(report))
