"""Crowds that are empty at some time: the same states on all backends, and the values that the language says for none."""

from __future__ import annotations

import warnings
from collections.abc import Iterable

import empty_crowds
import numpy as np
import pytest
from compilers import need_llvmlite
from empty_crowds import FRAMES, KINDS, LIVES, NEVER, OF_NONE, WHO, Size
from sampling import sampled

from antdsl.plan import ir
from antdsl.plan.traverse import iterate_statements, list_blocks
from antdsl.program.tables.effects import EFFECT_BY_OPERATION
from antdsl.program.tables.set_senses import SET_RESULT_OPERATIONS
from antdsl.program.tables.vocabulary import REDUCER_HELP
from antdsl.runtime import BindingCache, Options, World, WorldSetting, bind, state_hash, step
from antdsl.runtime.backends import BACKENDS

# How each backend is run: with parts larger and smaller than the crowd, and more threads than it has agents.
OPTIONS_BY_BACKEND = {
    "numpy": (Options("numpy"), Options("numpy", chunk=2, threads=5, shuffle_rows=3)),
    "native": (Options("native", wait_for_code=True), Options("native", chunk=8, threads=5, shuffle_rows=1, wait_for_code=True)),
    "reference": (Options("reference", shuffle_rows=2),),
}
CONTACTS = ("off", "soft", "hard")  # as `empty_crowds.setting` has them by its seed
COMBINATIONS = [f"{who} {life.name}" for who in WHO for life in LIVES]


def run(setting: WorldSetting, options: Options, built: BindingCache, size: Size) -> tuple[list[str], World]:
    world = bind(empty_crowds.plan(size), setting, options, binding_cache=built)
    hashes = [state_hash(world)]
    for _ in range(FRAMES):
        step(world)
        hashes.append(state_hash(world))
    return hashes, world


def held_against_each_other(case: str, kind: str, seed: int, size: Size, backends: Iterable[str] = BACKENDS) -> None:
    """All backends give the same hashes, none with a warning of NumPy's."""
    who, name = case.split()
    life = next(life for life in LIVES if life.name == name)
    setting, built = empty_crowds.setting(who, life, kind, seed), BindingCache()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        hashes = {
            options: run(setting, options, built, size)[0] for backend in backends for options in OPTIONS_BY_BACKEND[backend]
        }
    first, *others = hashes.values()
    assert all(each == first for each in others), {
        options: [a == b for a, b in zip(first, each, strict=True)] for options, each in hashes.items()
    }


def test_the_program_has_every_sense_set_reduction_and_effect() -> None:
    assert set(OPTIONS_BY_BACKEND) == set(BACKENDS)
    assert empty_crowds.words() <= {word for word, _ in empty_crowds.samples()}
    assert set(empty_crowds.REDUCTIONS) == set(OF_NONE) == set(REDUCER_HELP)
    assert {each.partition("(")[0] for each in empty_crowds.sets()} == SET_RESULT_OPERATIONS
    plan = empty_crowds.plan()
    all_statements = [
        each for species in plan.species.values() for _, block in list_blocks(species) for _, each in iterate_statements(block)
    ]
    assert {each.op for each in all_statements if isinstance(each, ir.Request)} == set(EFFECT_BY_OPERATION)
    assert {node.op for node in plan.nodes} >= {op for op in ir.OPERATION_BY_NAME if op.startswith(("set.", "reduce."))} - {
        "reduce.nth_item"
    }


SAMPLE = ("asker not_in_the_middle", "rabbit not_in_the_middle", "everybody not_at_the_end")


@pytest.mark.parametrize("case", sampled(COMBINATIONS, SAMPLE))
def test_backends_agree_on_searches_for_none(case: str) -> None:
    need_llvmlite()
    held_against_each_other(case, "still", 2, "sets")


@pytest.mark.parametrize("case", sampled(COMBINATIONS, SAMPLE[1:2]))
def test_numpy_senses_none_as_the_reference_does(case: str) -> None:
    held_against_each_other(case, "still", 2, "all", ("numpy", "reference"))


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("contacts", CONTACTS)
@pytest.mark.parametrize("case", COMBINATIONS)
def test_backends_agree_in_every_world(case: str, contacts: str, kind: str) -> None:
    need_llvmlite()
    held_against_each_other(case, kind, CONTACTS.index(contacts), "pairs")


@pytest.mark.parametrize("size", sampled(["sets", "pairs"], ["sets"]))
@pytest.mark.parametrize("backend", BACKENDS)
def test_of_none_there_is_what_the_language_says(backend: str, size: Size) -> None:
    _, world = run(empty_crowds.setting("rabbit", NEVER), OPTIONS_BY_BACKEND[backend][0], BindingCache(), size)
    now = world.populations["asker"].now
    assert len(world.populations["asker"]) == 3 and len(world.populations["rabbit"]) == 0
    for number, (how, set_text, _) in enumerate(empty_crowds.reduced(size == "pairs")):
        if "rabbit" in set_text:
            assert (now[f"r{number}"] == OF_NONE[how]).all(), (how, set_text)
    assert (now["pal"] == -1).all() and (now["met_last"] == -1).all()
    assert all(np.isfinite(each).all() for each in now.values() if each.dtype.kind == "f" and each is not now["max_turn"])
