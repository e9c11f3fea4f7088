"""What an editor asks the language server about a place: each feature through the protocol, in the foraging example."""

from __future__ import annotations

import shutil

import pytest
from lsp_client import COMMAND, ROOT, Editor, applied, ask, cut_out, initialize_params, lsp, place_of, pytest_lsp

FORAGING = ROOT / "examples" / "foraging"
FORAGER = (FORAGING / "forager.ant").read_text(encoding="utf-8")
SCENE = (FORAGING / "scene.yaml").read_text(encoding="utf-8")


@pytest_lsp.fixture(config=pytest_lsp.ClientServerConfig(server_command=COMMAND), scope="module")
async def client(lsp_client: pytest_lsp.LanguageClient, tmp_path_factory: pytest.TempPathFactory):
    folder = tmp_path_factory.mktemp("crowds")
    lsp_client.folder = folder
    shutil.copytree(FORAGING, folder / "foraging")
    await lsp_client.initialize_session(initialize_params(folder))
    editor = Editor(lsp_client)
    lsp_client.program = (folder / "foraging" / "forager.ant").resolve().as_uri()
    lsp_client.scene = (folder / "foraging" / "scene.yaml").resolve().as_uri()
    await editor.open(lsp_client.program, FORAGER)
    await editor.open(lsp_client.scene, SCENE)
    yield
    await lsp_client.shutdown_session()


pytestmark = pytest.mark.asyncio(loop_scope="module")


# --- hover -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "word, nth, expected",
    [
        ("smell    =", 0, ["a length, in `mm`", "from 0 mm to 200 mm", "default 40 mm", "How far an ant smells food"]),
        ("smell)", 0, ["param smell = 40 mm in 0 mm .. 200 mm"]),
        ("reward *", 0, ["a rate", "in `/s`", "Scent laid at the food"]),
        ("meal)", 0, ["let meal = nearest(food", "an item of `food`"]),
        ("scent >", 0, ["let scent", "number without a unit"]),
        ("load > 0", 0, ["value of each of `food`"]),
        ("load from", 0, ["attribute of `forager`", "value of each of `food`"]),
        ("source = meal", 0, ["source = none of food", "an item of `food`"]),
        ("carry {", 0, ["state carry", "Takes food home", "leads to `set_out`", "state of `forager`"]),
        ("food { load", 0, ["items food { load = 0 }", "Sources, each with a quantity"]),
        ("trail track", 0, ["field trail on ground, boulder { cell 6 mm; half_life 12 s }"]),
        ("half_life", 0, ["half of the amount disappears"]),
        ("wander(swing", 0, ["behaviour wander(swing: angle = ", "-> push", "steering.ant"]),
        ("swing: swing", 0, ["argument of `wander`", "angle"]),
        ("nearest(nest", 0, ["nearest(of: items", "the nearest, or none"]),
        ("within: smell", 0, ["within: length", "may be left out"]),
        ("size)", 0, ["size: length", "body length", "default 4 mm", "may be set"]),
        ("time_in_state", 0, ["the time since the agent entered its state"]),
        ("mm/s", 0, ["a speed"]),
        ("steer wander", 0, ["the push of the animal in this state", "steer seek(meal)"]),
        ("turn_p99", 0, ["a measure of the crowd's motion"]),
        ("on ground, boulder", 0, ["the surface of a field"]),
        ("from meal", 0, ["the agent or item that gives an amount"]),
        ("total(food", 0, ["the sum over all"]),
        ("state  # whatever", 0, ["the push that the animal's states steer"]),
    ],
)
async def test_hover_describes_words(client, word: str, nth: int, expected: list[str]) -> None:
    hover = await client.text_document_hover_async(lsp.HoverParams(**ask(client.program, place_of(FORAGER, word, nth))))
    assert hover is not None and not [each for each in expected if each not in hover.contents.value], (
        hover and hover.contents.value
    )


