"""The instructions of a plan, interpreted, against NumPy: the bits of every operation and statement."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import plans
import pytest
from compilers import need_llvmlite
from kernel_interpreter import interpreted_function

from antdsl.machine_code import lanes, llvm_compiler
from antdsl.machine_code.kernels import rendering
from antdsl.machine_code.kernels.ir import IrFunction
from antdsl.runtime import Options, bind, state_hash, step
from antdsl.runtime.backends.native import compile_queue, stored_blocks
from antdsl.runtime.backends.native.programs import write_program

FRAMES = 1


@dataclass
class Interpreted:
    """Stands for the code of a text."""

    functions: list[IrFunction]

    def function(self, name: str) -> Any:
        return interpreted_function(self.functions, f"@{name}.inside")


@pytest.mark.parametrize("avx2", [True, False])
def test_the_instructions_of_a_plan_mean_what_numpy_does(monkeypatch: pytest.MonkeyPatch, avx2: bool) -> None:
    need_llvmlite()
    functions: list[IrFunction] = []
    render = rendering.render_function

    def noted(function: IrFunction, declared: dict[str, str]) -> str:
        functions.append(function)
        return render(function, declared)

    monkeypatch.setattr(lanes, "render_function", noted)
    target = llvm_compiler.Target("x86_64-unknown-linux-gnu", "x86-64", "+avx2" if avx2 else "")
    monkeypatch.setattr(compile_queue, "write_program", lambda plan, blocks, facts, _: write_program(plan, blocks, facts, target))
    monkeypatch.setattr(
        compile_queue, "code_cache", SimpleNamespace(load_code=lambda _, write: Interpreted(functions) if write() else None)
    )
    monkeypatch.setattr(
        compile_queue, "stored_blocks", SimpleNamespace(index_plan=lambda *_: None, make_text_key=stored_blocks.make_text_key)
    )
    plan, setting = plans.rich(), plans.setting(11)
    worlds = [bind(plan, setting, Options("numpy")), bind(plan, setting, Options("native", wait_for_code=True))]
    for _ in range(FRAMES):
        for world in worlds:
            step(world)
        assert state_hash(worlds[0]) == state_hash(worlds[1])
    assert worlds[1].backend.ready_code is not None and functions  # type: ignore[attr-defined]
