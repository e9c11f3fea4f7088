"""The MCP server, called by the client of the package `mcp`."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("mcp", reason="the server needs the extra [mcp]")

import commands
from mcp.client import Client

from antdsl.mcp.folders import GrantedFolders, PathOutsideFolders
from antdsl.mcp.pages import list_pages, search_pages
from antdsl.mcp.server import build_server
from antdsl.mcp.tools import TOOLS, Tools

PAGE = Path(__file__).resolve().parents[2] / "docs" / "mcp.md"


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A project with a cache of three frames of 20 agents in `walk`."""
    folder = tmp_path_factory.mktemp("mcp") / "project"
    assert commands.run("new", str(folder), cwd=folder.parent).returncode == 0
    scene = folder / "scene.yaml"
    scene.write_text(scene.read_text().replace("count: 200", "count: 20"))
    program = folder / "walker.ant"
    text = program.read_text().replace("for 5 s", "for 0.1 s")
    program.write_text(text.replace("  always: motion.circling < 10 %\n", ""))  # which is known after 2 s
    (folder.parent / "secret.ant").write_text("ant 2\n")
    (folder / "link.ant").symlink_to(folder.parent / "secret.ant")
    answers = call(folder, ("run", {"scene": "scene.yaml", "frames": "1..3", "out": "walk"}))
    assert "the cache is in" in answers[0][1]
    return folder


def call(folder: Path, *calls: tuple[str, dict[str, Any]]) -> list[tuple[bool, str, bytes]]:
    """The answers to calls: whether each is an error, its text, and the data of its picture."""

    async def talk() -> list[tuple[bool, str, bytes]]:
        answers = []
        async with Client(build_server(Tools(GrantedFolders.open([folder])))) as client:
            for name, arguments in calls:
                result = await client.call_tool(name, arguments)
                texts = [part.text for part in result.content if part.type == "text"]
                pictures = [part.data.encode() for part in result.content if part.type == "image"]
                answers.append((bool(result.is_error), "\n".join(texts), b"".join(pictures)))
        return answers

    return asyncio.run(talk())


def test_check_answers_with_findings(project: Path) -> None:
    (failed, text, _), (wrong, finding, _) = call(project, ("check", {}), ("check", {"program": "ant 2\nspecies x {"}))
    assert (failed, text) == (False, "checked 2 files, no findings")
    assert not wrong and "error[unclosed-brace]" in finding and "<stdin>:2:11" in finding


def test_run_test_explain_and_render_answer_as_the_commands_do(project: Path) -> None:
    calls = (
        ("test", {"path": "walker.ant"}),
        ("explain", {"cache": "walk", "agent": "3", "frame": 2}),
        ("render", {"cache": "walk", "width": 64, "height": 36}),
    )
    (_, passed, _), (_, explanation, _), (failed, path, picture) = call(project, *calls)
    assert "1 passed" in passed
    assert explanation.startswith("walker 3, the step to frame 2 of scene.yaml")
    assert not failed and Path(path).is_relative_to(project) and picture.startswith(b"iVBOR")  # of a PNG, in base 64


def test_params_seed_and_resume_reach_the_command(project: Path) -> None:
    words = {"scene": "scene.yaml", "frames": "1..2", "out": "other", "seed": 7, "params": {"walker.pace": "5 mm/s"}}
    (failed, text, _), (repeated, again, _) = call(project, ("run", words), ("run", {**words, "resume": True}))
    assert (failed, "the cache is in" in text) == (False, True)
    assert (repeated, "the cache is in" in again) == (False, True)
    assert '"seed": 7' in (project / "other" / "manifest.json").read_text()


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        ("check", {"path": "../secret.ant"}),
        ("check", {"path": "link.ant"}),
        ("check", {"path": "*.ant"}),
        ("run", {"scene": "scene.yaml", "out": "../escaped"}),
        ("run", {"scene": "/etc/passwd"}),
        ("render", {"cache": "/"}),
        ("explain", {"cache": "walk/../../secret.ant", "agent": "0", "frame": 1}),
        ("check", {"path": "a" * 2000}),
    ],
)
def test_paths_outside_the_folders_are_refused(project: Path, name: str, arguments: dict[str, Any]) -> None:
    ((failed, text, _),) = call(project, (name, arguments))
    assert failed and any(part in text for part in ("outside the granted folders", "characters", "there is no file or folder"))
    assert not (project.parent / "escaped").exists()


