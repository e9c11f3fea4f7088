"""Reads the pages of docs/codes and does what their examples say. `python tests/code_pages.py [CODE…]` writes again what antdsl
says about the wrong ones, and the index. Read that text before you commit it.

A page has a title, the code's meaning, why it matters, and the sections Wrong and Right. In a section:

- a block is a file: `walker.ant` if it is a program, `scene.yaml` if it is a scene, or what a line such as `` `b.ant`: `` above
  it says (`` `b.ant`, saved as latin-1: `` for other bytes than UTF-8, `` `b.ply` is a folder. `` for a folder);
- `` `…` stands for `TEXT` 300 times more. `` makes a block long; `{n}` in
  the text counts, `{n+1}` is one further; `…, a line each.` where each is a line;
- `⟨U+200B⟩` is that character, which would not be seen;
- a block `python` is run; `` The package `NAME` is not installed. `` hides that package;
- a block `console` is the command; without one it is `antdsl check` of the scene, or of the first program;
- a block `text` is what antdsl says.

The files lie in a folder with those of examples/minimal."""

from __future__ import annotations

import io
import os
import re
import runpy
import shlex
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGES = ROOT / "docs" / "codes"
MINIMAL = ROOT / "examples" / "minimal"
DEFAULT_NAMES = {"ant": "walker.ant", "yaml": "scene.yaml"}
_BLOCK = re.compile(r"(?:^`([^`\n]+)`(?:, saved as ([a-z0-9-]+))?:\n\n)?^(`{3,4})(\w+)\n(.*?)^\3$", re.M | re.S)
_CHARACTER = re.compile(r"⟨U\+([0-9A-F]{4})⟩")
_FOLDER = re.compile(r"^`([^`\n]+)` is a folder\.$", re.M)
_HIDDEN = re.compile(r"^The package `(\w+)` is not installed\.$", re.M)
_REPEATED = re.compile(r"^`…` stands for `([^`\n]*)` ([\d,]+) times more(, a line each)?\.$", re.M)
_PARTS = re.compile(r"\A# ([a-z0-9-]+)\n\n\*(.+)\*\n\n(.+?)\n\n## Wrong\n\n(.+?)\n\n## Right\n\n(.+)\n\Z", re.S)
_CODE = re.compile(r"^(?:error|warning)\[([a-z0-9-]+)\]: ", re.M)


@dataclass(frozen=True)
class Example:
    """Files by name, names of folders, the words of the command after `antdsl`, what is said, if the page says so, and
    packages that are not there."""

    files: dict[str, bytes]
    folders: tuple[str, ...]
    command: tuple[str, ...]
    said: str | None
    hidden: tuple[str, ...] = ()


@dataclass(frozen=True)
class Page:
    code: str
    meaning: str
    why: str
    wrong: Example
    right: Example


def read(path: Path) -> Page:
    parts = _PARTS.match(path.read_text(encoding="utf-8"))
    assert parts, f"{path.name}: a page is a title, a meaning, why, `## Wrong` and `## Right`"
    return Page(parts[1], parts[2], parts[3], example(parts[4]), example(parts[5]))


def example(text: str) -> Example:
    files: dict[str, bytes] = {}
    command: tuple[str, ...] = ()
    said = None
    repeated = _REPEATED.search(text)
    for name, saved, _, kind, body in _BLOCK.findall(text):
        if kind == "console":
            command = tuple(shlex.split(body.removeprefix("$ antdsl ")))
        elif kind == "python":
            command = ("python", body)
        elif kind == "text" and not name:
            said = body
        else:
            if repeated and "…" in body:
                body = body.replace("…", _many(repeated[1], int(repeated[2].replace(",", "")), "\n" if repeated[3] else ""))
            body = _CHARACTER.sub(lambda match: chr(int(match[1], 16)), body)
            files[name or DEFAULT_NAMES[kind]] = body.encode(saved or "utf-8")
    folders = tuple(_FOLDER.findall(text))
    first = "scene.yaml" if "scene.yaml" in files else next((name for name in files if name.endswith(".ant")), "scene.yaml")
    return Example(files, folders, command or ("check", first), said, tuple(_HIDDEN.findall(text)))


def _many(text: str, times: int, between: str) -> str:
    return between.join(text.replace("{n}", str(n)).replace("{n+1}", str(n + 1)) for n in range(1, times + 1))


@contextmanager
def laid_out(example: Example, folder: Path) -> Iterator[None]:
    """The files of the example in the folder, which is the current one inside."""
    folder.mkdir()
    for file in ("walker.ant", "ground.ply", "scene.yaml"):
        shutil.copy(MINIMAL / file, folder)
    for name in example.folders:
        (folder / name).mkdir(parents=True)
    for name, data in example.files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    previous_folder, modules = Path.cwd(), dict(sys.modules)
    os.chdir(folder)
    try:
        for name in example.hidden:
            _hide(name)
        yield
    finally:
        os.chdir(previous_folder)
        if example.hidden:
            sys.modules.update({name: modules[name] for name in modules if name.split(".")[0] in example.hidden})
            for name in example.hidden:
                if sys.modules[name] is None:
                    del sys.modules[name]


