"""Parses a text incrementally. The text is divided into blocks, and a block is parsed again only when its text changes."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

from antdsl.diagnostics.model import Diagnostic, Fix, Label, Report
from antdsl.source import Source, Span
from antdsl.syntax import nodes as n
from antdsl.syntax.file_limits import ZERO_FILE_SIZES, add_sizes, is_within_limits
from antdsl.syntax.parser import ParsedPart, parse, parse_part
from antdsl.syntax.words import BLOCK_WORDS, LINE_WORDS_BY_RULE

# Brackets and line ends, and text that may hide them. Named groups require parsing the complete text.
_PIECE_PATTERN = re.compile(
    r'"[^"\n]*"|#[^\n]*|(?P<odd>\n[ \t]*\{)|[{}()\[\]\n]'
    r'|(?P<strange>["\x00-\x08\x0b-\x1f\x7f-\U0010ffff]|//|/\*|<<<<<<<|>>>>>>>|```|~~~)'
)
_FIRST_WORD_PATTERN = re.compile(r"[ \t]*([a-z]+)(?![A-Za-z_0-9])")
_BLOCK_START_WORDS = BLOCK_WORDS | {"on", "from"}
_TOP_LEVEL_WORDS = frozenset(LINE_WORDS_BY_RULE["top"])
_SPECIES_PATTERN = re.compile(r"species\b[^{}\n]*\{[ \t]*(?:#[^\n]*)?\n")
_EDITION_PATTERN = re.compile(r"(?:[ \t]*(?:#[^\n]*)?\n)*[ \t]*ant\b")
# Errors that a file reports once. If two blocks report one, the complete text must be parsed.
_ONCE_PER_FILE_CODES = frozenset(("bad-name", "look-alike", "odd-blank", "name-too-long", "line-too-long", "markdown-fence"))
_MAX_DIAGNOSTICS = 50  # parse errors after which messages get shorter


@dataclass(frozen=True, slots=True)
class TextBlock:
    """A range of complete lines, with the grammar rule that reads them."""

    rule: str
    start: int
    end: int


def cut_blocks(text: str) -> list[TextBlock] | None:
    """Return the blocks of a text, in order. Return None if the text must be parsed as a whole, for example because brackets are
    not paired.

    Each item at the top level of the file is a block, except a species. A species consists of several blocks: its first line,
    and each of its members."""
    tops, members = _find_bounds(text)
    if not tops or not _EDITION_PATTERN.match(text, 0, tops[0]):
        return None
    cut_list: list[TextBlock] = [TextBlock("begins", 0, tops[0])]
    for start, end in zip(tops, [*tops[1:], len(text)], strict=True):
        cut_list += (
            _cut_species(text, start, end, members) if text.startswith("species", start) else [TextBlock("top", start, end)]
        )
    return cut_list


def _find_bounds(text: str) -> tuple[list[int] | None, dict[int, tuple[list[int], int]]]:
    """Return the offsets at which the top-level items of a file begin, and the bounds of the lines in their braces. The first
    result is None if the brackets are not paired.

    The bounds are stored by the offset of the opening brace. They are the offsets of the lines inside the braces, and the offset
    of the closing brace."""
    tops: list[int] = [0] if _find_first_word(text, 0) in _TOP_LEVEL_WORDS else []
    members: dict[int, tuple[list[int], int]] = {}
    stack: list[str] = []
    opened, lines = 0, []  # type: tuple[int, list[int]]
    for match in _PIECE_PATTERN.finditer(text):
        if match.lastgroup:
            return None, {}
        sign = match.group()
        if sign == "\n":
            if not stack:
                if _find_first_word(text, match.end()) in _TOP_LEVEL_WORDS:
                    tops.append(match.end())
            elif len(stack) == 1 and stack[0] == "{":
                lines.append(match.end())
        elif sign in "{([":
            if sign == "{" and stack and stack[-1] != "{":
                return None, {}
            if not stack:
                opened, lines = match.start(), []
            stack.append(sign)
        elif sign in "})]":
            if not stack or stack.pop() + sign not in ("{}", "()", "[]"):
                return None, {}
            if not stack and sign == "}":
                members[opened] = lines, match.start()
    return (None if stack else tops), members


def _find_first_word(text: str, offset: int) -> str:
    match = _FIRST_WORD_PATTERN.match(text, offset)
    return match.group(1) if match else ""


def _cut_species(text: str, start: int, end: int, members: dict[int, tuple[list[int], int]]) -> Iterator[TextBlock]:
    head = _SPECIES_PATTERN.match(text, start, end)
    opened = text.find("{", start, end)
    lines, closed = members.get(opened, ([], -1))
    rest = text[closed + 1 : end] if closed >= 0 else ""
    if head is None or not lines or re.sub("#[^\n]*", "", rest).strip() or text[lines[-1] : closed].strip():
        yield TextBlock("top", start, end)
        return
    yield TextBlock("species", start, head.end())
    begin, block = head.end(), False
    for line in lines[:-1] if lines[0] == head.end() else lines:
        word = _find_first_word(text, line)
        if line > begin and word and (block or word in _BLOCK_START_WORDS):
            yield TextBlock("member", begin, line)
            begin = line
        if word:
            block = word in _BLOCK_START_WORDS
    yield TextBlock("member", begin, lines[-1])


@dataclass(slots=True)
class IncrementalParser:
    """Parser of one file that stores the parsed blocks from one version of the file to the next."""

    _cached_blocks: list[tuple[TextBlock, str, ParsedPart]] = field(default_factory=list)
    _parse_count: int = 0

    def parse(self, source: Source) -> tuple[n.File, Report]:
        """Return the parsed file and its errors, as `syntax.parse` does.

        Nodes have locations in separately parsed parts of the file. `File.file_span` converts them to locations in the file.
        Comments after the closing brace of a species are omitted."""
        cut_list = cut_blocks(source.text)
        if cut_list is None or len(cut_list) < 3:
            return parse(source)
        texts = [source.text[cut.start : cut.end] + ("}" if cut.rule == "species" else "") for cut in cut_list]
        head_count, tail_count = self._count_unchanged(cut_list, texts)
        last = len(cut_list) - tail_count
        new_blocks: list[tuple[TextBlock, str, ParsedPart]] = []
        sizes = ZERO_FILE_SIZES
        for number, (cut, text) in enumerate(zip(cut_list, texts, strict=True)):
            part = (
                self._cached_blocks[number][2] if number < head_count
                else self._cached_blocks[number - len(cut_list)][2] if number >= last
                else self._parse_block(source, cut, text)
            )  # fmt: skip
            new_blocks.append((cut, text, part))
            sizes = add_sizes(sizes, part.sizes)
            if not is_within_limits(sizes):
                return parse(source)  # which reports the exceeded limit
        self._cached_blocks = new_blocks
        parts = [(cut, part) for cut, _, part in self._cached_blocks]
        diagnostics = [d for _, part in parts for d in part.report.diagnostics]
        species_parts = [part for cut, part in parts if cut.rule == "species"]
        hard = any(part.report.diagnostics or not _is_species(part) for part in species_parts)
        if hard or len(diagnostics) > _MAX_DIAGNOSTICS or sum(d.code in _ONCE_PER_FILE_CODES for d in diagnostics) > 1:
            return parse(source)
        return _join_parts(source, parts)

    def _count_unchanged(self, blocks: list[TextBlock], texts: list[str]) -> tuple[int, int]:
        """Return how many blocks at the beginning of the file, and how many at its end, are unchanged.

        Blocks are compared in order. Equal texts at other positions do not count, because their locations differ."""
        cached_blocks, limit = self._cached_blocks, min(len(self._cached_blocks), len(blocks))
        head_count = tail_count = 0
        while head_count < limit and self._is_unchanged(cached_blocks[head_count], blocks[head_count], texts[head_count]):
            head_count += 1
        while tail_count < limit - head_count and self._is_unchanged(
            cached_blocks[-1 - tail_count], blocks[-1 - tail_count], texts[-1 - tail_count]
        ):
            tail_count += 1
        return head_count, tail_count

    @staticmethod
    def _is_unchanged(cached_block: tuple[TextBlock, str, ParsedPart], text_block: TextBlock, text: str) -> bool:
        return cached_block[0].rule == text_block.rule and cached_block[1] == text

    def _parse_block(self, source: Source, text_block: TextBlock, text: str) -> ParsedPart:
        self._parse_count += 1
        rule = "top" if text_block.rule in ("begins", "species") else text_block.rule
        return parse_part(Source(source.path, text, self._parse_count), rule, is_file_start=text_block.rule == "begins")


def _is_species(part: ParsedPart) -> bool:
    return len(part.nodes) == 1 and isinstance(part.nodes[0], n.Species)


def _join_parts(source: Source, parts: list[tuple[TextBlock, ParsedPart]]) -> tuple[n.File, Report]:
    items: list[n.TopItem] = []
    species: n.Species | None = None
    for cut, part in parts:
        if cut.rule == "member" and species is not None:
            species = replace(species, members=(*species.members, *part.nodes))
            items[-1] = species
            continue
        items += part.nodes
        species = part.nodes[0] if cut.rule == "species" else None
    first = parts[0][1]
    file = n.File(
        source, first.edition, first.help, tuple(items), tuple(c for _, part in parts for c in part.comments),
        tuple(span for _, part in parts for span in part.skipped_spans), any(not part.report.ok for _, part in parts),
        {part.source: cut.start for cut, part in parts},
    )  # fmt: skip
    return file, Report([move_diagnostic(each, file.file_span) for _, part in parts for each in part.report.diagnostics])


def move_diagnostic(diagnostic: Diagnostic, to_file_span: Callable[[Span], Span]) -> Diagnostic:
    """Return a diagnostic with all its spans converted by `to_file_span` from a part of a file to the complete file."""
    labels = tuple(Label(to_file_span(label.span), label.text) for label in diagnostic.labels)
    fix = Fix(to_file_span(diagnostic.fix.span), diagnostic.fix.text) if diagnostic.fix is not None else None
    return replace(
        diagnostic, span=to_file_span(diagnostic.span) if diagnostic.span is not None else None, labels=labels, fix=fix
    )
