"""Follows a lesson of docs/learn as a reader does: writes its files, makes its changes, runs its commands.

Blocks of a lesson, by their first line:
- `ant file=NAME`, `yaml file=NAME`: the complete file;
- `ant part=NAME`, `yaml part=NAME`: statements that replace those of the same name; a new one follows the one above it;
- `ant try=NAME`, `yaml try=NAME`: the answer to an exercise: such a part, checked and run, then undone;
- `bash`: commands; `text output`: lines that the last command prints.

`python tests/lessons.py [NAME…]` makes the pictures and recordings that the pages show."""

from __future__ import annotations

import re
import shlex
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGES = ROOT / "docs" / "learn"
IMAGES = ROOT / "docs" / "images" / "learn"
# Statements that begin with one of these words have a name.
NAMED = ("state", "species", "field", "surface", "obstacle", "items", "let", "param", "behaviour", "spec")
Runner = Callable[[list[str], Path], str]


def blocks(page: Path) -> Iterator[tuple[str, str]]:
    """The first line and the text of each block of a page."""
    yield from re.findall(r"^```([^\n]*)\n(.*?)^```", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)


def split_statements(text: str) -> list[list[str]]:
    """The statements of the outermost indentation, each with the lines that belong to it."""
    lines = text.splitlines()
    outer = min(_indentation(line) for line in lines if line.strip())
    statements: list[list[str]] = []
    for line in lines:
        if _indentation(line) == outer and line.strip() and not line.strip().startswith("}"):
            statements.append([])
        statements[-1].append(line)
    return statements


def apply_part(text: str, part: str) -> str:
    """A file's text with the statements of a part in place of those of the same name."""
    lines, last_end = text.splitlines(), None
    for statement in split_statements(part):
        key = _key(statement[0])
        start = next((n for n, line in enumerate(lines) if _key(line) == key), None)
        if start is None:
            assert last_end is not None, f"`{key}` is new and follows nothing"
            lines[last_end:last_end] = statement
            last_end += len(statement)
            continue
        end = start + 1
        while end < len(lines) and (not lines[end].strip() or _indentation(lines[end]) > _indentation(lines[start])):
            end += 1
        if end < len(lines) and lines[end].strip().startswith("}") and _indentation(lines[end]) == _indentation(lines[start]):
            end += 1
        lines[start:end] = statement
        last_end = start + len(statement)
    return "\n".join(lines) + "\n"


def _indentation(line: str) -> int:
    return len(line) - len(line.lstrip())


def _key(line: str) -> str:
    words = re.findall(r"[\w]+", line)
    return " ".join(words[: 2 if words[:1] and words[0] in NAMED else 1])


@dataclass
class Reader:
    """A reader in a folder. `run`: runs the words of a command in a folder and returns what it prints."""

    folder: Path
    run: Runner
    compares_output: bool = True
    commands: list[str] = field(default_factory=list)
    files: set[str] = field(default_factory=set)

    def follow(self, page: Path) -> None:
        """Do what a page says."""
        printed = ""
        for info, text in blocks(page):
            words = info.split()
            kind, _, name = words[1].partition("=") if len(words) > 1 else ("", "", "")
            if info == "bash":
                for line in (each for each in text.splitlines() if each.strip()):
                    printed = self.run_line(line)
            elif info == "text output":
                for line in text.splitlines() if self.compares_output else ():
                    assert line.strip() in printed, f"{page.name}: {line!r} is not in\n{printed}"
            elif kind == "file":
                (self.folder / name).write_text(text, encoding="utf-8")
                self.files.add(name)
            else:
                assert kind in ("part", "try"), f"{page.name}: {info}"
                path = self.folder / name
                original = path.read_text(encoding="utf-8")
                path.write_text(apply_part(original, text), encoding="utf-8")
                if kind == "try":
                    assert "no findings" in self.run(["antdsl", "check", "."], self.folder), text
                    self.run(["antdsl", "run", "scene.yaml", "--frames", "1..4", "--out", "tried"], self.folder)
                    path.write_text(original, encoding="utf-8")

    def run_line(self, line: str) -> str:
        self.commands.append(line)
        words = shlex.split(line)
        if words[0] == "cd":
            self.folder /= words[1]
            return ""
        return self.run(words, self.folder)


def _make_pictures(name: str) -> None:
    """Follow a lesson with complete shots, and store its last picture and a recording of its last shot."""
    from commands import run
    from PIL import Image

    def run_command(words: list[str], folder: Path) -> str:
        result = run(*words[1:], cwd=folder)
        return result.stdout + result.stderr

    with tempfile.TemporaryDirectory() as work:
        reader = Reader(Path(work), run_command)
        reader.follow(PAGES / f"{name}.md")
        picture = Image.open(max(reader.folder.rglob("picture.*.png"), key=lambda path: path.stat().st_mtime_ns)).convert("RGB")
        small = picture.resize((560, 315), Image.Resampling.LANCZOS)
        small.quantize(256, method=Image.Quantize.FASTOCTREE).save(IMAGES / f"{name}.png", optimize=True)
        [flags] = re.findall(r"<!-- recording: (.*) -->", (PAGES / f"{name}.md").read_text(encoding="utf-8"))
        words = ["antdsl", "render", "out/scene", "--width", "320", "--height", "180", "--legend", "none", "--out", "film"]
        run_command([*words, *flags.split()], reader.folder)
        stills = [Image.open(path).convert("RGB") for path in sorted((reader.folder / "film").glob("picture.*.png"))]
        options = {"save_all": True, "append_images": stills[1:], "duration": 100, "loop": 0, "quality": 35, "method": 6}
        stills[0].save(IMAGES / f"{name}.webp", **options)
        for suffix in ("png", "webp"):
            print(f"{name}.{suffix}: {(IMAGES / f'{name}.{suffix}').stat().st_size / 1000:.0f} kB", flush=True)


if __name__ == "__main__":
    IMAGES.mkdir(exist_ok=True)
    for each in sys.argv[1:] or sorted(path.stem for path in PAGES.glob("*.md")):
        _make_pictures(each)
