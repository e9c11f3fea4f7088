"""States that machine code gives, for tests to compare between processes: `python tests/native_states.py [--plain] [SCENE...]`.

Of a plan with every operation, and of scenes below `examples`, at most 200 agents of each line of a crowd. `--plain`: the code is
made for the oldest x86 of 64 bits, without the instructions that this one has."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import plans

from antdsl.machine_code import llvm_compiler
from antdsl.pipeline import open_scene
from antdsl.plan import ir
from antdsl.runtime import Options, WorldSetting, bind, state_hash, step

EXAMPLES = Path(__file__).resolve().parent.parent / "examples"
FRAMES = 8
PLAIN = llvm_compiler.Target("x86_64-unknown-linux-gnu", "x86-64", "")


def states(plan: ir.Plan, setting: WorldSetting, backend: str) -> list[str]:
    """Hashes of all frames."""
    world = bind(plan, setting, Options(backend, wait_for_code=True))  # type: ignore[arg-type]
    hashes = [state_hash(world)]
    for _ in range(FRAMES):
        step(world)
        hashes.append(state_hash(world))
    assert backend == "numpy" or (world.backend.ready_code is None) == bool(llvm_compiler.find_unavailability_reason())  # type: ignore[attr-defined]
    return hashes


def of_plan(backend: str) -> list[str]:
    """Those of every operation."""
    return states(plans.rich(), plans.setting(70), backend)


def of_scene(scene: str, backend: str) -> list[str]:
    """Those of an example."""
    shot, report = open_scene(EXAMPLES / scene)
    assert shot is not None, report
    crowds = tuple(replace(each, count=min(each.count, 200)) for each in shot.setting.crowds)
    return states(shot.plan, replace(shot.setting, crowds=crowds), backend)


if __name__ == "__main__":
    if "--plain" in sys.argv:
        llvm_compiler.find_host_target = lambda: PLAIN  # type: ignore[assignment]
    print(llvm_compiler.find_unavailability_reason() or "as machine code")
    print(*of_plan("native"))
    for scene in sys.argv[1:]:
        if not scene.startswith("-"):
            print(*of_scene(scene, "native"))
