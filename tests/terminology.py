"""Finds words to avoid: `docs/glossary.md` lists them, with what to write instead.

`python tests/terminology.py` prints the count of each area, and with `--list AREA` each place. `--record` writes the counts
to `terminology.json`, which the test compares with."""

from __future__ import annotations

import argparse
import ast
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
GLOSSARY = ROOT / "docs" / "glossary.md"
RECORD = Path(__file__).with_suffix(".json")
HEADING, NAME_ONLY = "## Words to avoid", " (a name)"
_COMMENT = re.compile(r"(?:^ *|  )#.*")
AREAS = {
    "names": "antdsl/**/*.py",
    "docstrings": "antdsl/**/*.py",
    "comments": "antdsl/**/*.py",
    "messages": "antdsl/**/*.py",
    "tests": "tests/**/*.py",
    "docs": "docs/**/*.md",
    "readme": "*.md",
    "grammar": "grammar/*.md",
}
EXCEPTIONS = {  # word in a file -> why it stays
    ("docs/commands_tests.md", "kept"): "a key in the JSON of `antdsl test`, which scripts read",
    ("docs/commands_tests.md", "asked"): "the file `asked.json` of a sweep, which later versions read",
    ("tests/runtime/test_native.py", "done"): "the method of the future that a test replaces",
    ("tests/house/test_terminology.py", "worked out"): "the sample text of this script's own test",
}


@dataclass(frozen=True, slots=True)
class Use:
    """A word to avoid, and where it is."""

    path: str
    line: int
    word: str


@cache
def words() -> tuple[frozenset[str], frozenset[str]]:
    """The words to avoid everywhere, and those to avoid as complete names."""
    rows = GLOSSARY.read_text(encoding="utf-8").partition(HEADING)[2].splitlines()
    cells = [line.split("|")[1].strip() for line in rows if line.startswith("| ")][1:]
    names = {cell.removesuffix(NAME_ONLY) for cell in cells if cell.endswith(NAME_ONLY)}
    return frozenset(cells) - {f"{name}{NAME_ONLY}" for name in names}, frozenset(names)


@cache
def _patterns() -> dict[str, re.Pattern[str]]:
    return {word: re.compile(rf"(?<![\w-]){re.escape(word)}(?![\w-])") for word in words()[0]}


def uses_in_text(path: str, line: int, text: str) -> Iterator[Use]:
    """Words to avoid in a text that begins at a line."""
    lower = text.lower()
    for word, pattern in _patterns().items():
        if word in lower:  # most texts have none: this is faster than the pattern
            for match in pattern.finditer(lower):
                yield Use(path, line + lower.count("\n", 0, match.start()), word)


@cache
def _words_in_name(name: str) -> list[str]:
    """The words of a name that are to be avoided."""
    everywhere, complete = words()
    plain = name.strip("_").lower()
    parts = re.findall(r"[a-z]+", re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower())
    return [plain] * (plain in complete) + [part for part in parts if part in everywhere]


def uses_in_name(path: str, line: int, name: str) -> Iterator[Use]:
    """The words of a name that are to be avoided."""
    return (Use(path, line, word) for word in _words_in_name(name))


def uses_in_names(path: str, tree: ast.Module) -> Iterator[Use]:
    """In names that a module defines: itself, classes, functions, parameters, attributes of classes, constants and variables."""
    yield from uses_in_name(path, 1, Path(path).stem)
    for node in _nodes(tree):
        match node:
            case ast.ClassDef(name=name) | ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name) | ast.arg(arg=name):
                yield from uses_in_name(path, node.lineno, name)
            case ast.Name(id=name, ctx=ast.Store()):
                yield from uses_in_name(path, node.lineno, name)


@cache
def _parsed(text: str) -> ast.Module:
    return ast.parse(text)


@cache
def _nodes(tree: ast.Module) -> list[ast.AST]:
    return list(ast.walk(tree))


def _docstrings(tree: ast.Module) -> dict[int, ast.Constant]:
    """The docstrings of a module by the identity of their nodes."""
    docstring_by_id = {}
    for node in _nodes(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) and node.body:
            first = node.body[0]
            if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant) and isinstance(first.value.value, str):
                docstring_by_id[id(first.value)] = first.value
    return docstring_by_id


def uses_in_docstrings(path: str, tree: ast.Module) -> Iterator[Use]:
    """In docstrings."""
    for node in _docstrings(tree).values():
        yield from uses_in_text(path, node.lineno, str(node.value))


def uses_in_messages(path: str, tree: ast.Module) -> Iterator[Use]:
    """In strings of two words or more that are no docstrings."""
    docstrings = _docstrings(tree)
    for node in _nodes(tree):
        if (
            isinstance(node, ast.Constant)
            and isinstance(node.value, str)
            and id(node) not in docstrings
            and " " in node.value.strip()
        ):
            yield from uses_in_text(path, node.lineno, node.value)


def uses_in_comments(path: str, text: str) -> Iterator[Use]:
    """In comments: what the formatter puts two blanks before, or at the beginning of a line."""
    for number, line in enumerate(text.splitlines(), 1):
        if match := _COMMENT.search(line):
            yield from uses_in_text(path, number, match.group())


def uses(area: str) -> Iterator[Use]:
    """Words to avoid in an area, without the exceptions."""
    return (use for use in _all_uses(area) if (use.path, use.word) not in EXCEPTIONS)


def _all_uses(area: str) -> Iterator[Use]:
    for file in sorted(ROOT.glob(AREAS[area])):
        path, text = file.relative_to(ROOT).as_posix(), file.read_text(encoding="utf-8")
        if file == GLOSSARY or "node_modules" in path or "/corpus/" in path:
            continue
        if file.suffix == ".md":
            yield from uses_in_text(path, 1, text)
            continue
        tree = _parsed(text)
        if area in ("names", "tests"):
            yield from uses_in_names(path, tree)
        if area in ("docstrings", "tests"):
            yield from uses_in_docstrings(path, tree)
        if area in ("comments", "tests"):
            yield from uses_in_comments(path, text)
        if area == "messages":
            yield from uses_in_messages(path, tree)


def counts() -> dict[str, int]:
    """How many words to avoid each area has."""
    return {area: sum(1 for _ in uses(area)) for area in AREAS}


def main() -> None:
    """Print, list or record."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--list", choices=AREAS)
    parser.add_argument("--record", action="store_true")
    options = parser.parse_args()
    if options.list:
        for use in uses(options.list):
            print(f"{use.path}:{use.line}: {use.word}")
        return
    result = counts()
    print(json.dumps(result, indent=1))
    if options.record:
        RECORD.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
