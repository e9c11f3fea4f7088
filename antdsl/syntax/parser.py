"""Parses source text to a File. The text is divided into lines, and each line is parsed separately, so that an error affects
only its line. The unreadable part of a line becomes a BadExpr, and the rest of the line remains."""

from __future__ import annotations

import re
from bisect import insort
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from threading import Lock
from typing import TYPE_CHECKING, Any

from antdsl import limits
from antdsl.diagnostics.model import Fix, Report
from antdsl.diagnostics.suggestion import find_nearest_name
from antdsl.source import Source, Span
from antdsl.syntax import nodes as n
from antdsl.syntax.blocks import BraceGroup, MappedText, SourceLine, cut_lines, map_text
from antdsl.syntax.brackets import get_token_text, pair_brackets
from antdsl.syntax.builder import Builder, FileHeader, ResultLine
from antdsl.syntax.editions import EDITIONS, FIRST_LINE, FIRST_LINE_ADVICE, UNKNOWN_EDITION_ADVICE
from antdsl.syntax.file_limits import (
    ZERO_FILE_SIZES,
    FileElementCounts,
    count_sizes,
    find_too_deep_nodes,
    is_within_limits,
    report_too_many,
)
from antdsl.syntax.mistakes.unexpected_tokens import (
    UnexpectedToken,
    has_doubled_sign,
    has_missing_brackets,
    is_line_start,
    make_diagnostic,
    make_misplaced_diagnostic,
    make_plain_diagnostic,
    suggest_first_word,
)
from antdsl.syntax.parse_tables import load_parser
from antdsl.syntax.scan import UNREADABLE_CHARACTER, TokenScan, scan_tokens
from antdsl.syntax.words import BODY_RULE_BY_LINE, LINE_CONTEXT_BY_WORD, LINE_WORDS_BY_RULE

if TYPE_CHECKING:
    from lark import Lark

_MAX_REPAIRED_LINES = 100  # after this many errors in a file, lines with errors are dropped instead of repaired
_BUILDER_LOCK = Lock()  # the builder stores the location of the current line

# Errors after which the meaning of a line is uncertain. After other errors it was corrected or removed.
_UNCERTAIN_CODES = frozenset((
    "missing-brace", "missing-line-end", "misplaced-line", "unclosed-bracket", "unclosed-text", "unexpected-text",
    "unfinished-line", "unknown-line", "unopened-bracket",
))  # fmt: skip

# Words and signs that separate the slots of a line. An unreadable slot is left out.
_SLOT_SEPARATORS = frozenset((
    "when", "held", "take", "from", "in", "to", "until", "then", "relax", "over", "for", "steer", "face", "->", "=", "+=",
    "-=", ":", "{", "}",
))  # fmt: skip


@lru_cache(maxsize=1)
def _load_parser_and_builder() -> tuple[Lark, Builder]:
    builder = Builder()
    return load_parser(builder), builder


def parse(source: Source) -> tuple[n.File, Report]:
    """Return a file with all parts of a text that could be read, and a report with an error for each part that could not.

    Never raises an exception."""
    report = Report()
    other = _detect_other_language(source.text)
    if other is not None:
        advice = f"a `.ant` file begins with `{FIRST_LINE}`"
        report.error("not-an-ant-file", f"this text looks like {other}", Span(source, 0, 1), advice)
        return n.File(source, None, None, (), has_errors=True), report
    scanned = scan_tokens(source, report)
    if all(token.kind == "end" for token in scanned.tokens):
        if report.ok:
            advice = f"begin with `{FIRST_LINE}`, then write a `species`"
            report.error("empty-file", "the file is empty", Span(source, 0, 0), advice)
        return n.File(source, None, None, (), tuple(scanned.comments), has_errors=True), report
    tokens = pair_brackets(scanned)
    if tokens is None:
        return n.File(source, None, None, (), tuple(scanned.comments), has_errors=True), report
    lines = cut_lines(scanned, tokens)
    scanned.fault_offsets.sort()
    if report_too_many(scanned, lines):
        return n.File(source, None, None, (), tuple(scanned.comments), has_errors=True), report
    with _BUILDER_LOCK:
        return _FileParser(scanned).parse_file(lines), report


