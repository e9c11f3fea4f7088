"""A text that is edited is checked in parts: it must say the same as a check of the whole text, after every edit."""

from __future__ import annotations

import random
from itertools import pairwise
from pathlib import Path

import pytest
from sampling import sampled

from antdsl import syntax
from antdsl.diagnostics import Diagnostic, Report
from antdsl.diagnostics.ignore_comments import apply_ignore_comments
from antdsl.lsp.text import DocumentText
from antdsl.lsp.workspace import Workspace
from antdsl.pipeline import compile_files
from antdsl.program.names.bindings import NameBindings
from antdsl.program.traverse import iterate_nodes
from antdsl.source import Source, Span
from antdsl.syntax import nodes
from antdsl.syntax.incremental_parser import IncrementalParser, cut_blocks

ROOT = Path(__file__).resolve().parents[2]
LIBRARY = {
    str(path): syntax.parse(Source(str(path), path.read_text(encoding="utf-8"))) for path in (ROOT / "behaviours").glob("*.ant")
}  # under the names that an editor gives them
EXAMPLES = sorted((ROOT / "examples").rglob("*.ant"))
INSERTED = ["{", "}", "(", ")", '"', "#", "\n", "\n\n", " ", ";", "x", "->", "when true -> search", "0.5 s", "state", "let a = b",
            "species two {\n  state a { steer heading }\n}\n", "  state extra { steer heading }\n", "Foo", "é", "// no", "-", "=",
            "use steering\n", "param p = 1\n", "world { surface other }\n", "\t", "\r"]  # fmt: skip


def said(diagnostics: list[Diagnostic]) -> list[tuple[object, ...]]:
    """All of each complaint, by places in the whole text."""

    def place(span: object) -> tuple[int, int] | None:
        return None if span is None else (span.start, span.end)  # type: ignore[attr-defined]

    return sorted(
        (d.code, d.message, d.help or "", d.severity, place(d.span), *((place(each.span), each.text) for each in d.labels),
         (place(d.fix.span), d.fix.text) if d.fix is not None else None)
        for d in diagnostics
    )  # fmt: skip


def bound(file: nodes.File, bindings: NameBindings) -> set[tuple[object, ...]]:
    """Every use of a name in a file with what it stands for, by places in the whole text. What is not written there, such as the
    names in a default of the language, is left out."""

    def place(span: Span) -> tuple[str, int, int]:
        file_span = file.file_span(span)
        return file_span.source.path, file_span.start, file_span.end

    written_there = {place(node.span) for node, _ in iterate_nodes(file.items) if isinstance(node, nodes.Name)}
    return {
        (place(span), place(key) if isinstance(key, Span) else key)
        for span, key in bindings.uses
        if place(span) in written_there
    }  # fmt: skip


def check_afresh(path: Path, text: str) -> tuple[list[tuple[object, ...]], set[tuple[object, ...]]]:
    """What the chain says about a text that is new to it, and what it resolves names to."""
    source = Source(str(path), text)
    parsed = syntax.parse(source)
    program, report = compile_files([path], parsed={**LIBRARY, str(path): parsed})
    own = [d for d in report.diagnostics if d.span is None or d.span.source.path == str(path)]
    assert program is not None
    return said(apply_ignore_comments(Report(own), [source]).diagnostics), bound(parsed[0], program.bindings)


def in_parts(workspace: Workspace, path: Path) -> tuple[list[tuple[object, ...]], set[tuple[object, ...]]]:
    """The same of a text that is open in an editor."""
    complaints, document = workspace.find_diagnostics(path), workspace.open_documents[path]
    return said(complaints), bound(document.parsed[0], workspace.find_bindings(path))


def edited(text: str, rng: random.Random) -> str:
    """A text with one edit: something typed, deleted, or a line moved."""
    place = rng.randrange(len(text) + 1)
    kind = rng.randrange(4)
    if kind == 0:
        return text[:place] + rng.choice(INSERTED) + text[place:]
    if kind == 1:
        return text[:place] + text[place + rng.choice([1, 1, 2, 5, 40, 200]) :]
    lines = text.split("\n")
    line = rng.randrange(len(lines))
    if kind == 2:
        lines.insert(rng.randrange(len(lines)), lines.pop(line))
    else:
        lines.insert(line, lines[line])
    return "\n".join(lines)


def run(path: Path, seed: int, edits: int) -> None:
    rng = random.Random(seed)
    original = path.read_text(encoding="utf-8")
    workspace, text = Workspace(), original
    workspace.put_document(path, text)
    assert in_parts(workspace, path) == check_afresh(path, text)
    for number in range(edits):
        text = original if number % 5 == 4 else edited(text, rng)
        text = text.replace("\r", "\n")
        workspace.change_document(path, DocumentText(text), number)
        assert in_parts(workspace, path) == check_afresh(path, text), f"seed {seed}, edit {number}:\n{text}"


@pytest.mark.parametrize("path", sampled(EXAMPLES, EXAMPLES[::3]), ids=lambda path: str(path.relative_to(ROOT / "examples")))
def test_incremental_parsing_equals_complete_parsing(path: Path) -> None:
    run(path, 1, 10)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2, 12))
@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: str(path.relative_to(ROOT / "examples")))
def test_incremental_parsing_equals_complete_parsing_after_many_edits(path: Path, seed: int) -> None:
    run(path, seed, 60)


def test_only_changed_blocks_are_parsed_again() -> None:
    text = (ROOT / "examples" / "foraging" / "forager.ant").read_text(encoding="utf-8")
    parts = IncrementalParser()
    first, _ = parts.parse(Source("x.ant", text))
    again, report = parts.parse(Source("x.ant", text.replace("held 0.5 s", "held 0.7 s", 1)))
    assert report.ok and len(first.parts) > 10
    assert len(set(again.parts) - set(first.parts)) == 1, "one state"


def test_blocks_are_complete_lines_in_order() -> None:
    for path in EXAMPLES:
        text = path.read_text(encoding="utf-8")
        blocks = cut_blocks(text)
        assert blocks is not None and len(blocks) > 3, path
        assert all(a.end <= b.start for a, b in pairwise(blocks))
        assert all(text[cut.start - 1 : cut.start] in ("", "\n") for cut in blocks)
        left = [text[a.end : b.start].partition("#")[0].strip() for a, b in pairwise(blocks)]
        assert set(left) <= {"", "}"}, "between blocks there is nothing but what closes a species"


def test_nodes_of_parts_have_locations_in_the_file() -> None:
    for path in EXAMPLES:
        source = Source(str(path), path.read_text(encoding="utf-8"))
        plain, _ = syntax.parse(source)
        parted, _ = IncrementalParser().parse(source)
        assert parted.parts, path

        def names(file: nodes.File) -> list[tuple[str, int, int]]:
            spans = [
                (node.text, file.file_span(node.span)) for node, _ in iterate_nodes(file.items) if isinstance(node, nodes.Name)
            ]
            return [(text, span.start, span.end) for text, span in spans]

        assert names(plain) == names(parted), path
        assert {c.text for c in parted.comments} <= {c.text for c in plain.comments}, path
