"""Texts of `.ant` files in every layout: small programs put together from the lines of real ones, and one text in a new random
layout, with comments wherever a line may end."""

from __future__ import annotations

import random
from functools import cache
from pathlib import Path

from random_programs import Author

from antdsl.diagnostics.model import Report
from antdsl.source import Source
from antdsl.syntax.blocks import SourceLine, cut_lines
from antdsl.syntax.brackets import pair_brackets
from antdsl.syntax.scan import ScannedToken, TokenScan, scan_tokens
from antdsl.syntax.words import BODY_RULE_BY_LINE

ROOT = Path(__file__).resolve().parents[1]
_FOLDERS = ("examples", "behaviours", "tests/programs", "tests/cases/syntax", "tests/cases/plan")
FILES = sorted(path for folder in _FOLDERS for path in (ROOT / folder).rglob("*.ant"))


def scanned(text: str) -> tuple[TokenScan, list[ScannedToken]]:
    scan_result = scan_tokens(Source("t.ant", text), Report())
    tokens = pair_brackets(scan_result)
    assert tokens is not None
    return scan_result, tokens


@cache
def pieces() -> dict[str, list[str]]:
    """The texts of all lines of the files, with their blocks, by the rule that reads them."""
    texts_by_rule: dict[str, list[str]] = {}

    def walk(text: str, lines: list[SourceLine], rule: str) -> None:
        for line in lines:
            words = text[line.start : line.end]
            texts_by_rule.setdefault(rule, []).append(words)
            for group in line.groups:
                inner = (
                    "weight"
                    if group.is_choice
                    else BODY_RULE_BY_LINE.get((rule, words.split()[0])) or BODY_RULE_BY_LINE.get((rule, "*"))
                )
                walk(text, group.lines, inner or "")

    for path in FILES:
        text = path.read_text(encoding="utf-8")
        found_here, tokens = scanned(text)
        walk(text, cut_lines(found_here, tokens), "top")
    return texts_by_rule


def program(rng: random.Random) -> str:
    """A text that parses: a species of random members, states with random lines, and a few other things of files."""
    parts = pieces()

    def choose_texts(rule: str, most: int, longest: int = 300, without: str = "") -> list[str]:
        fitting = [text for text in parts[rule] if len(text) <= longest and not (without and text.startswith(without))]
        return [rng.choice(fitting) for _ in range(rng.randint(0, most))]

    top = [text for text in choose_texts("top", 2, 500) if not text.startswith(("ant", '"'))]
    members = choose_texts("member", 7, without="start")
    author = Author(rng)
    author.before = lambda r: r.now["x"]
    for k in range(rng.randint(0, 2)):
        value, _ = author.number(rng.randint(2, 5))
        members.append(f"let long{k} = {value}" + (' "how long"' if rng.random() < 0.3 else ""))
    members.append("state busy {\n" + "\n".join(choose_texts("statement", 6)) + "\n}")
    members.append("layers {\n" + "\n".join(choose_texts("layer", 4)) + "\n}")
    rng.shuffle(members)
    species = "species a" + rng.choice(["", ' "help"']) + " {\n" + "\n".join(members) + "\n}"
    help = rng.choice(["", '"What it is."\n'])
    return "ant 1\n" + help + "\n".join(rng.sample([*top, species], len(top) + 1)) + "\n"


class Layout:
    """Lays a text out again. `comments` and `lines` say whether comments and line ends that mean something may be put in."""

    def __init__(self, rng: random.Random, *, free: bool = True) -> None:
        self.rng, self.free = rng, free
        self.comments: list[str] = []

    def comment(self) -> str:
        text = f"# c{len(self.comments)}" + self.rng.choice(["", " and more", '#;{ } ( "', " "])
        self.comments.append(text.rstrip())
        return text

    def again(self, text: str) -> str:
        """The text with other blanks, and where `free` with other line ends and comments. Its own comments are left out."""
        scan_result, tokens = scanned(text)
        out: list[str] = [self.ending(True)] if self.free and self.rng.random() < 0.2 else []
        depth = 0  # of ( and [
        for token, following in zip(tokens, [*tokens[1:], None], strict=True):
            sign = "".join(scan_result.clean_characters[token.start : token.end])
            if token.kind == "end":
                out.append(self.ending(False) if self.free else sign)
                continue
            out.append(self.number(sign) if token.kind == "number" else sign)
            depth += (sign in ("(", "[")) - (sign in (")", "]"))
            if following is not None:
                next_sign = "".join(scan_result.clean_characters[following.start : following.end])
                out.append(self.gap(sign, next_sign, following.start > token.end, depth))
        joined = "".join(out)
        if self.free and self.rng.random() < 0.2:
            joined = joined.rstrip("\n; \t")
        return joined.replace("\n", "\r\n") if self.rng.random() < 0.2 else joined

    def number(self, text: str) -> str:
        return text.replace(" ", self.rng.choice(["", " ", "  "]))

    def gap(self, sign: str, next_sign: str, is_separate: bool, depth: int) -> str:
        """What stands between two tokens of a line."""
        rng = self.rng
        if self.free and not depth and (sign == "{" or next_sign == "}") and rng.random() < 0.6:
            return self.ending(True)
        needed = (sign[-1].isalnum() or sign[-1] in '_"%') and (next_sign[0].isalnum() or next_sign[0] in '_"')
        least = " " if is_separate or needed else ""
        if depth and rng.random() < 0.15:
            return rng.choice(["\n", "\n\n   ", "  \n\t"])
        if depth and self.free and rng.random() < 0.06:
            comment_line = rng.choice(["  ", "\n  "]) + self.comment() + "\n"
            return comment_line if rng.random() < 0.7 else f"{comment_line}\n {self.comment()}\n"
        if sign in "([,{" or (next_sign in ")],}" and not needed):
            least = ""
        return rng.choice([least, least, " ", "   ", "\t"])

    def ending(self, inside: bool) -> str:
        """The end of a statement, or (inside) what may stand next to a brace."""
        rng = self.rng
        pick = rng.randrange(12)
        if pick < 4:
            return rng.choice(["\n", "\n      ", "  \n", "\n\t"])
        if pick < 6:
            return "\n\n" + "\n" * rng.randint(0, 3)
        if pick < 8:
            return rng.choice(["\n", " ", "  "]) + self.comment() + "\n"
        if pick == 8:
            return f"\n{self.comment()}\n\n\n  {self.comment()}\n"
        return rng.choice([" ", "\n"]) if inside else rng.choice([";", " ; ", ";;\n", ";\n"])
