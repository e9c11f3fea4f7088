"""Scenes: what is read, what is an error, and that every error has its place and says what to write."""

from __future__ import annotations

import os
import time
from fractions import Fraction
from pathlib import Path

import pytest

from antdsl.diagnostics import Report
from antdsl.scene import Roots, Scene, load_scene_text
from antdsl.scene.load import load_scene
from antdsl.scene.thing_models import MeshThing

CASES = Path(__file__).parents[1] / "cases" / "scene"


def read(text: str | bytes, folder: Path = CASES) -> tuple[Scene | None, Report]:
    data = text if isinstance(text, bytes) else text.encode()
    return load_scene_text(data, "scene.yaml", Roots(folder, {}))


def cases() -> list[tuple[str, str]]:
    """Chunks of `cases/scene/*.yaml`, each after a line `# error: CODE, LINE:COLUMN, WORDS` for every expected message."""
    named_chunks = []
    for path in sorted(CASES.glob("*.yaml")):
        for number, chunk in enumerate(path.read_text(encoding="utf-8").split("\n=====\n")):
            named_chunks.append((f"{path.stem}-{number}", chunk))
    return named_chunks


@pytest.mark.parametrize("chunk", [pytest.param(text, id=name) for name, text in cases()])
def test_cases(chunk: str) -> None:
    """Line numbers are those of the text after the comments with expected messages."""
    lines = chunk.splitlines()
    expected = [line.removeprefix("# error: ").split(", ", 2) for line in lines if line.startswith("# error: ")]
    text = "\n".join(line for line in lines if not line.startswith("# error: ")) + "\n"
    scene, report = read(text)
    got = [
        (d.code, "{}:{}".format(*d.span.source.find_line_column(d.span.start)), d.message, d.help)
        for d in report.sort_by_place()
        if d.span
    ]
    assert [entry[:2] for entry in got] == [(code, place) for code, place, _ in expected], got
    for (_, _, words), (_, _, message, help) in zip(expected, got, strict=True):
        assert words in f"{message} | {help}"
        assert message[0] in "`0123456789" or message[0].islower()
    assert (scene is None) == bool(expected)


def test_everything_a_scene_may_say() -> None:
    scene, report = read(
        """antdsl: 1
units: cm
up: z
fps: 23.976
frames: -20..1720
preroll: 200
substeps: 2
seed: 18446744073709551615
from: {cache: other/out, frame: 12}
world:
  ground: {mesh: terrain.ply, units: m, up: y, at: [0, 12 mm, 0], rotate: [0, 90, 1.5 rad], scale: 2}
  way_in: {curve: way.json}
  food: {apple: {at: [120, 0, 40], load: 400, radius: 5 mm}}
crowd:
  - {species: forager, from: forager.ant, count: 15000, place: {on: ground, around: apple, radius: 60 mm}}
set: {forager.smell: 50 mm}
fields: {trail: {start: 0.5}}
layers: {forager: [avoid, state]}
camera: {at: [200, 150, 300], look_at: [0, 0, 0], focal: 35 mm}
output: {attributes: [P, id], checkpoint: 10}
"""
    )
    assert not report.diagnostics and scene is not None
    model = scene.model
    assert model.fps == Fraction(24000, 1001) and model.frames == (-20, 1720) and model.unit_mm == 10
    assert model.seed == 2**64 - 1 and model.start is not None and model.start.frame == 12
    ground = model.world["ground"]
    assert isinstance(ground, MeshThing) and ground.at is not None and ground.rotate is not None
    assert [part.to_millimetres(10) for part in ground.at] == [0, 12, 0]
    assert ground.rotate[1].number == pytest.approx(1.5707963) and ground.rotate[2].number == 1.5
    apple = model.world["food"]["apple"]  # type: ignore[index]
    assert apple.model_extra["load"].number == 400 and apple.radius.to_millimetres(10) == 5


@pytest.mark.parametrize(
    ("bad", "code"),
    [
        (b"a: &x [" + b"*x," * 9 + b"]\n", "yaml-alias"),
        (b"a: &a [x]\nb: &b [*a,*a]\nc: &c [*b,*b]\n", "yaml-alias"),
        (b"base: {<<: {a: 1}}\n", "yaml-alias"),
        (b"x: !!python/object/apply:os.system ['touch /tmp/x']\n", "yaml-tag"),
        (b"x: !!binary aGk=\n", "yaml-tag"),
        (b"%YAML 3.0\n---\na: 1\n", "scene-syntax yaml-tag"),
        (b"%TAG ! tag:x,2000:\n---\na: 1\n", "yaml-tag"),
        (b"a: " + b"[" * 1_000_000, "too-large"),
        (b"a: " + b"{b: " * 600 + b"1" + b"}" * 600, "too-large"),
        (b"a: [" + b"1," * 60_000 + b"]", "too-large"),
        (b"seed: 1\nseed: 2\n", "duplicate-key"),
        (b"seed: 1\nSeed: 2\n", "duplicate-key"),
        (b"? [a, b]\n: 1\n", "wrong-value"),
        (b"antdsl: 1\n---\nantdsl: 1\n", "scene-syntax"),
        (b"", "empty-scene"),
        (b"# nothing\n", "empty-scene"),
        (b"- a\n- b\n", "wrong-value"),
        (b"word\n", "wrong-value"),
        (b"antdsl: 1\nworld:\n\tground: {mesh: a.ply}\n", "scene-syntax"),
        (b"\xff\xfea\x00:\x00", "not-utf8"),
        (b"antdsl: 1\nname: \xe9\n", "not-utf8"),
        (b"antdsl: 1\nname: \x00\n", "control-character"),
        ("antdsl: 1 # \u202e\n".encode(), "control-character"),
        (b"antdsl: 1\nseed: " + b"9" * 5000 + b"\n", "wrong-value"),
        (b"antdsl: 1\nfps: 1e400\n", "wrong-value"),
        (b"antdsl: 1\nfps: 24/0\n", "wrong-value"),
        (b"antdsl: 1\nset: {a.b: {x.__class__}}\n", "scene-syntax"),
    ],
)
def test_hostile_text_is_refused_at_its_place_and_at_once(bad: bytes, code: str) -> None:
    began = time.process_time()
    scene, report = read(bad)
    assert scene is None
    assert report.errors[0].code in code.split(), report.errors
    assert all(d.span is not None for d in report.errors)
    assert time.process_time() - began < 5.0  # ten times what it takes, for a busy machine


def test_a_byte_order_mark_and_crlf_are_accepted() -> None:
    scene, report = read("\ufeffantdsl: 1\r\nseed: 010\r\nfpss: 2\r\n")
    assert scene is None and [d.code for d in report.errors] == ["unknown-key"]
    span = report.errors[0].span
    assert span is not None and span.text == "fpss" and str(span).endswith(":3:1")


def test_a_folder_a_pipe_and_a_large_file_are_no_scene(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.yaml"
    os.mkfifo(pipe)
    large = tmp_path / "large.yaml"
    large.write_bytes(b"#" * (1024 * 1024 + 1))
    for path, code in (
        (tmp_path, "not-a-file"),
        (pipe, "not-a-file"),
        (large, "too-large"),
        (tmp_path / "none.yaml", "no-such-file"),
    ):
        scene, report = load_scene(path)
        assert scene is None and [d.code for d in report.errors] == [code]
