"""Reads an agent definition: a definition file in JSON, a glTF file or a USD file. All agents of a kind share what is read."""

from __future__ import annotations

from pathlib import Path

from antdsl.bodies.agents.body_files import GLTF, USD, BodyFiles, ending
from antdsl.bodies.agents.checked_values import Values
from antdsl.bodies.agents.definition import Definition
from antdsl.bodies.agents.definition_checks import whole
from antdsl.bodies.agents.definition_document import Parts, read_document
from antdsl.bodies.agents.json_text import Node
from antdsl.diagnostics import Report
from antdsl.scene.paths import Roots
from antdsl.source import Span


def read_definition(
    path: Path | str, roots: Roots | None = None, place: Span | None = None, *, prim: str = "", rate: float = 0.0
) -> tuple[Definition | None, Report]:
    """The definition in a .json, .glb, .gltf or USD file, or None and why there is none.

    A `Path` is one that a person named, whose own folder is the root of what it names in turn unless `roots` says otherwise; a
    text is one that a file names at `place`, and lies below `roots`. Of a USD file `prim` is what is read; animations are
    sampled about `rate` times a second (0: as often as the file's own frames, or 30 times)."""
    report = Report()
    if isinstance(path, Path):
        text = path.name
        roots = roots or Roots(path.resolve().parent)
        files = BodyFiles(roots, report, named={text: path})
        shown = str(path)
    else:
        text = shown = path
        folder = text[: max(text.rfind("/"), text.find(":")) + 1]
        files = BodyFiles(roots or Roots(Path.cwd()), report, folder)
        text = text[len(folder) :]
    if files.closed(shown, place):
        return None, report
    kind = ending(shown)
    name = text.rpartition(".")[0] or "body"
    if kind in GLTF or kind in USD:
        found = files.body(text, place, prim, rate)
        return (whole(Parts(found, whole=place), report) if found is not None else None), report
    if kind != "json":
        kinds = ", ".join(f".{each}" for each in ("json", *GLTF, *USD))
        report.error("wrong-kind", f"`{shown[-80:]}` is no file of a body", place, f"one of {kinds} is read")
        return None, report

    def document(values: Values, node: Node) -> Parts | None:
        values.report = report
        return read_document(values, node, files, name)

    parts, _ = files.part(text, "a definition", document, place)
    return (None if parts is None else whole(parts, report)), report