@dataclass(frozen=True, slots=True, eq=False)
class ParsedPart:
    """The nodes of some complete lines of a file that were parsed separately.

    `edition`, `help`: if the lines are the beginning of the file, its edition and help; otherwise None. `sizes`: the numbers of
    words, statements and species in the lines."""

    source: Source
    nodes: tuple[Any, ...]
    report: Report
    comments: tuple[n.Comment, ...]
    skipped_spans: tuple[Span, ...]
    edition: n.Number | None = None
    help: n.Text | None = None
    sizes: FileElementCounts = ZERO_FILE_SIZES


def parse_part(source: Source, rule: str, *, is_file_start: bool = False) -> ParsedPart:
    """Parse some complete lines of a file. `rule`: the grammar rule for their context: `top`, or `member` inside a species.

    Braces in the lines must be paired. Lines that exceed the limits of a file are not read. `is_file_start`: whether they are
    the beginning of the file. Never raises an exception."""
    report = Report()
    scanned = scan_tokens(source, report)
    tokens = pair_brackets(scanned)
    if tokens is None:
        return ParsedPart(source, (), report, tuple(scanned.comments), ())
    lines = cut_lines(scanned, tokens)
    scanned.fault_offsets.sort()
    sizes = count_sizes(scanned, lines)
    if not is_within_limits(sizes):
        return ParsedPart(source, (), report, tuple(scanned.comments), (), sizes=sizes)
    with _BUILDER_LOCK:
        reading = _FileParser(scanned)
        edition, help, lines = reading.parse_beginning(lines) if is_file_start else (None, None, lines)
        nodes = reading.parse_lines(lines, rule)
        return ParsedPart(source, nodes, report, tuple(scanned.comments), reading.list_recovered_spans(), edition, help, sizes)


def _detect_other_language(text: str) -> str | None:
    """Return the language of a JSON or YAML file that has the extension of a program. Return None for any other text. The first
    line decides."""
    first = text.lstrip("\ufeff \t\r\n")[:200]
    if re.match(r"""[\[{]\s*["{\[\]}]""", first):
        return "JSON"
    return "YAML" if re.match(r"(---|%YAML|[A-Za-z_][A-Za-z_0-9]*:)([ \t\r\n]|$)", first) else None


