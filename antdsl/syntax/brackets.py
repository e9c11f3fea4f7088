"""Pairs the brackets of tokens. A missing closing bracket is inserted, and reported at its opening bracket. A surplus bracket is
omitted. Line ends inside parentheses are removed."""

from __future__ import annotations

from dataclasses import dataclass, replace

from antdsl import limits
from antdsl.syntax.mistakes.continued_lines import join_continued_lines
from antdsl.syntax.scan import ScannedToken, TokenScan
from antdsl.syntax.words import BLOCK_WORDS, LINE_WORDS_BY_RULE

_CLOSING_BY_OPENING = {"(": ")", "[": "]", "{": "}"}
_MAX_LOOK_AHEAD_TOKENS = 200  # maximum number of tokens; a line is seldom longer
_MAX_BRACE_REPAIRS = 100  # with more errors, missing braces are not searched for, because each search scans the text
_LINE_WORDS = frozenset(word for words in LINE_WORDS_BY_RULE.values() for word in words)
_JOINING_WORDS = frozenset(("and", "or", "is", "in", "to", "then", "else"))  # words that continue an expression after a name


def pair_brackets(scan: TokenScan) -> list[ScannedToken] | None:
    """Return the tokens with paired brackets. Return None if they are nested too deeply."""
    depth = 0
    for token in scan.tokens:
        depth += (token.kind == "open") - (token.kind == "close" and depth > 0)
        if depth > limits.MAX_BRACKET_DEPTH:
            message = f"brackets are nested more than {limits.MAX_BRACKET_DEPTH} levels deep"
            scan.report_error("nesting-too-deep", message, token.start, token.end, "give the inner parts names with `let`")
            return None
    scan.tokens = join_continued_lines(scan)
    return _BracePairer(scan, _ParenthesisPairer(scan).pair_tokens()).pair_tokens()


def get_token_text(scan: TokenScan, token: ScannedToken) -> str:
    """Return the text of a token. For an inserted bracket, which is not in the source, this is the bracket sign."""
    return token.inserted_text or "".join(scan.clean_characters[token.start : token.end])


