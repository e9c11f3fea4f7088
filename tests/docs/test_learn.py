"""The lessons of docs/learn: a reader who follows them gets the files of examples/learn and the pictures of the pages."""

from __future__ import annotations

import re
from pathlib import Path

import commands
import pytest
from gallery_pictures import sections
from lessons import IMAGES, PAGES, ROOT, Reader, apply_part

from antdsl import syntax
from antdsl.scene.camera_models import CAMERA_VIEWS
from antdsl.source import Source

LESSONS = ("walk", "states", "layers", "trails", "surfaces", "species", "bodies", "directing")
SHORTER = {"run": ["--frames", "1..2"], "render": ["--width", "64", "--height", "36"]}


def shortened(words: list[str]) -> list[str]:
    """A command that takes less time: a shot of 2 frames, and a picture of its last frame."""
    if words[1] == "render":
        first = words.index("--frames") if "--frames" in words else None
        words = words if first is None else words[:first] + words[first + 2 :]
    return [*words[1:], *SHORTER.get(words[1], [])]


def run_shortened(words: list[str], folder: Path) -> str:
    result = commands.run(*shortened(words), cwd=folder, env={"COLUMNS": "200"})
    assert "Traceback" not in result.stderr and result.returncode in (0, 1), f"{words}\n{result.stdout}{result.stderr}"
    return result.stdout + result.stderr


def run_complete(words: list[str], folder: Path) -> str:
    result = commands.run(*words[1:], cwd=folder, env={"COLUMNS": "200"})
    assert "Traceback" not in result.stderr and result.returncode in (0, 1), f"{words}\n{result.stdout}{result.stderr}"
    return result.stdout + result.stderr


def follow(name: str, reader: Reader) -> None:
    reader.follow(PAGES / f"{name}.md")
    assert reader.run(["antdsl", "check", "--strict", "."], reader.folder).count("no findings") == 1
    finished = ROOT / "examples" / "learn" / name
    programs = {path.name for path in finished.iterdir() if path.suffix in (".ant", ".yaml")}
    assert reader.files >= programs, "every file is shown"
    for file in programs:
        assert laid_out(reader.folder / file) == laid_out(finished / file), f"{file} differs from that of examples/learn/{name}"


def laid_out(path: Path) -> str:
    text = path.read_text(encoding="utf-8")
    return syntax.format(Source(str(path), text))[0] if path.suffix == ".ant" else text


@pytest.mark.parametrize("name", LESSONS)
def test_a_reader_who_follows_a_lesson_gets_its_files(name: str, tmp_path: Path) -> None:
    follow(name, Reader(tmp_path, run_shortened, compares_output=False))


@pytest.mark.slow
@pytest.mark.parametrize("name", LESSONS)
def test_complete_shots_of_a_lesson_print_what_it_says(name: str, tmp_path: Path) -> None:
    reader = Reader(tmp_path, run_complete)
    follow(name, reader)
    assert list(reader.folder.rglob("picture.*.png"))


@pytest.mark.parametrize("name", LESSONS)
def test_a_lesson_shows_a_picture_and_a_recording_and_has_an_exercise(name: str) -> None:
    text = (PAGES / f"{name}.md").read_text(encoding="utf-8")
    for suffix, most in (("png", 150_000), ("webp", 400_000)):
        assert f"](../images/learn/{name}.{suffix})" in text
        assert (IMAGES / f"{name}.{suffix}").stat().st_size < most
    assert re.findall(r"^## Try it$", text, re.M) and re.findall(r"^```\w+ try=", text, re.M)


@pytest.mark.parametrize("name", LESSONS)
def test_sentences_of_a_lesson_are_short(name: str) -> None:
    text = re.sub(r"```.*?```|<!--.*?-->", "", (PAGES / f"{name}.md").read_text(encoding="utf-8"), flags=re.DOTALL)
    text = re.sub(r"\]\([^)]*\)", "", re.sub(r"`[^`]*`", "code", text))
    for sentence in re.split(r"(?<=[.:?!])\s|\n\n|\n[-|]", text):
        assert len(sentence.split()) <= 25, sentence


def test_a_part_replaces_statements_and_adds_new_ones() -> None:
    text = "species ant {\n  size 4 mm\n  state a {\n    steer 1\n  }\n  layers { state }\n}\n"
    part = "  state a {\n    steer 2\n  }\n  state b { steer 3 }\n"
    assert apply_part(text, part) == text.replace("steer 1\n  }\n", "steer 2\n  }\n  state b { steer 3 }\n")
    assert apply_part("a: 1\nb:\n  c: 2\nd: 3\n", "b: 4\ne: 5\n") == "a: 1\nb: 4\ne: 5\nd: 3\n"


def test_the_gallery_shows_each_example_and_its_commands_are_right(tmp_path: Path) -> None:
    """Each example is copied, its scene is there, and the last command draws a picture of another cache with the same flags."""
    assert (
        commands.run(
            "run", str(ROOT / "examples/minimal/scene.yaml"), "--frames", "1..2", "--out", "any", cwd=tmp_path
        ).returncode
        == 0
    )
    names = {lines[0][2] for _, lines in sections()}
    assert names == {path.name for path in (ROOT / "examples").iterdir() if path.is_dir()} - {"learn"}
    for picture, (copy, run, render) in sections():
        assert picture.is_file() and copy[:2] == ["antdsl", "examples"] and run[1] == "run" and render[1] == "render"
        name, scene = run[2].split("/")
        assert name == copy[2] and (ROOT / "examples" / name / scene).is_file()
        assert render[2] == f"{name}/out/{Path(scene).stem}"
        options = render[3:]
        if "--camera" in options and (named := options[options.index("--camera") + 1]) not in CAMERA_VIEWS:
            assert f"\n  {named}: " in (ROOT / "examples" / name / scene).read_text(encoding="utf-8"), "a camera of the scene"
            options[options.index("--camera") + 1] = "scene"
        flags = [*options, "--width", "64", "--height", "36", "--out", name]
        result = commands.run("render", "any", *flags, cwd=tmp_path)
        assert result.returncode == 0, result.stderr