def _hide(package: str) -> None:
    """Importing the package fails from now on, as where it is not installed."""
    from antdsl.scene.geometry.usd.errors import import_pxr_module

    import_pxr_module.cache_clear()
    for name in [name for name in sys.modules if name.split(".")[0] == package]:
        del sys.modules[name]
    sys.modules[package] = None  # type: ignore[assignment]


def said(example: Example, folder: Path) -> str:
    """What antdsl says of an example: the findings of a check, or all that another command prints."""
    with laid_out(example, folder):
        if example.command[0] == "python":
            return _run(example.command[1])
        if example.command[0] == "check":
            return _checked(example.command[1:])
        return _printed(example.command)


def _checked(words: tuple[str, ...]) -> str:
    from antdsl.diagnostics import Report
    from antdsl.diagnostics.ignore_comments import apply_ignore_comments
    from antdsl.diagnostics.render import render
    from antdsl.files import load_sources
    from antdsl.loading import ParsedFileCache
    from antdsl.pipeline import RunChoices, check_path

    strict = "--strict" in words
    grants = dict(word.split("=") for flag, word in pairwise(words) if flag == "--root")
    choices = RunChoices({name: Path(folder) for name, folder in grants.items()})
    parsed: ParsedFileCache = {}
    report = check_path(Path(words[-1]), choices, strict=strict, parsed=parsed)[1]
    findings = apply_ignore_comments(report, load_sources([Path(words[-1])], parsed), strict=strict).sort_by_place()
    report = Report([replace(one, severity="error") for one in findings] if strict else findings)
    return render(report, "full") if findings else ""


def _run(program: str) -> str:
    Path("example.py").write_text(program, encoding="utf-8")
    said = io.StringIO()
    with redirect_stdout(said):
        runpy.run_path("example.py")
    return said.getvalue().strip()


def _printed(words: tuple[str, ...]) -> str:
    from typer.testing import CliRunner

    from antdsl.cli import app
    from antdsl.cli.exits import CommandError

    result = CliRunner().invoke(app, list(words))
    if result.exception is not None and not isinstance(result.exception, (CommandError, SystemExit)):
        raise result.exception
    return result.stderr or result.stdout


def codes_in(text: str) -> set[str]:
    return set(_CODE.findall(text))


def written(path: Path, meaning: str, folder: Path) -> str:
    """The page with its meaning and what antdsl says of the wrong example as they are today."""
    text = path.read_text(encoding="utf-8")
    text = re.sub(r"\A# .*\n\n\*.*\*\n", lambda _: f"# {path.stem}\n\n*{sentence(meaning)}*\n", text)
    head, wrong, rest = re.split(r"(?<=\n)(?=## Wrong\n|## Right\n)", text)
    words = said(example(wrong), folder)
    wrong = re.sub(r"^```text\n.*?^```$", lambda _: f"```text\n{words.rstrip()}\n```", wrong, flags=re.M | re.S)
    return head + wrong + rest


def sentence(meaning: str) -> str:
    return f"{meaning[:1].upper()}{meaning[1:]}."


def index() -> str:
    """What docs/codes/README.md should say: every code with its meaning, by the sections of the table in the code."""
    from antdsl.diagnostics import codes

    lines = INDEX_HEAD.splitlines()
    for line in Path(codes.__file__).read_text(encoding="utf-8").splitlines():
        section = re.fullmatch(r"\s*# --- (.*?) -+", line)
        code = re.match(r'\s*"([a-z0-9-]+)":', line)
        if section:
            lines += ["", f"## {section[1][:1].upper()}{section[1][1:]}", "", "| code | meaning |", "|---|---|"]
        elif code:
            meaning = codes.CODE_DESCRIPTIONS[code[1]].replace("|", "\\|")
            lines.append(f"| [`{code[1]}`]({code[1]}.md) | {meaning} |")
    return "\n".join(lines) + "\n"


INDEX_HEAD = """# Codes

Every message has a code that never changes, a summary line, its place, and what to write instead.
Each code has a page: why it matters, a wrong example with its message, and a right example. The tests run both.
`antdsl check --explain CODE` shows the page.

An example is a file in a folder with the files of the smallest example, [examples/minimal](../../examples/minimal/scene.yaml).
The file is `walker.ant` or `scene.yaml` unless a line above it gives another name.
The command is `antdsl check` unless a page shows another.
"""


def main(page_codes: list[str]) -> None:
    import tempfile

    from antdsl.diagnostics.codes import CODE_DESCRIPTIONS

    with tempfile.TemporaryDirectory() as folder:
        for code in page_codes or CODE_DESCRIPTIONS:
            page = PAGES / f"{code}.md"
            if page.exists():
                page.write_text(written(page, CODE_DESCRIPTIONS[code], Path(folder, code)), encoding="utf-8")
    (PAGES / "README.md").write_text(index(), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
