"""Stills that are there already: whole ones of the same frame and look are not drawn again; chunks of a film are its frames."""

from __future__ import annotations

import shutil
import signal
from collections.abc import Iterable
from pathlib import Path

import commands
import numpy as np
import pytest
from PIL import Image
from sampling import sampled

from antdsl.cli import _run_without_warnings as run_in_process
from antdsl.diagnostics import Report

ROOT = Path(__file__).resolve().parents[2]
SMALL = ("--width", "96", "--height", "54", "--threads", "1")


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("kept")
    process = commands.run(
        "run", str(ROOT / "examples/minimal/scene.yaml"), "--frames", "1..6", "--out", "cache", "--quiet", cwd=folder
    )
    assert process.returncode == 0, process.stderr
    return folder / "cache"


def drawn(cache: Path, to: Path, *words: str) -> list[str]:
    """The names of the pictures that were drawn, and what else was said."""
    process = commands.run("render", str(cache), "--out", str(to), *SMALL, *words, cwd=cache.parent)
    assert process.returncode == 0, process.stderr
    return [Path(line).name for line in process.stdout.splitlines()]


def name(*frames: int) -> list[str]:
    return [f"picture.{frame:04d}.png" for frame in frames]


def pixels(folder: Path) -> dict[str, bytes]:
    return {path.name: np.asarray(Image.open(path)).tobytes() for path in sorted(folder.glob("picture.*.png"))}


@pytest.mark.parametrize("camera", sampled(["fit", "eye"], ["fit"]))
def test_chunks_of_a_shot_are_the_pictures_of_its_film(cache: Path, tmp_path: Path, camera: str) -> None:
    """Cameras that are chosen by the crowd stand where they stand for the whole film, whichever frames are drawn together."""
    look = ("--camera", camera, "--shot", "1..6", "--show", "none")
    drawn(cache, tmp_path / "whole", "--frames", "1..6", *look)
    for chunk in ("1..2", "3..4", "5..6"):
        drawn(cache, tmp_path / "chunks", "--frames", chunk, *look)
    assert pixels(tmp_path / "chunks") == pixels(tmp_path / "whole") and len(pixels(tmp_path / "whole")) == 6
    drawn(cache, tmp_path / "alone", "--frames", "5..6", "--camera", camera, "--show", "none")
    alone, film_pixels = pixels(tmp_path / "alone"), pixels(tmp_path / "whole")
    assert all(alone[each] != film_pixels[each] for each in name(5, 6)), "by itself a chunk has a camera of its own"


def test_whole_pictures_of_the_same_look_are_not_drawn_again(cache: Path, tmp_path: Path) -> None:
    words = ("--frames", "1..4", "--resume")
    assert drawn(cache, tmp_path, *words) == name(1, 2, 3, 4)
    assert drawn(cache, tmp_path, *words) == ["4 pictures were there already"]
    first = (tmp_path / "picture.0001.png").read_bytes()
    (tmp_path / "picture.0001.png").write_bytes(first[: len(first) // 2])
    (tmp_path / "picture.0002.png").write_bytes(b"no picture")
    shutil.copy(tmp_path / "picture.0004.png", tmp_path / "picture.0003.png")  # of another frame
    assert drawn(cache, tmp_path, *words) == [*name(1, 2, 3), "1 picture was there already"]
    assert (tmp_path / "picture.0001.png").read_bytes() == first, "the same bytes each time"
    assert drawn(cache, tmp_path, *words, "--marks", "9") == name(1, 2, 3, 4)
    assert drawn(cache, tmp_path, "--frames", "1..4", "--marks", "9") == name(1, 2, 3, 4), "drawn again, as nothing else is said"
    Image.open(tmp_path / "picture.0002.png").save(tmp_path / "picture.0002.png")  # by another program, without the hash
    assert drawn(cache, tmp_path, *words, "--marks", "9") == [*name(2), "3 pictures were there already"]
    assert not list(tmp_path.glob(".*"))


def test_pictures_of_another_cache_do_not_count(cache: Path, tmp_path: Path) -> None:
    words = ("--frames", "1..2", "--resume")
    other = tmp_path / "other"
    scene = str(ROOT / "examples/minimal/scene.yaml")
    assert (
        commands.run("run", scene, "--frames", "1..6", "--seed", "9", "--out", str(other), "--quiet", cwd=tmp_path).returncode
        == 0
    )
    assert drawn(cache, tmp_path / "p", *words) == name(1, 2) == drawn(other, tmp_path / "p", *words)


def test_a_film_is_made_of_the_pictures_that_are_there(cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The encoder is left out: what it would be given is looked at."""
    films: list[list[bytes]] = []

    def film(images: Iterable[np.ndarray], path: Path, fps: float) -> Report:
        films.append([image.tobytes() for image in images])
        return Report()

    monkeypatch.setattr("antdsl.outputs.pictures.write_film", film)
    monkeypatch.setattr("antdsl.outputs.pictures.check_film_support", Report)
    drawn(cache, tmp_path, "--frames", "1..3", "--shot", "1..6")
    drawn(cache, tmp_path, "--frames", "4..6", "--shot", "1..6")
    assert drawn(cache, tmp_path / "drawn", "--film") == ["film.mp4"]
    monkeypatch.setattr("antdsl.outputs.pictures.render.Renderer.draw", None)  # drawing now fails
    assert drawn(cache, tmp_path, "--film", "--resume") == ["film.mp4"]
    assert films[0] == films[1] and len(set(films[0])) == 6


def test_a_termination_leaves_whole_pictures_and_its_own_exit_code(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from antdsl.atomic_write import atomic_file
    from antdsl.outputs import drawing

    put, count = drawing.StillStore.write_still, []

    def ended(self: drawing.StillStore, frame: int, image: object) -> Path:
        count.append(frame)
        if len(count) == 3:
            with atomic_file(drawing.make_still_path(self.folder, frame)) as file:
                file.write(b"half")
                signal.raise_signal(signal.SIGTERM)
        return put(self, frame, image)  # type: ignore[arg-type]

    monkeypatch.setattr(drawing.StillStore, "write_still", ended)
    monkeypatch.setattr("sys.argv", ["antdsl", "render", str(cache), "--out", str(tmp_path), "--frames", "1..6", *SMALL])
    assert run_in_process() == 75 and "--resume" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == name(1, 2)
    monkeypatch.undo()
    assert drawn(cache, tmp_path, "--frames", "1..6", "--resume") == [*name(3, 4, 5, 6), "2 pictures were there already"]
