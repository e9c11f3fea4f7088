"""What a step of some cases is made of, counted exactly, compared with the budgets in `counts.json`.

`python tests/benchmarks/counts.py` prints what differs and exits with 1 if a count is more than 1.1 times the recorded one, so
that splitting a module breaks nothing. `--record` records the counts again: say why in the commit. `--print` prints them.
Compiled kernels are turned off. Without a compiler the native backend is left out, and nothing can be recorded.

The same program gives the same counts on any machine, under any load:

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

import argparse
import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

import antdsl
from antdsl.bench.cases import find_case
from antdsl.machine_code import llvm_compiler
from antdsl.runtime import Options, World, bind, step
from antdsl.runtime.backends import BACKENDS, NumpyBackend
from antdsl.runtime.backends.block_compiler import BlockInstruction, SlotFunction, SlotValues
from antdsl.scene.setting import WorldSetting

RECORDED = Path(__file__).with_suffix(".json")
COUNTED = (
    ("foraging", 500),
    ("boids", 500),
    ("cluster", 500),
    ("node", 500),
    ("moods", 200),
    ("flocking", 400),
    ("tunnel", None),
)
Counts = dict[str, dict[str, int]]
BUDGET = 1.1  # of the recorded count
SETTLED = 4  # steps before the one that is counted: tables are made, kernels compiled
_PACKAGE = str(Path(antdsl.__file__).resolve().parent)
_PARTS = frozenset(["<listcomp>", "<setcomp>", "<dictcomp>", "<genexpr>"])  # functions in some versions of Python only

StepCounts = dict[str, int]


def counted(cases: Sequence[str] = ()) -> Counts:
    """Counts by case, of all without any, in this process."""
    left_out = {"reference"}  # its speed does not matter
    if not llvm_compiler.is_available():
        left_out.add("native")  # which would run what NumPy runs
    counts_by_case = {}
    for name, agents in ((name, agents) for name, agents in COUNTED if not cases or name in cases):
        shot = find_case(name).make_shot(agents)
        for backend in BACKENDS:
            if backend not in left_out:
                counts_by_case[f"{name} {agents or ''} {backend}".replace("  ", " ")] = counts_of(
                    shot.plan, shot.setting, backend
                )
    return counts_by_case


def grown(counts_by_case: Mapping[str, Mapping[str, int]], recorded: Mapping[str, Mapping[str, int]]) -> list[str]:
    """Lines about counts that exceed their budget, or are not recorded."""
    lines = []
    for case, counts in counts_by_case.items():
        for name, number in counts.items():
            recorded_number = recorded.get(case, {}).get(name)
            if recorded_number is None:
                lines.append(f"{case}: {name} is {number:,} and not recorded")
            elif number > BUDGET * recorded_number:
                lines.append(
                    f"{case}: {name} is {number:,}, {number / max(recorded_number, 1):.3f} times the {recorded_number:,} recorded"
                )
    return lines


def main() -> None:
    """Compare, print or record."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", help="names of cases; all without any")
    parser.add_argument("--record", action="store_true")
    parser.add_argument("--print", action="store_true")
    options = parser.parse_args()
    if options.record and options.cases:
        parser.error("--record takes all cases")
    if options.record and (why := llvm_compiler.find_unavailability_reason()):
        raise SystemExit(f"--record takes all backends: {why}")
    counts_by_case = counted(options.cases)
    if options.print or options.record:
        text = json.dumps(counts_by_case, indent=2, sort_keys=True) + "\n"
        print(text, end="") if options.print else RECORDED.write_text(text, encoding="utf-8")
        return
    recorded = json.loads(RECORDED.read_text(encoding="utf-8"))
    for case, counts in counts_by_case.items():
        for name, number in counts.items():
            if number < (recorded_number := recorded.get(case, {}).get(name, 0)):
                print(f"{case}: {name} is {number:,}, less than the {recorded_number:,} recorded")
    if lines := grown(counts_by_case, recorded):
        raise SystemExit("\n".join([*lines, "where that is meant: python tests/benchmarks/counts.py --record"]))


def counts_of(plan: Any, setting: WorldSetting, backend: str = "numpy") -> StepCounts:
    """Return the counts of one step, on one thread, after SETTLED earlier steps. Raises KeyError for a backend that does not
    exist."""
    if backend not in BACKENDS:
        raise KeyError(backend)
    name: Any = backend
    world = bind(plan, setting, Options(backend=name, threads=1, wait_for_code=True))
    for _ in range(SETTLED):
        step(world)
    return count_step(world)


def count_step(world: World) -> StepCounts:
    """Make a step and count it. The step has the same result as without counting."""
    counts: StepCounts = {}
    with _count_numpy(counts), _count_instructions(world, counts), _count_functions(counts):
        step(world)
    own = getattr(world.backend, "count_instructions_by_function", None)
    if own is not None:
        counts |= {name: int(number) for name, number in own().items()}
    return dict(sorted(counts.items()))


# --- the NumPy backend's instructions ----------------------------------------------------------------------------------


@contextmanager
def _count_instructions(world: World, counts: StepCounts) -> Iterator[None]:
    backend = world.backend
    if type(backend) is not NumpyBackend:
        yield
        return
    counts |= {"instructions": 0, "instruction_bytes": 0, "elements": 0}
    NumpyBackend.set_timing_enabled(backend, True)  # also if the backend would continue with its own code
    scopes = {id(each.scope): each.scope for block in backend.metered_blocks.values() for each in block.instructions}
    plain = [(scope, scope.bound_calls) for scope in scopes.values()]
    for scope, calls in plain:
        scope.bound_calls = [_counting_call(call, code, counts) for call, code in zip(calls, scope.code, strict=True)]
    try:
        yield
    finally:
        for scope, calls in plain:
            scope.bound_calls = calls
        NumpyBackend.set_timing_enabled(backend, False)


def _counting_call(call: SlotFunction, instruction: BlockInstruction, counts: StepCounts) -> SlotFunction:
    slots = (*instruction.inputs, *([instruction.slot] if instruction.slot >= 0 else []))
    size = instruction.scope.row_count_slot

    def run(v: SlotValues) -> None:
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
def _count_numpy(counts: StepCounts) -> Iterator[None]:
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

    def __init__(self, function: Callable[..., Any], counts: StepCounts, inside: list[bool]) -> None:
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
def _count_functions(counts: StepCounts) -> Iterator[None]:
    counts["python_calls"] = 0

    def count_call(frame: FrameType, event: str, argument: object) -> None:
        code = frame.f_code
        if event == "call" and code.co_filename.startswith(_PACKAGE) and code.co_name not in _PARTS:
            counts["python_calls"] += not code.co_filename.endswith("metering.py")

    previous_profiler = sys.getprofile()
    sys.setprofile(count_call)
    try:
        yield
    finally:
        sys.setprofile(previous_profiler)


if __name__ == "__main__":
    main()
