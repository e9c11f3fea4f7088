"""Every code has a page, and every page says what antdsl says: its wrong example gives its code and nothing else, in exactly
these words and at this place; nothing at all is said of its right one."""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import code_pages
import pytest
from children import child_environment
from code_pages import PAGES, ROOT, Page

from antdsl.diagnostics.codes import CODE_DESCRIPTIONS
from antdsl.resources import find_code_page
from antdsl.source import Source
from antdsl.syntax.formatting.layout import format

FILES = sorted(path for path in PAGES.glob("*.md") if path.stem != "README")
# What an example cannot be run without; a package that is not there is not what these pages are about.
NEEDS = {
    **dict.fromkeys(("bad-usd", "no-such-prim", "usd-left-out"), "pxr"),
    **dict.fromkeys(("cannot-write", "no-pictures"), "imageio_ffmpeg"),
}


@pytest.fixture(scope="module")
def pages() -> dict[str, Page]:
    return {path.stem: code_pages.read(path) for path in FILES}


def test_every_code_has_a_page_and_every_page_a_code(pages: dict[str, Page]) -> None:
    assert sorted(pages) == sorted(CODE_DESCRIPTIONS)
    for name, page in pages.items():
        assert (page.code, page.meaning) == (name, code_pages.sentence(CODE_DESCRIPTIONS[name])), (
            f"run `python tests/code_pages.py {name}`"
        )


def test_code_pages_are_short(pages: dict[str, Page]) -> None:
    for name, page in pages.items():
        assert 40 < len(page.why) < 400 and page.why.endswith((".", "?")) and "\n" not in page.why, name
        blocks = re.findall(r"^```\w*\n(.*?)^```", (PAGES / f"{name}.md").read_text(encoding="utf-8"), flags=re.M | re.S)
        assert max(block.count("\n") for block in blocks) <= 20, name
        assert page.wrong.files != page.right.files or page.wrong.command != page.right.command, name
        assert page.wrong.said and page.right.said is None, name


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.stem)
def test_examples_on_code_pages_give_the_shown_output(path: Path, tmp_path: Path) -> None:
    needed = NEEDS.get(path.stem)
    if needed is not None and importlib.util.find_spec(needed) is None:
        pytest.skip(f"needs {needed}")
    page = code_pages.read(path)
    wrong = code_pages.said(page.wrong, tmp_path / "wrong").rstrip()
    assert page.wrong.said is not None
    assert wrong == page.wrong.said.rstrip(), f"run `python tests/code_pages.py {path.stem}` and read what changed"
    assert code_pages.codes_in(wrong) == {path.stem}
    assert code_pages.said(page.right, tmp_path / "right") == ""
    for name, data in page.right.files.items():
        if name.endswith(".ant"):
            text = data.decode("utf-8")
            assert format(Source(name, text))[0] == text, "a right example has the one layout"


def test_the_index_has_all_codes_by_their_sections() -> None:
    text = (PAGES / "README.md").read_text(encoding="utf-8")
    assert text == code_pages.index(), "run `python tests/code_pages.py`"
    assert re.findall(r"^\| \[`([a-z0-9-]+)`\]", text, flags=re.MULTILINE) == list(CODE_DESCRIPTIONS)


def test_the_pages_go_with_the_package() -> None:
    packed = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert packed["force-include"]["docs"] == "antdsl/_data/docs"
    assert find_code_page("unknown-state") == PAGES / "unknown-state.md" and find_code_page("no-such-code") is None


def test_explain_shows_the_page() -> None:
    environment = child_environment()
    command = [sys.executable, "-m", "antdsl", "check", "--explain", "unknown-state"]
    result = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60, encoding="utf-8")
    assert result.stdout == (PAGES / "unknown-state.md").read_text(encoding="utf-8")


def test_check_names_the_page_once_in_text_output(tmp_path: Path) -> None:
    from typer.testing import CliRunner

    from antdsl.cli import app

    wrong = code_pages.read(PAGES / "unknown-sign.md").wrong  # two complaints of one code
    with code_pages.laid_out(wrong, tmp_path / "wrong"):
        full, concise = (
            CliRunner().invoke(app, ["check", "walker.ant", "--format", kind]).stdout for kind in ("full", "concise")
        )
    assert full.count("for details, run `antdsl check --explain unknown-sign`") == 1 and "--explain" not in concise


def test_a_code_without_its_page_is_explained_in_a_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from antdsl.cli.printing import pages

    monkeypatch.setattr(pages, "find_code_page", lambda code: None)
    pages.print_code_page("trap")
    assert CODE_DESCRIPTIONS["trap"] in capsys.readouterr().out


