"""Words of other tools are reported with what is written here, and what is written here means something."""

from __future__ import annotations

import pytest
from test_program import checked, complaints

from antdsl.diagnostics import Diagnostic
from antdsl.program.tables.foreign_words import CALL_REPLACEMENTS, NAME_REPLACEMENTS
from antdsl.program.tables.vocabulary import (
    BUILTIN_ATTRIBUTE_BY_NAME,
    BUILTINS_BY_NAME,
    REDUCER_HELP,
    RESERVED_WORDS,
    RUN_VALUE_TYPES,
    SENSE_REPLACEMENTS,
    SENSE_TYPE_BY_NAME,
)

TEXT = """ant 1
use steering
world {{ surface ground }}
species a {{
  param gain = 0.5 in 0 .. 1
  x = 0.5
  turned = 30 deg
  yes = true
  waited = 0 s
  start go
  state go {{ steer wander(); {line}; when after 1 s -> go }}
  layers {{ state }}
}}
"""
GIVEN_TO = {
    "if {a}": "yes, 1, 0", "length": "heading", "unit": "heading", "angle": "heading, up", "vector": "1, 2, 3",
    "sin({a}": "turned", "normal(0": "", "mean": "",
}  # fmt: skip


def check_line(line: str) -> tuple[str, list[Diagnostic]]:
    text = TEXT.format(line=line)
    return text, [each for each in checked(text)[1].sort_by_place() if each.severity == "error"]


def mended(text: str, error: Diagnostic) -> str:
    assert error.fix is not None
    return text[: error.fix.span.start] + error.fix.text + text[error.fix.span.end :]


@pytest.mark.parametrize("word", CALL_REPLACEMENTS)
def test_a_call_of_another_tool_is_reported_with_its_equivalent(word: str) -> None:
    form = CALL_REPLACEMENTS[word]
    many = len({letter for letter in "abcde" if "{" + letter in form.lower()})
    usual = ", ".join(("x", "0.2", "gain + 1", "0", "1")[:many])
    arguments = next((values for begins, values in GIVEN_TO.items() if begins in form), usual)
    name, call = ("turned" if "angle" in form or "1 deg" in form or "1 rad" in form else "x"), f"{word}({arguments})"
    target = f"steer heading * length({call})" if "unit(" in form or "vector(" in form else f"{name} = {call}"
    text, (error, *rest) = check_line(target)
    assert error.code == "unknown-behaviour" and not rest and "`" in (error.help or "")
    if many or word in NAME_REPLACEMENTS:
        assert error.fix is not None and f"`{error.fix.text}`" in (error.help or "")
        assert not checked(mended(text, error))[1].errors, complaints(checked(mended(text, error))[1])


@pytest.mark.parametrize("word", NAME_REPLACEMENTS)
def test_a_name_of_another_tool_is_reported_with_its_equivalent(word: str) -> None:
    target = {"dt": "waited = waited + ", "0.5 turn": "turned = ", "1 turn": "turned = ", "time": "waited = "}
    text, (error, *rest) = check_line(f"{target.get(NAME_REPLACEMENTS[word], 'x = ')}{word}")
    assert error.code == "unknown-name" and not rest and f"write `{NAME_REPLACEMENTS[word]}`" in (error.help or "")
    assert not checked(mended(text, error))[1].errors


@pytest.mark.parametrize(
    ("line", "instead"),
    [
        ("x = lerp(x, 1, 0.1)", "x = mix(x, 1, 0.1)"),
        ("x = 2 * pow(x + 1, 2)", "x = 2 * (x + 1) ^ 2"),
        ("x = 1 - fract(x)", "x = 1 - (x - floor(x))"),
        ("x = step(0.5, x)", "x = (if x > 0.5 then 1 else 0)"),
        ("x += x * step * 1 /s^2", "x += x * dt * 1 /s^2"),
        ("waited += step() * 1 /s", "waited += dt * 1 /s"),
    ],
)
def test_what_is_written_instead_has_the_arguments_as_they_were(line: str, instead: str) -> None:
    text, (error,) = check_line(line)
    assert instead in mended(text, error)


def test_another_number_of_arguments_shows_the_form() -> None:
    _, (error,) = check_line("x = lerp(x, 1)")
    assert error.fix is None and "here that is `mix(a, b, c)`" in (error.help or "")


def test_a_step_and_other_units_say_where_they_stand() -> None:
    _, (step,) = check_line("x += x * step * 1 /s^2")
    assert "how long a step lasts" in (step.help or "") and "`1 step`" in (step.help or "")
    _, (unit,) = check_line("x = x * mm")
    assert "follows its number" in (unit.help or "") and "`1 mm`" in (unit.help or "") and unit.fix is None


def test_no_word_of_the_language_stands_in_the_tables() -> None:
    own = {*BUILTINS_BY_NAME, *REDUCER_HELP, *BUILTIN_ATTRIBUTE_BY_NAME, *RUN_VALUE_TYPES, *SENSE_TYPE_BY_NAME, *RESERVED_WORDS}
    assert not own & {*CALL_REPLACEMENTS, *NAME_REPLACEMENTS} and not {*CALL_REPLACEMENTS} & {*SENSE_REPLACEMENTS}
