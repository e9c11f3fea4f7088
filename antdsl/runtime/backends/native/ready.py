"""Makes a plan's blocks ready to run as machine code: text, code in memory, and the calls between its stages.

Each function that is called from outside is compiled by itself, in a thread beside the run, and kept by its text: in memory, and
in a folder for the next run (`object_cache`). Numbers of a program are no part of the text, so one that was changed compiles
nothing, and an edit only the stages that it changes."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from threading import Lock
from typing import Any
from weakref import ReferenceType, WeakKeyDictionary, ref

from antdsl.machine_code import codes, machine
from antdsl.plan import ir
from antdsl.runtime.backends import numpy_calls
from antdsl.runtime.backends.compile import BlockCompiler, Does, Instruction, Run
from antdsl.runtime.backends.native.programs import Facts, Program, program
from antdsl.runtime.sensing import SENSES

_plans: WeakKeyDictionary[ir.Plan, dict[Facts, Ready]] = WeakKeyDictionary()
_asked: list[tuple[ReferenceType[Future[Ready]], Generator[None, None, Ready]]] = []
_guard = Lock()

Blocks = Mapping[tuple[str, str], BlockCompiler]


class Unavailable(Exception):
    """No machine code can be made here; the message says why, and what to do about it."""


@dataclass(frozen=True, slots=True, eq=False)
class Ready:
    """`blocks` as they were compiled, which the rest refers to; `codes` by the name of a function; `calls` makes each call of an
    instruction that has no machine code; `together`: by block and stage what is called after it, those of one sense with one
    name at once."""

    blocks: Blocks
    facts: Facts
    program: Program
    codes: Mapping[str, machine.Code]
    calls: Mapping[Instruction, Run]
    together: Mapping[tuple[str, str, int], list[list[Instruction]]]

    def function(self, name: str) -> Any:
        """A function of the program, as `machine.Code` gives it."""
        return self.codes[name].function(name)


def known(plan: ir.Plan, facts: Facts) -> Ready | None:
    """What was made of a plan before, while that is in use somewhere."""
    with _guard:
        return _plans.get(plan, {}).get(facts)


def _made(plan: ir.Plan, blocks: Blocks, facts: Facts) -> Generator[None, None, Ready]:
    """A plan's blocks as machine code for this processor, a piece of the work at a time. Raises Unavailable."""
    if why := machine.unavailable():
        raise Unavailable(why)
    made = program(plan, blocks, facts, machine.host())
    yield
    calls: dict[Instruction, Run] = {}
    together: dict[tuple[str, str, int], list[list[Instruction]]] = {}
    for key, code in made.blocks.items():
        for stage, called in enumerate(code.schedule.calls):
            together[(*key, stage)] = _groups(called)
        for each in (each for called in code.schedule.calls for each in called):
            calls[each] = numpy_calls.call(each, blocks[key])(each.out, each.inputs, None)
    found = {}
    for name, text in made.units.items():
        found[name] = codes.code(text)
        yield
    ready = Ready(blocks, facts, made, found, calls, together)
    with _guard:
        _plans.setdefault(plan, {})[facts] = ready
    return ready


def beside(plan: ir.Plan, blocks: Blocks, facts: Facts) -> Future[Ready]:
    """A plan's blocks as machine code for this processor, made in a thread; Unavailable where it cannot be made. What was asked
    for last is made first: it is what somebody looks at. It is made as long as whoever asked holds what this gives: of a program
    that is saved again before its code has come, the world before is gone, and nothing more is made for it."""
    coming: Future[Ready] = Future()
    with _guard:
        _asked.append((ref(coming), _made(plan, blocks, facts)))
    _worker().submit(_work)
    return coming


def _work() -> None:
    """Do a piece of what was asked for last and is still waited for."""
    with _guard:
        _asked[:] = [each for each in _asked if each[0]() is not None]
        if not _asked:
            return
        asked, making = _asked[-1]
    try:
        next(making)
    except StopIteration as made:
        ready: Ready = made.value
        _over(asked, lambda coming: coming.set_result(ready))
    except Exception as problem:
        why = problem
        _over(asked, lambda coming: coming.set_exception(why))
    with suppress(RuntimeError):  # the program ends; nobody waits
        _worker().submit(_work)


def _over(asked: ReferenceType[Future[Ready]], tell: Callable[[Future[Ready]], None]) -> None:
    """One that was asked for has been made, or cannot be."""
    with _guard:
        _asked[:] = [each for each in _asked if each[0] is not asked]
    coming = asked()
    if coming is not None:
        tell(coming)


def forget() -> None:
    """Let go of all code in memory that no backend has in use, as in a process that begins; what a folder keeps stays there."""
    with _guard:
        _plans.clear()
    codes.forget()


@cache
def _worker() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(1, "machine code")


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