async def test_hover_reports_resting_states(client) -> None:
    path = client.folder / "rest.ant"
    text = "ant 1\nuse steering\nspecies bug {\n  start go\n  state go { steer wander(); when after 1 s -> rest }\n"
    text += "  state rest { when after 1 s -> drift }\n  state drift { steer coast(); when after 1 s -> go }\n}\n"
    path.write_text(text)
    await Editor(client).open(path, text)
    for word, still in (("rest {", True), ("drift {", False), ("go {", False)):
        hover = await client.text_document_hover_async(lsp.HoverParams(**ask(path.resolve().as_uri(), place_of(text, word))))
        assert hover is not None and ("agents stand still" in hover.contents.value) is still
    hover = await client.text_document_hover_async(lsp.HoverParams(**ask(path.resolve().as_uri(), place_of(text, "coast"))))
    assert hover is not None and "Continue the current motion" in hover.contents.value


async def test_hover_in_a_scene_knows_the_program_and_the_keys(client) -> None:
    async def said(word: str) -> str:
        hover = await client.text_document_hover_async(lsp.HoverParams(**ask(client.scene, place_of(SCENE, word))))
        return hover.contents.value if hover is not None else ""

    assert "Sources, each with a quantity" in await said("food:")
    assert "value of each of `food`" in await said("load: 400")
    assert "frames a second" in await said("fps")
    assert "species forager" in await said("forager, from")
    assert await said("42 mm") == ""


# --- completion ------------------------------------------------------------------------------------------------------


async def proposals(client, line: str, preceding_text: str = "    deposit trail track\n") -> dict[str, lsp.CompletionItem]:
    """What is proposed at the end of a line of a state, or of whatever comes after `preceding_text`."""
    editor, uri = Editor(client), (client.folder / "foraging" / "writing.ant").resolve().as_uri()
    at = FORAGER.index(preceding_text) + len(preceding_text)
    text = FORAGER[:at] + line + "\n" + FORAGER[at:]
    await editor.open(uri, text)
    position = lsp.Position(text[:at].count("\n") + line.count("\n"), len(line.rpartition("\n")[2]))
    completion = await client.text_document_completion_async(lsp.CompletionParams(**ask(uri, position)))
    editor.close(uri)
    return {item.label: item for item in completion.items}


@pytest.mark.parametrize(
    "line, expected, unwanted",
    [
        ("    when meal -> ", "search carry previous choose", "smell wander steer"),
        ("    when state == ", "search carry", "previous smell"),
        ("    when after 0.5 ", "s min step", "search wander"),
        ("    when speed < 3 mm/", "s", "search %"),
        ("    ", "steer when deposit enter load source", "param species smell"),
        ("    steer s", "seek separate", "steer"),
        ("    steer seek(", "target: meal nearest", "steer"),
        ("    steer wander(swing: 3 deg, ", "pace:", "swing:"),
        ("    deposit ", "trail", "ground meal"),
        ("    when meal.", "load position radius", "smell velocity"),
        ("    when nearest(nest).", "load position radius", "smell"),
        ("    load = sum(n in neighbours(3 mm): n.", "load size velocity", "meal2"),
        ("    when touching(meal) take 1 ", "load", "ground"),
        ("    # nothing in ", "", "search steer"),
    ],
)
async def test_completion_depends_on_the_position(client, line: str, expected: str, unwanted: str) -> None:
    items = await proposals(client, line)
    assert set(expected.split()) <= set(items), sorted(items)
    assert not set(unwanted.split()) & set(items)


