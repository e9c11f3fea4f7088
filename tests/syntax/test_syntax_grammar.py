"""The grammar has no conflict, the shipped tables are those of the grammar, and cutting a text changes nothing of its tree."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from random import Random
from types import FrameType

import pytest
from lark import Lark
from test_syntax_parse import TEXTS, shape

from antdsl import resources
from antdsl.diagnostics.model import Report
from antdsl.source import Source, Span
from antdsl.syntax import parse
from antdsl.syntax.brackets import pair_brackets
from antdsl.syntax.builder import Builder
from antdsl.syntax.grammar import build_parser, number_tokens
from antdsl.syntax.parse_tables import START_RULES, TABLES_FILE, compute_grammar_hash, load_parser
from antdsl.syntax.scan import scan_tokens
from antdsl.syntax.words import BODY_RULE_BY_LINE, EXAMPLE_LINES, LINE_CONTEXT_BY_WORD, LINE_WORDS_BY_RULE


class SinglePassBuilder(Builder):
    """Builds a file that is parsed in one go."""

    def file(self, parts: list) -> tuple:
        return tuple(
            part for part in parts if not hasattr(part, "start_pos") and part is not None and not hasattr(part, "edition")
        )


@pytest.fixture(scope="module")
def built() -> Lark:
    return build_parser((*START_RULES, "file"))  # raises on every conflict and collision


def test_tables_are_fresh(built: Lark) -> None:
    stored = json.loads(resources.grammar_file(TABLES_FILE).read_text(encoding="utf-8"))
    assert stored["grammar"] == compute_grammar_hash(), "run `python -m antdsl.syntax.grammar`"
    shipped = load_parser(Builder())
    assert _patterns(shipped) == _patterns(built)
    shipped_rules = {str(rule) for rule in shipped.rules}
    assert shipped_rules <= {str(rule) for rule in built.rules} and len(shipped_rules) > 150


def test_tables_are_the_same_from_build_to_build() -> None:
    shipped = json.loads(resources.grammar_file(TABLES_FILE).read_text(encoding="utf-8"))["data"]["parser"]["parser"]
    random = Random(5)

    def shuffled(keys: Iterable[str]) -> dict[str, str]:
        keys = list(keys)
        return dict(zip(keys, random.sample(keys, len(keys)), strict=True))

    token, state = shuffled(shipped["tokens"]), shuffled(shipped["states"])
    actions = [
        (state[old], [(token[key], [kind, to if kind else int(state[str(to)])]) for key, (kind, to) in each.items()])
        for old, each in shipped["states"].items()
    ]
    other = {
        "tokens": {token[key]: name for key, name in shipped["tokens"].items()},
        "states": {int(old): dict(random.sample(each, len(each))) for old, each in random.sample(actions, len(actions))},
        "start_states": {start: int(state[str(at)]) for start, at in shipped["start_states"].items()},
        "end_states": {start: int(state[str(at)]) for start, at in reversed(shipped["end_states"].items())},
    }
    assert other["start_states"] != shipped["start_states"]
    assert json.dumps(number_tokens(other)) == json.dumps(shipped), "however lark has numbered them"


def _patterns(parser: Lark) -> dict[str, tuple[str, str, int]]:
    return {t.name: (t.pattern.type, t.pattern.value, t.priority) for t in parser.terminals}


def test_every_terminal_has_a_unique_name(built: Lark) -> None:
    assert not [t.name for t in built.terminals if t.name.startswith("__")]
    patterns = [str(t.pattern) for t in built.terminals]
    assert len(patterns) == len(set(patterns))


def test_every_rule_is_built(built: Lark) -> None:
    rule_names = {
        rule.alias or rule.options.template_source or rule.origin.name for rule in built.rules if not rule.options.expand1
    }
    rule_names = {str(name) for name in rule_names if not str(name).startswith("_")} - {"file"}
    assert not [name for name in rule_names if not hasattr(Builder, name)]


def test_tables_load_fast() -> None:
    """Counted in calls, which a busy machine does not change; making the tables from the grammar takes half a second."""
    assert 10 * calls(lambda: load_parser(Builder())) < calls(build_parser)


def calls(work: Callable[[], object]) -> int:
    """Calls of Python functions while it works."""
    count = 0

    def count_call(frame: FrameType, event: str, value: object) -> None:
        nonlocal count
        count += event == "call"

    sys.setprofile(count_call)
    try:
        work()
    finally:
        sys.setprofile(None)
    return count


def test_parsing_does_not_import_the_grammar_builder() -> None:
    code = (
        "import sys; from antdsl.syntax import parse; from antdsl.source import Source;"
        "parse(Source('a', 'ant 1\\nspecies a { load = 0 }'));"
        "heavy = {'numpy', 'open3d', 'scipy', 'antdsl.syntax.grammar'} & set(sys.modules);"
        "sys.exit(str(heavy) if heavy else 0)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=Path(__file__).parents[2])


def test_example_lines_parse() -> None:
    words = {word for words in LINE_WORDS_BY_RULE.values() for word in words}
    assert words == set(EXAMPLE_LINES) and words - {"ant"} <= set(LINE_CONTEXT_BY_WORD)
    assert set(LINE_WORDS_BY_RULE) == set(START_RULES) and {body for body in BODY_RULE_BY_LINE.values()} <= set(START_RULES)
    terminals = {str(t.pattern.value).partition("(?!")[0] for t in load_parser(Builder()).terminals}
    assert words <= terminals


def test_forms_in_messages_can_be_parsed() -> None:
    builder = SinglePassBuilder()
    parser = load_parser(builder)
    for word, form in EXAMPLE_LINES.items():
        rule = next(rule for rule, words in LINE_WORDS_BY_RULE.items() if word in words)
        for each in form.split("` or `"):
            source = Source("form", each.replace("…", ""))
            builder.span_maker = Straight(source)
            parser.parse(source.text, start=rule)


class Straight:
    """The place of a text that is parsed as it stands."""

    def __init__(self, source: Source) -> None:
        self.source = source

    def make_source_span(self, start: int, end: int) -> Span:
        return Span(self.source, start, end)


@pytest.fixture(scope="module")
def single_pass_parser() -> tuple[Lark, SinglePassBuilder]:
    builder = SinglePassBuilder()
    return build_parser(("file",), builder), builder


@pytest.mark.parametrize("path", TEXTS, ids=lambda path: path.name)
def test_parsing_by_lines_equals_complete_parsing(path: Path, single_pass_parser: tuple[Lark, SinglePassBuilder]) -> None:
    parser, builder = single_pass_parser
    source = Source(path.name, path.read_text(encoding="utf-8"))
    scanned = scan_tokens(source, Report())
    assert pair_brackets(scanned) is not None  # this blanks the line ends inside parentheses
    builder.span_maker = Straight(source)
    items = parser.parse("".join(scanned.clean_characters), start="file")
    file, report = parse(source)
    assert report.ok and len(items) > 0 and shape(items) == shape(file.items)
