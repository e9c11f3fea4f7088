"""The steps of a shot: simulation, then frames in chunks, then the film."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

CHUNK = "Frames"  # what stands for a task's frames


@dataclass(frozen=True, slots=True)
class JobPath:
    """A path that may differ on another machine. `flow`: whether it is read, written, or both."""

    name: str
    path: Path
    flow: Literal["IN", "OUT", "INOUT"]
    description: str


@dataclass(frozen=True, slots=True)
class PathArgument:
    """A word of a command: `prefix`, then the path of a place, then `suffix`."""

    prefix: str
    place: JobPath
    suffix: str = ""


Word = str | PathArgument


@dataclass(frozen=True, slots=True)
class Step:
    """One command, or one for each chunk of frames, where `CHUNKED` stands for the chunk. `needs`: steps that must finish
    first."""

    name: str
    description: str
    command: tuple[Word, ...]
    needs: tuple[str, ...] = ()
    chunks: tuple[str, ...] = ()
    grace: int = 120  # seconds from SIGTERM to SIGKILL


@dataclass(frozen=True, slots=True)
class Job:
    """All steps of a shot, in a valid execution order."""

    name: str
    paths: tuple[JobPath, ...]
    steps: tuple[Step, ...]


@dataclass(frozen=True, slots=True)
class Shot:
    """The requested output: frames `first` to `last` of a scene, one drawn in `every` frames, `chunk` pictures per task. `run`
    and `render`: extra arguments of these commands."""

    scene: Path
    cache: Path
    pictures: Path
    first: int
    last: int
    every: int = 1
    chunk: int = 10
    run: tuple[str, ...] = ()
    render: tuple[str, ...] = ()
    roots: tuple[tuple[str, Path], ...] = ()
    film: bool = True


CHUNKED = "\0frames"  # no word of a command line has this character


def shot_job(shot: Shot, name: str) -> Job:
    """The job that makes a shot."""
    project = JobPath("Project", shot.scene.parent, "IN", "The folder of the scene, with all that lies below it")
    cache = JobPath("Cache", shot.cache, "INOUT", "The folder of the cache")
    pictures = JobPath("Pictures", shot.pictures, "INOUT", "The folder of the pictures")
    roots = tuple(JobPath(f"Root_{root}", path, "IN", f"The folder that the scene calls {root}") for root, path in shot.roots)
    between = f"{shot.first}..{shot.last}"
    named = zip(shot.roots, roots, strict=True)
    granted: list[Word] = [word for (root, _), place in named for word in ("--root", PathArgument(f"{root}=", place))]
    simulate: list[Word] = [
        "antdsl",
        "run",
        PathArgument("", project, f"/{shot.scene.name}"),
        "--frames",
        between,
        "--out",
        PathArgument("", cache),
    ]
    draw: list[Word] = ["antdsl", "render", PathArgument("", cache), "--out", PathArgument("", pictures)]
    look = (*(("--every", str(shot.every)) if shot.every > 1 else ()), *shot.render)
    steps = [
        Step(
            "simulation",
            "Frames are simulated one after the other, on one machine; a run that was ended goes on from its last checkpoint",
            (*simulate, *granted, *shot.run, "--resume"),
        ),
        Step(
            "frames",
            "Pictures are drawn in chunks, each on any machine; those that are there, whole, are not drawn again",
            (*draw, "--frames", CHUNKED, "--shot", between, *look, "--resume"),
            ("simulation",),
            frame_chunks(shot.first, shot.last, shot.every, shot.chunk),
            30,
        ),
    ]
    if shot.film:
        film = (*draw, "--film", "--frames", between, *look, "--resume")
        steps.append(Step("film", "The pictures become a film; missing pictures are drawn first", film, ("frames",), (), 30))
    return Job(name, (project, *roots, cache, pictures), tuple(steps))


def frame_chunks(first: int, last: int, every: int, count: int) -> tuple[str, ...]:
    """Ranges of frames that have `count` pictures each, the last perhaps fewer; each begins with a picture."""
    starts = range(first, last + 1, every * count)
    return tuple(f"{start}..{min(start + every * count - 1, last)}" for start in starts)


def command_words(command: Sequence[Word], frames: str, paths: Mapping[str, str]) -> list[str]:
    """Return a command as text, with a task's `frames` and the `paths` of places inserted."""
    return [
        f"{word.prefix}{paths[word.place.name]}{word.suffix}"
        if isinstance(word, PathArgument)
        else frames
        if word == CHUNKED
        else word
        for word in command
    ]