@pytest.mark.parametrize(
    "line, anchor, expected, unwanted",
    [
        ("  ", "  start search\n", "param let state layers max_speed", "steer surface"),
        ("  ", "world {\n", "surface obstacle items solid", "param cell"),
        ("", "use steering\n", "world species field behaviour spec", "steer"),
        ("field smoke on ground { ", "use steering\n", "cell half_life diffuse", "param"),
        ("use ", '"Foraging ants: search, carry food home, mark the way."\n', "steering", "world"),
        ("    ", "  layers {  # the first line wins when strength runs out\n", "state avoid separate", "steer"),
        ('  state rest "Lies down" ', "  start search\n", "amber blue", "search"),
        ("behaviour calm(way: ", "use steering\n", "push length place", "seek"),
        ("  on ", "  start search\n", "spawn collision", "smell"),
        ("  set ", "  for 20 s\n", "forager.smell forager.reward trail.half_life", "smell load forager.load trail.cell"),
        ("  goal = none of ", "  start search\n", "food nest forager", "smell stones seek"),
    ],
)
async def test_completion_depends_on_the_block(client, line: str, anchor: str, expected: str, unwanted: str) -> None:
    items = await proposals(client, line, anchor)
    assert set(expected.split()) <= set(items), sorted(items)
    assert not set(unwanted.split()) & set(items)


async def test_proposed_behaviours_have_placeholders(client) -> None:
    items = await proposals(client, "    steer ")
    assert items["seek"].insert_text == "seek(${1:target})$0" and items["seek"].insert_text_format == lsp.InsertTextFormat.Snippet
    assert items["seek"].detail == "seek(target: place) -> push" and "Move straight to" in items["seek"].documentation.value
    assert items["smell"].documentation.value == "How far an ant smells food"


@pytest.mark.parametrize(
    "line, anchor, expected, unwanted",
    [
        ("", "seed: 7\n", "crowd world set layers", "mesh"),
        ("  ", "world:\n", "ground stones food nest", "crowd"),
        ("    ", "  food:\n", "", "crowd"),
        ("  - {species: ", "crowd:\n", "forager", "ground"),
        ("  - {species: forager, from: ", "crowd:\n", "forager.ant", "scene.yaml"),
        ("  - {species: forager, ", "crowd:\n", "from count place name rate frames seconds each", "world"),
        ("  - {species: forager, place: {", "crowd:\n", "on around radius along edge in ranks clumps facing", "count"),
        ("  - {species: forager, place: {on: ", "crowd:\n", "ground boulder", "food"),
        ("  - {species: forager, place: {facing: ", "crowd:\n", "out in along food", "boulder"),
        ("  - {species: forager, place: {ranks: {", "crowd:\n", "columns spacing", "count"),
        ("  - {species: forager, each: {", "crowd:\n", "state load", "count"),
        ("set: {", "seed: 7\n", "forager.smell trail.half_life", "crowd"),
        ("layers: {", "seed: 7\n", "forager", "crowd"),
        ("    pear: {at: [0, 0, 0], ", "  food:\n", "load radius", "mesh"),
    ],
)
async def test_completion_of_scenes(client, line: str, anchor: str, expected: str, unwanted: str) -> None:
    editor, uri = Editor(client), (client.folder / "foraging" / "writing.yaml").resolve().as_uri()
    at = SCENE.index(anchor) + len(anchor)
    text = SCENE[:at] + line + "\n" + SCENE[at:]
    if line.startswith(("  - ", "set", "layers")):
        text = text.replace(
            "crowd:\n" + line + "\n", "crowd:\n  - {species: forager, from: forager.ant, count: 1}\n" + line + "\n"
        )
    await editor.open(uri, SCENE)
    await editor.rewrite(uri, text)
    at = text.index(line + "\n", text.index(anchor)) if line.strip() else at
    position = lsp.Position(text[: at + len(line)].count("\n"), len(line))
    completion = await client.text_document_completion_async(lsp.CompletionParams(**ask(uri, position)))
    editor.close(uri)
    labels = {item.label for item in completion.items}
    assert set(expected.split()) <= labels, sorted(labels)
    assert not set(unwanted.split()) & labels


# --- the document ----------------------------------------------------------------------------------------------------


