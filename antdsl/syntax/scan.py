"""Scans source text. It makes tokens, by which the text is divided, and a clean text for the parser. Characters and words that
are not allowed in any `.ant` text are reported here. They are corrected if the meaning is clear, so that one mistake gives
one message. The clean text is as long as the source, so offsets are valid in both."""

from __future__ import annotations

import re
import unicodedata
from bisect import bisect_left
from dataclasses import dataclass, field

from antdsl import limits
from antdsl.diagnostics.model import Fix, Report
from antdsl.source import Source, Span
from antdsl.syntax.mistakes.number_slips import (
    COMMA_NUMBER_PATTERN,
    LEADING_ZERO_PATTERN,
    find_number_problem,
    find_unit_help,
    make_comma_diagnostic,
)
from antdsl.syntax.mistakes.stray_text import (
    DOUBLE_QUOTES,
    SINGLE_QUOTES,
    WRONG_SIGN_HELP,
    check_stray_text,
    find_ascii_lookalike,
    make_replacement_word,
    replace_text_by_blanks,
)
from antdsl.syntax.nodes import Comment
from antdsl.syntax.words import NUMBER_REGEX, UNIT_REGEX, UNIT_SLIP_HELP, UNITS_REGEX

UNREADABLE_CHARACTER = "\ufffd"


@dataclass(frozen=True, slots=True)
class ScannedToken:
    """A token. `kind`: word, number, text, sign, open, close or end. `indent`: the indent of the line if this is its first
    token, else -1. `inserted_text`: the text of a missing bracket that was inserted, which has no length in the source."""

    kind: str
    start: int
    end: int
    indent: int = -1
    inserted_text: str = ""


@dataclass(slots=True)
class TokenScan:
    """The tokens and text that scanning produces. `clean_characters`: a list of characters until `text()` is called."""

    source: Source
    report: Report
    clean_characters: list[str]
    tokens: list[ScannedToken] = field(default_factory=list)
    comments: list[Comment] = field(default_factory=list)
    fault_offsets: list[int] = field(default_factory=list)  # offsets of errors, which suppress parse errors there

    def report_error(
        self,
        code: str,
        message: str,
        start: int,
        end: int,
        help: str | None = None,
        fix: str | None = None,
        insert_offset: int | None = None,
    ) -> None:
        """Report an error. `fix`: the text that replaces the span or, if `insert_offset` is set, is inserted at this offset."""
        span = Span(self.source, start, end)
        place = span if insert_offset is None else Span(self.source, insert_offset, insert_offset)
        self.report.error(code, message, span, help, fix=None if fix is None else Fix(place, fix))
        self.fault_offsets.append(start)

    def replace_by_blanks(self, start: int, end: int) -> None:
        self.clean_characters[start:end] = " " * (end - start)

    def replace_characters(self, start: int, text: str) -> None:
        self.clean_characters[start : start + len(text)] = text

    def has_fault(self, start: int, end: int) -> bool:
        """Return whether an error was reported between two offsets. `fault_offsets` must already be sorted."""
        index = bisect_left(self.fault_offsets, start)
        return index < len(self.fault_offsets) and self.fault_offsets[index] <= end


