"""Random programs of every construct, fed with what is no number, endless, huge and denormal: the same states on all backends."""

from __future__ import annotations

import numpy as np
import pytest
import random_extremes
from random_extremes import Extremes
from sampling import sampled

from antdsl.machine_code import llvm_compiler
from antdsl.plan import ir
from antdsl.runtime import BindingCache, Options, WorldSetting, bind, state_hash, step

PROGRAMS, FRAMES, BY_REFERENCE = 300, 50, 3
MOST = 150  # agents; programs that breed without end are followed as far as that
NUMPY = Options(backend="numpy", on_fault="quarantine")
REFERENCE = Options(backend="reference", on_fault="quarantine", shuffle_rows=2)
CHUNKS, THREADS = (8, 24, 1000, 100_000), (1, 2, 5)
# What no line of a program gives: a number that only specs read, and an operation that no line is lowered to.
BY_NONE = {"operation told"}


def states(plan: ir.Plan, setting: WorldSetting, seed: int, options: Options, frames: int, built: BindingCache) -> list[str]:
    """Hashes of the frames, as far as the crowd is not too large."""
    world = bind(plan, setting, options, binding_cache=built)
    hashes = [state_hash(world)]
    for frame in range(frames):
        if len(world) > MOST:
            break
        random_extremes.spoil(world, frame, seed)
        with np.errstate(all="ignore"):
            step(world)
        random_extremes.one_nan(world)
        hashes.append(state_hash(world))
    return hashes


@pytest.mark.skipif(not llvm_compiler.is_available(), reason="llvmlite is not installed")
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize("seed", sampled(range(PROGRAMS), (6, 7)))
def test_backends_agree_on_whatever_comes(seed: int) -> None:
    extremes, built = Extremes(seed), BindingCache()
    plan, _ = random_extremes.plan_and_program(extremes)
    setting = random_extremes.setting(extremes)
    options = Options("native", CHUNKS[seed % 4], THREADS[seed % 3], seed, "quarantine", wait_for_code=True)
    expected = states(plan, setting, seed, NUMPY, FRAMES, built)
    assert states(plan, setting, seed, options, FRAMES, built) == expected
    few = states(plan, setting, seed, REFERENCE, BY_REFERENCE, built)
    assert few == expected[: len(few)]


@pytest.mark.slow
def test_random_programs_have_every_construct() -> None:
    used_constructs: set[str] = set()
    for seed in range(PROGRAMS):
        used_constructs.update(random_extremes.constructs(*random_extremes.plan_and_program(Extremes(seed))))
    assert random_extremes.every_construct() - used_constructs == BY_NONE
