"""The tables of the documents are held against the code's own: words, keys, flags, the library, the ids of parity. Those of
the codes are in test_code_pages.py."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import column_tables
import pytest
from page_groups import SCENE_TEXT

COMMAND_PAGES = ("commands.md", "commands_run.md", "commands_tests.md", "commands_results.md", "pictures.md", "farms.md")
ROOT = Path(__file__).resolve().parents[2]


def rows(document: str) -> Iterator[list[str]]:
    """The cells of all table rows of a document."""
    for line in (ROOT / document).read_text(encoding="utf-8").splitlines():
        if line.startswith("|") and not re.fullmatch(r"[|\s:-]+", line):
            yield [cell.strip() for cell in re.split(r"(?<!\\)\|", line.strip().strip("|"))]


def test_the_card_has_all_the_words() -> None:
    """Units, given names, built-in operations, sets, colours, field settings and the library: whatever the tables have."""
    from antdsl.program.tables.colours import COLOUR_BY_NAME
    from antdsl.program.tables.vocabulary import (
        BUILTIN_ATTRIBUTE_BY_NAME,
        BUILTINS_BY_NAME,
        REDUCER_HELP,
        RESERVED_WORDS,
        RUN_VALUE_TYPES,
        SENSE_TYPE_BY_NAME,
        UNIT_BY_NAME,
    )
    from antdsl.syntax.words import FIELD_SETTING_WORDS, LINE_WORDS_BY_RULE, WORLD_KIND_WORDS

    text = (ROOT / "docs" / "card.md").read_text(encoding="utf-8")
    words = set(re.findall(r"[A-Za-z_]+|%", " ".join(re.findall(r"`([^`]+)`", text))))
    tables = (
        UNIT_BY_NAME,
        BUILTIN_ATTRIBUTE_BY_NAME,
        RUN_VALUE_TYPES,
        SENSE_TYPE_BY_NAME,
        BUILTINS_BY_NAME,
        REDUCER_HELP,
        COLOUR_BY_NAME,
        FIELD_SETTING_WORDS,
        WORLD_KIND_WORDS,
    )
    missing = {word for table in (*tables, *LINE_WORDS_BY_RULE.values()) for word in table} - words
    assert not missing, f"the card lacks {sorted(missing)}"
    assert {"flow", "map"} <= {*RESERVED_WORDS, *WORLD_KIND_WORDS} & words


@pytest.mark.parametrize(
    ("library_name", "page"), [("steering", "docs/language_wishes.md"), ("pedestrians", "docs/pedestrians.md")]
)
def test_each_library_is_in_its_reference_as_it_is(library_name: str, page: str) -> None:
    """Signature and help of each behaviour; on the card the names alone."""
    library = (ROOT / "behaviours" / f"{library_name}.ant").read_text(encoding="utf-8")
    broken = r"^(behaviour \w+\()\n((?:  .*\n)+)\) ->"
    library = re.sub(broken, lambda match: f"{match[1]}{' '.join(match[2].split())}) ->", library, flags=re.MULTILINE)
    signatures = re.findall(r'^behaviour (\w+)(\(.*?\)) -> (?:push|angle|length) \{\n  "(.*?)"', library, flags=re.MULTILINE)
    assert len(signatures) == len(re.findall(r"^behaviour ", library, flags=re.MULTILINE))
    reference = (ROOT / page).read_text(encoding="utf-8")
    expected_rows = [f"| `{name}{arguments}` | {help} |" for name, arguments, help in signatures]
    assert [row for row in expected_rows if row not in reference] == [], "rows that the library's table lacks"
    card = (ROOT / "docs" / "card.md").read_text(encoding="utf-8")
    assert "`" + " ".join(name for name, _, _ in signatures) + "`" in card, "all of them, in the order of the file"


def test_the_scene_page_has_all_the_keys() -> None:
    from antdsl.scene import scene_model, thing_models

    defined = {**vars(scene_model), **vars(thing_models)}.values()
    kinds = [kind for kind in defined if isinstance(kind, type) and issubclass(kind, scene_model.ScenePart)]
    parts = [kind for kind in kinds if kind is not scene_model.ScenePart]
    keys = {field.alias or name for part in parts for name, field in part.model_fields.items()}
    assert len(parts) > 8
    assert sorted(key for key in keys if f"`{key}`" not in SCENE_TEXT and f"`{key}:" not in SCENE_TEXT) == []


def test_the_page_of_commands_has_all_commands_and_flags() -> None:
    import typer.main

    from antdsl.cli import app

    text = "".join((ROOT / "docs" / name).read_text(encoding="utf-8") for name in COMMAND_PAGES)
    for name, command in typer.main.get_command(app).commands.items():  # type: ignore[attr-defined]
        assert f"`antdsl {name}" in text
        flags = [flag for part in command.params for flag in part.opts if flag.startswith("--")]
        assert [flag for flag in flags if flag not in text and flag != "--help"] == [], name


def test_the_page_of_the_cache_has_the_arrays_of_frames() -> None:
    text = column_tables.PAGE.read_text(encoding="utf-8")
    assert column_tables.page(text) == text, "run `python tests/column_tables.py`"


PARITY_IDS = [
    *(f"T{n:02}" for n in (*range(1, 41), *range(50, 61))),
    *("T60b", "T61", "T62"),
    *(f"P{n:02}" for n in range(1, 19)),
    *(f"H{n:02}" for n in range(1, 16)),
    *(f"R{n:02}" for n in range(1, 17)),
    *(f"D{n:02}" for n in range(1, 11)),
    *(f"X{n}" for n in range(1, 20)),
]


def test_parity_has_every_id_once_and_names_files_that_exist() -> None:
    table_rows = [row for row in rows("docs/parity.md") if row[0] != "id"]
    assert [row[0] for row in table_rows] == PARITY_IDS
    for name, what, state, evidence in table_rows:
        assert what and state in ("done", "part", "not yet"), name
        files = [word for word in re.findall(r"`([^`]+)`", evidence) if "/" in word and " " not in word]
        assert files or state == "not yet", f"{name} is {state} and names no file"
        for file in files:
            path, _, function = file.partition("::")
            assert (ROOT / path).exists(), f"{name}: there is no {path}"
            assert not function or f"def {function}(" in (ROOT / path).read_text(encoding="utf-8"), f"{name}: {file}"


def test_parity_begins_with_the_words_of_the_documents() -> None:
    """Each row about a document quotes at most fifteen of its words, then summarises. A row that is part says what is missing."""
    quoted_rows = [row for row in rows("docs/parity.md") if row[0][0] in "TPHR"]
    assert len(quoted_rows) == sum(name[0] in "TPHR" for name in PARITY_IDS)
    for name, what, state, evidence in quoted_rows:
        quotation = re.match(r'"([^"]*\w[^"]*)": \S', what)
        assert quotation, f"{name} begins with no quotation"
        assert len(quotation[1].split()) <= 15, f"{name} quotes too much"
        assert state != "part" or re.search(r"Missing: \S", evidence), f"{name} does not say what is missing"
