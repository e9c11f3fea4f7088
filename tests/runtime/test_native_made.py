"""When machine code is made and what becomes of it: stored for other runs, built again where it may be harmful, built for what an
edit changes and for nothing else."""

from __future__ import annotations

import functools
import gc
from collections import OrderedDict
from collections.abc import Callable
from copy import copy
from pathlib import Path
from threading import Event
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import pytest
from meaning import crowd, play

import antdsl
from antdsl import user_folders
from antdsl.machine_code import code_cache, llvm_compiler, object_cache
from antdsl.runtime import Options, World, bind, state_hash, step
from antdsl.runtime.backends.native import compile_queue, stored_blocks
from antdsl.runtime.backends.native import native_backend as native_backend
from antdsl.runtime.faults import FaultStop

pytestmark = pytest.mark.skipif(not llvm_compiler.is_available(), reason="llvmlite is not installed")

NUMPY = Options(backend="numpy")
NATIVE = Options(backend="native", wait_for_code=True)


@pytest.fixture
def afresh(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[[], list[str]]:
    """Begins as a new process would, with a folder for code; gives what is compiled from then on."""
    compiled: list[str] = []
    make = llvm_compiler.compile_object
    monkeypatch.setattr(user_folders, "home_folder", lambda: tmp_path)

    def noted(text: str, target: llvm_compiler.Target) -> bytes:
        compiled.append(text)
        return make(text, target)

    def begin() -> list[str]:
        while compile_queue._pending_requests:  # by worlds of other tests, which did not wait
            compile_queue._get_compile_thread().submit(int).result()
        compiled.clear()
        cache = object_cache.ObjectCache(tmp_path / "code")
        objects = functools.cache(lambda: cache)
        objects()
        monkeypatch.setattr(code_cache, "_get_object_cache", objects)
        monkeypatch.setattr(code_cache, "_code_by_key", OrderedDict())
        monkeypatch.setattr(compile_queue, "_code_by_plan", WeakKeyDictionary())
        monkeypatch.setattr(llvm_compiler, "compile_object", noted)
        return compiled

    return begin


EDITED = """
species a {{
  pace = 1
  start first
  state first {{
    steer vector(0.5, 0.25, 0)
    pace = pace * {number}
    when pace > 3 -> second
  }}
  state second {{ pace = pace {sign} 2 }}
}}
"""


def edited(sign: str = "+", number: str = "1.5") -> World:
    return play(EDITED.format(number=number, sign=sign), crowd(20, radius=50), steps=3, option_sets=(NATIVE,)).world


def test_code_of_another_run_is_used(afresh: Callable[[], list[str]]) -> None:
    compiled = afresh()
    expected = state_hash(edited())
    assert len(compiled) > 1
    compiled = afresh()
    world = edited()
    assert state_hash(world) == expected and compiled == [] and world.backend.list_messages() == []


def test_code_that_may_be_harmful_is_not_loaded_and_the_run_goes_on(afresh: Callable[[], list[str]], tmp_path: Path) -> None:
    afresh()
    expected = state_hash(edited())
    for path in (tmp_path / "code").iterdir():
        path.write_bytes(path.read_bytes()[:-1] + b"?")
    compiled = afresh()
    world = edited()
    assert state_hash(world) == expected and len(compiled) > 1
    assert world.backend.list_messages() and all("damaged, or was not written" in each for each in world.backend.list_messages())
    compiled = afresh()
    assert state_hash(edited()) == expected and compiled == [], "it was replaced"


def test_an_edit_compiles_what_it_changes_and_a_number_nothing(afresh: Callable[[], list[str]]) -> None:
    compiled = afresh()
    edited()
    assert len(compiled) == len(set(compiled)) > 1
    compiled.clear()
    edited(number="2.5")
    assert compiled == []
    edited(sign="-")
    assert len(compiled) == 1 and "@a.act.0" in compiled[0]


def test_a_stored_plan_is_run_without_its_text_and_tells_the_same_faults(
    afresh: Callable[[], list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fault() -> str:
        with pytest.raises(FaultStop) as stop:
            play(EDITED.format(number="1e30", sign="* 1e9 *"), crowd(20, radius=50), steps=6, option_sets=(NATIVE,))
        return str(stop.value)

    afresh()
    message, expected = fault(), state_hash(edited())
    compiled = afresh()
    monkeypatch.setattr(compile_queue, "write_program", lambda *what: pytest.fail("the text was written"))
    assert state_hash(edited()) == expected and fault() == message and compiled == []
    assert message.startswith("test.ant:18:")


def test_whatever_a_text_depends_on_changes_the_key_of_its_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    world, other, host = edited(), edited("-"), llvm_compiler.find_host_target()

    def key(
        of: World = world,
        facts: compile_queue.WorldFacts = compile_queue.WorldFacts(False, False),
        target: llvm_compiler.Target = host,
    ) -> str:
        subject = stored_blocks.index_plan(of.plan, of.backend.blocks, facts, target)  # type: ignore[attr-defined]
        assert subject is not None
        return subject.key

    keys = [
        key(),
        key(other),
        key(facts=compile_queue.WorldFacts(True, False)),
        key(facts=compile_queue.WorldFacts(False, True)),
        key(target=llvm_compiler.PORTABLE_TARGET),
    ]
    keys.append(key(facts=compile_queue.WorldFacts(False, False, is_timed=True)))
    assert key() == key(edited())
    monkeypatch.setattr(stored_blocks, "hash_sources", lambda: "other modules")
    keys.append(key())
    monkeypatch.setattr(object_cache, "list_environment_versions", lambda: ("another LLVM",))
    keys.append(key())
    assert len(set(keys)) == len(keys)


def test_of_modules_without_sources_nothing_is_stored(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(antdsl, "__file__", str(tmp_path / "__init__.pyc"))
    world = edited()
    assert (
        stored_blocks.index_plan(
            world.plan, world.backend.blocks, compile_queue.WorldFacts(False, False), llvm_compiler.find_host_target()
        )
        is None
    )  # type: ignore[attr-defined]


def programs_saved(count: int) -> list[World]:
    """Worlds of a program that is saved again and again, each with a line that differs."""
    return [
        play(EDITED.format(number=1, sign="+" + k * " pace *"), crowd(3, radius=5), option_sets=(NUMPY,)).world
        for k in range(count)
    ]


def test_the_latest_request_is_compiled_first_and_one_without_a_waiter_is_not_compiled(afresh: Callable[[], list[str]]) -> None:
    compiled, go = afresh(), Event()
    worlds = programs_saved(7)
    compile_queue._get_compile_thread().submit(go.wait)
    coming = [
        compile_queue.start_code_build(each.plan, each.backend.blocks, compile_queue.WorldFacts(False, False)) for each in worlds
    ]  # type: ignore[attr-defined]
    del coming[1::2]
    go.set()
    for each in coming:
        each.result()
    blocks = [text for text in compiled if "@a.act.0" in text]
    still = compile_queue.WorldFacts(False, False)
    texts = [
        compile_queue.write_program(each.plan, each.backend.blocks, still, llvm_compiler.find_host_target())
        for each in worlds[::2]
    ]  # type: ignore[attr-defined]
    assert blocks == [each.units["a.act.0"] for each in reversed(texts)] and len(blocks) == 4
    compile_queue._get_compile_thread().submit(int).result()
    assert not compile_queue._pending_requests


def test_however_many_programs_step_in_turn_each_gets_its_code_and_asks_once(
    afresh: Callable[[], list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    afresh()
    requests: list[Any] = []

    def beside(*what: Any) -> Any:
        requests.append(compile_queue.start_code_build(*what))
        return requests[-1]

    monkeypatch.setattr(native_backend, "start_code_build", beside)
    monkeypatch.setattr(native_backend, "_MIN_EARLIER_STEP_SECONDS", 0.0)
    worlds = [bind(each.plan, each.setting, Options(backend="native")) for each in programs_saved(7)]
    go = Event()
    compile_queue._get_compile_thread().submit(go.wait)
    for _ in range(3):
        for world in worlds:
            step(world)
    go.set()
    for each in requests:
        each.result()
    for world in worlds:
        step(world)
    assert len(requests) == 7 and all(world.backend.ready_code is not None for world in worlds)  # type: ignore[attr-defined]


def test_a_world_that_is_gone_has_no_code_made(afresh: Callable[[], list[str]], monkeypatch: pytest.MonkeyPatch) -> None:
    compiled, go = afresh(), Event()
    monkeypatch.setattr(native_backend, "_MIN_EARLIER_STEP_SECONDS", 0.0)
    (saved,) = programs_saved(1)
    world = bind(saved.plan, saved.setting, Options(backend="native"))
    compile_queue._get_compile_thread().submit(go.wait)
    for _ in range(2):
        step(world)
    assert len(compile_queue._pending_requests) == 1
    del world
    gc.collect()
    go.set()
    while compile_queue._pending_requests:
        compile_queue._get_compile_thread().submit(int).result()
    assert compiled == []


def test_a_plan_that_is_gone_leaves_no_code_behind(afresh: Callable[[], list[str]]) -> None:
    afresh()
    world = edited()
    same = bind(world.plan, world.setting, Options())
    step(same)
    assert same.backend.ready_code is world.backend.ready_code is not None  # type: ignore[attr-defined]
    assert len(compile_queue._code_by_plan) == 1
    del world, same
    gc.collect()
    assert len(compile_queue._code_by_plan) == 0


def test_who_asks_with_other_arrays_each_time_is_answered_of_those_and_leaves_nothing_behind() -> None:
    """As specs do: registers that are the run's own, read again after they have changed, and new arrays for answers."""
    world = edited()
    rooms: Any = world.backend._padded_arrays  # type: ignore[attr-defined]
    population, values = world.populations["a"], np.zeros(len(world), np.float32)
    for k in range(100):
        population_copy = copy(population)
        values[:] = k
        population_copy.start = {"pace": values}
        population_copy.now = {"pace": np.full(len(world), k, np.float32)}
        rooms.begin_step([population_copy])
        array, _ = rooms.pad_register(population_copy, "pace", start=True)
        rooms.pad_register(population_copy, "pace", start=False)
        assert population_copy.start["pace"] is array and (array == k).all()
        assert len(rooms._padded_by_id) < 80