_TOKEN_PATTERN = re.compile(
    rf"""(?P<blank>[ \t\r]+)
    | (?P<comment>\#[^\n]*)
    | (?P<end>[\n;])
    | (?P<text>"[^"\n]*"?)
    | (?P<number>{NUMBER_REGEX})
    | (?P<word>[A-Za-z_][A-Za-z_0-9]*)
    | (?P<open>[(\[{{])
    | (?P<close>[)\]}}])
    | (?P<wrong>&&|\|\||//|/\*|=>|:=|===|\+\+|\*\*)
    | (?P<sign>->|\.\.|[-+<>=!]=|[-+*/^<>=.,:])
    | (?P<odd>.)""",
    re.VERBOSE | re.DOTALL,
)
_UNIT_BEHIND_PATTERN = re.compile(rf"[ \t]*{UNITS_REGEX}")
_WORD_PATTERN = re.compile(r"[A-Za-z_][A-Za-z_0-9]*")
_HYPHENATED_NAME_PATTERN = re.compile(r"[A-Za-z][A-Za-z_0-9]*(?:-[A-Za-z][A-Za-z_0-9]*)+(?![A-Za-z_0-9])")
_NAMING_WORDS = frozenset(
    ("state", "species", "param", "let", "latch", "field", "machine", "behaviour", "measure", "start", "->")
)  # a name follows
_ANY_WORD_PATTERN = re.compile(r"\w+")
_SWALLOWED_TAIL_PATTERN = re.compile(r"[ \t\r]*[{};]*[ \t\r]*(#[^\n]*)?$")  # the end of a line inside an unclosed text
_COLON_PATTERN = re.compile(r"[ \t]*:")
_FRACTION_PATTERN = re.compile(r"\.[0-9]+")
_UNIT_SLIP_PATTERN = re.compile(rf"[/*]({'|'.join(UNIT_SLIP_HELP)})(?![A-Za-z0-9_])")
_PER_UNIT_PATTERN = re.compile(rf"(?:[/*]{UNIT_REGEX})+")
_NON_NUMBER_WORDS = ("nan", "inf", "infinity")


def scan_tokens(source: Source, report: Report) -> TokenScan:
    """Return the tokens of a text. Errors are added to `report`. No text raises an exception."""
    text_scan = TokenScan(source, report, list(source.text))
    check_stray_text(text_scan)
    _Scanner(text_scan).scan_all()
    text_scan.fault_offsets.sort()
    return text_scan


