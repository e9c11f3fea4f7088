"""What docs/scaling.md says of kernels on graphics processors: LLVM writes PTX of them, in which no operation is fused."""

from __future__ import annotations

import re

import pytest
from compilers import need_llvmlite

from antdsl.machine_code import machine
from antdsl.machine_code.kernels.kernel import Kernel
from antdsl.numerics.elementary_compiled import cosines
from antdsl.runtime.moving.advance_compiled import arrive
from antdsl.runtime.moving.strides_compiled import set_out

TARGET = machine.Target("nvptx64-nvidia-cuda", "sm_90", "")


@pytest.mark.parametrize("kernel", [cosines, set_out, arrive], ids=lambda kernel: kernel.__name__)
def test_a_kernel_becomes_ptx_without_fused_operations(kernel: Kernel) -> None:
    need_llvmlite()
    try:
        ptx = machine.assembly(kernel.text(TARGET), TARGET)
    except RuntimeError as problem:
        pytest.skip(f"llvmlite is made without PTX: {problem}")
    found = set(re.findall(r"\b((?:fma|mad|add|sub|mul|div|sqrt)\.[a-z.]*f(?:32|64))\b", ptx))
    assert found, "it calculates"
    assert {name for name in found if name.startswith(("fma", "mad")) or ".rn." not in name or "ftz" in name} == set()
