"""Steps of another tree and of this one, phase by phase, in turn in one run.

`python tests/benchmarks/other_tree.py ../other foraging --agents 15000` tells for a case of `antdsl bench` what a step takes
there by its own default, here with NumPy, and here as machine code: milliseconds of CPU time by phase, and the ratio of each to
the other tree with where it lies with 95 %. Blocks are decide, act and blend without the time that rays take. Each tree runs in a
separate process; all take a turn of some steps, `--pairs` times. Scenes are each tree's own; texts that make a case are this
tree's, since the other one may be older."""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from statistics import mean
from typing import Any

from pairs import of_this_tree, ratios, scale_setting

ROOT = Path(__file__).resolve().parents[2]
BLOCKS = ("decide", "act", "blend")
WARM, WARM_FOR = (
    6,
    1.0,
)  # steps that are not counted, and s of them: rows come into order of place after the first, and kernels are
# loaded once steps have taken a third of a second
VARIANTS = (("before", ""), ("NumPy", "numpy"), ("native", "native"))


def shot_of(case: str, agents: int | None) -> tuple[Any, Any]:
    """Plan and setting of a case, by the package that is imported."""
    from antdsl.pipeline import open_scene

    if case == "foraging":
        name = "scene.yaml" if agents is not None and agents <= 2000 else "many.yaml"
        shot, report = open_scene(Path.cwd() / "examples" / "foraging" / name)
    elif case == "boids":
        import tempfile

        texts = of_this_tree("programs")
        with tempfile.TemporaryDirectory() as folder:
            count = agents or 15_000
            Path(folder, "scene.yaml").write_text(texts.plane_scene("boid", count, texts.disc_radius(count)))
            Path(folder, "boid.ant").write_text(texts.BOIDS)
            shot, report = open_scene(Path(folder, "scene.yaml"))
        agents = None
    else:
        shot, report = open_scene(Path.cwd() / case)
    if shot is None:
        raise SystemExit("\n".join(diagnostic.message for diagnostic in report.errors))
    setting = shot.setting if agents is None else scale_setting(shot.setting, agents)
    # An older tree has no contacts, and the frame that is written by hand has none.
    return shot.plan, replace(setting, contacts="off") if hasattr(setting, "contacts") else setting


def rays_timed() -> list[float]:
    """Seconds that senses of rays take from now on, summed up."""
    from antdsl.runtime.sensing import world_senses as sensing

    spent = [0.0]

    def timed(work: Callable[..., Any]) -> Callable[..., Any]:
        def run(*arguments: Any, **named: Any) -> Any:
            began = time.process_time()
            try:
                return work(*arguments, **named)
            finally:
                spent[0] += time.process_time() - began

        return run

    senses: Any = sensing.SENSE_FUNCTIONS
    senses["ray"] = timed(senses["ray"])
    with suppress(ImportError):  # an older tree has NumPy only
        from antdsl.runtime.backends.native import address_tables

        address_tables.get_obstacle_clearance = timed(
            address_tables.get_obstacle_clearance
        )  # possible hits are computed before, not in the sense itself
    return spent


def serve(case: str, agents: int | None, backend: str, steps: int) -> None:
    """Make the requested turns of steps, a line each; report CPU seconds of a step by phase."""
    from antdsl.runtime import Options, bind, step

    options: dict[str, Any] = {"backend": backend} if backend else {}
    if backend == "native":
        options["wait_for_code"] = True
    rays = rays_timed()
    world = bind(*shot_of(case, agents), Options(threads=1, **options))
    taken = 0
    while taken < WARM or sum(world.cpu_seconds.values()) < WARM_FOR:
        step(world)
        taken += 1
    print("ready", flush=True)
    for _ in sys.stdin:
        world.cpu_seconds.clear()
        rays[0] = 0.0
        for _ in range(steps):
            step(world)
        times = {phase: seconds / steps for phase, seconds in world.cpu_seconds.items()}
        times["blocks"] = sum(times[phase] for phase in BLOCKS) - rays[0] / steps
        times["step"] = sum(world.cpu_seconds.values()) / steps
        print(json.dumps(times), flush=True)


def started(tree: Path, words: list[str]) -> subprocess.Popen[str]:
    """A process of a tree that has bound its world."""
    child = subprocess.Popen(
        [sys.executable, __file__, *words, "--serve"],
        env={**os.environ, "PYTHONPATH": str(tree)},
        cwd=tree,
        text=True,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    assert child.stdout is not None
    if child.stdout.readline() != "ready\n":
        raise SystemExit(f"{tree}: the process ended with {child.wait()}")
    return child


def turn(children: list[subprocess.Popen[str]], number: int) -> dict[str, float]:
    """What a turn of one of them has cost."""
    child = children[number]
    assert child.stdin is not None and child.stdout is not None
    child.stdin.write("\n")
    child.stdin.flush()
    times: dict[str, float] = json.loads(child.stdout.readline())
    return times


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("other", type=Path, help="the tree to compare with")
    parser.add_argument("case", help="`foraging`, `boids`, or a scene by its path in either tree")
    parser.add_argument("--agents", type=int, default=None)
    parser.add_argument("--pairs", type=int, default=20)
    parser.add_argument("--steps", type=int, default=1, help="of a turn")
    parser.add_argument("--backend", default="", help=argparse.SUPPRESS)
    parser.add_argument("--serve", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.serve:
        serve(options.case, options.agents, options.backend, options.steps)
        return
    words = [str(options.other), options.case, "--steps", str(options.steps)]
    words += [] if options.agents is None else ["--agents", str(options.agents)]
    trees = (options.other.resolve(), ROOT, ROOT)
    children = [started(tree, [*words, "--backend", variant]) for tree, (_, variant) in zip(trees, VARIANTS, strict=True)]
    turns = ratios.measure_in_turn(partial(turn, children), len(VARIANTS), options.pairs)
    for child in children:
        child.kill()
    print(f"{options.case}, {options.agents or 'its own'} agents, {options.pairs} turns of {options.steps} steps; CPU ms a step")
    print("| phase | " + " | ".join(name for name, _ in VARIANTS) + " | NumPy / before | native / before | native / NumPy |")
    print("|---|" + "---|" * (len(VARIANTS) + 3))
    for phase in turns[0][0]:
        costs = [[each[variant].get(phase, 0.0) for each in turns] for variant in range(len(VARIANTS))]
        if mean(costs[0]) < 1e-5 and phase != "step":
            continue
        row = [f"{1000 * mean(each):.2f}" for each in costs]
        for one, two in ((1, 0), (2, 0), (2, 1)):
            row.append(str(ratios.bootstrap_interval([a / b for a, b in zip(costs[one], costs[two], strict=True) if b])))
        print(f"| {phase} | " + " | ".join(row) + " |", flush=True)


if __name__ == "__main__":
    main()
