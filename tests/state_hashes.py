"""State hashes of the examples, frame by frame: the same on every machine, and unchanged by what only changes the code.

`python tests/state_hashes.py --compare` holds every example against `tests/state_hashes.txt` at frames 0, 1, 2, 4, 8, … and tells
the first frame that differs; `--record` writes that file again. `--frames 8` stops after frame 8, `--most 200` takes at most
so many agents of each line of a crowd (and is only printed: the file is of whole crowds). Scenes may be named one by one. With
`--feet` compares or records `tests/feet_hashes.txt` instead: hashes of the feet of at most 60 agents of each line, to frame 16.
COMPILED=oldest in the environment, kernels are compiled for the oldest x86-64. Exit code 1 where a hash differs, so that
`git bisect run python tests/state_hashes.py --compare examples/worth/scene.yaml` finds the commit that changed one."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from antdsl.machine_code import llvm_compiler
from antdsl.pipeline import open_scene
from antdsl.runtime import Options, bind, feet_hash, state_hash, step

ROOT = Path(__file__).resolve().parent.parent
RECORDED = ROOT / "tests" / "state_hashes.txt"
RECORDED_FEET = ROOT / "tests" / "feet_hashes.txt"
FEET_FRAMES, FEET_AGENTS = 16, 60
# `base` and `fields` are what other scenes of their folder extend.
SCENES = tuple(p for p in sorted((ROOT / "examples").rglob("*.yaml")) if p.stem not in ("base", "fields"))


def named(scene: Path) -> str:
    """`foraging/many`: the scene's place below `examples`."""
    return scene.resolve().relative_to(ROOT / "examples").with_suffix("").as_posix()


def frames_of(scene: Path, frames: int | None, most: int | None, feet: bool = False) -> Iterator[tuple[int, str]]:
    """Every frame of a scene with its state hash, or that of its `feet`, up to `frames` or the scene's own end."""
    shot, report = open_scene(scene)
    if shot is None:
        sys.exit(str(report))
    setting = shot.setting
    if most is not None:
        setting = replace(setting, crowds=tuple(replace(crowd, count=min(crowd.count, most)) for crowd in setting.crowds))
    world = bind(shot.plan, setting, Options(feet=feet))
    yield 0, feet_hash(world.feet) if feet else state_hash(world)
    for frame in range(1, (shot.frames.last - shot.frames.first if frames is None else frames) + 1):
        step(world)
        yield frame, feet_hash(world.feet) if feet else state_hash(world)


def feet_of(scene: Path) -> dict[int, str]:
    """The hashes of a scene's feet that are recorded, by frame; none where no body of it has legs."""
    return {
        frame: hash_text
        for frame, hash_text in frames_of(scene, FEET_FRAMES, FEET_AGENTS, feet=True)
        if is_recorded_frame(frame) and hash_text
    }


def recorded(path: Path = RECORDED) -> dict[str, dict[int, str]]:
    """What the file says: for each scene the hashes by frame."""
    lines = [line.split() for line in path.read_text(encoding="utf-8").splitlines()]
    return {
        name: {int(frame): hash_text for frame, _, hash_text in (word.partition(":") for word in words)} for name, *words in lines
    }


def is_recorded_frame(frame: int) -> bool:
    """Whether a frame is one of those that are recorded."""
    return frame & (frame - 1) == 0


def difference(scene: Path, frames: int | None = None) -> str | None:
    """Where a scene first differs from what is recorded, in words; None where it does not."""
    expected = recorded().get(named(scene))
    if expected is None:
        return f"{named(scene)} is not recorded: python tests/state_hashes.py --record"
    for frame, frame_hash in frames_of(scene, frames, None):
        if frame in expected and expected[frame] != frame_hash:
            return f"{named(scene)} differs at frame {frame}: {frame_hash}, recorded was {expected[frame]}"
    return None


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scenes", nargs="*", type=Path, default=SCENES)
    parser.add_argument("--frames", type=int)
    parser.add_argument("--most", type=int)
    task = parser.add_mutually_exclusive_group()
    task.add_argument("--compare", action="store_true")
    task.add_argument("--record", action="store_true")
    parser.add_argument("--feet", action="store_true")
    options = parser.parse_args()
    if os.environ.get("COMPILED") == "oldest":
        llvm_compiler.find_host_target = lambda: llvm_compiler.Target("x86_64-unknown-linux-gnu", "x86-64", "")
    if options.feet:
        return _feet(options.scenes, record=options.record)
    known = recorded() if RECORDED.exists() else {}
    wrong = 0
    for scene in options.scenes:
        if options.compare:
            message = difference(scene, options.frames)
            wrong += message is not None
            print(message or f"{named(scene)}: as recorded", flush=True)
            continue
        frame_hashes = [
            (frame, each)
            for frame, each in frames_of(scene, options.frames, options.most)
            if options.most or is_recorded_frame(frame)
        ]
        print(named(scene), *(f"{frame}:{each}" for frame, each in frame_hashes), flush=True)
        known[named(scene)] = dict(frame_hashes)
        if options.record:
            _write(RECORDED, known)
    return 1 if wrong else 0


def _feet(scenes: Sequence[Path], *, record: bool) -> int:
    known = recorded(RECORDED_FEET) if RECORDED_FEET.exists() else {}
    wrong = 0
    for scene in scenes:
        feet_hashes, name = feet_of(scene), named(scene)
        wrong += feet_hashes != known.get(name, {})
        print(f"{name}: {'as recorded' if feet_hashes == known.get(name, {}) else 'differs'}", flush=True)
        if record and feet_hashes:
            known[name] = feet_hashes
    if record:
        _write(RECORDED_FEET, known)
    return 1 if wrong and not record else 0


def _write(path: Path, known: Mapping[str, Mapping[int, str]]) -> None:
    lines = [" ".join([name, *(f"{frame}:{each}" for frame, each in rows.items())]) for name, rows in sorted(known.items())]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
