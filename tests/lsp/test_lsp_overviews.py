"""Signatures, links, colours, symbols of all files, and the button above a spec, through the protocol in the foraging example."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from lsp_client import COMMAND, ROOT, Editor, ask, cursor, cut_out, initialize_params, lsp, place_of, pytest_lsp

from antdsl.lsp.features.outline import find_workspace_symbols
from antdsl.lsp.features.signatures import find_signatures
from antdsl.lsp.workspace import Workspace
from antdsl.program.tables.colours import COLOUR_BY_NAME

FORAGING = ROOT / "examples" / "foraging"
FORAGER = (FORAGING / "forager.ant").read_text(encoding="utf-8")
SCENE = (FORAGING / "scene.yaml").read_text(encoding="utf-8")
BUG_PROGRAM = """ant 2
species bug {
  state walk amber { steer heading }
}
spec "walks" { 2 s; each bug { always: speed < 1 m/s } }
spec "flies" { 2 s; each bug { always: speed > 1 m/s } }
"""


@pytest_lsp.fixture(config=pytest_lsp.ClientServerConfig(server_command=COMMAND), scope="module")
async def client(lsp_client: pytest_lsp.LanguageClient, tmp_path_factory: pytest.TempPathFactory):
    folder = tmp_path_factory.mktemp("crowds")
    shutil.copytree(FORAGING, folder / "foraging")
    await lsp_client.initialize_session(initialize_params(folder))
    editor = Editor(lsp_client)
    lsp_client.folder = folder
    lsp_client.program = (folder / "foraging" / "forager.ant").resolve().as_uri()
    lsp_client.scene = (folder / "foraging" / "scene.yaml").resolve().as_uri()
    await editor.open(lsp_client.program, FORAGER)
    await editor.open(lsp_client.scene, SCENE)
    yield
    await lsp_client.shutdown_session()


in_session = pytest.mark.asyncio(loop_scope="module")


@in_session
async def test_a_call_shows_its_signature(client) -> None:
    place = place_of(FORAGER, "wander(swing", inside=len("wander("))
    help = await client.text_document_signature_help_async(lsp.SignatureHelpParams(**ask(client.program, place)))
    signature = help.signatures[0]
    assert signature.label.startswith("wander(swing: angle")
    assert signature.parameters[signature.active_parameter].label.startswith("swing: angle")
    outside = await client.text_document_signature_help_async(
        lsp.SignatureHelpParams(**ask(client.program, place_of(FORAGER, "species forager")))
    )
    assert outside is None


@pytest.mark.parametrize(
    ("line", "function", "active"),
    [
        ("steer seek(|", "seek", "target"),
        ("steer wander(|swing: 3 deg", "wander", "swing"),
        ("let a = clamp(1, |", "clamp", "to"),
        ("let a = clamp(max(1, 2), |", "clamp", "to"),
        ("let a = clamp(max(1, |", "max", None),
        ("let a = distance(nearest(|", "nearest", None),
        ("let a = clamp(1, 2 .. 3, |", "clamp", ""),
        ("let a = clamp(zzz: |", "clamp", ""),
    ],
)
def test_the_parameter_at_the_cursor_is_active(tmp_path: Path, line: str, function: str, active: str | None) -> None:
    text, _ = cursor(f"ant 2\nuse steering\nspecies bug {{\n  state walk amber {{ {line}")
    workspace = Workspace()
    document = workspace.put_document(tmp_path / "a.ant", text)
    offset = f"ant 2\nuse steering\nspecies bug {{\n  state walk amber {{ {line}".index("|")
    signature = find_signatures(workspace, document, offset)[0]
    assert signature.label.startswith(f"{function}(")
    if active is not None:
        label = "" if signature.active_parameter is None else signature.parameters[signature.active_parameter]
        assert label.partition(":")[0] == active


@pytest.mark.parametrize("line", ["", "when |", '"a text (|', "# wander(|", "steer unknown_function(|"])
def test_there_is_no_signature_outside_calls(tmp_path: Path, line: str) -> None:
    text = f"ant 2\nspecies bug {{\n  state walk amber {{\n {line.replace('|', '')}"
    workspace = Workspace()
    assert find_signatures(workspace, workspace.put_document(tmp_path / "a.ant", text), len(text)) == []


@in_session
async def test_links_lead_to_the_files(client) -> None:
    links = await client.text_document_document_link_async(lsp.DocumentLinkParams(lsp.TextDocumentIdentifier(client.scene)))
    targets = {cut_out(SCENE, link.range): link.target for link in links}
    assert targets["forager.ant"] == client.program
    links = await client.text_document_document_link_async(lsp.DocumentLinkParams(lsp.TextDocumentIdentifier(client.program)))
    targets = {cut_out(FORAGER, link.range): link.target for link in links}
    assert targets["steering"].endswith("behaviours/steering.ant")


@in_session
async def test_states_show_their_colours(client) -> None:
    document = lsp.TextDocumentIdentifier(client.program)
    colours = await client.text_document_document_color_async(lsp.DocumentColorParams(document))
    values = {cut_out(FORAGER, each.range): each.color for each in colours}
    assert values and set(values) <= set(COLOUR_BY_NAME)
    for name, colour in values.items():
        assert (colour.red * 255, colour.green * 255, colour.blue * 255) == pytest.approx(COLOUR_BY_NAME[name])
    name, colour = next(iter(values.items()))
    choices = await client.text_document_color_presentation_async(lsp.ColorPresentationParams(document, colour, colours[0].range))
    assert choices[0].label == name


@in_session
async def test_symbols_of_all_files_are_searched(client) -> None:
    (client.folder / "bug.ant").write_text(BUG_PROGRAM)
    client.workspace_did_change_watched_files(lsp.DidChangeWatchedFilesParams([]))
    symbols = await client.workspace_symbol_async(lsp.WorkspaceSymbolParams("bug"))
    assert (symbols[0].name, symbols[0].container_name) == ("bug", "bug.ant")
    symbols = await client.workspace_symbol_async(lsp.WorkspaceSymbolParams("crr"))
    assert "carry" in {each.name for each in symbols}
    assert await client.workspace_symbol_async(lsp.WorkspaceSymbolParams("zzzz")) == []


def test_a_search_without_files_gives_nothing() -> None:
    assert find_workspace_symbols(Workspace(), "") == []


@in_session
async def test_a_spec_has_a_button_that_runs_it(client) -> None:
    path = client.folder / "foraging" / "forager.ant"
    lenses = await client.text_document_code_lens_async(lsp.CodeLensParams(lsp.TextDocumentIdentifier(client.program)))
    names = [lens.command.arguments[1] for lens in lenses]
    assert names and all(f'spec "{name}"' in FORAGER for name in names)
    assert lenses[0].command.title == "run spec" and Path(lenses[0].command.arguments[0]) == path.resolve()


@in_session
async def test_a_button_reports_what_the_spec_says(client) -> None:
    folder = client.folder / "small"
    folder.mkdir()
    program = folder / "walker.ant"
    program.write_text(
        "ant 2\nspecies bug {\n  size 4 mm\n  max_speed 10 mm/s\n  state walk amber { steer heading }\n}\n"
        'spec "slow enough" on "scene.yaml" {\n  for 0.1 s\n  always: count(bug) == 3\n}\n'
        'spec "too many" on "scene.yaml" {\n  for 0.1 s\n  always: count(bug) == 4\n}\n'
    )
    (folder / "scene.yaml").write_text(
        "antdsl: 1\nunits: mm\ncrowd:\n  - {species: bug, from: walker.ant, count: 3, place: {around: [0, 0, 0], radius: 9 mm}}\n"
    )
    for name, kind, part in (("slow enough", lsp.MessageType.Info, "1 passed"), ("too many", lsp.MessageType.Warning, "failed")):
        await client.workspace_execute_command_async(lsp.ExecuteCommandParams("antdsl.runSpec", [str(program), name]))
        message = client.messages[-1]
        assert (message.type, part in message.message) == (kind, True), message.message
