"""The language server, driven as an editor drives it: complaints as one types, texts of all kinds, files that come and go."""

from __future__ import annotations

import shutil

import pytest
from lsp_client import COMMAND, ROOT, Editor, ask, cursor, cut_out, initialize_params, lsp, place_of, pytest_lsp

FORAGING = ROOT / "examples" / "foraging"
FORAGER = (FORAGING / "forager.ant").read_text(encoding="utf-8")


@pytest_lsp.fixture(config=pytest_lsp.ClientServerConfig(server_command=COMMAND), scope="module")
async def client(lsp_client: pytest_lsp.LanguageClient, tmp_path_factory: pytest.TempPathFactory):
    folder = tmp_path_factory.mktemp("with blanks & 100%")
    lsp_client.folder = folder
    shutil.copytree(FORAGING, folder / "foraging")
    await lsp_client.initialize_session(initialize_params(folder))
    yield
    await lsp_client.shutdown_session()


pytestmark = pytest.mark.asyncio(loop_scope="module")


async def test_findings_are_published_and_removed_while_typing(client) -> None:
    editor, path = Editor(client), client.folder / "foraging" / "typing.ant"
    assert await editor.open(path, FORAGER) == []
    wrong = FORAGER.replace("-> follow_trail", "-> folow_trail", 1)
    diagnostics = await editor.rewrite(path.as_uri(), wrong)
    assert [(d.code, cut_out(wrong, d.range), d.source) for d in diagnostics] == [("unknown-state", "folow_trail", "antdsl")]
    assert "did you mean `follow_trail`?" in diagnostics[0].message
    assert await editor.rewrite(path.as_uri(), FORAGER) == []
    editor.close(path.as_uri())


async def test_other_yaml_files_are_ignored(client) -> None:
    editor, path = Editor(client), client.folder / "compose.yaml"
    recipe = "services:\n  web: {image: nginx}\n"
    assert await editor.open(path, recipe) == []
    assert await editor.rewrite(path.as_uri(), "antdsl: 1\n" + recipe) != []
    editor.close(path.as_uri())


async def test_incremental_edits_are_applied(client) -> None:
    editor, path = Editor(client), client.folder / "foraging" / "parts.ant"
    await editor.open(path, FORAGER)
    at = place_of(FORAGER, "40 mm in", inside=0)
    both = [
        lsp.TextDocumentContentChangePartial(lsp.Range(at, lsp.Position(at.line, at.character + 2)), "50"),
        lsp.TextDocumentContentChangePartial(lsp.Range(lsp.Position(0, 4), lsp.Position(0, 5)), "7"),
    ]
    diagnostics = await editor.change(path.as_uri(), both)
    assert [(d.code, d.range.start) for d in diagnostics] == [("unknown-edition", lsp.Position(0, 4))]
    hover = await client.text_document_hover_async(lsp.HoverParams(**ask(path.as_uri(), place_of(FORAGER, "smell    ="))))
    assert "param smell = 50 mm" in hover.contents.value
    editor.close(path.as_uri())


async def test_positions_are_utf_16_from_0(client) -> None:
    editor, path = Editor(client), client.folder / "ants 🐜 %20.ant"
    text = 'ant 1\nspecies ant "🐜🐜 walks" { max_speed 3 mm/s; state a "🐜" { steer heading * faktor } }\n'
    diagnostics = await editor.open(path, text)
    assert [(d.code, d.range.start) for d in diagnostics] == [("unknown-name", place_of(text, "faktor", inside=0))]
    assert diagnostics[0].range.start.character == text.splitlines()[1].index("faktor") + 3, "three ants take two columns each"
    assert cut_out(text, diagnostics[0].range) == "faktor"
    text, position = cursor(text.replace("heading", "hea|ding"))
    hover = await client.text_document_hover_async(lsp.HoverParams(**ask(path.as_uri(), position)))
    assert "where it faces" in hover.contents.value and cut_out(text, hover.range) == "heading"
    editor.close(path.as_uri())


@pytest.mark.parametrize("end", ["\r\n", "\r"])
async def test_line_ends_do_not_move_positions(client, end: str) -> None:
    editor, path = Editor(client), client.folder / "ends.ant"
    diagnostics = await editor.open(path, FORAGER.replace("-> carry", "-> cary").replace("\n", end))
    plain = FORAGER.replace("-> carry", "-> cary")
    assert [(d.code, cut_out(plain, d.range)) for d in diagnostics if d.severity == 1] == [("unknown-state", "cary")]
    editor.close(path.as_uri())


