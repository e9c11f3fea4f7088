"""Colours: the TextMate grammar, the extension for VS Code and the Pygments lexer see every example as the real lexer does."""

from __future__ import annotations

import importlib
import json
import re
import shutil
import subprocess
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from antdsl.diagnostics.model import Report
from antdsl.highlighting.patterns import SCOPE_AND_TOKEN_BY_CLASS, TOKEN_PATTERNS
from antdsl.highlighting.textmate import GRAMMAR_FILES, SCOPE_NAME, build_grammar_text, find_scope
from antdsl.source import Source
from antdsl.syntax.blocks import SourceLine, cut_lines, map_text
from antdsl.syntax.brackets import pair_brackets
from antdsl.syntax.parser import _load_parser_and_builder
from antdsl.syntax.scan import TokenScan, scan_tokens
from antdsl.syntax.words import BODY_RULE_BY_LINE

ROOT = Path(__file__).resolve().parents[2]
EXTENSION = ROOT / "grammar" / "vscode"
FOLDERS = ("examples", "behaviours", "tests/programs", "tests/cases/syntax")
TEXTS = sorted(path for folder in FOLDERS for path in (ROOT / folder).rglob("*.ant"))
Cut = list[tuple[int, int, str]]  # start, end, class

# What each class of the colours is to the lexer: it does not tell names apart, nor one sign from another.
SEEN_AS = {
    **dict.fromkeys(("number", "unit"), "number"),
    **dict.fromkeys(("declaration", "keyword", "word operator"), "keyword"),
    **dict.fromkeys(("declared", "target", "label", "builtin", "function", "given", "kind", "constant", "name"), "name"),
    **dict.fromkeys(("operator", "bracket"), "operator"),
    "comment": "comment",
    "string": "string",
}


@cache
def real(path: Path) -> Cut:
    """The tokens as the parser's own lexer has them, keywords distinguished from names by what may be at the position."""
    scanned = scan_tokens(Source(path.name, path.read_text(encoding="utf-8")), Report())
    tokens = pair_brackets(scanned)
    assert tokens is not None
    kinds = {"text": "string", "number": "number", "sign": "operator", "open": "operator", "close": "operator", "word": "name"}
    spans = [(t.start, t.end, kinds[t.kind]) for t in scanned.tokens if t.kind in kinds]
    spans += [
        (t.start, t.end, "operator") for t in scanned.tokens if t.kind == "end" and scanned.clean_characters[t.start] == ";"
    ]
    spans += [(comment.span.start, comment.span.end, "comment") for comment in scanned.comments]
    keywords = set(keyword_places(scanned, cut_lines(scanned, tokens), "top"))
    return sorted((start, end, "keyword" if start in keywords else kind) for start, end, kind in spans)


def keyword_places(scanned: TokenScan, lines: list[SourceLine], rule: str) -> Iterator[int]:
    """Where words begin that the parser took for keywords."""
    parser, builder = _load_parser_and_builder()
    for line in lines:
        text = map_text(scanned, line)
        first = text.text.split()[0]
        builder.span_maker, builder.body_by_offset = text, {}
        for group in line.groups:
            inner = (
                "weight" if group.is_choice else BODY_RULE_BY_LINE.get((rule, first)) or BODY_RULE_BY_LINE.get((rule, "*")) or ""
            )
            yield from keyword_places(scanned, group.lines, inner)
        interactive = parser.parse_interactive(text.text, start="header" if first == "ant" else rule)
        builder.span_maker = text
        if len(line.tokens) == 1 and line.tokens[0].kind == "text" and rule == "top":
            continue  # the help of the file
        for token in interactive.iter_parse():
            if token.type not in ("NAME", "LABEL") and token.value[0].isalpha():
                yield text.find_source_offset(token.start_pos)


