"""A host that flushes denormal numbers, or rounds upward, changes no result: not that of machine code, and not that of a step."""

from __future__ import annotations

import threading
from collections.abc import Callable
from fractions import Fraction
from functools import partial
from typing import Any

import numpy as np
import pytest
from meaning import crowd
from plan_text import plan_of
from test_workers import squared

from antdsl.machine_code import llvm_compiler
from antdsl.machine_code.entry_functions import write_inner_function
from antdsl.machine_code.llvm_module import LlvmModule
from antdsl.numerics import parallel
from antdsl.numerics.processor.float_environment import has_standard_floats, set_standard_floats, use_standard_floats
from antdsl.passes import optimise_plan
from antdsl.plan import ir
from antdsl.runtime import Options, WorldSetting, bind, state_hash, step

pytestmark = pytest.mark.skipif(not llvm_compiler.is_available(), reason="a host's flags are set by machine code")

FLUSHED, UPWARD = 0x8040, 0x4000  # bits of MXCSR
HOSTS = {"flushes": FLUSHED, "rounds upward": UPWARD}
X86 = """
declare void @llvm.x86.sse.stmxcsr(ptr)
declare void @llvm.x86.sse.ldmxcsr(ptr)
define void @host(ptr %t, i64 %bits, i64 %none) {
  %now = alloca i32
  call void @llvm.x86.sse.stmxcsr(ptr %now)
  %old = load i32, ptr %now
  %more = trunc i64 %bits to i32
  %new = or i32 %old, %more
  store i32 %new, ptr %now
  call void @llvm.x86.sse.ldmxcsr(ptr %now)
  ret void
}
"""


def hosted(bits: int, work: Callable[[], Any]) -> Any:
    """What a thread of a host gives that has such bits set; they are still set when the work is done."""
    if not llvm_compiler.find_host_target().is_x86:
        pytest.skip("the bits are those of x86")
    outcomes: list[Any] = []
    code = llvm_compiler.load_object(llvm_compiler.compile_object(X86, llvm_compiler.find_host_target()))

    def run() -> None:
        code.function("host")(None, bits, 0)
        try:
            assert not has_standard_floats()
            result = work()
            assert not has_standard_floats()
            outcomes.append(result)
        except BaseException as problem:
            outcomes.append(problem)

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    if isinstance(outcomes[0], BaseException):
        raise outcomes[0]
    return outcomes[0]


@pytest.mark.parametrize("bits", HOSTS.values(), ids=HOSTS)
def test_standard_floats_work_in_threads(bits: int) -> None:
    small, third = np.full(99, 1e-45, np.float32), np.full(99, -3.0, np.float32)

    def work() -> tuple[bytes, bytes]:
        host_bytes = (small * small.dtype.type(1)).tobytes() + (1 / third).tobytes()
        with use_standard_floats():
            assert has_standard_floats()
            within = (small * small.dtype.type(1)).tobytes() + (1 / third).tobytes()
        return host_bytes, within

    host_bytes, within = hosted(bits, work)
    assert within == small.tobytes() + (1 / third).tobytes() != host_bytes
    assert hosted(bits, lambda: threading_is_standard(set_standard_floats)) is True


def threading_is_standard(begin: Callable[[], None]) -> bool:
    """Whether a thread that begins so works as the standard says; it takes over what the one has that begins it."""
    answers = []

    def run() -> None:
        assert not has_standard_floats()
        begin()
        answers.append(has_standard_floats())

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    return answers == [True]


@pytest.mark.parametrize("bits", HOSTS.values(), ids=HOSTS)
def test_standard_floats_work_in_machine_code(bits: int) -> None:
    """Called outside of any step: a product of denormal numbers, and a quotient."""
    module = LlvmModule(llvm_compiler.find_host_target())
    body = """  %first = load ptr, ptr %t
  %values = load <8 x float>, ptr %first, align 4
  %same = fmul <8 x float> %values, splat (float 1.0)
  %parts = fdiv <8 x float> %same, splat (float 3.0)
  store <8 x float> %parts, ptr %first, align 4"""
    module.functions["thirds"] = write_inner_function(module, "thirds", body)
    code = llvm_compiler.load_object(llvm_compiler.compile_object(module.text(), llvm_compiler.find_host_target()))
    inputs = np.array([1e-44, -1e-40, 1.0, -2.0, 1e-38, -3.0, 7e-45, -10.0], np.float32)

    def work() -> bytes:
        values = inputs.copy()
        pointers = np.array([values.ctypes.data], np.int64)
        code.function("thirds")(pointers.ctypes.data, 0, 8)
        return values.tobytes()

    assert hosted(bits, work) == work()


@pytest.mark.parametrize("bits", HOSTS.values(), ids=HOSTS)
def test_standard_floats_work_in_parallel_parts(bits: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parallel, "count_available_cores", lambda: 4)
    values = np.linspace(2.0**-540, 2.0**-500, 4_000)

    def work() -> bytes:
        x, out, times = values.copy(), np.zeros(4_000), np.zeros(4_000, np.int64)
        parallel.run_in_parts(partial(squared, x, out, times), 4_000, 3, 100)
        return out.tobytes()

    assert hosted(bits, work) == work() == (values * values).tobytes()


SMALL = """
species a {
  low = 1e-30
  lower = 1e-20
  heard = 0
  drift = 0
  state only {
    low = low * 0.01 + uniform(0, 1) * lower * lower
    lower = lower * 0.0003
    heard = sum(n in neighbours(30 mm): n.low * 1e-5) + low / 3
    drift = drift + lower * uniform(-1, 1)
  }
}
"""


def run(plan: ir.Plan, backend: str, threads: int, steps: int = 6) -> list[str]:
    """The states of a crowd with values that become denormal, then zero."""
    options = Options(backend=backend, threads=threads, chunk=40, wait_for_code=True)  # type: ignore[arg-type]
    world = bind(plan, WorldSetting(fps=Fraction(10), crowds=(crowd(90, radius=40),)), options)
    hashes, denormal = [state_hash(world)], False
    for _ in range(steps):
        step(world)
        hashes.append(state_hash(world))
        bits = np.abs(world.populations["a"].now["low"]).view(np.int32)
        denormal |= bool(((bits > 0) & (bits < 0x800000)).any())
    assert denormal
    return hashes


@pytest.mark.parametrize(
    ("backend", "threads", "bits"),
    [
        ("numpy", 2, FLUSHED),
        ("native", 1, FLUSHED | UPWARD),
        *(
            pytest.param(backend, 1, bits, marks=pytest.mark.slow)
            for backend in ("numpy", "native", "reference")
            for bits in HOSTS.values()
        ),
    ],
)
def test_a_host_changes_no_state(backend: str, threads: int, bits: int) -> None:
    plan = optimise_plan(plan_of(SMALL))
    assert hosted(bits, lambda: run(plan, backend, threads)) == run(plan, "numpy", 1)