class _FileParser:
    """Parser of the lines of one scanned text."""

    def __init__(self, scan: TokenScan) -> None:
        self.scan = scan
        self.source = scan.source
        self.report = scan.report
        self.parser, self.builder = _load_parser_and_builder()
        self.builder.body_by_offset = {}

    # --- the file ---

    def parse_file(self, lines: list[SourceLine]) -> n.File:
        edition, help, lines = self.parse_beginning(lines)
        items = self.parse_lines(lines, "top")
        if not items and self.report.ok:
            help_text = "write a `species`, or a `behaviour` that other files can use"
            self.report.error("empty-file", "file declares nothing", Span(self.source, 0, 0), help_text)
        comments, broken = tuple(self.scan.comments), not self.report.ok
        return n.File(self.source, edition, help, items, comments, self.list_recovered_spans(), broken)

    def parse_beginning(self, lines: list[SourceLine]) -> tuple[n.Number | None, n.Text | None, list[SourceLine]]:
        """Return the edition and the help of a file, and the lines that follow them."""
        edition, lines = self.parse_header(lines)
        help: n.Text | None = None
        if lines and [token.kind for token in lines[0].tokens] == ["text"]:
            first = lines.pop(0)
            help = n.Text(get_token_text(self.scan, first.tokens[0])[1:-1], Span(self.source, first.start, first.end))
        return edition, help, lines

    def list_recovered_spans(self) -> tuple[Span, ...]:
        return tuple(d.span for d in self.report.diagnostics if d.code in _UNCERTAIN_CODES and d.span is not None)

    def parse_header(self, lines: list[SourceLine]) -> tuple[n.Number | None, list[SourceLine]]:
        """Return the edition, and the lines after it. If no edition is given, use the current one and add a warning."""
        if lines and [token.kind for token in lines[0].tokens] == ["number"]:
            span = Span(self.source, lines[0].start, lines[0].end)
            self.report.error("unexpected-text", f"file begins with `{span.text}`", span, FIRST_LINE_ADVICE)
            return None, lines[1:]
        if not lines or get_token_text(self.scan, lines[0].tokens[0]) != "ant":
            start = lines[0].start if lines else 0
            if not self.scan.has_fault(0, start):
                span = Span(self.source, start, lines[0].tokens[0].end if lines else 0)
                fix, message = Fix(Span(self.source, 0, 0), f"{FIRST_LINE}\n"), "file does not name its edition"
                self.report.warning("missing-edition", message, span, FIRST_LINE_ADVICE, fix=fix)
            return None, lines
        nodes = self.parse_line(lines[0], "header")
        for node in nodes:
            if isinstance(node, FileHeader):
                if node.edition.value not in EDITIONS:
                    message = f"edition `{node.edition.span.text}` is unknown to this version of antdsl"
                    self.report.error("unknown-edition", message, node.edition.span, UNKNOWN_EDITION_ADVICE)
                return node.edition, lines[1:]
        return None, lines[1:]

    # --- lines ---

    def parse_lines(self, lines: list[SourceLine], rule: str) -> tuple[Any, ...]:
        return tuple(node for line in lines for node in self.parse_line(line, rule))

    def parse_line(self, line: SourceLine, rule: str) -> list[Any]:
        """Return the nodes of a line: one node, no node for an invalid line, or two nodes if a line end is missing."""
        first = get_token_text(self.scan, line.tokens[0])
        if line.groups and first not in LINE_WORDS_BY_RULE[rule] and not self.has_reached_error_limit():
            first = find_nearest_name(first, LINE_WORDS_BY_RULE[rule]) or first
        for group in line.groups:
            self.suppress_block_errors(group)
            body = "weight" if group.is_choice else BODY_RULE_BY_LINE.get((rule, first)) or BODY_RULE_BY_LINE.get((rule, "*"))
            self.builder.body_by_offset[group.opening.start] = self.parse_lines(group.lines, body) if body else ()
        text = map_text(self.scan, line)
        from lark.exceptions import UnexpectedInput

        try:
            return self.check_node(self.try_parse(text, rule), line)
        except UnexpectedInput as error:
            at_error_limit = self.has_reached_error_limit()
            unexpected = self.make_unexpected(error, line, text, rule, at_error_limit)
            if not self.has_diagnostic(line, text):
                self.report.add(make_plain_diagnostic(unexpected) if at_error_limit else make_diagnostic(unexpected))
                insort(self.scan.fault_offsets, unexpected.span.start)
            return [] if at_error_limit else self.recover_line(line, text, rule, unexpected)

    def suppress_block_errors(self, group: BraceGroup) -> None:
        """Suppress errors in a block without `}`. Because its end is unknown, its last lines may belong outside of it."""
        if group.closing_brace.inserted_text and group.lines:
            one_line = "\n" not in self.source.text[group.opening.start : group.closing_brace.end]
            for line in group.lines if one_line else group.lines[-1:]:
                insort(self.scan.fault_offsets, line.start)

    def has_reached_error_limit(self) -> bool:
        """Return whether so many errors were reported that more would not help the author."""
        return len(self.report.diagnostics) > _MAX_REPAIRED_LINES

    def try_parse(self, text: MappedText, rule: str) -> Any:
        self.builder.span_maker = text
        return self.parser.parse(text.text, start=rule)

    def has_diagnostic(self, line: SourceLine, text: MappedText) -> bool:
        """Return whether an error about this line has already been reported."""
        for _, offset, length in text.parts[:-1]:
            if self.scan.has_fault(offset, offset + length - 1):
                return True
        _, offset, length = text.parts[-1]
        stop = self.source.text.find("\n", offset + length)
        return self.scan.has_fault(offset, len(self.source.text) if stop < 0 else stop)

    def check_node(self, node: Any, line: SourceLine) -> list[Any]:
        """Return the nodes of a line after checks that the grammar cannot express. They concern depth, results of behaviours,
        and unknown properties."""
        if len(line.tokens) > limits.MAX_EXPRESSION_DEPTH:
            for span in find_too_deep_nodes(node):
                message = f"this expression is more than {limits.MAX_EXPRESSION_DEPTH} operations deep"
                self.report.error("expression-too-deep", message, span, "give parts of the expression names with `let`")
                return []
        if isinstance(node, n.Behaviour):
            self.check_results(node, line)
        if (
            isinstance(node, n.AnimalProperty) and node.name.text in LINE_CONTEXT_BY_WORD
        ):  # `steer heading` reads like `size 4 mm`
            self.report.add(make_misplaced_diagnostic(node.name.text, node.name.span))
            return []
        return [node]

    def check_results(self, node: n.Behaviour, line: SourceLine) -> None:
        lines = self.builder.body_by_offset.get(line.groups[-1].opening.start, ()) if line.groups else ()
        results = [each for each in lines if isinstance(each, ResultLine)]
        if any(self.scan.has_fault(group.opening.start, group.closing_brace.end) for group in line.groups):
            return  # an unparsed line may be the result
        if not results:
            help = "end the behaviour with a line that is only a value, such as `direction(target)`"
            self.report.error("missing-result", f"behaviour `{node.name.text}` has no result", node.name.span, help)
        for extra in results[:-1]:
            help = "give this value a name with `let`, or delete the line"
            self.report.error("second-result", f"behaviour `{node.name.text}` has more than one result", extra.span, help)

    # --- lines that cannot be read ---

    def make_unexpected(
        self, error: Any, line: SourceLine, text: MappedText, rule: str, is_at_error_limit: bool
    ) -> UnexpectedToken:
        token = getattr(error, "token", None)
        ended = token is not None and token.type == "$END"
        position = len(text.text) if ended else error.pos_in_stream
        if token is not None and not ended:
            position = token.start_pos
        offset = text.find_source_offset(position)
        # the parser may have read `->` as a minus and failed at the `>`
        previous_tokens = [each for each in line.tokens if ended or each.end <= offset]
        next_tokens = line.tokens[len(previous_tokens) :]
        last, bad_token = (previous_tokens[-1] if previous_tokens else None), (next_tokens[0] if next_tokens else None)
        span = Span(self.source, bad_token.start, bad_token.end) if bad_token else Span(self.source, line.end, line.end)
        first = line.tokens[0]
        interactive = getattr(error, "interactive_parser", None)
        expected_terminals = interactive.accepts() if interactive is not None and not is_at_error_limit else ()
        return UnexpectedToken(
            rule,
            get_token_text(self.scan, first),
            get_token_text(self.scan, last) if last else "",
            last.kind if last else "",
            get_token_text(self.scan, bad_token) if bad_token else "",
            bad_token.kind if bad_token else "",
            span,
            Span(self.source, first.start, first.end),
            frozenset(expected_terminals),
            get_token_text(self.scan, next_tokens[1]) if len(next_tokens) > 1 else "",
            get_token_text(self.scan, previous_tokens[-2]) if len(previous_tokens) > 1 else "",
        )

    def recover_line(self, line: SourceLine, text: MappedText, rule: str, unexpected: UnexpectedToken) -> list[Any]:
        """Return the nodes that can be read from a line with an error. The error is already reported."""
        position = text.find_position(unexpected.span.start)
        if unexpected.token_text and is_line_start(unexpected):
            halves = [text.replace_range(position, len(text.text), ""), text.replace_range(0, position, "")]
            return [node for half in halves for node in self.parse_first_valid(iter([half]), rule)]
        return self.parse_first_valid(self.iterate_repairs(line, text, rule, unexpected, position), rule)

    def parse_first_valid(self, candidates: Iterator[MappedText], rule: str) -> list[Any]:
        from lark.exceptions import UnexpectedInput

        for candidate in candidates:
            try:
                return [self.try_parse(candidate, rule)]
            except UnexpectedInput:
                continue
        return []

    def iterate_repairs(
        self, line: SourceLine, text: MappedText, rule: str, unexpected: UnexpectedToken, position: int
    ) -> Iterator[MappedText]:
        suggestion = suggest_first_word(unexpected)
        if suggestion is not None:
            yield text.replace_range(0, len(unexpected.first_word), suggestion)
        if unexpected.token_text == "=" and "SAME" in unexpected.expected_terminals:
            yield text.replace_range(position, position + 1, ":")
            yield text.replace_range(position, position + 1, "==")
        if has_doubled_sign(unexpected):
            yield text.replace_range(position, position + 2, "=")
        if has_missing_brackets(unexpected):
            yield text.replace_range(position, position + len(unexpected.token_text), f"({unexpected.token_text})")
        lefts, rights, clause = self.find_gap(line, text, position)
        for left in lefts:
            for right in rights:
                if left <= right and "{" not in text.text[left:right]:
                    yield text.replace_range(left, right, f" {UNREADABLE_CHARACTER} ")
        for right in rights:
            if "{" not in text.text[clause:right]:
                yield text.replace_range(clause, right, " ")
        if unexpected.token_text and unexpected.token_text not in "{}":
            yield text.replace_range(position, position + len(unexpected.token_text), "")
        yield from self.iterate_bare_blocks(line, text, rule)

    def find_gap(self, line: SourceLine, text: MappedText, position: int) -> tuple[list[int], list[int], int]:
        """Return the possible bounds of the unreadable part of a line: a list of start positions, a list of end positions, and
        the start of its clause.

        The unreadable part may begin or end at the separators around it, and at the ends of the line. The clause starts at the
        previous separator. One of the repairs removes everything from there on."""
        marks: list[tuple[int, int]] = []
        depth = 0
        for token in line.tokens:
            sign = get_token_text(self.scan, token)
            depth -= sign in (")", "]")
            if depth <= 0 and (sign in _SLOT_SEPARATORS or token.kind == "text"):
                start = text.find_position(token.start)
                marks.append((start, start + len(sign)))
            depth += sign in ("(", "[")
        previous_marks = [mark for mark in marks if mark[1] <= position][-1:]
        lefts = [end for _, end in previous_marks]
        word_ends = [text.find_position(token.end) for token in line.tokens[:2] if token.end <= text.find_source_offset(position)]
        rights = [start for start, _ in marks if start >= position][:1]
        clause = previous_marks[0][0] if previous_marks else position
        return [*lefts, *reversed(word_ends), 0], [*rights, len(text.text)], clause

    def iterate_bare_blocks(self, line: SourceLine, text: MappedText, rule: str) -> Iterator[MappedText]:
        """Yield simplified texts that replace an unreadable first line of a block. They consist only of its first word, its name
        and the braces."""
        words = [token for token in line.tokens if token.kind in ("word", "text")][:2]
        first = get_token_text(self.scan, line.tokens[0])
        if not line.groups or BODY_RULE_BY_LINE.get((rule, first)) is None or len(words) < 2:
            return
        group = line.groups[-1]
        name = (get_token_text(self.scan, words[1]), words[1].start, words[1].end - words[1].start)
        head = [(f"{first} ", line.start, len(first)), name]
        braces = [
            ("{", group.opening.start, len("{")),
            ("}", group.closing_brace.start, group.closing_brace.end - group.closing_brace.start),
        ]
        extra = {"field": " on x ", "behaviour": "() -> push "}.get(first, " ")
        yield MappedText(self.source, [*head, (extra, words[1].end, 0), *braces])
