"""`antdsl body FILE`: prints an agent definition (joints, shapes, layers, clips, transform groups, metadata), or converts it to
another file format."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from antdsl.cli.exits import CommandError, ExitCode
from antdsl.cli.printing.messages import print_note, print_result

if TYPE_CHECKING:
    from antdsl.bodies.agents.definition import Definition


BODY_TARGETS = ("antdsl", "houdini")
_PROPOSAL_RATE = 120.0  # samples per second; enough to measure the speeds of feet that stand for a few frames


def run_body_command(
    file: Path = typer.Argument(
        ..., help="A definition file (.json), a glTF file (.glb, .gltf), a USD file, or a word of the library: ant."
    ),
    as_json: bool = typer.Option(False, "--json", help="Print the body and its findings as JSON, for other programs."),
    prim: str = typer.Option("", "--prim", metavar="PATH", help="USD: read this prim and everything below it."),
    rate: float = typer.Option(
        0.0, "--rate", min=0.0, max=1000.0, help="Samples per second of animations; 0: a USD file's frame rate, or 30 for glTF."
    ),
    to: Path = typer.Option(
        None,
        "--to",
        metavar="FILE",
        help="Write the body: a .glb or .gltf file, or a .json definition with its parts in a folder next to it.",
    ),
    layer: str = typer.Option(
        "", "--layer", metavar="NAME", help="For .glb and .gltf: the layer of shapes to write. [default: the displayed layer]"
    ),
    target: str = typer.Option(
        "antdsl", "--for", metavar="PROGRAM", help="For .json: `houdini` writes clips as text clips of Houdini (.clip)."
    ),
    propose: bool = typer.Option(
        False,
        "--propose",
        help="Propose a definition file for you to correct: legs, gaits, axes, units, strides, idle clip and capsule.",
    ),
    quiet: bool = typer.Option(False, "--quiet", "-q", help="Print findings only."),
    root: list[str] = typer.Option([], "--root", metavar="NAME=DIR", help="Grant a folder outside the file's own."),
) -> None:
    """List the contents of an agent's body (joints, shapes, layers, clips, groups, metadata), and report mistakes."""
    from antdsl.bodies.files.reading import read_definition
    from antdsl.bodies.library import load_library_body
    from antdsl.cli.arguments import parse_grants
    from antdsl.cli.printing.body_tables import format_body, format_body_json
    from antdsl.cli.printing.reports import choose_exit_code, print_report
    from antdsl.diagnostics import Report
    from antdsl.scene.library_bodies import BODY_WORDS
    from antdsl.scene.paths import Roots

    roots = Roots(file.resolve().parent, parse_grants(root))
    report = Report()
    definition: Definition | None
    if str(file) in BODY_WORDS and not file.is_file():
        definition = load_library_body(str(file))
    else:
        definition, report = read_definition(file, roots, prim=prim, rate=rate or (_PROPOSAL_RATE if propose else 0.0))
    if propose:
        print_report(report)
        if definition is not None and report.ok:
            _print_or_write_proposal(definition, file, to, quiet)
    elif as_json:
        print_result(format_body_json(definition, report), newline=False)
    else:
        print_report(report)
        if definition is not None and not quiet and to is None:
            for line in format_body(definition):
                print_result(line)
    if definition is not None and report.ok and to is not None and not propose:
        _write_body(definition, file, to, layer, target, quiet)
    if not report.ok:
        raise CommandError(
            ExitCode.FINDINGS if as_json and choose_exit_code(report) is not ExitCode.INPUT_OUTPUT else choose_exit_code(report)
        )


def _print_or_write_proposal(body: Definition, source: Path, target: Path | None, quiet: bool) -> None:
    """Print the proposed definition file, or write it to `target`."""
    from antdsl.atomic_write import write_atomically
    from antdsl.bodies.proposing.proposal import propose_definition
    from antdsl.cli.destinations import protect_inputs, require_writable_file

    if source.suffix.lower() == ".json" or not source.is_file():
        raise typer.BadParameter(f"`{source.name}` is not a glTF or USD file", param_hint="FILE")
    if target is None:
        print_result(propose_definition(body, source.name).format_text(), newline=False)
        return
    if target.suffix.lower() != ".json":
        raise typer.BadParameter(f"`{target.name}` must end in .json", param_hint="--to")
    folder = target.resolve().parent
    if folder not in source.resolve().parents:
        advice = f"write it next to the file: `--to {source.with_suffix('.json')}`"
        raise typer.BadParameter(f"`{source}` is not in the folder of `{target}` or below it; {advice}", param_hint="--to")
    require_writable_file(target, "--to")
    with protect_inputs({"--to": target}) as inputs:
        inputs.append(source)
    write_atomically(target, propose_definition(body, source.resolve().relative_to(folder).as_posix()).format_text().encode())
    if not quiet:
        print_note(f"{target}: read its reasons, correct mistakes, and name it in a scene: `body: {target.name}`")


def _write_body(body: Definition, source: Path, target: Path, layer: str, program: str, quiet: bool) -> None:
    """Write a definition in another file format. Also report the parts of the definition that this format cannot store."""
    from antdsl.atomic_write import create_folder_durably, write_atomically
    from antdsl.bodies.files.writing import build_definition_files, write_gltf
    from antdsl.bodies.posed_body import find_base_layer
    from antdsl.cli.destinations import protect_inputs, require_writable_file, require_writable_folder

    kind = target.suffix.lower()
    if kind not in (".json", ".glb", ".gltf"):
        raise typer.BadParameter(f"`{target.name}` must end in .json, .glb or .gltf", param_hint="--to")
    if layer and layer not in body.layers:
        layer_names = ", ".join(f"`{name}`" for name in body.layers) or "no layer"
        raise typer.BadParameter(f"the body has no layer `{layer}`: there is {layer_names}", param_hint="--layer")
    if program not in BODY_TARGETS or (program != BODY_TARGETS[0] and kind != ".json"):
        words = f"`{program}` is none of {', '.join(BODY_TARGETS)}" if program not in BODY_TARGETS else "write a .json definition"
        raise typer.BadParameter(words, param_hint="--for")
    require_writable_file(target, "--to")
    notes: list[str] = []
    if kind == ".json":
        files = build_definition_files(body, target.stem, has_houdini_clips=program == "houdini")
        parts = [path for path in files if path != target.name]
        require_writable_folder(target.parent / target.stem, "--to", *(path.partition("/")[2] for path in parts))
    else:
        data, notes = write_gltf(body, body.layers[layer] if layer else find_base_layer(body), text=kind == ".gltf")
        files, parts = {target.name: data}, []
    with protect_inputs({"--to": target}, {"--to": (target.parent, [target.stem])} if parts else None) as inputs:
        inputs.append(source)
    for path in (*parts, target.name):
        create_folder_durably((target.parent / path).parent)
        write_atomically(target.parent / path, files[path])
    if not quiet:
        print_note(
            f"{target}, and {len(parts)} files in {target.parent / target.stem}"
            if parts
            else f"{target}: {len(files[target.name]):,} bytes"
        )
        for note in notes:
            print_note(f"note: {note}")