class _Scanner:
    """One pass over the text, with a method for each kind of token. Faulty tokens are corrected or replaced by blanks."""

    def __init__(self, text_scan: TokenScan) -> None:
        self.token_scan = text_scan
        self.characters = "".join(text_scan.clean_characters)
        self.indent = 0  # indent of the current line; -1 after its first token
        self.reported_texts: set[str] = set()  # names and mistakes that are already reported
        self.last_end = -1  # offset where the last token ended
        self.open_bracket_count = 0  # open ( and [ that may contain comma-separated values

    def scan_all(self) -> None:
        position = 0
        while position < len(self.characters):
            match = _TOKEN_PATTERN.match(self.characters, position)
            assert match is not None and match.lastgroup is not None
            position = getattr(self, match.lastgroup)(match.start(), match.end(), match.group())

    def add_token(self, kind: str, start: int, end: int) -> int:
        self.token_scan.tokens.append(ScannedToken(kind, start, end, self.indent))
        self.indent = 0 if kind == "end" and self.characters[start] == "\n" else -1
        self.last_end = end
        return end

    def blank(self, start: int, end: int, piece: str) -> int:  # also for corrected blanks
        if self.indent >= 0:
            self.indent += sum(4 if character == "\t" else 1 for character in piece if character != "\r")
        self.token_scan.replace_by_blanks(start, end)
        return end

    def comment(self, start: int, end: int, piece: str) -> int:
        self.token_scan.comments.append(
            Comment(piece.rstrip("\r"), Span(self.token_scan.source, start, end - piece.endswith("\r")))
        )
        self.token_scan.replace_by_blanks(start, end)
        return end

    def end(self, start: int, end: int, piece: str) -> int:
        return self.add_token("end", start, end)

    def sign(self, start: int, end: int, piece: str) -> int:
        if piece == "." and self.characters[end : end + 1].isdigit() and self.last_end != start:
            digits = _FRACTION_PATTERN.match(self.characters, start)
            if digits is not None:
                stop = digits.end()
                message = f"number `{digits.group()}` begins with a dot"
                self.token_scan.report_error("bad-number", message, start, stop, f"write `0{digits.group()}`")
                self.token_scan.replace_characters(start, "1" + " " * (stop - start - 1))
                return self.add_token("number", start, self.find_quantity_end(stop))
        return self.add_token("sign", start, end)

    def open(self, start: int, end: int, piece: str) -> int:
        declares = [self.characters[each.start : each.end] for each in self.token_scan.tokens[-2:-1]] == ["behaviour"]
        self.open_bracket_count = 0 if piece == "{" or declares else self.open_bracket_count + 1
        return self.add_token("open", start, end)

    def close(self, start: int, end: int, piece: str) -> int:
        self.open_bracket_count = max(0, self.open_bracket_count - 1) if piece != "}" else 0
        return self.add_token("close", start, end)

    # --- words and numbers ---

    def word(self, start: int, end: int, piece: str) -> int:
        if self.characters[end : end + 1] > "\x7f" and self.characters[end].isalnum():
            return self.repair_foreign_word(start)
        if piece in _NON_NUMBER_WORDS and not _COLON_PATTERN.match(self.characters, end):
            help = "leave the limit out, or write a large number"
            self.token_scan.report_error("bad-number", f"`{piece}` is not a number here", start, end, help)
            return self.mark_unreadable(start, end)
        if len(piece) > limits.MAX_NAME_CHARACTERS:
            message = f"this name has {len(piece)} characters, but at most {limits.MAX_NAME_CHARACTERS} are allowed"
            self.token_scan.report_error("name-too-long", message, start, end, "choose a shorter name")
            self.reported_texts.add(piece)
        hyphened = _HYPHENATED_NAME_PATTERN.match(self.characters, start)
        if hyphened and self.token_scan.tokens and get_last_token_text(self.token_scan) in _NAMING_WORDS:
            return self.repair_hyphens(start, hyphened.end(), hyphened.group())
        if not re.fullmatch(r"[a-z][a-z_0-9]*", piece):
            suggestion = re.sub(r"[^a-z0-9_]", "_", re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "_", piece).lower()).strip("_") or "name"
            if piece not in self.reported_texts:
                self.reported_texts.add(piece)
                wrong = "begins with `_`" if piece[0] == "_" else "is not written in lower case"
                message = f"name `{piece[:80]}` {wrong}"
                help = f"write `{suggestion[:80]}`; names are small letters, digits and `_`, and begin with a letter"
                self.token_scan.report_error("bad-name", message, start, end, help, suggestion)
            self.token_scan.replace_characters(start, re.sub("^_+", lambda match: "x" * len(match.group()), piece.lower()))
        return self.add_token("word", start, end)

    def repair_hyphens(self, start: int, end: int, piece: str) -> int:
        """Correct hyphens in a name, such as `turn-home`, at the declaration of the name or the name of a state."""
        suggestion = piece.replace("-", "_").lower()
        if piece not in self.reported_texts:
            self.reported_texts.add(piece)
            help = f"write `{suggestion[:80]}`; names are small letters, digits and `_`, and begin with a letter"
            self.token_scan.report_error("bad-name", f"name `{piece[:80]}` has a `-` in it", start, end, help, suggestion)
        self.token_scan.replace_characters(start, suggestion)
        return self.add_token("word", start, end)

    def repair_foreign_word(self, start: int) -> int:
        """Correct a word with non-ASCII letters or digits, one letter at a time."""
        match = _ANY_WORD_PATTERN.match(self.characters, start)
        piece = match.group() if match else self.characters[start]
        end = start + len(piece)
        plain = "".join(find_ascii_lookalike(character) or "x" for character in piece)
        if re.fullmatch(r"[µμ]N", piece):
            self.token_scan.report_error("look-alike", f"unit `{piece}` has a Greek letter", start, end, "write `uN`", "uN")
            self.token_scan.replace_characters(start, "uN")
            return self.add_token("word", start, end)
        if piece not in self.reported_texts:
            self.reported_texts.add(piece)
            foreign_character = next(character for character in piece if character > "\x7f")
            name = unicodedata.name(foreign_character, f"U+{ord(foreign_character):04X}").lower()
            if all(find_ascii_lookalike(character) for character in piece):
                message = f"`{piece[:80]}` looks like `{plain[:80]}`, but has a {name} in it"
                self.token_scan.report_error("look-alike", message, start, end, f"type `{plain[:80]}`", plain)
            else:
                message = f"name `{piece[:80]}` has a {name} in it"
                self.token_scan.report_error("bad-name", message, start, end, "names are small letters a to z, digits and `_`")
        plain = plain.lower()
        self.token_scan.replace_characters(start, plain)
        if plain[0].isdigit():
            digits = len(plain) - len(plain.lstrip("0123456789"))
            return self.number(start, start + digits, plain[:digits])
        self.token_scan.replace_characters(start, "x" * (len(plain) - len(plain.lstrip("_"))))
        return self.add_token("word", start, end)

    def find_quantity_end(self, end: int) -> int:
        tail = _UNIT_BEHIND_PATTERN.match(self.characters, end)
        return tail.end() if tail else end

    def number(self, start: int, end: int, piece: str) -> int:
        commas = COMMA_NUMBER_PATTERN.match(self.characters, start)
        if commas is not None and (not self.open_bracket_count or LEADING_ZERO_PATTERN.search(commas.group())):
            return self.repair_commas(start, commas.end())
        problem = find_number_problem(piece, self.characters, end)
        if problem is not None:
            message, stop, help = problem
            self.token_scan.report_error("bad-number", message, start, stop, help)
            self.token_scan.replace_characters(start, "1" + " " * (stop - start - 1))
            end = stop
        tail = _UNIT_BEHIND_PATTERN.match(self.characters, end)
        if tail is not None:
            end = tail.end()
            slip = _UNIT_SLIP_PATTERN.match(self.characters, end)
            if slip is not None:
                message = f"`{slip.group(1)}` is not a unit"
                self.token_scan.report_error("unknown-unit", message, slip.start(1), slip.end(), UNIT_SLIP_HELP[slip.group(1)])
                return self.mark_unreadable(start, slip.end())
        elif (glued := _WORD_PATTERN.match(self.characters, end)) is not None:
            unit = glued.group()
            self.token_scan.report_error("unknown-unit", f"`{unit[:80]}` is not a unit", end, glued.end(), find_unit_help(unit))
            return self.mark_unreadable(start, glued.end())
        return self.add_token("number", start, end)

    def repair_commas(self, start: int, end: int) -> int:
        """Report a number with a comma where a comma cannot separate two numbers. A decimal comma is read as a dot."""
        diagnostic = make_comma_diagnostic(Span(self.token_scan.source, start, end))
        self.token_scan.report.add(diagnostic)
        self.token_scan.fault_offsets.append(start)
        if diagnostic.fix is None or len(diagnostic.fix.text) < end - start:
            return self.mark_unreadable(start, self.find_quantity_end(end))
        self.token_scan.replace_characters(start, diagnostic.fix.text)
        return self.add_token("number", start, self.find_quantity_end(end))

    def mark_unreadable(self, start: int, end: int) -> int:
        """Add a token that stands for a number with an unknown unit. Checks of units ignore it."""
        self.token_scan.replace_by_blanks(start, end)
        self.token_scan.replace_characters(start, UNREADABLE_CHARACTER)
        return self.add_token("number", start, end)

    # --- what does not belong ---

    def wrong(self, start: int, end: int, piece: str) -> int:
        help, repair = WRONG_SIGN_HELP[piece]
        if repair == "comment":
            if piece == "/*" and (close := self.characters.find("*/", end)) >= 0:
                stop = close + 2
            else:
                stop = self.characters.find("\n", end)
                stop = len(self.characters) if stop < 0 else stop
            self.token_scan.report_error("unknown-sign", f"`{piece}` does not begin a comment", start, end, help)
            replace_text_by_blanks(self.token_scan, start, stop)
            return stop
        fix = make_replacement_word(help, self.characters[start - 1 : start] if start else "", self.characters[end : end + 1])
        self.token_scan.report_error("unknown-sign", f"`{piece}` is not a sign of the language", start, end, help, fix)
        if repair is None:
            self.token_scan.replace_by_blanks(start, end)
            return end
        self.token_scan.replace_characters(start, repair)
        return self.add_token("sign", start, end)

    def odd(self, start: int, end: int, piece: str) -> int:
        if piece in DOUBLE_QUOTES or piece in SINGLE_QUOTES:
            return self.repair_quotes(start, piece)
        if piece.isspace() or unicodedata.category(piece) in ("Zs", "Cf"):
            if "blank" not in self.reported_texts and (start > 0 or piece != "\ufeff"):
                self.reported_texts.add("blank")
                name = unicodedata.name(piece, f"U+{ord(piece):04X}").lower()
                self.token_scan.report_error("odd-blank", f"this blank is not a space: {name}", start, end, "type a space", " ")
            return self.blank(start, end, piece)
        if piece.isalnum() and piece not in "\u00b2\u00b3":
            return self.repair_foreign_word(start)
        tokens = self.token_scan.tokens
        if piece in "\u00b0\u00ba" and tokens and tokens[-1].kind == "number" and tokens[-1].end == self.last_end:
            number = tokens.pop()
            self.token_scan.report_error("unknown-sign", f"`{piece}` is not a unit", start, end, "write `deg`")
            rest = _PER_UNIT_PATTERN.match(self.characters, end)
            end = rest.end() if rest is not None else end
            self.token_scan.replace_by_blanks(start, end)
            return max(end, self.mark_unreadable(number.start, number.end))
        help, repair = WRONG_SIGN_HELP.get(piece, ("delete it", None))
        fix = make_replacement_word(help, self.characters[start - 1 : start] if start else "", self.characters[end : end + 1])
        self.token_scan.report_error("unknown-sign", f"`{piece}` is not a sign of the language", start, end, help, fix)
        if repair is not None and len(repair) > 1:
            return self.repair_wide_sign(start, end, repair)
        self.token_scan.replace_characters(start, repair or " ")
        return self.add_token("sign", start, end) if repair else end

    def repair_wide_sign(self, start: int, end: int, repair: str) -> int:
        """Replace a sign such as `≤` by two characters. The second character takes the position of an adjacent blank."""
        if self.characters[end : end + 1] == " ":
            end += 1
        elif start > 0 and self.token_scan.clean_characters[start - 1] == " ":
            start -= 1
        else:
            self.token_scan.replace_by_blanks(start, end)
            return end
        self.token_scan.replace_characters(start, repair)
        return self.add_token("sign", start, end)

    def repair_quotes(self, start: int, piece: str) -> int:
        quotes = DOUBLE_QUOTES + '"' if piece in DOUBLE_QUOTES else SINGLE_QUOTES
        line_end = self.characters.find("\n", start)
        line_end = len(self.characters) if line_end < 0 else line_end
        stop = next((index for index in range(start + 1, line_end) if self.characters[index] in quotes), -1)
        if stop < 0:
            message = f"`{piece}` is not a sign of the language"
            self.token_scan.report_error("unknown-sign", message, start, start + 1, 'write text in `"` quotes')
            self.token_scan.replace_by_blanks(start, start + 1)
            return start + 1
        self.token_scan.report_error(
            "wrong-quotes",
            f"this text is in `{piece}` quotes",
            start,
            stop + 1,
            f'write `"{self.characters[start + 1 : stop][:60]}"`',
            '"' + self.characters[start + 1 : stop].replace('"', "'") + '"',
        )
        self.token_scan.replace_characters(start, '"' + self.characters[start + 1 : stop].replace('"', " ") + '"')
        return self.add_token("text", start, stop + 1)

    def text(self, start: int, end: int, piece: str) -> int:
        if len(piece) > 1 and piece.endswith('"'):
            return self.add_token("text", start, end)
        smart = next((index for index in range(start + 1, end) if self.characters[index] in DOUBLE_QUOTES), -1)
        if smart > 0:
            message = f"this text ends in a `{self.characters[smart]}` quote"
            self.token_scan.report_error("wrong-quotes", message, smart, smart + 1, 'write `"`', '"')
            self.token_scan.replace_characters(smart, '"')
            return self.add_token("text", start, smart + 1)
        stop = start + len(_SWALLOWED_TAIL_PATTERN.sub("", piece))
        message = "this text has no closing quote"
        self.token_scan.report_error(
            "unclosed-text", message, start, start + 1, 'end the text with `"` on the same line', '"', stop
        )
        if stop - start < 2:
            self.token_scan.replace_by_blanks(start, start + 1)
            return start + 1
        self.token_scan.replace_characters(stop - 1, '"')
        return self.add_token("text", start, stop)


def get_last_token_text(text_scan: TokenScan) -> str:
    """Return the text of the last token."""
    last = text_scan.tokens[-1]
    return text_scan.source.text[last.start : last.end]
