"""The same bits on other processors: few frames of examples in processes that lack instructions, or that qemu gives others."""

from __future__ import annotations

import shutil
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
from children import child_environment

ROOT = Path(__file__).resolve().parents[2]
# One of each example; what lies beside them has the same program and ground.
SCENES = (
    "alarm/scene", "anthill/scene", "arena/scene", "battle/scene", "bridge/scene", "evacuation/scene", "flocking/scene",
    "flow/scene", "foraging/scene", "foraging_study/default", "minimal/scene", "moods/scene", "roaches/scene",
    "thesis/tunnel_and_can", "torture/scene", "tunnel/led", "tunnel/scene", "tunnel/vectors", "walker/scene", "worth/scene",
)  # fmt: skip
SAMPLE_SCENES = ("moods/scene",)
# What NumPy chooses between at run time, libm's versions with AVX2 and FMA, and BLAS for the oldest processor that it knows.
WITHOUT = {
    "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR",
    "GLIBC_TUNABLES": "glibc.cpu.hwcaps=-AVX,-AVX2,-FMA,-FMA4,-AVX2_Usable,-FMA_Usable",
    "OPENBLAS_CORETYPE": "Prescott",
}


def disabled() -> str:
    """All features that this NumPy chooses between and can do without; it refuses those that it does not know."""
    from numpy._core._multiarray_umath import __cpu_dispatch__

    return " ".join(__cpu_dispatch__)


def hashes(
    scenes: tuple[str, ...], frames: int, most: int, settings: dict[str, str], command_prefix: tuple[str, ...] = ()
) -> str:
    clean = {k: v for k, v in child_environment().items() if not k.startswith(("NPY_", "ANTDSL_", "GLIBC_", "OPENBLAS_"))}
    paths = [str(ROOT / "examples" / f"{scene}.yaml") for scene in scenes]
    process = subprocess.run(
        [*command_prefix, sys.executable, str(ROOT / "tests" / "state_hashes.py"), "--frames", str(frames),
         "--most", str(most), *paths],
        env={**clean, **settings}, capture_output=True, text=True,
    )  # fmt: skip
    assert process.returncode == 0, process.stderr[-3000:]
    return process.stdout


@cache
def local_hashes(scenes: tuple[str, ...], frames: int, most: int) -> str:
    output = hashes(scenes, frames, most, {})
    assert len(output.splitlines()) == len(scenes)
    return output


def test_poses_do_not_depend_on_instruction_sets() -> None:
    clean = {k: v for k, v in child_environment().items() if not k.startswith(("NPY_", "GLIBC_", "OPENBLAS_"))}
    outputs = set()
    for settings in ({}, {**WITHOUT, "NPY_DISABLE_CPU_FEATURES": disabled()}):
        process = subprocess.run(
            [sys.executable, str(ROOT / "tests" / "bodies" / "pose_hash.py")],
            env={**clean, **settings}, capture_output=True, text=True,
        )  # fmt: skip
        assert process.returncode == 0, process.stderr[-3000:]
        outputs.add(process.stdout)
    assert len(outputs) == 1


def test_examples_without_the_instructions_that_libraries_choose_between() -> None:
    settings = {**WITHOUT, "NPY_DISABLE_CPU_FEATURES": disabled()}
    assert hashes(SAMPLE_SCENES, 2, 60, settings) == local_hashes(SAMPLE_SCENES, 2, 60)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["NPY_DISABLE_CPU_FEATURES", "GLIBC_TUNABLES", "OPENBLAS_CORETYPE", "all"])
def test_every_example_without_them(name: str) -> None:
    settings = {**WITHOUT, "NPY_DISABLE_CPU_FEATURES": disabled()}
    chosen = settings if name == "all" else {name: settings[name]}
    assert hashes(SCENES, 4, 200, chosen) == local_hashes(SCENES, 4, 200)


@pytest.mark.slow
def test_every_example_with_kernels_compiled_for_the_oldest_processor(tmp_path: Path) -> None:
    assert hashes(SCENES, 4, 200, {"COMPILED": "oldest", "ANTDSL_NATIVE_CACHE": str(tmp_path)}) == local_hashes(SCENES, 4, 200)


@pytest.mark.slow
@pytest.mark.parametrize("processor", ["Haswell", "SandyBridge"])
def test_every_example_on_an_older_processor(processor: str) -> None:
    qemu = shutil.which("qemu-x86_64")
    if qemu is None:
        pytest.skip("there is no qemu-x86_64 here (the package qemu-user)")
    assert hashes(SCENES, 2, 100, {}, (qemu, "-cpu", processor)) == local_hashes(SCENES, 2, 100)