async def test_symbols_are_nested(client) -> None:
    identifier = lsp.TextDocumentIdentifier(client.program)
    symbols = await client.text_document_document_symbol_async(lsp.DocumentSymbolParams(identifier))
    assert [each.name for each in symbols if each.kind != lsp.SymbolKind.Method] == ["steering", "world", "trail", "forager"]
    inner = {each.name: each for each in symbols[3].children}
    assert {"smell", "load", "meal", "search", "carry", "layers"} <= set(inner)
    assert inner["carry"].kind == lsp.SymbolKind.EnumMember and cut_out(FORAGER, inner["carry"].selection_range) == "carry"
    assert cut_out(FORAGER, inner["carry"].range).startswith("state carry") and cut_out(FORAGER, inner["carry"].range).endswith(
        "}"
    )
    scene = await client.text_document_document_symbol_async(lsp.DocumentSymbolParams(lsp.TextDocumentIdentifier(client.scene)))
    assert [each.name for each in scene][:3] == ["antdsl", "units", "up"]
    world = next(each for each in scene if each.name == "world")
    assert [each.name for each in world.children] == ["ground", "boulder", "stones", "food", "nest"]


async def test_blocks_fold(client) -> None:
    folds = await client.text_document_folding_range_async(lsp.FoldingRangeParams(lsp.TextDocumentIdentifier(client.program)))
    lines = FORAGER.splitlines()
    first_words = [lines[each.start_line].split()[0] for each in folds]
    assert first_words[:3] == ["world", "species", "state"] and first_words.count("state") == 6
    assert all(lines[each.end_line + 1].strip() == "}" for each in folds)
    scene = await client.text_document_folding_range_async(lsp.FoldingRangeParams(lsp.TextDocumentIdentifier(client.scene)))
    assert [SCENE.splitlines()[each.start_line].strip() for each in scene] == ["world:", "food:", "nest:", "crowd:"]


async def test_semantic_tokens_have_kinds(client) -> None:
    identifier = lsp.TextDocumentIdentifier(client.program)
    tokens = await client.text_document_semantic_tokens_full_async(lsp.SemanticTokensParams(identifier))
    words = _token_texts(tokens.data)
    for pair in [
        ("species", "keyword"), ("forager", "class"), ("smell", "property"), ("40 mm", "number"), ("nearest", "function"),
        ("wander", "function"), ("swing", "parameter"), ("carry", "enumMember"), ("# body length", "comment"), ("->", "operator"),
        ("20 /s", "number"), ('"Smells food"', "string"), ("size", "property"), ("steering", "namespace"),
    ]:  # fmt: skip
        assert pair in words, pair
    assert "".join(text for text, _ in words) == "".join(part for part in _without_signs(FORAGER)), (
        "every word, number, text and comment has its token, once"
    )
    part_range = lsp.Range(lsp.Position(32, 0), lsp.Position(33, 0))
    part = await client.text_document_semantic_tokens_range_async(lsp.SemanticTokensRangeParams(identifier, part_range))
    assert _token_texts(part.data)[:3] == [("let", "keyword"), ("meal", "property"), ("=", "operator")]


def _token_texts(data: list[int]) -> list[tuple[str, str]]:
    """Tokens of the forager's program, with their text."""
    from antdsl.lsp.features.tokens import TOKEN_TYPES
    from antdsl.lsp.text import DocumentText

    text, line, column, pairs = DocumentText(FORAGER), 0, 0, []
    for number in range(0, len(data), 5):
        down, along, length, kind, _ = data[number : number + 5]
        line, column = line + down, along if down else column + along
        start = text.find_offset(line, column)
        pairs.append((text.text[start : text.find_offset(line, column + length)], TOKEN_TYPES[kind]))
    return pairs


def _without_signs(text: str) -> list[str]:
    """The text token by token as the real scanner cuts it, less brackets, commas and the like."""
    from antdsl.diagnostics import Report
    from antdsl.source import Source
    from antdsl.syntax.scan import scan_tokens

    scanned = scan_tokens(Source("x.ant", text), Report())
    pieces = [(t.start, text[t.start : t.end]) for t in scanned.tokens if t.kind not in ("open", "close", "end")]
    pieces += [(c.span.start, c.text) for c in scanned.comments]
    return [piece for _, piece in sorted(pieces) if piece not in (",", ":", ".")]