async def test_a_scene_is_checked_with_its_program_and_again_when_that_changes(client) -> None:
    editor, folder = Editor(client), client.folder / "foraging"
    program, scene = folder / "forager.ant", folder / "scene.yaml"
    text = scene.read_text(encoding="utf-8")
    assert await editor.open(scene, text) == []
    wrong = text.replace("load: 400", "lod: 400", 1)
    assert [cut_out(wrong, d.range) for d in await editor.rewrite(scene.as_uri(), wrong)] == ["lod"]
    assert await editor.rewrite(scene.as_uri(), text) == []
    await editor.open(program, FORAGER.replace("surface  ground ", "curve    way\n  surface  ground "))
    diagnostics = await _next(editor, scene.as_uri())
    assert any("`way`" in d.message for d in diagnostics), "the scene does not bind what the buffer declares"
    await editor.rewrite(program.as_uri(), FORAGER)
    assert await _next(editor, scene.as_uri()) == []
    assert program.read_text(encoding="utf-8") == FORAGER
    editor.close(program.as_uri())
    editor.close(scene.as_uri())


async def _next(editor: Editor, uri: str) -> list[lsp.Diagnostic]:
    """Diagnostics of a document that was not changed itself: the answer to a request shows that they have been sent."""
    await editor.client.text_document_document_symbol_async(lsp.DocumentSymbolParams(lsp.TextDocumentIdentifier(uri)))
    return editor.known[uri][1]


async def test_a_document_that_is_no_file_yet(client) -> None:
    editor = Editor(client)
    diagnostics = await editor.open("untitled:Untitled-1", "ant 1\nspecies walker { state a { steer nowhere } }\n")
    assert [d.code for d in diagnostics] == ["unknown-name"]
    editor.close("untitled:Untitled-1")


async def test_a_file_that_is_deleted_and_one_that_cannot_be_read(client) -> None:
    editor, folder = Editor(client), client.folder
    module = folder / "mine.ant"
    module.write_text("ant 1\nbehaviour calm() -> push { heading * 0.1 }\n", encoding="utf-8")
    text = 'ant 1\nuse "./mine.ant" as mine\nspecies walker { state a { steer mine.calm() } }\n'
    path = folder / "uses.ant"
    assert await editor.open(path, text) == []
    module.unlink()
    event = lsp.FileEvent(module.as_uri(), lsp.FileChangeType.Deleted)
    client.workspace_did_change_watched_files(lsp.DidChangeWatchedFilesParams([event]))
    assert [d.code for d in await _next(editor, path.as_uri())] == ["no-such-file"]
    module.write_bytes(b"\xff\xfe\x00bad")
    client.workspace_did_change_watched_files(lsp.DidChangeWatchedFilesParams([event]))
    await _next(editor, path.as_uri())
    hover = await client.text_document_hover_async(lsp.HoverParams(**ask(path.as_uri(), place_of(text, "calm"))))
    assert hover is None
    module.unlink()
    editor.close(path.as_uri())


async def test_missing_documents_have_no_findings(client) -> None:
    missing = (client.folder / "missing.ant").as_uri()
    identifier = lsp.TextDocumentIdentifier(missing)
    assert await client.text_document_hover_async(lsp.HoverParams(**ask(missing, lsp.Position(3, 3)))) is None
    assert not await client.text_document_document_symbol_async(lsp.DocumentSymbolParams(identifier))
    assert not await client.text_document_folding_range_async(lsp.FoldingRangeParams(identifier))
    await client.text_document_completion_async(lsp.CompletionParams(**ask(missing, lsp.Position(0, 0))))


async def test_no_intermediate_text_stops_the_server(client) -> None:
    """Every prefix of an example, as if a user typed it, and every text that lacks a stretch; with requests at each."""
    editor, path = Editor(client), client.folder / "prefixes.ant"
    text = (ROOT / "examples" / "alarm" / "alarm.ant").read_text(encoding="utf-8")
    await editor.open(path, "")
    for stop in range(0, len(text), 23):
        await editor.rewrite(path.as_uri(), text[:stop])
        last = cursor(text[:stop] + "|")[1]
        await client.text_document_completion_async(lsp.CompletionParams(**ask(path.as_uri(), last)))
        await client.text_document_hover_async(lsp.HoverParams(**ask(path.as_uri(), last)))
    for start in range(0, len(text), 97):
        await editor.rewrite(path.as_uri(), text[:start] + text[start + 61 :])
        identifier = lsp.TextDocumentIdentifier(path.as_uri())
        await client.text_document_semantic_tokens_full_async(lsp.SemanticTokensParams(identifier))
        text_range = lsp.Range(lsp.Position(0, 0), lsp.Position(500, 0))
        await client.text_document_inlay_hint_async(lsp.InlayHintParams(identifier, text_range))
    assert await editor.rewrite(path.as_uri(), text) == []
    editor.close(path.as_uri())
