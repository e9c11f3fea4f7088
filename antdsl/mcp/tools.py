"""The tools that an assistant can call. Each runs a command of antdsl in a child process, and returns what it prints."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple

import anyio
from mcp.server.mcpserver import Image
from mcp.server.mcpserver.exceptions import ToolError

from antdsl.child_processes import build_module_command, build_module_environment
from antdsl.lsp.word_help import explain_word
from antdsl.mcp.folders import GrantedFolders, PathOutsideFolders
from antdsl.mcp.pages import format_sections, list_pages, read_page, search_pages
from antdsl.safe_read import read_first_bytes

_MAX_TEXT_CHARACTERS = 40_000  # of one answer
_MAX_SECONDS = 3600.0
_MAX_PICTURE_PIXELS = 1920  # width and height
_MAX_PICTURE_BYTES = 32 << 20
_SUCCESS, _FINDINGS = 0, 1  # exit codes


class Completed(NamedTuple):
    """The result of a command. `text`: its standard output, followed by its messages."""

    code: int
    text: str


@dataclass(frozen=True, slots=True)
class Tools:
    """The tools, for calls that stay within some folders. `grants`: the options `--root NAME=DIR` for scenes."""

    folders: GrantedFolders
    grants: tuple[str, ...] = ()

    async def check(
        self,
        path: str = ".",
        program: str | None = None,
        show: Literal["findings", "params", "cost", "imports"] = "findings",
        strict: bool = False,
    ) -> str:
        """Find mistakes in programs (.ant) and scenes (.yaml) without running them.

        path: a file or a folder. program: the text of a program to check instead of a file. show: `params` lists the params and
        their defaults, `cost` the cost of each state and the size of scenes, `imports` what was read of each mesh. strict: count
        warnings as errors. The answer gives for each mistake its place, what was expected, and the text to write instead."""
        options = [] if show == "findings" else [f"--{show}"]
        options += ["--strict"] if strict else []
        place = "-" if program is not None else self._locate_existing(path)
        words = ["check", *options, *self._grant_words(), "--", str(place)]
        return self._require(await self._run(words, stdin=program), _SUCCESS, _FINDINGS)

    async def run(
        self,
        scene: str,
        out: str | None = None,
        frames: str | None = None,
        seed: int | None = None,
        params: dict[str, str] | None = None,
        resume: bool = False,
        seconds: float = 300.0,
    ) -> str:
        """Simulate a scene and write its cache. The answer names the folder of the cache.

        scene: a scene file (.yaml). out: the folder of the cache; without it, `out/SCENE` beside the scene. frames: a range such
        as `1..48`, instead of the scene's. seed: instead of the scene's. params: values of params by name, such as
        {"forager.smell": "50 mm"}. resume: continue a run that was stopped. seconds: the longest time that the run may take, at
        most 3600; a run that takes longer is stopped, and all frames it has written stay."""
        options = [*self._grant_words(), *_option("frames", frames), *_option("seed", seed)]
        options += [f"--set={name}={value}" for name, value in (params or {}).items()]
        options += _option("out", None if out is None else self._locate(out))
        options += ["--resume"] if resume else []
        return self._require(await self._run(["run", *options, "--", str(self._locate_existing(scene))], seconds), _SUCCESS)

    async def test(self, path: str = ".", name: str | None = None, seeds: int | None = None, seconds: float = 300.0) -> str:
        """Run the specs of programs and report which fail, with the frame and the values.

        path: a program, a scene or a folder. name: only specs with this text in their name. seeds: run each spec with seeds 1 to
        this number. seconds: the longest time that the specs may take, at most 3600."""
        options = [*self._grant_words(), *_option("seeds", seeds), "--no-keep", *([] if name is None else ["-k", name])]
        return self._require(
            await self._run(["test", *options, "--", str(self._locate_existing(path))], seconds), _SUCCESS, _FINDINGS
        )

    async def explain(self, cache: str, agent: str, frame: int, species: str | None = None) -> str:
        """Explain what an agent decided in a frame: transitions, the push of each layer, senses and random draws.

        cache: a folder that `run` wrote. agent: the agent's id. frame: the frame after the step. species: the agent's species, if
        the scene has several."""
        options = [*self._grant_words(), f"--agent={agent}", f"--frame={frame}", *_option("species", species)]
        return self._require(await self._run(["explain", *options, "--", str(self._locate_existing(cache))]), _SUCCESS)

    async def render(
        self, cache: str, frame: int | None = None, camera: str | None = None, width: int = 960, height: int = 540
    ) -> list[Any]:
        """Draw one frame of a cache. The answer is the picture, and the path of its file.

        cache: a folder that `run` wrote. frame: without it, the last. camera: the name of a camera of the scene, `fit`, `above`,
        `top`, `eye` or `close`; without it, the scene's own. width, height: pixels, at most 1920."""
        if not (0 < width <= _MAX_PICTURE_PIXELS and 0 < height <= _MAX_PICTURE_PIXELS):
            raise ToolError(f"width and height are 1 to {_MAX_PICTURE_PIXELS} pixels")
        options = [*_option("frames", None if frame is None else f"{frame}..{frame}"), *_option("camera", camera)]
        words = ["render", *options, f"--width={width}", f"--height={height}", "--", str(self._locate_existing(cache))]
        text = self._require(await self._run(words), _SUCCESS)
        pictures = [line for line in text.splitlines() if line.endswith(".png")]
        if not pictures:
            raise ToolError(f"no picture was drawn: {text}")
        picture = self._locate(pictures[-1])
        return [Image(data=read_first_bytes(picture, _MAX_PICTURE_BYTES), format="png"), str(picture)]

    async def docs(self, topic: str, start: int = 0) -> str:
        """Look something up in the documentation.

        topic: the name of a page, a word of the language, a behaviour, a code such as `unknown-state`, or words to search for.
        start: the character of a page to begin with, for pages that are longer than one answer."""
        page = read_page(topic)
        if page is not None:
            return _cut(page, max(start, 0))
        word = topic.strip("` ").removesuffix("()")
        explanation = explain_word(word)
        sections = search_pages(topic)
        parts = [*([explanation] if explanation is not None else []), *([format_sections(sections)] if sections else [])]
        if not parts:
            return f"no page has any of these words. The pages: {', '.join(list_pages())}"
        return _cut("\n\n".join(parts), 0)

    def _locate(self, text: str) -> Path:
        """Return the path that a call names. Raises ToolError if it is outside the granted folders."""
        try:
            return self.folders.locate(text)
        except PathOutsideFolders as error:
            raise ToolError(str(error)) from None

    def _locate_existing(self, text: str) -> Path:
        """Return the path that a call names. Raises ToolError if nothing exists there, or if it is outside the granted folders.

        A command would read a missing path as a pattern, which could select links to other files."""
        path = self._locate(text)
        if not path.exists():
            raise ToolError(f"there is no file or folder `{path}`")
        return path

    def _grant_words(self) -> list[str]:
        return [f"--root={grant}" for grant in self.grants]

    async def _run(self, words: list[str], seconds: float = 300.0, stdin: str | None = None) -> Completed:
        """Run a command of antdsl and return its result. Raises ToolError if it takes longer than `seconds`."""
        if not 0 < seconds <= _MAX_SECONDS:
            raise ToolError(f"seconds is a number above 0, at most {_MAX_SECONDS:g}")
        result = None
        with anyio.move_on_after(seconds):
            result = await anyio.run_process(
                build_module_command("antdsl", *words),
                input=(stdin or "").encode(),  # never the standard input of this process, which has the calls
                stderr=subprocess.STDOUT,
                check=False,
                cwd=self.folders.folders[0],
                env={**build_module_environment(), "NO_COLOR": "1", "COLUMNS": "130"},
            )
        if result is None:
            advice = "; call `run` again with `resume` to continue" if words[0] == "run" else ""
            raise ToolError(f"`antdsl {words[0]}` was stopped after {seconds:g} s{advice}")
        return Completed(result.returncode, result.stdout.decode("utf-8", "replace").strip())

    def _require(self, completed: Completed, *codes: int) -> str:
        """Return the output of a command. Raises ToolError if its exit code is not one of `codes`."""
        text = _cut(completed.text, 0) or "no output"
        if completed.code not in codes:
            raise ToolError(f"{text}\n(exit code {completed.code})")
        return text


class ToolEntry(NamedTuple):
    """An entry in the table of tools: the method of `Tools`, its name, and whether it only reads."""

    method: Callable[..., Any]
    is_reader: bool


TOOLS = (
    ToolEntry(Tools.check, True),
    ToolEntry(Tools.run, False),
    ToolEntry(Tools.test, True),
    ToolEntry(Tools.explain, True),
    ToolEntry(Tools.render, False),
    ToolEntry(Tools.docs, True),
)


def _option(name: str, value: object) -> list[str]:
    """Return the words of a command-line option; [] if `value` is None."""
    return [] if value is None else [f"--{name}={value}"]


def _cut(text: str, start: int) -> str:
    """Return the part of a text from `start` on that fits into an answer, with a remark if more follows."""
    part = text[start : start + _MAX_TEXT_CHARACTERS]
    end = start + len(part)
    return part if end >= len(text) else f"{part}\n[… {len(text) - end} more characters, from character {end}]"
