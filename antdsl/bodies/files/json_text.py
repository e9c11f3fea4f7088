"""Parses JSON text into a tree in which each value knows its location in the text.

The format is RFC 8259. In addition, comments (`//`, `/* */`) and a comma after the last value are allowed. The nesting depth and
the number of values are limited during parsing."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from math import isfinite

from antdsl import limits
from antdsl.diagnostics import Label, Report
from antdsl.diagnostics.suggestion import find_nearest_name
from antdsl.scene.document import PathKey, decode_source
from antdsl.source import Source, Span

JsonValue = dict[str, "JsonNode"] | list["JsonNode"] | list[float] | str | int | float | bool | None


_KIND_NAMES = {
    dict: "names with values `{ … }`", list: "a list", str: "a text", bool: "true or false", int: "a number", float: "a number",
    type(None): "nothing",
}  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class JsonNode:
    """A JSON value, which begins at the character `start` of its text and ends before `end`.

    `value`: a mapping for an object; a list of plain numbers for an array of numbers only; a list of nodes for any other array.
    `keys`: the locations of an object's keys.
    `has_plain_numbers`: whether `value` is a list of plain numbers."""

    source: Source
    value: JsonValue
    start: int
    end: int
    keys: dict[str, tuple[int, int]] = field(default_factory=dict)
    has_plain_numbers: bool = False

    @property
    def span(self) -> Span:
        """Return the span of the complete value."""
        return Span(self.source, self.start, self.end)

    @property
    def marked_span(self) -> Span:
        """Return the span that findings about the value mark. For an object or an array, it is the first character, otherwise
        the complete text of the value."""
        return Span(self.source, self.start, self.start + 1) if isinstance(self.value, dict | list) else self.span

    @property
    def kind(self) -> str:
        """Return the kind of the value in words, such as `an object`."""
        return _KIND_NAMES[type(self.value)]

    def get_inner(self, key: PathKey) -> JsonNode | None:
        """Return the node of an object's entry or of an array's item, or None if there is none."""
        if isinstance(self.value, dict) and isinstance(key, str):
            return self.value.get(key)
        if isinstance(self.value, list) and isinstance(key, int) and not self.has_plain_numbers and 0 <= key < len(self.value):
            item = self.value[key]
            return item if isinstance(item, JsonNode) else None
        return None


def find_node(root: JsonNode, path: Sequence[PathKey]) -> JsonNode:
    """Return the node at a path of keys. Keys that the tree does not have are skipped."""
    node = root
    for key in path:
        node = node.get_inner(key) or node
    return node


def find_span(root: JsonNode, path: Sequence[PathKey], *, key: bool = False) -> Span:
    """Return the span for findings about the node at `path`, or about the innermost existing node on the path.

    `key`: return the span of the path's last key instead."""
    if not path:
        return root.marked_span
    node, last = find_node(root, path[:-1]), path[-1]
    if key and isinstance(last, str) and last in node.keys:
        return Span(node.source, *node.keys[last])
    if node.has_plain_numbers and isinstance(last, int):
        return _find_number_span(node, last)
    return (node.get_inner(last) or node).marked_span


def find_text(root: JsonNode, text: str) -> Span:
    """Return the span of the first value in a tree that equals `text`. If there is no such value, return the span that marks the
    complete tree."""
    waiting = [root]
    while waiting:
        node = waiting.pop(0)
        if node.value == text and isinstance(node.value, str):
            return node.span
        children = node.value.values() if isinstance(node.value, dict) else node.value if isinstance(node.value, list) else ()
        waiting += [each for each in children if isinstance(each, JsonNode)]
    return root.marked_span


def _find_number_span(node: JsonNode, number: int) -> Span:
    """Return the span of one number in a list."""
    for count, match in enumerate(re.finditer(r"[^\s,\[\]]+", node.span.text)):
        if count == number:
            return Span(node.source, node.start + match.start(), node.start + match.end())
    return node.span


