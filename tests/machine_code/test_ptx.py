"""What docs/scaling.md says of kernels on graphics processors: LLVM writes PTX of them, in which no operation is fused."""

from __future__ import annotations

import re

import pytest
from compilers import need_llvmlite

from antdsl.fields.pheromone import advance_cells
from antdsl.machine_code import llvm_compiler
from antdsl.machine_code.kernels.kernel import Kernel
from antdsl.numerics.elementary_loops import write_cosines
from antdsl.runtime.moving.substep_kernels import prepare_steps
from antdsl.runtime.moving.velocities import update_arrived_rows

TARGET = llvm_compiler.Target("nvptx64-nvidia-cuda", "sm_90", "")


def ptx_of(kernel: Kernel) -> str:
    """A kernel's text in PTX."""
    need_llvmlite()
    try:
        return llvm_compiler.compile_assembly(kernel.text(TARGET), TARGET)
    except RuntimeError as problem:
        pytest.skip(f"llvmlite is made without PTX: {problem}")


@pytest.mark.parametrize("kernel", [write_cosines, prepare_steps, update_arrived_rows], ids=lambda kernel: kernel.__name__)
def test_a_kernel_becomes_ptx_without_fused_operations(kernel: Kernel) -> None:
    operations = set(re.findall(r"\b((?:fma|mad|add|sub|mul|div|sqrt)\.[a-z.]*f(?:32|64))\b", ptx_of(kernel)))
    assert operations, "it calculates"
    assert {name for name in operations if name.startswith(("fma", "mad")) or ".rn." not in name or "ftz" in name} == set()


def test_numbers_are_read_and_stored_whole() -> None:
    # byte by byte they are where nothing is known of how arrays lie, and an H100 was seen to lose lowest bytes then
    moved = set(re.findall(r"\b(?:ld|st)\.(?:v\d\.)?[a-z]\d+", ptx_of(advance_cells)))
    assert {"ld.b64", "st.b64"} <= moved
    assert not any(each.endswith(("8", "16")) for each in moved)
