"""Makes a plan's blocks ready to run as machine code: text, code in memory, and the calls between its stages.

Code is made in a thread beside the run; a program that was compiled in this process before, whatever its numbers were, is there
at once."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from hashlib import blake2b
from threading import Lock
from typing import Any

from antdsl.plan import ir
from antdsl.runtime.backends import numpy_calls
from antdsl.runtime.backends.compile import BlockCompiler, Does, Instruction, Run
from antdsl.runtime.backends.native import machine
from antdsl.runtime.backends.native.programs import Facts, Program, program
from antdsl.runtime.sensing import SENSES

_KEPT = 16  # programs whose code stays in memory
_known: OrderedDict[bytes, machine.Code] = OrderedDict()
_guard = Lock()

Blocks = Mapping[tuple[str, str], BlockCompiler]


@dataclass(frozen=True, slots=True, eq=False)
class Ready:
    """`calls` makes each call of an instruction that has no machine code; `together`: by block and stage what is called after it,
    those of one sense with one name at once."""

    program: Program
    code: machine.Code
    calls: Mapping[Instruction, Run]
    together: Mapping[tuple[str, str, int], list[list[Instruction]]]


def prepared(plan: ir.Plan, blocks: Blocks, facts: Facts) -> Ready:
    """A plan's blocks as machine code for this processor."""
    made = program(plan, blocks, facts, machine.host())
    calls: dict[Instruction, Run] = {}
    together: dict[tuple[str, str, int], list[list[Instruction]]] = {}
    for key, code in made.blocks.items():
        for stage, called in enumerate(code.schedule.calls):
            together[(*key, stage)] = _groups(called)
        for each in (*code.requests, *(each for called in code.schedule.calls for each in called)):
            calls[each] = numpy_calls.call(each, blocks[key])(each.out, each.inputs, None)
    return Ready(made, _loaded(made.text), calls, together)


def beside(plan: ir.Plan, blocks: Blocks, facts: Facts) -> Future[Ready]:
    """The same, made in a thread."""
    return _worker().submit(prepared, plan, blocks, facts)


@cache
def _worker() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(1, "machine code")


def _loaded(text: str) -> machine.Code:
    key = blake2b(text.encode(), digest_size=16).digest()
    with _guard:
        if key in _known:
            _known.move_to_end(key)
            return _known[key]
    code = machine.load(machine.object_code(text, machine.host()))
    with _guard:
        _known[key] = code
        while len(_known) > _KEPT:
            _known.popitem(last=False)
    return code


def _groups(calls: list[Instruction]) -> list[list[Instruction]]:
    """Calls in their order; those that can be guarded or are of one sense and name are made at once."""
    found: list[list[Instruction]] = []
    known: dict[Any, list[Instruction]] = {}
    for each in calls:
        if each.does is not Does.VALUE or not isinstance(each.what, ir.Node) or each.what.op not in SENSES:
            found.append([each])
            continue
        key = (each.what.op, each.what.attrs)
        if key not in known:
            known[key] = []
            found.append(known[key])
        known[key].append(each)
    return found