def report_unknown_name(
    report: Report, span: Span | None, noun: str, name: str, known_names: Iterable[str], *, is_warning: bool = False
) -> None:
    """Report that there is no `noun` called `name`, and suggest the most similar of `known_names`."""
    near = find_nearest_name(name, known_names)
    add = report.warning if is_warning else report.error
    add("unknown-name", f"there is no {noun} `{name[:60]}`", span, f'write `"{near}"`' if near else None)


class _SyntaxErrorReported(Exception):
    """Error that ends the parsing of a text. The finding is already in the report."""


_SPACE_PATTERN = re.compile(r"(?:[ \t\r\n]+|//[^\n]*|/\*(?:[^*]|\*(?!/))*+\*/)*+")
_STRING_PATTERN = re.compile(r'"(?:[^"\\\x00-\x1f]|\\.)*+"')
_NUMBER_PATTERN = re.compile(r"-?(?:0|[1-9][0-9]*+)(\.[0-9]++)?([eE][+-]?[0-9]++)?(?![0-9A-Za-z_.+-])")
_NUMBER_ARRAY_PATTERN = re.compile(r"\[[-+0-9eE.,\s]*+\]")
_WORD_PATTERN = re.compile(r"[A-Za-z0-9_.+'\-]{1,40}")
_LONE_SURROGATE_PATTERN = re.compile("[\ud800-\udfff]")
_VALUE_BY_WORD: dict[str, bool | None] = {"true": True, "false": False, "null": None}
_MAX_MAGNITUDE = 1.7e308
_MAX_DIGITS = 400  # maximum number of characters in a number
_NON_FINITE_WORDS = frozenset(
    ("nan", "inf", "infinity", "-nan", "-inf", "-infinity", "+inf", "+infinity", "1.#inf", "1.#qnan", "-1.#ind")
)
_WORD_CORRECTIONS = {"True": "true", "False": "false", "None": "null", "undefined": "null", "TRUE": "true", "FALSE": "false"}


def read_tree(data: bytes, name: str, expected_part: str) -> tuple[JsonNode | None, Report]:
    """Return the tree of a file's bytes, and a report. After an error, the tree is None and the report contains the error.

    `expected_part`: what the file should contain, in words, such as `a rig`."""
    source, report = decode_source(data, name, expected_part)
    return read_json(source, expected_part) if report.ok else (None, report)


def read_json(source: Source, expected_part: str) -> tuple[JsonNode | None, Report]:
    """Return the tree of a text, and a report. After an error, the tree is None and the report contains the error.

    `expected_part`: what the text should contain, in words, such as `a rig`."""
    reader = _JsonReader(source, expected_part)
    try:
        return reader.read_document(), reader.report
    except _SyntaxErrorReported:
        return None, reader.report


