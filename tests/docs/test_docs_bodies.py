"""The blocks of docs/bodies.md: parts are read as the page says what they are, files that it names are in one folder."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import commands
import pytest
from body_parts import READERS, read_part

from antdsl.bodies.files.clip_document import TRANSFORM_PARTS
from antdsl.bodies.files.definition_checks import DOCUMENTED_DEFORMERS
from antdsl.bodies.files.document_model import BodyForm, list_keys
from antdsl.bodies.files.named_files import _HELP_BY_CLOSED_FORMAT
from antdsl.bodies.files.reading import read_definition

DOCS = Path(__file__).resolve().parents[2] / "docs"
TEXT = "".join((DOCS / name).read_text(encoding="utf-8") for name in ("bodies.md", "body_files.md"))
BLOCKS = re.findall(r"^```(\w+) ?(\w*)(?: file=(\S+))?\n(.*?)^```", TEXT, flags=re.MULTILINE | re.DOTALL)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for _, _, name, text in BLOCKS:
        if name:
            (tmp_path / name).write_text(text, encoding="utf-8")
    (tmp_path / "block.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    return tmp_path


@pytest.mark.parametrize("kind", READERS)
def test_each_part_is_read_as_the_page_says(kind: str) -> None:
    (text,) = [text for language, word, _, text in BLOCKS if (language, word) == ("json", kind)]
    part, report = read_part(text.encode(), READERS[kind])
    assert part is not None and not report.diagnostics, report.diagnostics


def test_the_definition_is_whole(folder: Path) -> None:
    definition, report = read_definition(folder / "puppet.json")
    assert definition is not None and not report.diagnostics, report.diagnostics
    assert definition.shapes["block"].points.max() == 10 and definition.clips["wave"].marks == {"up": 0.25}


def test_the_command_tells_what_the_page_shows(folder: Path) -> None:
    (text,) = [text for language, word, _, text in BLOCKS if (language, word) == ("console", "bodies")]
    command, *lines = text.splitlines()
    result = commands.run(*shlex.split(command)[2:], cwd=folder)
    assert result.returncode == 0, result.stdout + result.stderr
    assert [line for line in lines if line not in result.stdout.splitlines()] == [], result.stdout


def test_the_page_has_all_keys_parts_and_deformers_and_the_files_that_are_not_read() -> None:
    words = set(re.findall(r"`([^`\n]+)`", TEXT)) | {word for cell in re.findall(r"`([^`\n]+)`", TEXT) for word in cell.split()}
    assert [key for key in list_keys(BodyForm) if key not in words] == []
    assert [part for part in TRANSFORM_PARTS if part not in words] == []
    assert [name for name in DOCUMENTED_DEFORMERS if "+" not in name and name not in words] == []
    assert {"bclip", "sc", "fbx", "abc"} <= set(_HELP_BY_CLOSED_FORMAT) and all(
        f"`.{each}`" in TEXT for each in ("bclip", "sc", "fbx", "abc")
    )
