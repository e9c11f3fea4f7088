"""Parses a scene's text to a tree of mappings, sequences and scalars, each with its location.

It reads YAML without tags, anchors, aliases, merges or duplicate keys. Scalars stay text. The schema decides the meaning of
`no`, `1:30` or `010`."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from antdsl import limits
from antdsl.diagnostics import Diagnostic, Label, Report
from antdsl.scene.flow_mistakes import explain_key_without_value, find_closing_parenthesis, suggest_flow_mapping
from antdsl.scene.indentation import explain_indentation, explain_missing_colon
from antdsl.source import Source, Span
from antdsl.syntax.mistakes.number_slips import find_comma_number, make_comma_diagnostic

PathKey = str | int


@dataclass(frozen=True, slots=True, eq=False)
class ScalarNode:
    """A scalar as text. `is_quoted`: whether it is in quotes in the source."""

    text: str
    is_quoted: bool
    span: Span


@dataclass(frozen=True, slots=True, eq=False)
class SequenceNode:
    """A sequence of values."""

    items: tuple[DocumentNode, ...]
    span: Span


@dataclass(frozen=True, slots=True, eq=False)
class MappingNode:
    """A mapping. `entries`: the values, in the order of the text; `keys`: the location of each key."""

    entries: dict[str, DocumentNode]
    keys: dict[str, Span]
    span: Span


DocumentNode = ScalarNode | SequenceNode | MappingNode


def to_plain_tree(node: DocumentNode) -> Any:
    """Return the tree as dicts, lists and str, the form that the schema reads."""
    if isinstance(node, MappingNode):
        return {key: to_plain_tree(value) for key, value in node.entries.items()}
    if isinstance(node, SequenceNode):
        return [to_plain_tree(item) for item in node.items]
    return node.text


def find_span(node: DocumentNode, path: Sequence[PathKey], *, key: bool = False) -> tuple[Span, tuple[PathKey, ...]]:
    """Return the location of the value at a path of keys, and the part of the path that exists.

    If `key` is true, return the location of the last key instead. If the value does not exist, return the location of its
    nearest existing ancestor. Parts of the path that are only in the schema, such as its tags, are skipped."""
    span, walked = node.span, ()  # type: tuple[Span, tuple[PathKey, ...]]
    for part in path:
        if isinstance(node, MappingNode) and isinstance(part, str) and part in node.entries:
            span = node.keys[part] if key else node.entries[part].span
            node = node.entries[part]
        elif isinstance(node, SequenceNode) and isinstance(part, int) and 0 <= part < len(node.items):
            node = node.items[part]
            span = node.span
        else:
            continue
        walked = (*walked, part)
    return span, walked


class _DocumentError(Exception):
    """Error that ends the reading of a document. It has already been added to the report."""


# Invisible characters and characters that look like a blank. YAML reads them as letters. Joiners belong to the spelling of words.
_UNUSUAL_BLANK_PATTERN = re.compile("[\u00a0\u00ad\u1680\u180e\u2000-\u200b\u200e\u200f\u202f\u205f-\u2064\u3000]")
_QUOTED_TEXT_PATTERN = re.compile(r"""'[^'\n]*'|"(?:\\.|[^"\\\n])*"|(?:^|(?<=\s))#[^\n]*""", re.MULTILINE)
_CALL_PATTERN = re.compile(r"[A-Za-z_]\w*\([^()\n]*\)", re.ASCII)
_MAX_QUOTED_LINE_CHARACTERS = 500  # characters around an error that are read for its message
_FORBIDDEN_CHARACTERS = re.compile(
    "[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ufeff\ud800-\udfff]"
)


def decode_source(data: bytes, name: str, file_kind: str = "a scene") -> tuple[Source, Report]:
    """Return the bytes of a text file as a Source, and a report. A byte order mark is dropped. Any encoding except UTF-8 is an
    error.

    `file_kind`: words for the kind of file, for messages."""
    report = Report()
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        source = Source(name, "")
        report.error("not-utf8", f"`{name}` is UTF-16, not UTF-8", Span(source, 0, 0), "save the file as UTF-8")
        return source, report
    data = data.removeprefix(b"\xef\xbb\xbf")
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as problem:
        display_text = data.decode("utf-8", "replace")
        place = len(data[: problem.start].decode("utf-8"))
        source = Source(name, display_text)
        report.error("not-utf8", f"byte {problem.start} is not UTF-8", Span(source, place, place + 1), "save the file as UTF-8")
        return source, report
    source = Source(name, text)
    bad = _FORBIDDEN_CHARACTERS.search(text)
    if bad:
        message = f"the character U+{ord(bad[0]):04X} is not allowed in {file_kind}: it is invisible"
        help = "start a new line there" if bad[0] in "\x85\u2028\u2029\x0b\x0c" else "delete it"
        report.error("control-character", message, Span(source, bad.start(), bad.end()), help)
    return source, report