class _ParenthesisPairer:
    """Pairing of `( )` and `[ ]`. Braces and `;` are not allowed inside them, so each of these closes all open parentheses."""

    def __init__(self, scan: TokenScan) -> None:
        self.scan = scan
        self.out: list[ScannedToken] = []
        self.origin: list[int] = []  # for each token of `out`, its index in the scan
        self.open: list[int] = []  # indices in `out` of open brackets
        self.indents = _compute_line_indents(scan.tokens)

    def pair_tokens(self) -> list[ScannedToken]:
        """Return all tokens with paired parentheses, without line ends inside them."""
        tokens, index = self.scan.tokens, 0
        while index <= len(tokens):
            token = tokens[index] if index < len(tokens) else None
            text = get_token_text(self.scan, token) if token is not None else "}"
            if self.open and (token is None or text in ("{", "}", ";") or self.is_line_start(index, text)):
                index = self.close_unclosed(index)
                continue
            if token is None:
                break
            self.pair_token(index, token, text)
            index += 1
        for token in self.out:
            if token.kind == "soft":
                self.scan.replace_characters(token.start, " ")
        return [token for token in self.out if token.kind != "soft"]

    def is_line_start(self, index: int, text: str) -> bool:
        """Return whether the token begins a line that cannot be part of a value, such as `let x`, `when x` or `state x`."""
        tokens = self.scan.tokens
        if tokens[index].indent < 0 or text not in _LINE_WORDS or index + 1 == len(tokens):
            return False
        return tokens[index + 1].kind == "word" and get_token_text(self.scan, tokens[index + 1]) not in _JOINING_WORDS

    def pair_token(self, index: int, token: ScannedToken, text: str) -> None:
        """Add the next token to the output. Missing closing brackets are inserted before it, and a closing bracket is paired."""
        tokens = self.scan.tokens
        if text in ("(", "[") and not self.open and self.is_block_opening(index):
            first = get_token_text(self.scan, tokens[self.find_line_start(index)])
            message = f"`{first}` has `{text}` instead of `{{`"
            self.scan.report_error("missing-brace", message, token.start, token.end, "write `{`", "{")
            self.scan.replace_characters(token.start, "{")
        elif text in ("(", "["):
            self.open.append(len(self.out))
        elif text in (")", "]"):
            if not self.open:
                opening = "(" if text == ")" else "["
                self.scan.report_error(
                    "unopened-bracket",
                    f"`{text}` has no opening `{opening}`",
                    token.start,
                    token.end,
                    "delete this bracket, or write the one that opens it",
                    "",
                )
                self.scan.replace_by_blanks(token.start, token.end)
                return
            if not self.close_bracket(index, token, text):
                return
        elif token.kind == "end" and self.open:
            token = replace(token, kind="soft")
        self.out.append(token)
        self.origin.append(index)

    def find_line_start(self, index: int) -> int:
        """Return the index of the first token on the line of a token."""
        while index and self.scan.tokens[index].indent < 0:
            index -= 1
        return index

    def is_block_opening(self, index: int) -> bool:
        """Return whether a parenthesis at the end of a line stands where the brace of a block should be. In this case, the next
        line has a larger indent."""
        tokens = self.scan.tokens
        if index + 2 >= len(tokens) or tokens[index + 1].kind != "end":
            return False
        start = self.find_line_start(index)
        if any(self.scan.clean_characters[token.start] == "{" for token in tokens[start:index]):
            return False
        first, next_line = tokens[start], tokens[index + 2]
        word = get_token_text(self.scan, first)
        if word not in BLOCK_WORDS or next_line.indent <= first.indent:
            return False
        next_token = next((token for token in tokens[index + 3 :] if token.kind != "end"), None)
        if word == "behaviour" and next_token is not None and get_token_text(self.scan, next_token) == ":":
            return False  # the word is the name of an argument
        return get_token_text(self.scan, next_line) in _LINE_WORDS

    def close_bracket(self, index: int, token: ScannedToken, text: str) -> bool:
        """Pair a closing bracket with an open bracket, and return True. Brackets that were opened between the two are reported
        as unclosed.

        Return False if there is no matching open bracket. The caller must then omit the closing bracket."""
        expected_signs = [_CLOSING_BY_OPENING[get_token_text(self.scan, self.out[place])] for place in self.open]
        if text not in expected_signs:
            if self.is_closed_later(index, expected_signs[-1]):
                self.scan.report_error(
                    "unopened-bracket",
                    f"`{text}` is never opened",
                    token.start,
                    token.end,
                    "delete this bracket, or write the one that opens it",
                    "",
                )
                self.scan.replace_by_blanks(token.start, token.end)
                return False
            message = f"`{text}` where `{expected_signs[-1]}` was expected"
            self.scan.report_error(
                "unopened-bracket", message, token.start, token.end, f"write `{expected_signs[-1]}`", expected_signs[-1]
            )
            self.scan.replace_characters(token.start, expected_signs[-1])
        else:
            while expected_signs.pop() != text:
                inner = self.out[self.open.pop()]
                sign = get_token_text(self.scan, inner)
                end = self.out[-1].end
                _report_unclosed(self.scan, inner, sign, end)
                self.out.append(ScannedToken("close", end, end, -1, _CLOSING_BY_OPENING[sign]))
                self.origin.append(index)
        self.open.pop()
        return True

    def is_closed_later(self, index: int, expected_sign: str) -> bool:
        """Return whether the bracket that closes the innermost open bracket follows on the same line."""
        depth = 0
        for token in self.scan.tokens[index + 1 : index + 1 + _MAX_LOOK_AHEAD_TOKENS]:
            text = get_token_text(self.scan, token) if token.kind in ("open", "close") else ""
            if token.kind == "end" or text in ("{", "}"):
                return False
            if depth == 0 and text == expected_sign:
                return True
            depth += (_CLOSING_BY_OPENING.get(text) == expected_sign) - (text == expected_sign)
        return False

    def close_unclosed(self, index: int) -> int:
        """Report and close a bracket that is still open at the end of its statement: its line and the following lines with a
        larger indent.

        Returns the index of the token at which pairing continues."""
        first, last = self.open[0], self.out[self.open[-1]]
        indent = self.indents[self.origin[first]]
        cut = len(self.out)
        for place in range(first + 1, len(self.out) - 1):
            following = self.out[place + 1]
            if get_token_text(self.scan, following) == "->":  # an arrow never occurs in parentheses
                cut = place + 1
                break
            if self.out[place].kind == "soft" and following.kind != "soft":
                word = get_token_text(self.scan, following) if following.kind == "word" else ""
                if following.indent <= indent or word in _LINE_WORDS:
                    cut = place
                    break
        while self.out[cut - 1].kind == "soft":
            cut -= 1
        text = get_token_text(self.scan, last)
        end = self.out[cut - 1].end
        _report_unclosed(self.scan, last, text, end)
        go_on = self.origin[cut] if cut < len(self.out) else index
        closing = [
            ScannedToken("close", end, end, -1, _CLOSING_BY_OPENING[get_token_text(self.scan, self.out[place])])
            for place in reversed(self.open)
        ]
        del self.out[cut:], self.origin[cut:]
        self.out.extend(closing)
        self.origin.extend([go_on] * len(closing))
        self.open.clear()
        return go_on