def compare(path: Path, coloured: Cut) -> None:
    text = path.read_text(encoding="utf-8")
    kinds: list[str | None] = [None] * len(text)
    for start, end, kind in coloured:
        kinds[start:end] = [SEEN_AS[kind]] * (end - start)
    for start, end, kind in real(path):
        different = {kinds[at] for at in range(start, end) if kind == "string" or kind == "comment" or not text[at].isspace()} - {
            kind
        }
        assert not different, (
            f"{Source(path.name, text).find_line_column(start)}: `{text[start:end]}` is a {kind}, not {different}"
        )
    real_places = {at for start, end, _ in real(path) for at in range(start, end)}
    assert not [at for at, kind in enumerate(kinds) if kind is not None and at not in real_places and not text[at].isspace()]


def test_the_real_lexer_tells_keywords_from_names() -> None:
    path = ROOT / "examples" / "foraging" / "forager.ant"
    text = path.read_text(encoding="utf-8")
    words = {(text[start:end], kind) for start, end, kind in real(path)}
    assert {("when", "keyword"), ("state", "keyword"), ("state", "name"), ("30 mm/s", "number"), ("->", "operator")} <= words
    assert ("meal", "keyword") not in words and ("wander", "keyword") not in words


@pytest.mark.parametrize("path", TEXTS, ids=lambda p: str(p.relative_to(ROOT)))
def test_pygments_sees_what_the_lexer_sees(path: Path) -> None:
    from antdsl.highlighting.lexer import AntLexer, find_token_type

    names = {find_token_type(name): name for name in reversed(SCOPE_AND_TOKEN_BY_CLASS)}
    lexer = AntLexer(stripnl=False, ensurenl=False)
    tokens = list(lexer.get_tokens_unprocessed(path.read_text(encoding="utf-8")))
    assert "".join(value for _, _, value in tokens) == path.read_text(encoding="utf-8")
    compare(path, [(at, at + len(value), names[kind]) for at, kind, value in tokens if value.strip() and kind in names])


@pytest.mark.parametrize("path", TEXTS, ids=lambda p: str(p.relative_to(ROOT)))
def test_textmate_sees_what_the_lexer_sees(path: Path) -> None:
    onigurumacffi = pytest.importorskip("onigurumacffi", reason="the package `onigurumacffi` (extra `test`) is not installed")
    compiled = [(onigurumacffi.compile(rule["match"]), rule) for rule in json.loads(build_grammar_text())["patterns"]]
    names = {find_scope(name): name for name in reversed(SCOPE_AND_TOKEN_BY_CLASS)}
    spans: Cut = []
    begin = 0
    for line in path.read_text(encoding="utf-8").split("\n"):
        at = 0
        while at < len(line):
            matches = [
                (match.start(), k, match, rule) for k, (regex, rule) in enumerate(compiled) if (match := regex.search(line, at))
            ]
            if not matches:
                break
            _, _, match, rule = min(matches, key=lambda each: each[:2])
            assert match.end() > match.start(), rule
            groups = {"0": {"name": rule["name"]}} if "name" in rule else rule["captures"]
            for number, group in groups.items():
                start, end = match.span(int(number))
                if start >= 0:
                    spans.append((begin + start, begin + end, names[group["name"]]))
            at = match.end()
        begin += len(line) + 1
    compare(path, spans)


NODE = """
const fs = require("fs");
const { Registry, parseRawGrammar, INITIAL } = require("vscode-textmate");
const oniguruma = require("vscode-oniguruma");
const [grammar, scopeName, ...paths] = process.argv.slice(2);
(async () => {
  await oniguruma.loadWASM(fs.readFileSync(require.resolve("vscode-oniguruma/release/onig.wasm")).buffer);
  const registry = new Registry({
    onigLib: Promise.resolve({
      createOnigScanner: (patterns) => new oniguruma.OnigScanner(patterns),
      createOnigString: (text) => new oniguruma.OnigString(text),
    }),
    loadGrammar: async () => parseRawGrammar(fs.readFileSync(grammar, "utf8"), grammar),
  });
  const loaded = await registry.loadGrammar(scopeName);
  const found = {};
  for (const path of paths) {
    let stack = INITIAL, begin = 0;
    found[path] = [];
    for (const line of fs.readFileSync(path, "utf8").split("\\n")) {
      const { tokens, ruleStack } = loaded.tokenizeLine(line, stack);
      for (const { startIndex, endIndex, scopes } of tokens)
        if (scopes.length > 1)
          found[path].push([begin + startIndex, begin + Math.min(endIndex, line.length), scopes.at(-1)]);
      stack = ruleStack;
      begin += line.length + 1;
    }
  }
  console.log(JSON.stringify(found));
})();
"""