def test_mistakes_of_calls_have_messages(project: Path) -> None:
    calls = (
        ("run", {"scene": "--help"}),
        ("run", {"scene": "scene.yaml", "seconds": 0.2, "out": "slow"}),
        ("run", {"scene": "scene.yaml", "seconds": -1}),
        ("render", {"cache": "walk", "width": 100_000}),
        ("run", {"scene": "scene.yaml", "frames": "--force"}),
    )
    answers = call(project, *calls)
    assert [failed for failed, _, _ in answers] == [True] * 5
    for (_, text, _), part in zip(
        answers, ("no file", "stopped after 0.2 s", "seconds is", "width and height", "--force"), strict=True
    ):
        assert part in text


def test_docs_find_pages_words_and_codes(project: Path) -> None:
    calls = [
        ("docs", {"topic": topic}) for topic in ("docs/card", "seek()", "unknown-state", "two colonies fight", "zzzz", "card")
    ]
    (_, card, _), (_, seek, _), (_, code, _), (_, results, _), (_, nothing, _), (_, short, _) = call(project, *calls)
    assert card == short and card.startswith("#")
    assert "behaviour seek(" in seek and "unknown-state" in code
    assert "docs/two_colonies" in results or "docs/fighting" in results
    assert "no page has any of these words" in nothing and "docs/card" in nothing


def test_a_long_page_comes_in_parts(project: Path) -> None:
    ((_, first, _),) = call(project, ("docs", {"topic": "docs/parity"}))
    mark = first.rpartition("from character ")[2].removesuffix("]")
    ((_, second, _),) = call(project, ("docs", {"topic": "docs/parity", "start": int(mark)}))
    page = (PAGE.parent / "parity.md").read_text(encoding="utf-8")
    assert page.startswith(first.rpartition("\n[… ")[0]) and second[:100] == page[int(mark) : int(mark) + 100]


@pytest.mark.parametrize(
    ("query", "page"),
    [
        ("export usd to blender", "docs/usd"),
        ("pheromone trail field half life", "docs/learn/trails"),
        ("install on a build server", "docs/install"),
        ("notes for one agent", "docs/directing"),
    ],
)
def test_a_search_finds_the_page_of_a_subject(query: str, page: str) -> None:
    assert page in {section.page for section in search_pages(query)}


def test_a_relative_path_starts_in_the_folder_that_has_the_file(tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    first.mkdir(), second.mkdir()
    (second / "scene.yaml").touch()
    folders = GrantedFolders.open([first, second, first])
    assert folders.folders == (first, second)
    assert folders.locate("scene.yaml") == second / "scene.yaml"
    assert folders.locate("new.yaml") == first / "new.yaml"
    assert folders.locate(str(second)) == second
    with pytest.raises(PathOutsideFolders):
        folders.locate("../third")
    with pytest.raises(NotADirectoryError):
        GrantedFolders.open([tmp_path / "third"])


def test_the_page_names_all_tools() -> None:
    text = PAGE.read_text(encoding="utf-8")
    names = [entry.method.__name__ for entry in TOOLS]
    assert [line.split("`")[1] for line in text.splitlines() if line.startswith("| `")] == names
    assert "docs/mcp" in list_pages()


def test_every_tool_explains_its_parameters() -> None:
    for entry in TOOLS:
        described = entry.method.__doc__ or ""
        names = entry.method.__code__.co_varnames[1 : entry.method.__code__.co_argcount]
        assert [name for name in names if f"{name}:" not in described and f"{name}," not in described] == []


def test_a_root_must_be_a_folder(tmp_path: Path) -> None:
    for words in (("mcp",), ("mcp", "--root", "missing"), ("mcp", "--root", f"assets={tmp_path}")):
        assert commands.run(*words, cwd=tmp_path).returncode == 2