@dataclass(slots=True)
class _OpenBrace:
    """An open brace.

    `indent`: the indent of the line with the brace. `line`: the number of this line. `inner_indent`: the indent of the lines
    inside the braces."""

    token: ScannedToken
    indent: int
    line: int
    inner_indent: int | None = None  # indent of its first line; -1 if text follows the brace on its line


class _BracePairer:
    """Pairing of `{` and `}`. If there are more of one kind than of the other, the indents of the lines show where a brace is
    missing."""

    def __init__(self, scan: TokenScan, tokens: list[ScannedToken]) -> None:
        self.scan = scan
        self.tokens = tokens
        self.indents = _compute_line_indents(tokens)
        self.out: list[ScannedToken] = []
        self.open_braces: list[_OpenBrace] = []
        self.line = 0
        self.uses_indents = any(
            token.indent > 0 and token.kind != "end" for token in tokens
        )  # whether the text indents its blocks
        self.surplus_closings = 0  # closing braces minus opening ones

    def pair_tokens(self) -> list[ScannedToken]:
        """Return all tokens with paired braces."""
        signs = [get_token_text(self.scan, token) for token in self.tokens if token.kind in ("open", "close")]
        depth = lowest = 0
        for sign in signs:
            depth += (sign == "{") - (sign == "}")
            lowest = min(lowest, depth)
        if depth == 0 and lowest == 0:
            return self.tokens
        self.surplus_closings = -depth
        for index, token in enumerate(self.tokens):
            self.pair_token(token, self.indents[index])
        if self.open_braces:
            end = self.tokens[-1].end
            _report_unclosed(self.scan, self.open_braces[-1].token, "{", end)
            self.out.extend(ScannedToken("close", end, end, -1, "}") for _ in self.open_braces)
        return self.out

    def pair_token(self, token: ScannedToken, indent: int) -> None:
        """Add the next token to the output, after any missing braces. `indent`: the indent of the token's line."""
        sign = get_token_text(self.scan, token) if token.kind in ("open", "close") else ""
        self.line += token.kind == "end" and self.scan.source.text[token.start] == "\n"
        if token.kind != "end" and sign != "}":
            self.close_dedented_blocks(token)
            if self.open_braces and self.open_braces[-1].inner_indent is None:
                self.open_braces[-1].inner_indent = token.indent
        if sign == "{":
            self.open_braces.append(_OpenBrace(token, indent, self.line))
        elif sign == "}" and not self.close_brace(token, indent):
            return
        self.out.append(token)

    def close_dedented_blocks(self, token: ScannedToken) -> None:
        """Close an indented block at the first line that is not indented more than the line with the opening brace."""
        while self.open_braces and token.indent >= 0:
            top = self.open_braces[-1]
            own_line = self.uses_indents if top.inner_indent is None else top.inner_indent == -1 or top.inner_indent > top.indent
            if not own_line or token.indent > top.indent:
                return
            self.close_before_line()

    def close_brace(self, token: ScannedToken, indent: int) -> bool:
        """Return whether a `}` pairs with an open brace. If not, report it and omit it."""
        if token.indent >= 0:
            if any(entry.indent == token.indent for entry in self.open_braces) and not (
                self.open_braces[-1].indent < token.indent
            ):
                while self.open_braces[-1].indent != token.indent:
                    self.close_before_line()
                self.open_braces.pop()
                return True
            if (not self.open_braces or self.open_braces[-1].indent < token.indent) and self.surplus_closings > 0:
                self.surplus_closings -= 1
                return self.repair_opening(token)
        elif self.surplus_closings > 0 and not (
            self.open_braces and (self.open_braces[-1].line == self.line or self.open_braces[-1].inner_indent == -1)
        ):
            self.surplus_closings -= 1
            return self.drop_brace(token)
        if not self.open_braces:
            return self.drop_brace(token)
        self.open_braces.pop()
        return True

    def drop_brace(self, token: ScannedToken) -> bool:
        """Report a `}` without a `{`. Return False, because the caller must omit this token."""
        self.scan.report_error(
            "unopened-brace",
            "`}` has no opening `{`",
            token.start,
            token.end,
            "delete this brace, or write the `{` that it closes",
            "",
        )
        self.scan.replace_by_blanks(token.start, token.end)
        return False

    def repair_opening(self, token: ScannedToken) -> bool:
        """Insert a missing `{` for a surplus `}`. It is inserted at the end of the line that begins the block, which has the
        same indent as the `}`. Return whether there is such a line."""
        nothing_left = -1 if len(self.scan.report.diagnostics) < _MAX_BRACE_REPAIRS else len(self.out)
        for place in range(len(self.out) - 1, nothing_left, -1):
            candidate = self.out[place]
            if candidate.kind == "end" or candidate.indent < 0 or candidate.indent > token.indent:
                continue
            if candidate.indent < token.indent or get_token_text(self.scan, candidate) not in BLOCK_WORDS:
                break
            stop = next((index for index in range(place, len(self.out)) if self.out[index].kind == "end"), len(self.out))
            if any(t.kind == "open" and get_token_text(self.scan, t) == "{" for t in self.out[place:stop]):
                break
            last = self.out[stop - 1]
            word = get_token_text(self.scan, candidate)
            help = "write `{` at the end of this line"
            self.scan.report_error("missing-brace", f"`{word}` has no `{{`", candidate.start, last.end, help, " {", last.end)
            self.out.insert(stop, ScannedToken("open", last.end, last.end, -1, "{"))
            return True
        return self.drop_brace(token)

    def close_before_line(self) -> None:
        """Report the innermost open brace as unclosed. Insert its `}` at the end of the last line that has been read."""
        entry = self.open_braces.pop()
        place = len(self.out)
        while place and self.out[place - 1].kind == "end":
            place -= 1
        end = self.out[place - 1].end
        _report_unclosed(self.scan, entry.token, "{", end)
        self.out.insert(place, ScannedToken("close", end, end, -1, "}"))


def _report_unclosed(scan: TokenScan, token: ScannedToken, sign: str, end: int) -> None:
    """Report an open bracket that is never closed. `end`: the offset at which its end is assumed."""
    code, closing = ("unclosed-brace" if sign == "{" else "unclosed-bracket"), _CLOSING_BY_OPENING[sign]
    fix = closing if sign != "{" else f" {closing}"
    scan.report_error(code, f"`{sign}` is never closed", token.start, token.end, f"write the missing `{closing}`", fix, end)


def _compute_line_indents(tokens: list[ScannedToken]) -> list[int]:
    """Return, for each token, the indent of the line on which it is."""
    indents, indent = [], 0
    for token in tokens:
        indent = token.indent if token.indent >= 0 else indent
        indents.append(indent)
    return indents