def node() -> str:
    """Node, where it is and the packages that `npm install` puts beside the extension are."""
    program = shutil.which("node")
    if program is None:
        pytest.skip("node is not installed")
    if not (EXTENSION / "node_modules" / "vscode-textmate").is_dir():
        pytest.skip("run `npm install` in grammar/vscode")
    return program


def test_vs_code_sees_what_the_lexer_sees(tmp_path: Path) -> None:
    """By the packages with which VS Code itself colours."""
    program = node()
    (tmp_path / "node_modules").symlink_to(EXTENSION / "node_modules")
    (tmp_path / "colours.js").write_text(NODE)
    grammar = EXTENSION / "syntaxes" / "antdsl.tmLanguage.json"
    command = [program, "colours.js", str(grammar), SCOPE_NAME, *map(str, TEXTS)]
    result = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=120)
    assert result.returncode == 0, result.stderr
    names = {find_scope(name): name for name in reversed(SCOPE_AND_TOKEN_BY_CLASS)}
    tokens = json.loads(result.stdout)
    for path in TEXTS:
        assert max(path.read_text(encoding="utf-8")) < "\U00010000"  # so that places are the same in UTF-16
        compare(path, [(start, end, names[kind]) for start, end, kind in tokens[str(path)]])


# --- the files that ship ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", GRAMMAR_FILES)
def test_the_grammar_is_fresh(name: str) -> None:
    text = (ROOT / "grammar" / name).read_text(encoding="utf-8")
    assert text == build_grammar_text(), "run `python -m antdsl.highlighting.textmate`"


def test_every_word_of_the_grammar_has_a_colour() -> None:
    """A keyword that is put into the grammar and into no table would stay a name here."""
    from antdsl.highlighting.lexer import AntLexer
    from antdsl.program.tables.vocabulary import UNIT_BY_NAME

    words = set(re.findall(r"^_?[A-Z_]+\.1: /([a-z]+)\(", (ROOT / "grammar" / "antdsl.lark").read_text(encoding="utf-8"), re.M))
    assert len(words) > 60
    for word in sorted(words - {"previous", "choose"}):
        kinds = set()
        for text in (f"{word} x", f"{word}: x", f"a {word} x"):
            kinds |= {str(kind) for _, kind, value in AntLexer().get_tokens_unprocessed(text) if value == word}
        assert kinds & {"Token.Keyword", "Token.Keyword.Declaration", "Token.Operator.Word"}, word
    for unit in UNIT_BY_NAME:
        tokens = list(AntLexer().get_tokens_unprocessed(f"3 {unit}"))
        assert [str(kind) for _, kind, _ in tokens] == ["Token.Literal.Number", "Token.Keyword.Type"], unit


def test_every_pattern_is_of_use() -> None:
    """Each wins somewhere in the examples, and names a class for each of its groups."""
    from antdsl.highlighting.lexer import AntLexer

    won = set()
    for path in TEXTS:
        text, at = path.read_text(encoding="utf-8"), 0
        while at < len(text):
            match = next(
                ((k, m) for k, p in enumerate(TOKEN_PATTERNS) if (m := re.compile(p.regex, AntLexer.flags).match(text, at))), None
            )
            won.add(match[0] if match else None)
            at = match[1].end() if match else at + 1
    assert won - {None} == set(range(len(TOKEN_PATTERNS)))
    for pattern in TOKEN_PATTERNS:
        assert len(pattern.group_classes) == max(1, re.compile(pattern.regex).groups)


