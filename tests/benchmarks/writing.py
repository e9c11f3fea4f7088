"""What it costs to write a cache: CPU time of steps with frames that are written, beside the same steps of a second world
without.

`python tests/benchmarks/writing.py foraging --agents 15000 100000` takes a case of `antdsl bench` with so many agents each.
Feet are off in both worlds (`antdsl bench` measures what they cost in a full run), steps take one thread, and the thread that
writes counts, with checkpoints and until the last frame of a turn is in the file. `--rounds` turns each of `--steps` steps,
in turn; the first of each is not counted. It prints milliseconds a frame, and the ratio of the two with where it lies with 95
%.

What a write costs the system depends on the memory that it finds. A virtual machine may have given memory that is free back to
its host (`page_reporting` of Linux): such a page is created again the first time that it is touched, and a file of 1.7 MB takes 2
to 5 ms in place of 0.5. So before each turn, of either world, several times the memory that its files may take is allocated,
touched and freed, and no turn pays for what another process has left; `--memory-as-it-is` leaves that away.

A file system may make files more slowly where many have just been removed (ext4 does not use their numbers again for some
minutes, and looks at each of them): `--folder` says where caches are made, the usual place of temporary files otherwise."""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from statistics import fmean

import numpy as np

from antdsl.bench.cases import BENCH_CASES, find_case
from antdsl.bench.measuring import wait_for_code
from antdsl.bench.ratios import compute_bootstrap_interval, measure_in_turn
from antdsl.outputs.cache.cache_reader import make_frame_path
from antdsl.outputs.cache.hashes import HASHES_FILE_NAME
from antdsl.outputs.recording import Recording, begin_recording, record_frames
from antdsl.runtime import Options, World, bind, step
from antdsl.scene.values import parse_frame_range

TIMES = 4  # allocated before a turn, in sizes of its files
WARM = 8  # steps before anything is measured: rows come into order of place, machine code is there


def steps_of(world: World) -> Iterator[int]:
    """The frames of a world that are not written."""
    yield world.frame
    while True:
        step(world)
        yield world.frame


def frames_of(recording: Recording) -> Iterator[int]:
    """The frames of a run that writes them."""
    for each in record_frames(recording):
        yield each.world.frame


def wait_for(folder: Path, frame: int) -> None:
    """Return once the file of a frame and its line are written."""
    begins = f'{{"frame": {frame},'.encode()
    while not make_frame_path(folder, frame).exists() or begins not in (folder / HASHES_FILE_NAME).read_bytes()[-1000:]:
        time.sleep(0.002)


def touch(size: int) -> None:
    """Have so many bytes of memory that is free be there."""
    np.ones(size, np.uint8)


def measured(case: str, agents: int, steps: int, rounds: int, place: Path | None, *, as_it_is: bool) -> list[tuple[float, float]]:
    """CPU seconds of a frame, without a cache and with one, turn by turn. `place`: where the cache is made; `as_it_is`: whether
    memory is taken as it is."""
    shot = find_case(case).make_bare_shot(find_case(case).make_shot(agents))
    last = WARM + (rounds + 1) * steps + 1
    shot = replace(shot, scene=shot.scene.replace_values(frames=parse_frame_range(f"1..{last}")))
    options = Options(backend="native", threads=1)
    with tempfile.TemporaryDirectory(dir=place) as temporary:
        folder = Path(temporary, "cache")
        recording = begin_recording(shot, folder, options, resume=False, force=False)
        recording.world = bind(shot.plan, shot.setting, options)
        worlds = bind(shot.plan, shot.setting, options), recording.world
        steppers = steps_of(worlds[0]), frames_of(recording)
        for stepper, world in zip(steppers, worlds, strict=True):
            for _ in range(WARM):
                next(stepper)
            wait_for_code(world)
        wait_for(folder, worlds[1].frame)
        size = 0 if as_it_is else TIMES * steps * make_frame_path(folder, worlds[1].frame).stat().st_size

        def turn(number: int) -> float:
            touch(size)
            began = time.process_time()
            for _ in range(steps):
                frame = next(steppers[number])
            if number:
                wait_for(folder, frame)
            return (time.process_time() - began) / steps

        turns = measure_in_turn(turn, 2, rounds)
        recording.stop_requested = True
        for _ in steppers[1]:
            pass
    return [(without, written) for without, written in turns]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("case", choices=sorted(BENCH_CASES), nargs="?", default="foraging")
    parser.add_argument("--agents", type=int, nargs="+", default=[15_000])
    parser.add_argument("--steps", type=int, default=24)
    parser.add_argument("--rounds", type=int, default=10)
    parser.add_argument("--folder", type=Path)
    parser.add_argument("--memory-as-it-is", action="store_true")
    options = parser.parse_args()
    for agents in options.agents:
        turns = measured(options.case, agents, options.steps, options.rounds, options.folder, as_it_is=options.memory_as_it_is)
        plain, written = (1000 * fmean(turn[k] for turn in turns) for k in (0, 1))
        ratio = compute_bootstrap_interval([with_cache / without for without, with_cache in turns])
        print(
            f"{options.case}, {agents:,} agents: a step {plain:.2f} ms, with its frame written {written:.2f}, "
            f"{written - plain:.2f} more; ratio {ratio}",
            flush=True,
        )


if __name__ == "__main__":
    main()
