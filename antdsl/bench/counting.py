"""Exact counts of the work in a step: the same program gives the same counts on any machine, under any load.

| count | of |
|---|---|
| `instructions` | calls of the NumPy backend's compiled blocks, without regions that no agent is in |
| `instruction_bytes` | bytes of their operands and results |
| `elements` | rows that they process, in total |
| `numpy_calls` | NumPy functions called by name (`np.take`, `np.add.at`) from outside NumPy; operators are not counted |
| `numpy_bytes` | bytes of the arrays that these calls take and return |
| `python_calls` | functions of antdsl that Python called |

A backend with additional counts, such as instructions that it compiled, offers `counts() -> Mapping[str, int]`: `instructions
NAME` counts a function of machine code, in LLVM's language."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

from antdsl.runtime import Options, World, bind, step
from antdsl.runtime.backends import BACKENDS, NumpyBackend
from antdsl.runtime.backends.compile import Instruction, Run, Slots
from antdsl.scene.setting import Setting

SETTLED = 4  # steps before the one that is counted: tables are made, kernels compiled
_PACKAGE = str(Path(__file__).resolve().parents[1])
_PARTS = frozenset(["<listcomp>", "<setcomp>", "<dictcomp>", "<genexpr>"])  # functions in some versions of Python only

Counts = dict[str, int]


def counts_of(plan: Any, setting: Setting, backend: str = "numpy") -> Counts:
    """Return the counts of one step, on one thread, after SETTLED earlier steps. Raises KeyError for a backend that does not
    exist."""
    if backend not in BACKENDS:
        raise KeyError(backend)
    name: Any = backend
    world = bind(plan, setting, Options(backend=name, threads=1, wait_for_code=True))
    for _ in range(SETTLED):
        step(world)
    return count_step(world)


def count_step(world: World) -> Counts:
    """Make a step and count it. The step has the same result as without counting."""
    counts: Counts = {}
    with _count_numpy(counts), _count_instructions(world, counts), _count_functions(counts):
        step(world)
    own = getattr(world.backend, "counts", None)
    if own is not None:
        counts |= {name: int(number) for name, number in own().items()}
    return dict(sorted(counts.items()))


# --- the NumPy backend's instructions ----------------------------------------------------------------------------------


@contextmanager
def _count_instructions(world: World, counts: Counts) -> Iterator[None]:
    backend = world.backend
    if type(backend) is not NumpyBackend:
        yield
        return
    counts |= {"instructions": 0, "instruction_bytes": 0, "elements": 0}
    NumpyBackend.measure(backend, True)  # also if the backend would continue with its own code
    scopes = {id(each.scope): each.scope for block in backend.metered.values() for each in block.instructions}
    plain = [(scope, scope.calls) for scope in scopes.values()]
    for scope, calls in plain:
        scope.calls = [_counting_call(call, code, counts) for call, code in zip(calls, scope.code, strict=True)]
    try:
        yield
    finally:
        for scope, calls in plain:
            scope.calls = calls
        NumpyBackend.measure(backend, False)


def _counting_call(call: Run, instruction: Instruction, counts: Counts) -> Run:
    slots = (*instruction.inputs, *([instruction.out] if instruction.out >= 0 else []))
    size = instruction.scope.size

    def run(v: Slots) -> None:
        call(v)
        counts["instructions"] += 1
        counts["elements"] += v[size]
        counts["instruction_bytes"] += sum(_byte_count(v[slot]) for slot in slots)

    return run


def _byte_count(value: Any) -> int:
    """Return the bytes of an array, or of the arrays in a tuple or a list."""
    if isinstance(value, np.ndarray):
        return value.nbytes
    return sum(map(_byte_count, value)) if isinstance(value, tuple | list) else 0


# --- functions of NumPy, by name ---------------------------------------------------------------------------------------


@contextmanager
def _count_numpy(counts: Counts) -> Iterator[None]:
    """Count the calls from outside NumPy to all functions in NumPy's namespace."""
    counts |= {"numpy_calls": 0, "numpy_bytes": 0}
    inside = [False]
    plain = {name: value for name, value in vars(np).items() if not name.startswith("_") and _is_function(value)}
    for name, value in plain.items():
        setattr(np, name, _CountingFunction(value, counts, inside))
    try:
        yield
    finally:
        for name, value in plain.items():
            setattr(np, name, value)


def _is_function(value: Any) -> bool:
    return callable(value) and not isinstance(value, type)


class _CountingFunction:
    """A NumPy function that counts its calls. Calls that it makes to other NumPy functions are not counted. It is equal to the
    original function and has its hash and module, so that a kernel built meanwhile names the original in its text."""

    def __init__(self, function: Callable[..., Any], counts: Counts, inside: list[bool]) -> None:
        self._function, self._counts, self._inside = function, counts, inside
        self.__module__ = getattr(function, "__module__", "numpy")

    def __eq__(self, other: object) -> bool:
        return other is self._function or (isinstance(other, _CountingFunction) and other._function is self._function)

    def __hash__(self) -> int:
        return hash(self._function)

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        if self._inside[0]:
            return self._function(*arguments, **named)
        self._inside[0] = True
        try:
            result = self._function(*arguments, **named)
        finally:
            self._inside[0] = False
        self._counts["numpy_calls"] += 1
        self._counts["numpy_bytes"] += _byte_count(arguments) + _byte_count(tuple(named.values())) + _byte_count(result)
        return result

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._function, name)
        return (
            _CountingFunction(value, self._counts, self._inside)
            if name in ("reduce", "accumulate", "at", "outer", "reduceat")
            else value
        )


# --- functions of antdsl -----------------------------------------------------------------------------------------------


@contextmanager
def _count_functions(counts: Counts) -> Iterator[None]:
    counts["python_calls"] = 0

    def count_call(frame: FrameType, event: str, argument: object) -> None:
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(_PACKAGE) and code.co_name not in _PARTS:
            counts["python_calls"] += code.co_filename != __file__ and not code.co_filename.endswith("metering.py")

    previous_profiler = sys.getprofile()
    sys.setprofile(count_call)
    try:
        yield
    finally:
        sys.setprofile(previous_profiler)
