"""From a name to its declaration, to all its places, and to another name: over programs, the library and scenes."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from lsp_client import COMMAND, ROOT, applied, ask, cut_out, initialize_params, lsp, place_of, pytest_lsp

from antdsl.lsp.text import uri_to_path
from antdsl.pipeline import check_path

FORAGING = ROOT / "examples" / "foraging"
FORAGER = (FORAGING / "forager.ant").read_text(encoding="utf-8")
SCENE = (FORAGING / "scene.yaml").read_text(encoding="utf-8")
USING = """ant 1
use steering
use "./mine.ant" as mine
world { surface ground; items food { load = 0 } }
species walker {
  load = 0
  calm = 1
  let near = nearest(food)
  machine moving {
    start roam
    state roam { steer mine.stroll(pace: 0.5); when state == roam and mood.state == angry -> flee; when shout -> flee }
    state flee { steer seek(near); when after 1 s -> roam { emit shout(within: 5 mm) } }
  }
  machine mood {
    start quiet
    state quiet { when any(n in neighbours(9 mm): n.calm < 0.5 and n.load > 0) -> angry }
    state angry { let pulse = calm * 2; calm -= 0.1 /s; when pulse < 1 -> quiet }
  }
  on shout { calm -= 0.2 }
  on collision(other) { calm -= other.calm * 0.1 }
}
"""
MINE = "ant 1\nbehaviour stroll(pace: number) -> push {\n  let slow = pace * 0.5\n  heading * slow\n}\n"


@pytest_lsp.fixture(config=pytest_lsp.ClientServerConfig(server_command=COMMAND), scope="module")
async def client(lsp_client: pytest_lsp.LanguageClient, tmp_path_factory: pytest.TempPathFactory):
    folder = tmp_path_factory.mktemp("crowds").resolve()
    lsp_client.folder = folder
    for name in ("forager.ant", "scene.yaml", "many.yaml"):
        (folder / "foraging").mkdir(exist_ok=True)
        shutil.copy(FORAGING / name, folder / "foraging" / name)
    (folder / "using").mkdir()
    (folder / "using" / "walker.ant").write_text(USING, encoding="utf-8")
    (folder / "using" / "mine.ant").write_text(MINE, encoding="utf-8")
    await lsp_client.initialize_session(initialize_params(folder))
    yield
    await lsp_client.shutdown_session()


pytestmark = pytest.mark.asyncio(loop_scope="module")


def text_of(uri: str) -> str:
    path = uri_to_path(uri)
    assert path is not None
    return path.read_text(encoding="utf-8")


def lines(locations: list[lsp.Location]) -> list[tuple[str, str]]:
    """The file and the text of the line of each location."""
    line_texts = []
    for each in locations:
        path = uri_to_path(each.uri)
        assert path is not None
        line_texts.append((path.name, text_of(each.uri).splitlines()[each.range.start.line].strip()))
    return line_texts


async def definition(client, file: str, word: str, nth: int = 0) -> list[tuple[str, str]]:
    uri = (client.folder / file).as_uri()
    position = place_of(text_of(uri), word, nth)
    return lines(await client.text_document_definition_async(lsp.DefinitionParams(**ask(uri, position))))


@pytest.mark.parametrize(
    "file, word, nth, expected",
    [
        ("foraging/forager.ant", "smell)", 0, ("forager.ant", "param smell")),
        ("foraging/forager.ant", "-> carry", 0, None),
        ("foraging/forager.ant", "carry {", 0, ("forager.ant", "state carry")),
        ("foraging/forager.ant", "meal)", 0, ("forager.ant", "let meal")),
        ("foraging/forager.ant", "trail track", 0, ("forager.ant", "field trail")),
        ("foraging/forager.ant", "wander(", 0, ("steering.ant", "behaviour wander")),
        ("foraging/forager.ant", "swing: swing", 0, ("steering.ant", "behaviour wander")),
        ("foraging/forager.ant", "scene.yaml", 0, ("scene.yaml", "# 500 ants")),
        ("foraging/forager.ant", "load > 0", 0, ("forager.ant", "items    food")),
        ("foraging/scene.yaml", "forager, from", 0, ("forager.ant", "species forager")),
        ("foraging/scene.yaml", "forager.ant", 0, ("forager.ant", "ant 2")),
        ("foraging/scene.yaml", "food:", 0, ("forager.ant", "items    food")),
        ("foraging/scene.yaml", "load:", 0, ("forager.ant", "items    food")),
        ("foraging/scene.yaml", "home, radius", 0, ("scene.yaml", "home:")),
        ("foraging/many.yaml", "patience:", 0, ("forager.ant", "param patience")),
        ("foraging/many.yaml", "track:", 0, ("forager.ant", "param track")),
        ("using/walker.ant", "stroll(", 0, ("mine.ant", "behaviour stroll")),
        ("using/walker.ant", "pace:", 0, ("mine.ant", "behaviour stroll")),
        ("using/walker.ant", "./mine", 0, ("mine.ant", "ant 1")),
        ("using/walker.ant", "mine.stroll", 0, ("walker.ant", 'use "./mine.ant" as mine')),
        ("using/walker.ant", "angry ->", 0, ("walker.ant", "state angry")),
        ("using/walker.ant", "mood.state", 0, ("walker.ant", "machine mood")),
        ("using/walker.ant", "calm < 0.5", 0, ("walker.ant", "calm = 1")),
        ("using/walker.ant", "n.calm", 0, ("walker.ant", "state quiet")),
        ("using/walker.ant", "other.calm", 0, ("walker.ant", "on collision(other)")),
        ("using/walker.ant", "shout -> flee", 0, ("walker.ant", "")),
        ("using/walker.ant", "pulse < 1", 0, ("walker.ant", "state angry")),
        ("using/mine.ant", "slow\n", 0, ("mine.ant", "let slow")),
    ],
)
async def test_definitions_of_names_are_found(client, file: str, word: str, nth: int, expected: tuple[str, str] | None) -> None:
    targets = await definition(client, file, word, nth)
    if expected is None:
        assert targets == []
    else:
        assert targets and targets[0][0] == expected[0] and expected[1] in targets[0][1], targets


async def references(client, file: str, word: str, declaration: bool = True) -> list[lsp.Location]:
    uri = (client.folder / file).as_uri()
    context = lsp.ReferenceContext(declaration)
    return list(await client.text_document_references_async(
        lsp.ReferenceParams(context=context, **ask(uri, place_of(text_of(uri), word)))
    ))  # fmt: skip


async def test_references_are_found_in_programs_and_scenes(client) -> None:
    locations = await references(client, "foraging/forager.ant", "patience =")
    assert [
        (name, cut_out(text_of(each.uri), each.range)) for each, (name, _) in zip(locations, lines(locations), strict=True)
    ] == [("forager.ant", "patience")] * 3 + [("many.yaml", "patience")]
    assert len(await references(client, "foraging/forager.ant", "patience =", declaration=False)) == 3
    states = lines(await references(client, "foraging/forager.ant", 'approach "Smells'))
    assert len(states) == 5 and sum("-> approach" in line for _, line in states) == 4
    assert {name for name, _ in lines(await references(client, "foraging/scene.yaml", "stones:"))} == {
        "forager.ant", "scene.yaml", "many.yaml",
    }  # fmt: skip
    assert len(await references(client, "using/mine.ant", "stroll")) == 2


async def rename(client, file: str, word: str, new: str) -> dict[str, str]:
    """The texts of all files after a rename, by their name."""
    uri = (client.folder / file).as_uri()
    params = lsp.RenameParams(new_name=new, **ask(uri, place_of(text_of(uri), word)))
    workspace_edit = await client.text_document_rename_async(params)
    return {uri_to_path(each).name: applied(text_of(each), list(edits)) for each, edits in workspace_edit.changes.items()}


@pytest.mark.parametrize(
    "word, new, files",
    [
        ("smell    =", "nose", {"forager.ant"}),
        ("patience =", "endurance", {"forager.ant", "many.yaml"}),
        ("load   =", "cargo", {"forager.ant", "scene.yaml", "many.yaml"}),
        ('carry "', "haul", {"forager.ant"}),
        ("food {", "meals", {"forager.ant", "scene.yaml", "many.yaml"}),
        ("trail on", "scent_trail", {"forager.ant"}),
        ("forager {", "worker", {"forager.ant", "scene.yaml", "many.yaml"}),
        ("meal  =", "crumb", {"forager.ant"}),
    ],
)
async def test_a_renamed_program_is_the_same_program(client, tmp_path: Path, word: str, new: str, files: set[str]) -> None:
    texts = await rename(client, "foraging/forager.ant", word, new)
    assert set(texts) == files
    for name in ("forager.ant", "scene.yaml", "many.yaml"):
        (tmp_path / name).write_text(texts.get(name, (FORAGING / name).read_text(encoding="utf-8")), encoding="utf-8")
    for mesh in FORAGING.glob("*.ply"):
        shutil.copy(mesh, tmp_path / mesh.name)
    program, report = check_path(tmp_path / "scene.yaml")
    assert program is not None and not report.diagnostics, [(d.message, str(d.span)) for d in report.diagnostics]
    assert check_path(tmp_path / "many.yaml")[1].ok
    old = word.split()[0]
    assert not [line for line in texts["forager.ant"].splitlines() if f"{old} = " in line or f" {old}(" in line]


async def test_a_rename_reaches_into_used_files_and_machines(client) -> None:
    texts = await rename(client, "using/mine.ant", "pace:", "tempo")
    assert "mine.stroll(tempo: 0.5)" in texts["walker.ant"] and "let slow = tempo * 0.5" in texts["mine.ant"]
    texts = await rename(client, "using/walker.ant", "angry ->", "furious")
    assert "mood.state == furious" in texts["walker.ant"] and "-> furious }" in texts["walker.ant"]
    texts = await rename(client, "using/walker.ant", "shout ->", "alarm")
    assert texts["walker.ant"].count("alarm") == 3 and "shout" not in texts["walker.ant"]
    texts = await rename(client, "using/walker.ant", "other.calm", "rival")
    assert "on collision(rival) { calm -= rival.calm * 0.1 }" in texts["walker.ant"]


@pytest.mark.parametrize(
    "file, word, new, why",
    [
        ("foraging/forager.ant", "smell    =", "size", "word of the language"),
        ("foraging/forager.ant", "smell    =", "state", "word of the language"),
        ("foraging/forager.ant", "smell    =", "Nose", "small letters"),
        ("foraging/forager.ant", "smell    =", "reward", "already"),
        ("foraging/forager.ant", "smell    =", "meal", "already"),
        ("foraging/forager.ant", "food {", "trail", "already"),
        ("foraging/forager.ant", 'carry "', "search", "already"),
        ("foraging/forager.ant", "wander(", "stroll", "library"),
        ("foraging/forager.ant", "nearest(", "closest_of", "word of the language"),
        ("foraging/scene.yaml", "food:", "nest", "already"),
        ("using/walker.ant", "calm = 1", "n", "hide"),
        ("using/mine.ant", "pace", "slow", "already"),
    ],
)
async def test_a_rename_that_would_change_the_meaning_is_refused(client, file: str, word: str, new: str, why: str) -> None:
    from pygls.exceptions import JsonRpcException

    with pytest.raises(JsonRpcException, match=why):
        await rename(client, file, word, new)


async def test_rename_needs_a_name_at_the_position(client) -> None:
    from pygls.exceptions import JsonRpcException

    uri = (client.folder / "foraging" / "forager.ant").as_uri()
    where = await client.text_document_prepare_rename_async(lsp.PrepareRenameParams(**ask(uri, place_of(FORAGER, "smell)"))))
    assert cut_out(FORAGER, where) == "smell"
    with pytest.raises(JsonRpcException, match="no name at this position"):
        await client.text_document_prepare_rename_async(lsp.PrepareRenameParams(**ask(uri, place_of(FORAGER, "40 mm", inside=0))))