class _JsonReader:
    """A recursive parser of one text. A method that reads a value takes its position in the text and returns its node."""

    def __init__(self, source: Source, expected_part: str) -> None:
        self.source, self.text, self.expected_part = source, source.text, expected_part
        self.report = Report()
        self.count = 0

    def report_error(
        self, start: int, end: int, message: str, help: str | None, *labels: Label, code: str = "json-syntax"
    ) -> _SyntaxErrorReported:
        """Report an error at characters `start` to `end`, and return the exception that the caller must raise."""
        if len(self.text) > start:
            end = max(end, start + 1)
        self.report.error(code, message, Span(self.source, start, end), help, labels=labels)
        return _SyntaxErrorReported()

    def skip_whitespace(self, offset: int) -> int:
        """Return the position after white space and comments that begin at `offset`."""
        match = _SPACE_PATTERN.match(self.text, offset)
        assert match is not None
        offset = match.end()
        if self.text.startswith("/*", offset):
            raise self.report_error(offset, offset + 2, "this comment has no end", "write `*/` at the end of the comment")
        return offset

    def read_document(self) -> JsonNode:
        """Return the node of the complete text, which must be a single value."""
        at = self.skip_whitespace(0)
        if at == len(self.text):
            raise self.report_error(0, 0, f"the file is empty, but must contain {self.expected_part}", "write `{ … }`")
        node = self.read_value(at, 0)
        at = self.skip_whitespace(node.end)
        if at < len(self.text):
            raise self.report_error(at, at + 1, f"there is text after the end of {self.expected_part}", "delete it")
        return node

    def read_value(self, offset: int, depth: int) -> JsonNode:
        """Return the node of the value at `offset`, which may be of any kind. `depth`: the number of brackets around it."""
        self.count += 1
        if self.count > limits.MAX_BODY_JSON_VALUES:
            raise self.report_error(
                offset, offset, f"there are more than {limits.MAX_BODY_JSON_VALUES:,} values", None, code="too-large"
            )
        sign = self.text[offset : offset + 1]
        if sign == "[":
            return self.read_number_array(offset) or self.read_array(offset, depth)
        if sign == "{":
            return self.read_object(offset, depth)
        if sign == '"':
            return self.read_string(offset)
        match = _NUMBER_PATTERN.match(self.text, offset)
        if match:
            return JsonNode(self.source, self.parse_number(match), offset, match.end())
        return self.read_word(offset)

    def parse_number(self, match: re.Match[str]) -> int | float:
        """Return the number that the pattern matched. Raises an error for too many digits, and for values that are too large."""
        if match.end() - match.start() > _MAX_DIGITS:
            raise self.report_error(match.start(), match.end(), "a number has too many digits", "round it")
        value = float(match[0])
        if not isfinite(value):
            words = f"`{match[0][:40]}` is too large for a number"
            raise self.report_error(match.start(), match.end(), words, "write a smaller number", code="out-of-range")
        return value if match[1] or match[2] else int(match[0])

    def read_number_array(self, offset: int) -> JsonNode | None:
        """Parse an array that contains only numbers, such as the values of a clip. Return None if the array contains anything
        else, or an error."""
        match = _NUMBER_ARRAY_PATTERN.match(self.text, offset)
        if not match:
            return None
        inside = match[0][1:-1].strip()
        inside = inside.removesuffix(",") if inside != "," else inside
        try:
            values = json.loads(f"[{inside}]")
        except ValueError:  # repeated commas, an invalid number, or a number with thousands separators
            return None
        if not all(-_MAX_MAGNITUDE <= each <= _MAX_MAGNITUDE for each in values):
            return None
        self.count += len(values) // 16  # a plain number needs less memory than a node
        return JsonNode(self.source, values, offset, match.end(), has_plain_numbers=True)

    def enter_brackets(self, offset: int, depth: int) -> int:
        """Return the depth inside the brackets at a position. Raises an error if brackets are nested too deeply."""
        if depth >= limits.MAX_BRACKET_DEPTH:
            words = f"values are nested more than {limits.MAX_BRACKET_DEPTH} levels deep"
            raise self.report_error(offset, offset + 1, words, None, code="too-large")
        return depth + 1

    def read_array(self, offset: int, depth: int) -> JsonNode:
        depth, items, place = self.enter_brackets(offset, depth), [], self.skip_whitespace(offset + 1)
        while self.text[place : place + 1] != "]":
            items.append(self.read_value(self.require_text(place, offset, "]"), depth))
            place = self.skip_separator(items[-1].end, offset, "]")
        return JsonNode(self.source, items, offset, place + 1)

    def read_object(self, offset: int, depth: int) -> JsonNode:
        depth, place = self.enter_brackets(offset, depth), self.skip_whitespace(offset + 1)
        entries: dict[str, JsonNode] = {}
        keys: dict[str, tuple[int, int]] = {}
        while self.text[place : place + 1] != "}":
            key = self.read_key(self.require_text(place, offset, "}"))
            name = str(key.value)
            if name in entries:
                first = Label(Span(self.source, *keys[name]), "here first")
                words = f"the key `{name[:60]}` occurs twice"
                raise self.report_error(key.start, key.end, words, "keep one of them", first, code="duplicate-key")
            place = self.skip_whitespace(key.end)
            if self.text[place : place + 1] != ":":
                raise self.report_error(place, place + 1, f"`:` is missing after `{name[:60]}`", 'write `"key": value`')
            place = self.require_text(self.skip_whitespace(place + 1), offset, "}")
            if self.text[place : place + 1] in (",", "}"):
                raise self.report_error(key.start, key.end, f"`{name[:60]}` has no value", 'write `"key": value`')
            entries[name], keys[name] = self.read_value(place, depth), (key.start, key.end)
            place = self.skip_separator(entries[name].end, offset, "}")
        return JsonNode(self.source, entries, offset, place + 1, keys)

    def read_key(self, offset: int) -> JsonNode:
        """Return the node of an object's key, a text in double quotes."""
        if self.text[offset] == '"':
            return self.read_string(offset)
        match = _WORD_PATTERN.match(self.text, offset)
        word = match[0] if match else self.text[offset]
        bare = word.strip("'")
        help = f'write `"{bare}"`' if re.fullmatch("[A-Za-z0-9_.-]+", bare) else 'write `"key": value`'
        raise self.report_error(offset, offset + len(word), f"a key needs double quotes, but `{word}` has none", help)

    def require_text(self, offset: int, opening_offset: int, closing_bracket: str) -> int:
        """Return `offset` if it is before the end of the text. Raises an error if the text ends there, because a bracket is
        still open."""
        if offset >= len(self.text):
            opening = Label(Span(self.source, opening_offset, opening_offset + 1), "this bracket is still open")
            raise self.report_error(
                offset, offset, f"the text ends before `{closing_bracket}`", f"write the missing `{closing_bracket}`", opening
            )
        return offset

    def skip_separator(self, end: int, opening_offset: int, closing_bracket: str) -> int:
        """Return the position of the next value after the comma, or that of the closing bracket if there is no further value.
        `end`: the end of the previous value."""
        at = self.require_text(self.skip_whitespace(end), opening_offset, closing_bracket)
        if self.text[at] == ",":
            return self.require_text(self.skip_whitespace(at + 1), opening_offset, closing_bracket)
        if self.text[at] != closing_bracket:
            opening = Label(Span(self.source, opening_offset, opening_offset + 1), "this bracket is still open")
            help = f"write `,` between two values, or `{closing_bracket}` at the end"
            raise self.report_error(end, end + 1, f"`,` or `{closing_bracket}` is missing here", help, opening)
        return at

    def read_string(self, offset: int) -> JsonNode:
        match = _STRING_PATTERN.match(self.text, offset)
        if not match:
            line = re.compile(r"[^\n]*").match(self.text, offset)
            end = line.end() if line else offset + 1
            raise self.report_error(
                offset, end, "this text has no closing quote on its line, or has a character that must be escaped", 'write `"…"`'
            )
        try:
            text = str(json.loads(match[0]))
        except ValueError:
            raise self.report_error(
                offset, match.end(), "a `\\` in this text has no meaning", "write `\\\\` if you mean a backslash"
            ) from None
        if _LONE_SURROGATE_PATTERN.search(text):
            raise self.report_error(
                offset,
                match.end(),
                "this text contains only half of a character (a lone surrogate)",
                "write the complete character",
            )
        return JsonNode(self.source, text, offset, match.end())

    def read_word(self, offset: int) -> JsonNode:
        """Return the node of `true`, `false` or `null`. Raises an error for any other word, and suggests a correction."""
        match = _WORD_PATTERN.match(self.text, offset)
        word = match[0] if match else self.text[offset : offset + 1]
        if word in _VALUE_BY_WORD:
            return JsonNode(self.source, _VALUE_BY_WORD[word], offset, offset + len(word))
        message, help = f"`{word}` is not a value", None
        if word.lower() in _NON_FINITE_WORDS:
            message, help = f"`{word}` is not a valid number here", "write a number, such as `0`"
        elif word in _WORD_CORRECTIONS:
            help = f"write `{_WORD_CORRECTIONS[word]}`"
        elif word.startswith("'"):
            message, help = "text needs double quotes", 'write `"…"`'
        elif re.match(r"[-+.]?[0-9.]", word):
            message, help = f"`{word}` is not a valid number", "write `0.5`, `-2` or `1e-3`"
        elif match:
            help = f'write `"{word}"`' if re.fullmatch("[A-Za-z_]+", word) else None
        elif word == ",":
            message, help = "a value is missing before this comma", "delete the comma"
        raise self.report_error(offset, offset + len(word), message, help)
