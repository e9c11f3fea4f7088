"""Every code block of the documents is run: programs are checked, scenes are read, commands and Python are executed.

A block's first line says what it is: see `BLOCKS`."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import commands
import pytest
from forked import Forked
from preview_page import few

from antdsl.diagnostics.model import Report
from antdsl.source import Source

ROOT = Path(__file__).resolve().parents[2]
INDEX_OF_CODES = ROOT / "docs" / "codes" / "README.md"  # the pages themselves are run by test_code_pages.py
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "grammar" / "README.md"]
DOCUMENTS = [*PAGES, INDEX_OF_CODES, *sorted((ROOT / "docs").glob("*.md"))]
# A workflow and hooks are run by tests/cli/test_new_project.py; what is written for other systems is not run here.
THEIRS = ("netlogo", "gaml", "vex")
BLOCKS = (
    *("ant", "yaml scene", "yaml edits", "yaml workflow", "yaml hooks", "toml", "python", "console", "text", "json", "bash"),
    *THEIRS,
)

# What a fragment stands in. The names are those of the samples in the language reference.
WORLD = """ant 1
use steering
world {
  surface ground; obstacle stones; solid hill; curve way_in
  items food { load = 0 }; items nest { load = 0 }
}
"""
TRAIL = "field trail on ground { cell 4 mm; half_life 8 s }\n"
ATTRIBUTES = "  load = 0\n  source = none of food\n"
WALKER = "species walker { start stroll; state stroll { steer wander() }; layers { state } }\n"
SEARCHING = "  start search\n  state search { steer wander(); when chance 1 %/s -> rest }\n"
RESTING = "  state rest { when after 1 s -> search }\n"


@dataclass(frozen=True)
class Block:
    document: Path
    line: int
    info: str
    text: str

    def __str__(self) -> str:
        return f"{self.document.relative_to(ROOT)}:{self.line}"

    @property
    def words(self) -> list[str]:
        return self.info.split()

    @property
    def expected_error(self) -> str | None:
        return next((word.removeprefix("error=") for word in self.words if word.startswith("error=")), None)


def blocks() -> Iterator[Block]:
    for document in DOCUMENTS:
        info, start, lines = None, 0, []
        for number, line in enumerate(document.read_text(encoding="utf-8").splitlines(), 1):
            if line.startswith("```"):
                if info is None:
                    info, start, lines = line[3:].strip(), number, []
                else:
                    yield Block(document, start, info, "\n".join(lines) + "\n")
                    info = None
            elif info is not None:
                lines.append(line)
        assert info is None, f"{document}:{start}: this block has no end"


ALL = list(blocks())


def of_kind(kind: str) -> list[Block]:
    return [block for block in ALL if block.words[:1] == [kind]]


def complete_text(block: Block) -> str:
    """The block's text as a file that can be checked."""
    part = next((word.removeprefix("fragment-of-") for word in block.words if word.startswith("fragment-of-")), None)
    if part is None:
        return block.text
    text = block.text
    if part == "page":  # it speaks of what the blocks above it on its page declare
        above = [b.text for b in ALL if b.document == block.document and b.line < block.line and b.words[:1] == ["ant"]]
        return WORLD + "\n".join([*above, text])
    if part == "file":
        words = WORLD + TRAIL if "world {" not in text else "ant 1\nuse steering\n"
        return words + text + ("" if re.search(r"^(species|behaviour) ", text, re.M) else WALKER)
    if part == "species":
        rest = "" if "start " in text else SEARCHING + RESTING
        layers = "" if "layers " in text else "  layers { state }\n"
        return WORLD + TRAIL + "species forager {\n" + text + rest + layers + "}\n"
    if part == "state":
        prefix = WORLD + TRAIL + "species forager {\n" + ATTRIBUTES + "  start search\n  state search {\n"
        return prefix + text + "  }\n" + RESTING + "  layers { state }\n}\n"
    assert part == "expressions", f"{block}: what is a {part}?"
    conditions = [line for line in text.splitlines() if "chance" in line or "state ==" in line]
    lets = "".join(f"  let e{n} = {line}\n" for n, line in enumerate(text.splitlines()) if line not in conditions)
    whens = "".join(f"    when {line} -> rest\n" for line in conditions)
    body = "  start search\n  state search {\n" + whens + "    when after 1 s -> rest\n  }\n"
    return WORLD + TRAIL + "species forager {\n" + ATTRIBUTES + lets + body + RESTING + "  layers { state }\n}\n"


def check(text: str, name: str) -> Report:
    from antdsl.loading import find_library
    from antdsl.program import check as check_program
    from antdsl.syntax import parse

    file, report = parse(Source(name, text))
    _, findings = check_program(file, library=find_library, modules={})
    report.extend(findings)
    return report


def test_every_block_says_what_it_is() -> None:
    for block in ALL:
        assert any(block.info == kind or block.info.startswith(kind + " ") for kind in BLOCKS), f"{block}: ```{block.info}"


@pytest.mark.parametrize("block", of_kind("ant"), ids=str)
def test_programs_check_as_the_documents_say(block: Block) -> None:
    text = complete_text(block)
    report = check(text, str(block))
    errors = [f"{d.span}: {d.code}: {d.message}" for d in report.errors]
    if block.expected_error is None:
        assert not errors, "\n".join([*errors, text])
    else:
        assert [d.code for d in report.errors] == [block.expected_error], "\n".join([*errors, text])


