"""JSON text with places: what people write is read, what is wrong is reported at its place, nothing ends in a traceback."""

from __future__ import annotations

import json
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from antdsl import limits
from antdsl.bodies.files.json_text import JsonNode, read_json
from antdsl.source import Source


def plain(node: JsonNode) -> Any:
    if isinstance(node.value, dict):
        return {key: plain(each) for key, each in node.value.items()}
    if isinstance(node.value, list):
        return [plain(each) if isinstance(each, JsonNode) else each for each in node.value]
    return node.value


def read(text: str) -> Any:
    node, report = read_json(Source("x.json", text), "a rig")
    assert node is not None, report.diagnostics
    return plain(node)


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers(-(10**20), 10**20) | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=30,
)


@given(VALUES, st.sampled_from([None, 2, "\t"]), st.booleans())
def test_it_reads_what_the_standard_library_writes(value: Any, indent: Any, ascii_only: bool) -> None:
    result = read(json.dumps(value, indent=indent, ensure_ascii=ascii_only))
    assert result == value and json.dumps(result) == json.dumps(value)  # a whole number stays one


def test_a_comma_too_many_and_comments_are_passed_over() -> None:
    assert read('// a rig\n{"a": [1, 2,], /* inside, \n even * here */ "b": {"c": [],},\n} // end') == {
        "a": [1, 2],
        "b": {"c": []},
    }


def test_values_have_their_places() -> None:
    text = '{\n  "a": [1, "two"]\n}'
    node, _ = read_json(Source("x.json", text), "a rig")
    assert node is not None and isinstance(node.value, dict)
    inner = node.value["a"]
    assert isinstance(inner.value, list) and isinstance(inner.value[1], JsonNode)
    assert [text[slice(*node.keys["a"])], text[inner.start : inner.end]] == ['"a"', '[1, "two"]']
    assert text[inner.value[1].start : inner.value[1].end] == '"two"'


@pytest.mark.parametrize(
    ("text", "code", "marked", "help"),
    [
        ("", "json-syntax", "", "write `{ … }`"),
        ('{"a": 1', "json-syntax", "", "write the missing `}`"),
        ("[1, 2", "json-syntax", "", "write the missing `]`"),
        ('{"a": 1 "b": 2}', "json-syntax", " ", "write `,` between two values, or `}` at the end"),
        ('{"a" 1}', "json-syntax", "1", 'write `"key": value`'),
        ('{"a": }', "json-syntax", '"a"', 'write `"key": value`'),
        ("{'a': 1}", "json-syntax", "'a'", 'write `"a"`'),
        ("{a: 1}", "json-syntax", "a", 'write `"a"`'),
        ('{"a": NaN}', "json-syntax", "NaN", "write a number, such as `0`"),
        ('{"a": -Infinity}', "json-syntax", "-Infinity", "write a number, such as `0`"),
        ('{"a": True}', "json-syntax", "True", "write `true`"),
        ('{"a": .5}', "json-syntax", ".5", "write `0.5`, `-2` or `1e-3`"),
        ("[1, , 2]", "json-syntax", ",", "delete the comma"),
        ("[1,,]", "json-syntax", ",", "delete the comma"),
        ('{"a": 1} {', "json-syntax", "{", "delete it"),
        ('{"a": "b}', "json-syntax", '"b}', 'write `"…"`'),
        ('["\\x"]', "json-syntax", '"\\x"', "write `\\\\` if you mean a backslash"),
        ('["\\ud800"]', "json-syntax", '"\\ud800"', "write the complete character"),
        ("[1] /* open", "json-syntax", "/*", "write `*/` at the end of the comment"),
        ('{"a": 1, "a": 2}', "duplicate-key", '"a"', "keep one of them"),
        ("[1e999]", "out-of-range", "1e999", "write a smaller number"),
        ("[" * 70 + "]" * 70, "too-large", "[", None),
    ],
)
def test_mistakes_are_reported_at_their_place(text: str, code: str, marked: str, help: str | None) -> None:
    node, report = read_json(Source("x.json", text), "a rig")
    assert node is None
    (diagnostic,) = report.diagnostics
    assert diagnostic.span is not None
    assert (diagnostic.code, diagnostic.span.text, diagnostic.help) == (code, marked, help), diagnostic


def test_values_are_counted_as_they_come(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "MAX_BODY_JSON_VALUES", 100)
    for text in ("[" + "{}," * 200 + "]", "[[" + "1," * 3200 + "], {}]"):
        node, report = read_json(Source("x.json", text), "a rig")
        assert node is None and report.diagnostics[0].code == "too-large", text[:20]


@given(st.text(alphabet='{}[]",:/*\\ntrue 0123.eE+-aN\n') | st.text())
def test_any_text_is_read_or_reported(text: str) -> None:
    node, report = read_json(Source("x.json", text), "a rig")
    assert (node is None) == bool(report.diagnostics)
    try:
        expected = json.loads(text, parse_constant=lambda word: 1 / 0)
    except (ValueError, ZeroDivisionError, RecursionError):
        return
    if node is not None:
        assert plain(node) == expected
