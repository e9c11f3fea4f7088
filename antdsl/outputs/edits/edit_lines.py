"""Reads edits: converts the text of a file to the lines of `edits:`. Each error has its location and a suggested correction."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from antdsl import limits
from antdsl.diagnostics import Report
from antdsl.diagnostics.suggestion import find_nearest_name
from antdsl.outputs.cache.manifest import Manifest, join_line
from antdsl.outputs.edits.cache_selection import list_selector_names
from antdsl.outputs.edits.edit_layer import AgentsLine, EditLine
from antdsl.outputs.edits.verb_table import VERB_BY_WORD
from antdsl.scene.document import (
    DocumentNode,
    MappingNode,
    PathKey,
    ScalarNode,
    SequenceNode,
    decode_source,
    find_span,
    read_document,
    to_plain_tree,
)
from antdsl.scene.flow_mistakes import explain_joined_entry
from antdsl.scene.load import drop_cascading_errors, report_model_error
from antdsl.scene.notes.selectors import find_selector_problems, find_unknown_name
from antdsl.scene.values import FrameRange
from antdsl.source import Source, Span

_EXAMPLE = "write `edits:` and below it lines such as `- {kill: ant, share: 30 %}`"
EDITS_KEY = "edits"


@dataclass(frozen=True, slots=True, eq=False)
class PlacedEdit:
    """A line of `edits:` with its location. `text`: the line as a single line of text. `number`: its index among the lines."""

    line: EditLine
    text: str
    number: int


@dataclass(frozen=True, slots=True, eq=False)
class EditList:
    """The edits of a file that are not off, in the order of the text."""

    edits: tuple[PlacedEdit, ...]
    document: MappingNode
    source: Source

    def span(self, edit: PlacedEdit, *path: PathKey) -> Span:
        """Return the location of a line, or of a value in the line."""
        return find_span(self.document, (EDITS_KEY, edit.number, *path))[0]


def read_edits(data: bytes, name: str, manifest: Manifest) -> tuple[EditList | None, Report]:
    """Return the edits in the content of a file, and a report. The edits are None if there are errors.

    `manifest`: the manifest of the cache to be edited, which has the names that selectors use."""
    source, report = decode_source(data, name, "edits")
    document = None
    if report.ok:
        document, report = read_document(source, "the file of edits", _EXAMPLE)
    if document is None:
        return None, report
    nodes = document.entries.get(EDITS_KEY)
    for key in document.entries:
        if key != EDITS_KEY:
            report.error("unknown-key", f"`{key[:60]}` is not a key of edits", document.keys[key], _EXAMPLE)
    if not isinstance(nodes, SequenceNode):
        report.error("missing-key", "the file of edits has no list `edits`", Span(source, 0, min(1, len(source.text))), _EXAMPLE)
    elif len(nodes.items) > limits.MAX_EDITS:
        message = f"{len(nodes.items):,} edits are more than the limit of {limits.MAX_EDITS:,}"
        report.error("too-large", message, nodes.span, "combine edits of the same verb by a list of agents")
    if not report.ok or not isinstance(nodes, SequenceNode):
        return None, report
    edits = [
        PlacedEdit(line, join_line(node.span.text), number)
        for number, node in enumerate(nodes.items)
        for line in _read_line(report, document, number, node)
    ]
    placed = EditList(tuple(edit for edit in edits if edit.line.off == "no"), document, source)
    for edit in edits:
        _check_names(report, placed, edit, manifest)
    return (placed if report.ok else None), report


def _read_line(report: Report, document: MappingNode, number: int, node: DocumentNode) -> Iterator[EditLine]:
    """Yield the line at a node. If the node is not a valid line, report an error and yield nothing."""
    from pydantic import ValidationError

    known = ", ".join(f"`{word}`" for word in VERB_BY_WORD)
    if not isinstance(node, MappingNode) or not node.entries:
        joined = explain_joined_entry(node.text) if isinstance(node, ScalarNode) else None
        message, help = joined or ("expected an edit here", "write a line such as `{kill: ant, share: 30 %}`")
        report.error("wrong-value", message, node.span, help)
        return
    verb = next(iter(node.entries))
    if verb not in VERB_BY_WORD:
        meant = next((key for key in node.entries if key in VERB_BY_WORD), None)
        near = find_nearest_name(verb, VERB_BY_WORD)
        help = f"write `{meant}` first" if meant else f"did you mean `{near}`?" if near else f"write one of {known}"
        report.error("unknown-key", f"`{verb[:60]}` is not an edit", node.keys[verb], help)
        return
    model, tag = VERB_BY_WORD[verb].line, f"{verb}-edit"
    try:
        yield model.model_validate(to_plain_tree(node))
    except ValidationError as problem:
        for error in drop_cascading_errors(problem.errors(include_url=False, include_input=False)):
            error["loc"] = (EDITS_KEY, number, tag, *error["loc"])
            report_model_error(report, document, error, {tag: model})


def _check_names(report: Report, edits: EditList, edit: PlacedEdit, manifest: Manifest) -> None:
    """Report the names and frames in a line that do not exist in the cache."""
    line, names = edit.line, list_selector_names(manifest)
    problems = (
        [*find_selector_problems(line.agents, names, line.verb), *find_selector_problems(line, names)]
        if isinstance(line, AgentsLine)
        else []
    )
    for problem in problems:
        help = problem.help
        if not manifest.lines:
            help += "; this cache has no names of crowd lines: the scene gives none, or an older version wrote it"
        report.error("unknown-name", problem.message, edits.span(edit, *problem.path), help)
    for path, name in line.list_items():
        for problem in find_unknown_name(name, names.items, "no item is named", path):
            report.error("unknown-name", problem.message, edits.span(edit, *path), problem.help)
    for key in ("frames", "ever"):
        frames: FrameRange | None = getattr(line, key, None)
        if frames is not None and (frames.last < manifest.first or frames.first > manifest.last):
            message, help = (
                f"the cache has no frames {frames.first} to {frames.last}",
                f"the cache has frames {manifest.first} to {manifest.last}",
            )
            report.error("wrong-value", message, edits.span(edit, key), help)