def read_document(
    source: Source, subject: str = "the scene", example: str = "begin with `antdsl: 1`"
) -> tuple[MappingNode | None, Report]:
    """Return the tree of a text, and a report. The tree is None if the text is unusable.

    `subject`: words for the text, for messages. `example`: advice if the text is empty."""
    reader = _DocumentReader(source, subject, example)
    try:
        root = reader.read_root()
    except _DocumentError:
        return None, reader.report
    return (root if reader.report.ok else None), reader.report


@dataclass(slots=True)
class _UnfinishedNode:
    """A mapping or sequence under construction."""

    start: int
    is_mapping: bool
    items: list[DocumentNode] = field(default_factory=list)


class _DocumentReader:
    """Reader of one source. Errors are added to `report`."""

    def __init__(self, source: Source, subject: str, example: str) -> None:
        self.source, self.subject, self.example = source, subject, example
        self.report = Report()
        self.lines = [0]
        for match in re.finditer("\r\n|\r|\n", source.text):
            self.lines.append(match.end())

    def find_offset(self, mark: Any) -> int:
        """Return the character offset of `mark`, a position that YAML reports."""
        start: int = self.lines[min(mark.line, len(self.lines) - 1)]
        return min(start + int(mark.column), len(self.source.text))

    def find_span(self, event: Any) -> Span:
        """Return the location of a YAML event."""
        start, end = self.find_offset(event.start_mark), self.find_offset(event.end_mark)
        return Span(self.source, start, max(end, start))

    def make_error(self, code: str, message: str, span: Span, help: str | None = None, *labels: Label) -> _DocumentError:
        """Report an error. Return the exception, which the caller raises."""
        self.report.error(code, message, span, help, labels=labels)
        return _DocumentError()

    def read_root(self) -> MappingNode:
        """Return the tree. Raises _DocumentError after reporting an error."""
        import yaml

        loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
        try:
            root = self.build_tree(yaml, yaml.parse(self.source.text, Loader=loader))
        except yaml.YAMLError as problem:
            raise self.reject_syntax(problem) from None
        start_span = Span(self.source, 0, min(len(self.source.text), 1))
        if root is None or (isinstance(root, ScalarNode) and not root.text):
            raise self.make_error("empty-scene", f"{self.subject} is empty", start_span, self.example)
        if not isinstance(root, MappingNode):
            raise self.make_error("wrong-value", f"{self.subject} is a list of `key: value` lines", root.span, self.example)
        return root

    def reject_depth(self, span: Span) -> _DocumentError:
        """Report nesting that is too deep. Return the exception, which the caller raises."""
        return self.make_error("too-large", f"values are nested more than {limits.MAX_YAML_DEPTH} levels deep", span)

    def report_odd_blank(self, match: re.Match[str]) -> None:
        """Report the first character that looks like a blank but is a different character, such as a non-breaking space."""
        import unicodedata

        character = match[0]
        is_blank = unicodedata.category(character) == "Zs"
        message = f"{unicodedata.name(character).lower()} (U+{ord(character):04X})"
        count = len(_UNUSUAL_BLANK_PATTERN.findall(self.source.text))
        help = "type a space instead" if is_blank else "delete it"
        help += f"; the file has {count} such characters" if count > 1 else ""
        help += "; if a name contains one, put the name in quotes"
        place = Span(self.source, match.start(), match.end())
        words = f"this blank is not a space: {message}" if is_blank else f"{message} is invisible"
        self.report.error("odd-blank", words, place, help)

    def reject_syntax(self, problem: Any) -> _DocumentError:
        """Report a syntax error of YAML. Return the exception, which the caller raises."""
        mark = getattr(problem, "problem_mark", None) or getattr(problem, "context_mark", None)
        start = self.find_offset(mark) if mark is not None else 0
        words = (getattr(problem, "problem", None) or "this is not YAML").replace("'\\t'", "a tab")
        text, help = self.source.text, None
        labels: list[Label] = []
        if "nesting depth" in words:  # recent YAML readers look ahead beyond the events that they have returned
            return self.reject_depth(Span(self.source, start, min(start + 1, len(self.source.text))))
        if not text.isascii():
            odd = _UNUSUAL_BLANK_PATTERN.search(_QUOTED_TEXT_PATTERN.sub(lambda quoted: "." * len(quoted[0]), text))
            if odd is not None:
                self.report_odd_blank(odd)
                return _DocumentError()
        better = self.explain_problem(problem, start)
        if better is not None:
            self.report.add(better)
            return _DocumentError()
        if text[start : start + 1] == "\t" or "a tab" in words:
            words, help = "a tab cannot indent a line", "indent with blanks"
        elif "%" in text[start : start + 1]:
            words, help = "directives are not supported", "begin with `antdsl: 1`"
        elif "mapping values are not allowed" in words:
            words, help = "a second `:` in one line", self.find_call_help(start) or "put the text in quotes, or start a new line"
        elif str(getattr(problem, "context", "")).startswith("while parsing a flow"):
            opened = self.find_offset(problem.context_mark)
            closing = "}" if text[opened : opened + 1] == "{" else "]"
            words, help = f"expected `,` or `{closing}`", f"write the missing `{closing}`, or a comma between two values"
            indexed = re.search(r"([A-Za-z_]\w*)\[([0-9]+)\]?\Z", text[opened : start + 20].partition("]")[0], re.ASCII)
            if indexed is not None and text[start : start + 1] == "[":
                help = f"write `{indexed[1]}.{indexed[2]}`"
            help = self.find_call_help(start) or help
            labels = [Label(Span(self.source, opened, opened + 1), "this is still open")]
        place = Span(self.source, start, min(start + 1, len(text)))
        return self.make_error("scene-syntax", f"cannot read the scene here: {words}", place, help, *labels)

    def find_call_help(self, position: int) -> str | None:
        """Return advice on what to write instead of the call at a position, such as `all(ant, within: 9 mm)`. Return None if
        there is no call at the position."""
        line = self.source.text[max(0, position - _MAX_QUOTED_LINE_CHARACTERS) : position + _MAX_QUOTED_LINE_CHARACTERS]
        calls = _CALL_PATTERN.finditer(line)
        at = min(position, _MAX_QUOTED_LINE_CHARACTERS)
        return next((suggest_flow_mapping(call[0]) for call in calls if call.start() <= at < call.end()), None)

    def explain_problem(self, problem: Any, start: int) -> Diagnostic | None:
        """Return an error message that is more precise than YAML's own message, or None if there is none. `start`: the offset of
        the error."""
        if str(getattr(problem, "context", "")).startswith("while parsing a flow"):
            return None
        start_mark = getattr(problem, "context_mark", None)
        if "could not find expected ':'" in (getattr(problem, "problem", None) or "") and start_mark is not None:
            diagnostic = explain_missing_colon(self.source, self.find_offset(start_mark))
            if diagnostic is not None:
                return diagnostic
        return explain_indentation(self.source, start) or explain_missing_colon(self.source, start)

    def build_tree(self, yaml: Any, events: Any) -> DocumentNode | None:
        """Return the tree built from YAML's stream of events. The result is None if the text contains no document.

        The stack is explicit, so that limits on depth and size are checked before memory is used."""
        stack: list[_UnfinishedNode] = []
        root: DocumentNode | None = None
        count = documents = 0
        for event in events:
            node: DocumentNode | None = None
            if isinstance(event, yaml.DocumentStartEvent):
                documents += 1
                if event.version or event.tags:
                    raise self.make_error(
                        "yaml-tag",
                        "directives such as `%YAML` and `%TAG` are not supported",
                        self.find_span(event),
                        "delete the line",
                    )
                if documents > 1:
                    raise self.make_error(
                        "scene-syntax",
                        "the scene contains a second document",
                        self.find_span(event),
                        "delete `---` and everything after it",
                    )
                continue
            if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None):
                raise self.make_error(
                    "yaml-alias",
                    "anchors and aliases are not supported",
                    self.find_span(event),
                    "write the value wherever it is needed",
                )
            if getattr(event, "tag", None) not in (None, "!"):
                raise self.make_error(
                    "yaml-tag", "tags such as `!name` are not supported", self.find_span(event), "write only the value"
                )
            if isinstance(event, yaml.NodeEvent):
                count += 1
                if count > limits.MAX_YAML_NODES:
                    raise self.make_error(
                        "too-large", f"the scene has more than {limits.MAX_YAML_NODES:,} values", self.find_span(event)
                    )
            if isinstance(event, yaml.ScalarEvent):
                node = ScalarNode(event.value, bool(event.style), self.find_span(event))
                odd = None if event.style or event.value.isascii() else _UNUSUAL_BLANK_PATTERN.search(event.value)
                if odd is not None:
                    self.report_odd_blank(_UNUSUAL_BLANK_PATTERN.search(self.source.text, node.span.start) or odd)
                    raise _DocumentError
            elif isinstance(event, yaml.CollectionStartEvent):
                stack.append(_UnfinishedNode(self.find_offset(event.start_mark), isinstance(event, yaml.MappingStartEvent)))
                if len(stack) > limits.MAX_YAML_DEPTH:
                    raise self.reject_depth(self.find_span(event))
            elif isinstance(event, yaml.CollectionEndEvent):
                node = self.finish_node(stack.pop(), self.find_offset(event.end_mark))
            if node is not None:
                if stack:
                    stack[-1].items.append(node)
                else:
                    root = node
        return root

    def report_call_with_comma(self, open_node: _UnfinishedNode) -> None:
        """Report a comma inside the parentheses of a call, where it ends a value of `{…}` or `[…]`, as in `{kill: all(ant,
        within: 9 mm)}`."""
        for item in open_node.items:
            if not isinstance(item, ScalarNode) or item.is_quoted or item.text.count("(") <= item.text.count(")"):
                continue
            text = self.source.text
            end = find_closing_parenthesis(text, item.span.start, len(text))
            if end is None or "," not in text[item.span.start : end] or item.span.end >= end:
                continue
            call = Span(self.source, item.span.start, end)
            message = "the comma in these parentheses ends the value here"
            self.report.error("scene-syntax", message, call, suggest_flow_mapping(call.text))
            raise _DocumentError

    def finish_node(self, open_node: _UnfinishedNode, end: int) -> DocumentNode:
        """Return the finished node of a mapping or sequence that has been read completely. `end`: the offset at which it ends."""
        text = self.source.text
        while end > open_node.start + 1 and text[end - 1 : end].isspace():
            end -= 1
        span = Span(self.source, open_node.start, end)
        if not open_node.is_mapping:
            if text[open_node.start : open_node.start + 1] == "[":
                self.report_call_with_comma(open_node)
            return SequenceNode(tuple(open_node.items), span)
        is_flow = text[open_node.start : open_node.start + 1] == "{"
        if is_flow:
            self.report_call_with_comma(open_node)
        entries: dict[str, DocumentNode] = {}
        keys: dict[str, Span] = {}
        folded: dict[str, str] = {}
        for number, (key, value) in enumerate(zip(open_node.items[::2], open_node.items[1::2], strict=True)):
            if not isinstance(key, ScalarNode) or not key.text:
                self.report.error("wrong-value", "a key must be one word", key.span, "write `key: value`")
                continue
            if isinstance(value, ScalarNode) and not value.text and not value.is_quoted:  # `{radius: 0,4 m}`
                comma_number = find_comma_number(self.source, key.span.start - 1)
                if comma_number is not None:
                    self.report.add(make_comma_diagnostic(comma_number))
                    continue
                if is_flow and not key.is_quoted and not text[key.span.end : value.span.start + 1].lstrip().startswith(":"):
                    previous = open_node.items[2 * number - 1] if number else None
                    entry = (list(entries)[-1], previous.text) if isinstance(previous, ScalarNode) and entries else None
                    message, help = explain_key_without_value(key.text, entry)
                    self.report.error("scene-syntax", message, key.span, help)
                    raise _DocumentError
            if key.text == "<<":
                self.report.error("yaml-alias", "merges are not supported", key.span, "repeat the values where they are needed")
                continue
            other = folded.get(key.text.lower())
            if other is not None:
                words = f"`{key.text}` is given twice" if other == key.text else f"`{key.text}` and `{other}` differ by case only"
                self.report.error(
                    "duplicate-key", words, key.span, "keep one of them", labels=(Label(keys[other], "here first"),)
                )
                continue
            folded[key.text.lower()] = key.text
            entries[key.text] = value
            keys[key.text] = key.span
        return MappingNode(entries, keys, span)