def test_explain_is_laid_out_on_a_terminal(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """What rich makes of a page has its words and none of Markdown's signs."""
    from antdsl.cli.printing import pages

    monkeypatch.setattr("sys.stdout.isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "100")
    pages.print_code_page("unknown-state")
    output = capsys.readouterr().out
    assert "did you mean `stroll`?" in output and "when after 1 s -> strol }" in output
    assert "```" not in output and "## " not in output


def explained(*words: str) -> tuple[int, str]:
    from typer.testing import CliRunner

    from antdsl.cli import app

    result = CliRunner().invoke(app, ["check", "--explain", *words])
    said = result.stdout if result.exception is None else f"{result.exception.message}\n{result.exception.hint}"  # type: ignore[attr-defined]
    return result.exit_code, said


@pytest.mark.parametrize(
    ("word", "said"),
    [
        ("wander", ("behaviour wander(swing: angle", "`use steering`", "keep turning")),
        ("when", ("when meal -> approach", "a transition to another state", "the layer applies only")),
        ("touching", ("touching(x: place) -> bool",)),
        ("max_speed", ("fastest", "default 30 mm/s")),
        ("max", ("max(field: field", "max(n in SET: …)")),
        ("min", ("min(a: number A", "a time", "1 min = 60 s")),
        ("half_life", ("setting of a field",)),
        ("spread", ("argument of `feelers`", "argument of `avoid`")),
        ("frames", ("first and last frame",)),
        ("amber", ("a colour for states",)),
        ("steering", ("`wander`", "`seek`")),
        ("noise", ("scale: length", "noise(scale: 20 mm")),
        ("collision", ("the agent's body begins to touch another one",)),
        ("wander()", ("behaviour wander(",)),
        ("circle", ("depend on each other in a circle",)),
    ],
)
def test_words_and_behaviours_are_explained_too(word: str, said: tuple[str, ...]) -> None:
    code, text = explained(word)
    assert code == 0 and all(each in text for each in said), text


@pytest.mark.parametrize(
    ("word", "meant"),
    [("wandr", "wander"), ("unknown-stat", "unknown-state"), ("touchin", "touching"), ("halflife", "half_life")],
)
def test_unknown_words_suggest_a_similar_one(word: str, meant: str) -> None:
    assert f"did you mean `{meant}`?" in explained(word)[1]


def test_all_words_of_the_card_are_explained() -> None:
    from antdsl.lsp.word_help import explain_word, list_known_words

    rows = (ROOT / "docs" / "card.md").read_text(encoding="utf-8")
    card = set(re.findall(r"(?<![A-Za-z_.])[a-z_]{2,}(?![A-Za-z_0-9])|%", " ".join(re.findall(r"`([^`]+)`", rows))))
    placeholders = {"attribute", "behaviours", "colour", "comment", "help", "label", "mine", "name", "rate", "scene"}
    assert sorted(word for word in card - placeholders if explain_word(word) is None) == []
    assert all(explain_word(word) is not None for word in list_known_words())


def test_the_last_line_names_the_codes_that_were_shown(tmp_path: Path) -> None:
    from typer.testing import CliRunner

    from antdsl.cli import app

    program = tmp_path / "a.ant"
    ignored = "  energy = 0  # antdsl: ignore[unused-attribute] later\n"
    program.write_text(f"ant 1\nspecies a {{\n{ignored}  max_speed 30\n  size 4 s\n  state go {{ steer heading }}\n}}\n")
    said = CliRunner().invoke(app, ["check", str(program)]).stdout
    assert "for details, run `antdsl check --explain missing-unit`, or name `wrong-unit`\n" in said
    program.write_text(program.read_text().replace("30\n", "30 mm/s\n").replace("4 s", "4 mm"))
    assert "--explain" not in CliRunner().invoke(app, ["check", str(program)]).stdout


UNITS = (
    "mm/s",
    "%/s",
    "/s",
    "mm^2",
    "mm^3",
    "mm^2/s",
    "deg/s",
    "%/step",
    "/step",
    "mm/step",
    "cm/s",
    "g*mm/s^2",
    "/s^2",
    "m",
    "N",
)


@pytest.mark.parametrize("unit", [*UNITS, "30 mm/s", "10%/s"])
def test_units_that_are_made_of_others_are_explained(unit: str) -> None:
    code, text = explained(unit)
    bare = unit.lstrip("0123456789. ")
    assert code == 0 and text.startswith(f"# {bare}\n") and f"3 {bare}" in text


def test_every_unit_of_the_documents_is_explained() -> None:
    from antdsl.lsp.word_help import explain_word

    text = "\n".join(path.read_text(encoding="utf-8") for path in [ROOT / "grammar" / "README.md", *(ROOT / "docs").glob("*.md")])
    units = set(re.findall(r"(?<![\w./])[0-9][0-9.]* ?((?:%|[a-zA-Z]+)?(?:\^[0-9])?/(?:s|step)(?:\^[0-9])?)(?![\w/])", text))
    assert len(units) > 4 and sorted(unit for unit in units if explain_word(unit) is None) == []


@pytest.mark.parametrize(
    ("word", "meanings"),
    [
        ("by", ("by: area", "`above`", "about: up, by: 15 deg", "argument of `rotate`")),
        ("place", ("x: place", "anything with a position", "place: {on: ground}", "where they begin")),
        ("on", ("on collision", "actions for an event", "field trail on ground", "the surface of a field")),
        ("set", ("set forager.smell = 50 mm", "a value that the spec sets", "set: {forager.smell: 60 mm}", "other values")),
        ("step", ("`response 1 step`", "`dt`")),
        ("mass", ("mass 1 g", "inertia", "x: mass", "numbers in `g`")),
        ("position", ("position(nearest(food))", "let mine = position", "nearest(food).position")),
    ],
)
def test_each_meaning_of_a_word_has_a_section_and_a_sample(word: str, meanings: tuple[str, ...]) -> None:
    _, text = explained(word)
    assert all(each in text for each in meanings), text
    parts = text.split("\n## ")[1:]
    assert len(parts) >= 2 or word == "step"
    for part in parts:
        assert part.count("\n```") >= 2, part


def test_a_slip_in_a_unit_is_reported() -> None:
    assert "write `s`" in explained("mm/sec")[1]


def test_every_meaning_of_every_word_has_its_sample() -> None:
    from antdsl.lsp import sample_lines, word_descriptions
    from antdsl.program.tables.vocabulary import BUILTINS_BY_NAME, REDUCER_HELP, TYPE_BY_WORD

    assert set(sample_lines.CALL_SAMPLES) == set(BUILTINS_BY_NAME) and set(sample_lines.SET_QUERY_SAMPLES) == set(REDUCER_HELP)
    rows = [sample_lines.CALL_SAMPLES, sample_lines.SET_QUERY_SAMPLES, *(_samples_of(table) for table in _word_tables())]
    for word, form in (each for forms in rows for each in forms.items()):
        assert word in form or word == "other", (word, form)
    assert {word for word, dim in TYPE_BY_WORD.items() if isinstance(dim, str)} | {"number"} == set(word_descriptions.TYPE_HELP)


def _word_tables() -> list[Any]:
    from antdsl.lsp import word_descriptions
    from antdsl.program.tables.things import KIND_BY_WORD

    return [
        word_descriptions.INNER_WORD_HELP,
        word_descriptions.AGGREGATE_HELP,
        KIND_BY_WORD,
        word_descriptions.SETTING_HELP,
        word_descriptions.SCENE_KEY_HELP,
        word_descriptions.STATE_WORD_HELP,
        word_descriptions.VALUE_HELP,
    ]


def _samples_of(table: Any) -> dict[str, str]:
    return {word: row.sample for word, row in table.items()}


AROUND = """ant 1
use steering
world { surface ground; obstacle stones; curve path; flow drift; camera shot; items food { load = 0 }; items nest { load = 0 } }
field trail on ground { cell 4 mm; half_life 8 s }
species rabbit { load = 0 }
species forager {
  load = 0
  start go
  state go { deposit trail load * 1 /s; when after 1 s -> go }
  on spawn { emit alarm(within: 10 mm) }
  on alarm { load += 1 }
"""


def test_samples_of_calls_and_sets_are_right() -> None:
    from test_program import checked

    from antdsl.lsp.sample_lines import CALL_SAMPLES, SET_QUERY_SAMPLES

    for form in (*CALL_SAMPLES.values(), *SET_QUERY_SAMPLES.values()):
        errors = checked(f"{AROUND}  let one = {form}\n}}\n")[1].errors
        assert not errors, (form, [error.message for error in errors])


def test_samples_of_lines_and_scenes_can_be_read() -> None:
    from antdsl.lsp.word_descriptions import SCENE_KEY_HELP
    from antdsl.scene.load import load_scene_text
    from antdsl.scene.paths import Roots
    from antdsl.syntax import parse

    templates = ("{}", "species a {{ {} }}", "species a {{ state s {{ {} }} }}", 'spec "s" on "s.yaml" {{ {} }}')
    templates += ('spec "s" on "s.yaml" {{ each a {{ {} }} }}', "species a {{ let x = {} }}", "species a {{ on e {{ {} }} }}")
    for form in (form for table in _word_tables() if table is not SCENE_KEY_HELP for form in _samples_of(table).values()):
        texts = [f"ant 1\n{place.format(form)}\n" for place in templates]
        assert any(parse(Source("a.ant", text))[1].ok for text in texts), form
    for form in _samples_of(SCENE_KEY_HELP).values():
        text = form if form.startswith("antdsl:") else f"antdsl: 1\n{form}"
        report = load_scene_text(f"{text}\n".encode(), "other.yaml", Roots(Path("."), {}))[1]
        assert not {error.code for error in report.errors} - {"no-such-file", "unknown-name", "wrong-path"}, (form, report.errors)
