"""Compiles the blocks of plans to machine code in a background thread, and prepares the calls between stages.

Each function with external callers is compiled separately. Code is cached by its text, in memory and in a folder for later runs
(`object_cache`). The numbers of a program are not part of the text, so changing a number compiles nothing. An edit compiles only
the stages that it changes."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, partial
from threading import Lock
from typing import Any
from weakref import ReferenceType, WeakKeyDictionary, ref

from antdsl.machine_code import code_cache, llvm_compiler
from antdsl.plan import ir
from antdsl.runtime.backends import numpy_calls
from antdsl.runtime.backends.block_compiler import BlockInstruction, InstructionKind, SlotFunction
from antdsl.runtime.backends.native import stored_blocks
from antdsl.runtime.backends.native.block_writer import BlockCodePlan
from antdsl.runtime.backends.native.programs import CompiledBlocks, NativeProgram, WorldFacts, write_program
from antdsl.runtime.sensing.world_senses import SENSE_FUNCTIONS

_code_by_plan: WeakKeyDictionary[ir.Plan, dict[WorldFacts, CompiledPlanCode]] = WeakKeyDictionary()
_pending_requests: list[tuple[ReferenceType[Future[CompiledPlanCode]], Generator[None, None, CompiledPlanCode]]] = []
_requests_lock = Lock()


class CodeUnavailable(Exception):
    """Error: machine code cannot be compiled on this machine. The message contains the reason and a remedy."""


@dataclass(frozen=True, slots=True, eq=False)
class CompiledPlanCode:
    """The loaded machine code of a plan.

    `blocks`: the compiled blocks to which the other fields refer. `block_codes`: the block codes, by species and block.
    `loaded_code`: the loaded code, by function name. `calls`: the function call for each instruction without machine code.
    `call_groups`: the calls after each stage, by (species, block, stage). Calls of the same sense with the same name form a
    group."""

    blocks: CompiledBlocks
    facts: WorldFacts
    block_codes: Mapping[tuple[str, str], BlockCodePlan]
    loaded_code: Mapping[str, llvm_compiler.LoadedCode]
    calls: Mapping[BlockInstruction, SlotFunction]
    call_groups: Mapping[tuple[str, str, int], list[list[BlockInstruction]]]

    def get_function(self, name: str) -> Any:
        """Return the function called `name`. Same as `llvm_compiler.LoadedCode.get_function`."""
        return self.loaded_code[name].function(name)


def find_compiled_code(plan: ir.Plan, facts: WorldFacts) -> CompiledPlanCode | None:
    """Return the loaded code of a plan if it is in memory, else None."""
    with _requests_lock:
        return _code_by_plan.get(plan, {}).get(facts)


def _build_plan_code(
    plan: ir.Plan, blocks: CompiledBlocks, facts: WorldFacts, stored: stored_blocks.StoredBlocks | None
) -> Generator[None, None, CompiledPlanCode]:
    """Compile a plan's blocks for this processor, and return their code. Raises CodeUnavailable.

    This is a generator: each `next` does a part of the work."""
    if why := llvm_compiler.find_unavailability_reason():
        raise CodeUnavailable(why)
    host = llvm_compiler.find_host_target()
    text = cache(lambda: write_program(plan, blocks, facts, host))
    if stored is None:
        subject = stored_blocks.index_plan(plan, blocks, facts, host)
        stored = {name: stored_blocks.make_text_key(each) for name, each in text().units.items()}, dict(text().blocks)
        if subject is not None:
            stored_blocks.store_blocks(subject, text())
    units, written = stored
    yield
    calls: dict[BlockInstruction, SlotFunction] = {}
    together: dict[tuple[str, str, int], list[list[BlockInstruction]]] = {}
    for key, code in written.items():
        for stage, called in enumerate(code.schedule.calls_after_stage):
            together[(*key, stage)] = _group_calls_by_sense(called)
        for each in (each for called in code.schedule.calls_after_stage for each in called):
            calls[each] = numpy_calls.make_call(each, blocks[key])(each.slot, each.inputs, None)
    machine_codes = {}
    for name, named in units.items():
        machine_codes[name] = code_cache.load_code(named, partial(_get_unit_text, text, name))
        yield
    ready = CompiledPlanCode(blocks, facts, written, machine_codes, calls, together)
    with _requests_lock:
        _code_by_plan.setdefault(plan, {})[facts] = ready
    return ready


def _get_unit_text(text: Callable[[], NativeProgram], name: str) -> str:
    return text().units[name]


def find_stored_blocks(plan: ir.Plan, blocks: CompiledBlocks, facts: WorldFacts) -> stored_blocks.StoredBlocks | None:
    """Return the compiled blocks of a plan that an earlier run stored, or None. They make it unnecessary to write the plan's
    text."""
    subject = (
        stored_blocks.index_plan(plan, blocks, facts, llvm_compiler.find_host_target()) if llvm_compiler.is_available() else None
    )
    return None if subject is None else stored_blocks.read_stored_blocks(subject)


def start_code_build(
    plan: ir.Plan, blocks: CompiledBlocks, facts: WorldFacts, stored: stored_blocks.StoredBlocks | None = None
) -> Future[CompiledPlanCode]:
    """Build the machine code of a plan's blocks in a thread. Return a future of the code; its exception may be CodeUnavailable.

    The latest request is built first, because a user waits for it. Building stops when the caller drops the future, for example
    because the program was saved again. `stored`: the result of `find_stored_blocks`."""
    coming: Future[CompiledPlanCode] = Future()
    with _requests_lock:
        _pending_requests.append((ref(coming), _build_plan_code(plan, blocks, facts, stored)))
    _get_compile_thread().submit(_run_next_build_piece)
    return coming


def _run_next_build_piece() -> None:
    """Do the next part of the work for the latest request that is still needed."""
    with _requests_lock:
        _pending_requests[:] = [each for each in _pending_requests if each[0]() is not None]
        if not _pending_requests:
            return
        future_reference, making = _pending_requests[-1]
    try:
        next(making)
    except StopIteration as made:
        ready: CompiledPlanCode = made.value
        _finish_build_request(future_reference, lambda future: future.set_result(ready))
    except Exception as problem:
        why = problem
        _finish_build_request(future_reference, lambda future: future.set_exception(why))
    with suppress(RuntimeError):  # the program is exiting, so no caller waits
        _get_compile_thread().submit(_run_next_build_piece)


def _finish_build_request(
    future_reference: ReferenceType[Future[CompiledPlanCode]], set_outcome: Callable[[Future[CompiledPlanCode]], None]
) -> None:
    """Complete a request if its future still exists. `set_outcome`: sets the result or the error of the future."""
    with _requests_lock:
        _pending_requests[:] = [each for each in _pending_requests if each[0] is not future_reference]
    coming = future_reference()
    if coming is not None:
        set_outcome(coming)


def release_unused_code() -> None:
    """Discard all code in memory that no backend uses, as if the process had just started. Code on disk is not changed."""
    with _requests_lock:
        _code_by_plan.clear()
    code_cache.release_unused_code()


@cache
def _get_compile_thread() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(1, "machine code")


def _group_calls_by_sense(calls: list[BlockInstruction]) -> list[list[BlockInstruction]]:
    """Return the calls in groups, in order. Calls of the same sense with the same name form a group."""
    groups: list[list[BlockInstruction]] = []
    known: dict[Any, list[BlockInstruction]] = {}
    for each in calls:
        if (
            each.kind is not InstructionKind.VALUE
            or not isinstance(each.subject, ir.PlanNode)
            or each.subject.op not in SENSE_FUNCTIONS
        ):
            groups.append([each])
            continue
        key = (each.subject.op, each.subject.attrs)
        if key not in known:
            known[key] = []
            groups.append(known[key])
        known[key].append(each)
    return groups