async def test_hints_rank_layers_and_count_frames(client) -> None:
    async def hints(uri: str) -> list[tuple[int, str, str]]:
        everything = lsp.Range(lsp.Position(0, 0), lsp.Position(999, 0))
        inlay_hints = await client.text_document_inlay_hint_async(
            lsp.InlayHintParams(lsp.TextDocumentIdentifier(uri), everything)
        )
        return [(each.position.line, each.label, each.tooltip) for each in inlay_hints]

    lines, inlay_hints = FORAGER.splitlines(), await hints(client.program)
    ranks = [(lines[line].split("(")[0].strip(), text) for line, text, _ in inlay_hints if text.endswith(".")]
    assert [text for _, text in ranks] == ["1.", "2.", "3.", "4."] and ranks[0][0] == "avoid"
    held = next(text for line, text, _ in inlay_hints if "held 0.5 s" in lines[line])
    assert held == "12 frames", "24 a second, as its scenes say"
    editor, alone = Editor(client), (client.folder / "alone.ant").resolve().as_uri()
    await editor.open(
        alone, "ant 1\nspecies ant { state a { when after 0.3 s -> b }\n state b { when after 3 step -> a }\n start a }\n"
    )
    assert await hints(alone) == [(1, "8 frames at 24 fps", "0.3 s is 8 frames at 24 fps, because no scene sets another rate")]
    editor.close(alone)


# --- repairs ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "right, wrong",
    [
        ("-> follow_trail", "-> folow_trail"),
        ("response       0.15 s", "response       0.15"),
        ("steer arrive(meal)", "steer arive(meal)"),
        ("wander(swing: swing)", "wander(swimg: swing)"),
        ("deposit trail track", "deposit trial track"),
        ("no meal held", "no mael held"),
    ],
)
async def test_suggestions_can_be_applied(client, right: str, wrong: str) -> None:
    assert right in FORAGER
    editor, uri = Editor(client), (client.folder / "foraging" / "wrong.ant").resolve().as_uri()
    text = FORAGER.replace(right, wrong, 1)
    diagnostics = await editor.open(uri, text)
    errors = [each for each in diagnostics if each.severity == lsp.DiagnosticSeverity.Error]
    assert len(errors) == 1
    context = lsp.CodeActionContext(errors)
    params = lsp.CodeActionParams(lsp.TextDocumentIdentifier(uri), errors[0].range, context)
    actions = await client.text_document_code_action_async(params)
    assert len(actions) == 1 and actions[0].kind == lsp.CodeActionKind.QuickFix and actions[0].title.startswith("Write `")
    mended = applied(text, list(actions[0].edit.changes[uri]))
    assert [d for d in await editor.rewrite(uri, mended) if d.severity == lsp.DiagnosticSeverity.Error] == []
    editor.close(uri)


async def test_formatting_is_that_of_fmt(client) -> None:
    from antdsl import syntax
    from antdsl.source import Source

    async def formatted(text: str) -> str | None:
        editor, uri = Editor(client), (client.folder / "foraging" / "layout.ant").resolve().as_uri()
        await editor.open(uri, text)
        options = lsp.FormattingOptions(tab_size=8, insert_spaces=False)
        edits = await client.text_document_formatting_async(
            lsp.DocumentFormattingParams(lsp.TextDocumentIdentifier(uri), options)
        )
        editor.close(uri)
        return None if edits is None else applied(text, list(edits))

    untidy = (
        FORAGER.replace("    steer ", "  steer   ")
        .replace("    deposit", "\tdeposit")
        .replace(" -> ", "->")
        .replace("\n\n", "\n\n\n")
    )
    assert await formatted(FORAGER) == FORAGER
    assert untidy != FORAGER and await formatted(untidy) == syntax.format(Source("layout.ant", untidy))[0]
    assert await formatted(FORAGER.replace("state carry", "state carry carry carry")) is None, "a text with errors is left alone"