def test_complaints_look_as_the_documents_show_them() -> None:
    """A block ```text complaint shows the messages about the program before it."""
    from antdsl.diagnostics.render import render

    complaints = [(ALL[n - 1], block) for n, block in enumerate(ALL) if block.info == "text complaint"]
    assert complaints
    for program, block in complaints:
        name = next(word.removeprefix("file=") for word in program.words if word.startswith("file="))
        assert render(check(complete_text(program), name), "full").strip() == block.text.strip(), str(block)


@pytest.mark.parametrize("block", [block for block in of_kind("yaml") if block.words[1] == "scene"], ids=str)
def test_scenes_read_as_the_documents_say(block: Block) -> None:
    from antdsl.scene import Roots, load_scene_text

    _, report = load_scene_text(block.text.encode(), str(block), Roots(ROOT / "examples" / "foraging", {}))
    codes = [d.code for d in report.errors]
    assert codes == ([] if block.expected_error is None else [block.expected_error]), report.errors


@pytest.mark.parametrize("block", [block for block in of_kind("yaml") if block.words[1] == "edits"], ids=str)
def test_edits_read_as_the_documents_say(block: Block, cache: Path) -> None:
    from antdsl.outputs.cache.manifest import ItemsEntry, LineEntry, read_manifest
    from antdsl.outputs.edits.edit_lines import read_edits

    manifest = read_manifest(cache)
    names = {
        "species": (manifest.species[0].model_copy(update={"name": "ant"}),),
        "lines": (LineEntry(name="guards", species="ant", ranges=((0, 40),)),),
        "items": (ItemsEntry(name="food", names=("leaf",), position=((0, 0, 0),), radius=(1,), attributes=()),),
        "last": 240,
    }
    edits, report = read_edits(block.text.encode(), str(block), manifest.model_copy(update=names))
    assert edits is not None, report.errors


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with `examples`, in which the documents' commands are run."""
    new_folder = tmp_path_factory.mktemp("documents")
    (new_folder / "examples").symlink_to(ROOT / "examples", target_is_directory=True)
    return new_folder


@pytest.fixture(scope="module")
def cache(folder: Path) -> Path:
    """`cache` in the folder: the minimal example, six frames; `summary.json` beside it."""
    command = ["run", "examples/minimal/scene.yaml", "--frames", "1..6", "--out", "cache", "--quiet", "--summary", "summary.json"]
    result = commands.run(*command, cwd=folder)
    assert result.returncode == 0, result.stdout + result.stderr
    return folder / "cache"


@pytest.fixture(scope="module")
def light_folder(cache: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with that cache and the foraging example on ground of fewer triangles, which is soon ready."""
    new_folder = tmp_path_factory.mktemp("python")
    (new_folder / "cache").symlink_to(cache, target_is_directory=True)
    (new_folder / "examples").mkdir()
    few(new_folder / "examples", 500)
    for example in (ROOT / "examples").iterdir():
        if example.name != "foraging":
            (new_folder / "examples" / example.name).symlink_to(example)
    return new_folder


@pytest.mark.parametrize("block", of_kind("python"), ids=str)
def test_python_runs(block: Block, light_folder: Path, tmp_path: Path) -> None:
    script = tmp_path / "block.py"
    script.write_text(block.text, encoding="utf-8")
    code, printed = Forked(cwd=light_folder, script=script).ended(120)
    assert code == 0, printed


RUN: dict[Path, list[Block]] = {}
for _block in of_kind("console"):
    if "run" in _block.words:
        RUN.setdefault(_block.document, []).append(_block)


@pytest.mark.parametrize("document", RUN, ids=lambda path: path.name)
def test_commands_do_what_the_documents_say(document: Path, folder: Path) -> None:
    """Each `$ antdsl …` line is run; a line of output that follows must occur in what it prints."""
    for block in RUN[document]:
        printed = ""
        for line in block.text.splitlines():
            if not line.startswith("$"):
                assert line.strip() in printed, f"{block}: {line!r} is not in\n{printed}"
                continue
            command = shlex.split(line[1:])
            assert command[0] == "antdsl", line
            result = commands.run(*command[1:], cwd=folder, env={"COLUMNS": "200"})
            printed = result.stdout + result.stderr
            assert "Traceback" not in printed, f"{block}: {line}\n{printed}"


def test_the_page_of_commands_has_all_keys_of_a_summary(cache: Path) -> None:
    summary = json.loads((cache.parent / "summary.json").read_text(encoding="utf-8"))
    text = (ROOT / "docs" / "commands_run.md").read_text(encoding="utf-8")
    assert [key for key in (*summary, *summary["motion"]) if f"`{key}`" not in text] == []


def test_every_link_leads_somewhere() -> None:
    for document in (*DOCUMENTS, *sorted((ROOT / "docs" / "learn").glob("*.md"))):
        text = re.sub(r"```.*?```", "", document.read_text(encoding="utf-8"), flags=re.DOTALL)
        for link in re.findall(r"\]\(([^)\s]+)\)", text):
            target, _, anchor = link.partition("#")
            if "://" in link:
                continue
            file = (document.parent / target).resolve() if target else document
            assert file.exists(), f"{document.name}: {link}"
            if anchor:
                assert anchor in anchors(file), f"{document.name}: {link}"


def anchors(file: Path) -> set[str]:
    headings = re.findall(r"^#+ (.*)$", file.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).replace(" ", "-") for head in headings}


def test_the_shortest_program_is_the_example() -> None:
    first = next(block for block in ALL if block.document == ROOT / "README.md" and block.info == "ant")
    assert first.text == (ROOT / "examples" / "minimal" / "walker.ant").read_text(encoding="utf-8")