def test_pygments_finds_the_lexer() -> None:
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    module, _, name = settings["project"]["entry-points"]["pygments.lexers"]["antdsl"].partition(":")
    lexer = getattr(importlib.import_module(module), name)
    assert "ant" in lexer.aliases and "*.ant" in lexer.filenames


def test_the_extension_names_files_that_are_there() -> None:
    package = json.loads((EXTENSION / "package.json").read_text(encoding="utf-8"))
    gives = package["contributes"]
    files = [package["main"], *(each["configuration"] for each in gives["languages"])]
    files += [each["path"] for each in (*gives["grammars"], *gives["snippets"])]
    assert [name for name in files if not (EXTENSION / name).is_file()] == []
    assert {each["scopeName"] for each in gives["grammars"]} == {SCOPE_NAME}
    assert {each["language"] for each in (*gives["grammars"], *gives["snippets"])} == {each["id"] for each in gives["languages"]}
    program = (EXTENSION / "extension.js").read_text(encoding="utf-8")
    assert set(re.findall(r'registerCommand\("([^"]+)"', program)) == {each["command"] for each in gives["commands"]}
    assert gives["configuration"]["properties"]["antdsl.command"]["default"] == ["antdsl", "lsp"]
    required = {name for name in re.findall(r'require\("([^"./]+)', program)} - {"vscode"}
    assert required == set(package["dependencies"])
    assert package["contributes"]["configurationDefaults"]["[antdsl]"]["editor.rulers"] == [120]


def test_snippets_are_programs() -> None:
    """With what stands in their holes, each is read without an error at its place, and laid out as `fmt` does."""
    from antdsl.syntax import format

    around = {
        **dict.fromkeys(("param", "state", "layers"), ("ant 1\nspecies a {\n", "}\n")),
        "when": ("ant 1\nspecies a {\n  state s {\n", "  }\n}\n"),
        "ant": ("", ""),
    }
    snippets = json.loads((EXTENSION / "snippets" / "antdsl.json").read_text(encoding="utf-8"))
    assert len(snippets) >= 10
    for snippet in snippets.values():
        start, end = around.get(snippet["prefix"], ("ant 1\n", ""))
        indent = "  " * start.count("{")
        filled = [re.sub(r"\$\{\d+(?::([^}]*)|\|([^,|]*)[^}]*)\}", r"\1\2", line) for line in snippet["body"]]
        text = start + "".join(f"{indent}{line}".rstrip() + "\n" for line in filled) + end
        formatted, report = format(Source("t.ant", text))
        assert formatted == text, (snippet["prefix"], report.diagnostics)


def test_the_extension_packs(tmp_path: Path) -> None:
    program = node()
    copy = tmp_path / "vscode"
    shutil.copytree(EXTENSION, copy, symlinks=True)
    packer = copy / "node_modules" / "@vscode" / "vsce" / "vsce"
    words = ["package", "--allow-missing-repository", "--skip-license", "--out", "antdsl.vsix"]
    result = subprocess.run([program, str(packer), *words], cwd=copy, capture_output=True, text=True, timeout=300)
    assert result.returncode == 0, result.stdout + result.stderr
    from zipfile import ZipFile

    names = set(ZipFile(copy / "antdsl.vsix").namelist())
    expected_files = (
        "extension.js",
        "package.json",
        "syntaxes/antdsl.tmLanguage.json",
        "snippets/antdsl.json",
        "language-configuration.json",
    )
    assert {f"extension/{name}" for name in expected_files} <= names
    assert "extension/node_modules/vscode-languageclient/node.js" in names
    assert not [name for name in names if "vscode-textmate" in name or "@vscode/vsce" in name]
