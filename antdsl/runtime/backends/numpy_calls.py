"""Function calls for the instructions of compiled blocks. Each public function returns a maker of closures over the slots of one
run.

`v` is the list of slots. The first slots hold the world, the population, the effects, the buffers and the cached senses."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import randomness
from antdsl.numerics.elementwise import FUNCTION_BY_NAME, UFUNC_BY_NAME
from antdsl.plan import ir
from antdsl.runtime import pairs as sets
from antdsl.runtime.backends.compile import (
    BUFFERS_SLOT,
    LAZY_VALUES_SLOT,
    PAIRS_SLOT,
    POPULATION_SLOT,
    THREADS_SLOT,
    WORLD_SLOT,
    BlockCompiler,
    BlockInstruction,
    InstructionKind,
    RowScope,
    SlotFunction,
    SlotFunctionMaker,
    SlotValues,
)
from antdsl.runtime.backends.numpy_statements import row_numbers, statement
from antdsl.runtime.sensing import SENSE_FUNCTIONS


def call(instruction: BlockInstruction, compiler: BlockCompiler) -> SlotFunctionMaker:
    """Return the maker of an instruction's call; it takes the slots of output, inputs and buffer."""
    scope, what = instruction.scope, instruction.what
    if not isinstance(what, ir.PlanNode):
        return statement(instruction) if instruction.inner is None else region(scope, instruction.inner)
    match instruction.does:
        case InstructionKind.VALUE | InstructionKind.BY_PAIR:
            return elementwise(what) or leaf(what, compiler, scope)
        case InstructionKind.GATHER:
            return gather(scope, what.kind is ir.ValueKind.TUPLE)
        case InstructionKind.KEEP:
            assert instruction.inner is not None
            return keep(what, scope, instruction.inner, instruction.result)
        case InstructionKind.PAIRS:
            return pairs(what, compiler, scope)
        case InstructionKind.SPREAD:
            return spread
        case InstructionKind.OF_PAIR:
            return pair_leaf(what, scope)
        case InstructionKind.REDUCE:
            return reduction(what)
    raise AssertionError(f"no call for {instruction.does}")


def enter(v: SlotValues, scope: RowScope, rows: Any, size: int, picked: NDArray[np.intp] | None) -> None:
    """Set a scope's rows and the views of its output buffers."""
    v[scope.rows], v[scope.size], v[scope.picked] = rows, size, picked
    buffers = v[BUFFERS_SLOT]
    for (dtype, number), slot in scope.views.items():
        v[slot] = buffers[dtype][number][:size]


def descend(v: SlotValues, scope: RowScope, inner: RowScope, picked: NDArray[np.intp] | None) -> None:
    """Run an inner scope for some of a scope's rows (None: all)."""
    rows = v[scope.rows]
    if picked is None:
        enter(v, inner, rows, v[scope.size], None)
    elif isinstance(rows, slice):
        enter(v, inner, picked + rows.start if rows.start else picked, len(picked), picked)
    else:
        enter(v, inner, rows.take(picked), len(picked), picked)
    for call in inner.calls:
        call(v)


def region(scope: RowScope, inner: RowScope) -> SlotFunctionMaker:
    """Return the call of an `If`: it runs the inner scope for the rows for which the condition holds."""

    def make(out: int, inputs: tuple[int, ...], buffer: int | None) -> SlotFunction:
        (a,) = inputs

        def run(v: SlotValues) -> None:
            condition = v[a]
            if condition.ndim == 0:
                if condition:
                    descend(v, scope, inner, None)
                return
            picked = condition.nonzero()[0]
            if len(picked):
                descend(v, scope, inner, None if len(picked) == len(condition) else picked)

        return run

    return make


def gather(scope: RowScope, several: bool) -> SlotFunctionMaker:
    """Return the call that takes a value of the enclosing scope for the rows of this scope."""
    picked = scope.picked

    def make(out: int, inputs: tuple[int, ...], buffer: int | None) -> SlotFunction:
        (a,) = inputs

        def run(v: SlotValues) -> None:
            p = v[picked]
            if p is None:
                v[out] = v[a]
            elif several:
                v[out] = tuple(part.take(p) for part in v[a])
            else:
                v[out] = v[a].take(p)

        return run

    return make


def keep(node: ir.PlanNode, scope: RowScope, inner: RowScope, result: int) -> SlotFunctionMaker:
    """Return the call for a sense that is cached for the step. It is computed only for rows without a value."""

    def make(out: int, inputs: tuple[int, ...], buffer: int | None) -> SlotFunction:
        def run(v: SlotValues) -> None:
            has, arrays = v[LAZY_VALUES_SLOT][node]
            rows = v[scope.rows]
            missing = (~has[rows]).nonzero()[0]
            if len(missing):
                descend(v, scope, inner, None if len(missing) == v[scope.size] else missing)
                new = v[inner.rows]
                has[new] = True
                for array, part in zip(arrays, v[result] if node.kind is ir.ValueKind.TUPLE else (v[result],), strict=True):
                    array[new] = part
            v[out] = tuple(array[rows] for array in arrays) if node.kind is ir.ValueKind.TUPLE else arrays[0][rows]

        return run

    return make


def elementwise(node: ir.PlanNode) -> SlotFunctionMaker | None:
    """Return the maker for an operation of the elementwise table, or None for other nodes."""
    f = FUNCTION_BY_NAME.get(node.op)
    if f is None:
        return None
    buffered = node.op in UFUNC_BY_NAME

    def make(out: int, inputs: tuple[int, ...], buffer: int | None) -> SlotFunction:
        a = inputs[0]
        b = inputs[1] if len(inputs) > 1 else -1
        if len(inputs) == 3:
            c = inputs[2]

            def run(v: SlotValues) -> None:
                v[out] = f(v[a], v[b], v[c])
        elif len(inputs) == 2 and buffered and buffer is not None:

            def run(v: SlotValues) -> None:
                v[out] = f(v[a], v[b], v[buffer])
        elif len(inputs) == 2:

            def run(v: SlotValues) -> None:
                v[out] = f(v[a], v[b])
        elif buffered and buffer is not None:

            def run(v: SlotValues) -> None:
                v[out] = f(v[a], v[buffer])
        else:

            def run(v: SlotValues) -> None:
                v[out] = f(v[a])

        return run

    return make


def leaf(node: ir.PlanNode, compiler: BlockCompiler, scope: RowScope) -> SlotFunctionMaker:
    """Return the maker of the call for a register, draw, part of a tuple or sense."""
    rows = scope.rows
    if node.op == "get":
        index = node.attrs[0]
        return lambda out, inputs, buffer: lambda v: v.__setitem__(out, v[inputs[0]][index])
    if node.op in ("snap", "load"):
        name, copied = node.attrs[0], node.op == "load" and node.attrs[0] in compiler.changing

        def read(out: int, inputs: tuple[int, ...], buffer: int | None) -> SlotFunction:
            def run(v: SlotValues) -> None:
                population = v[POPULATION_SLOT]
                value = (population.now if node.op == "load" else population.start)[name][v[rows]]
                v[out] = value.copy() if copied and isinstance(v[rows], slice) else value

            return run

        return read
    if node.op == "draw":
        return _draw(node, compiler, scope)
    sense = SENSE_FUNCTIONS[node.op]

    def make(out: int, inputs: tuple[int, ...], buffer: int | None) -> SlotFunction:
        def run(v: SlotValues) -> None:
            v[out] = sense(v[WORLD_SLOT], v[POPULATION_SLOT], node, v[rows], *[v[a] for a in inputs])

        return run

    return make


def _draw(node: ir.PlanNode, compiler: BlockCompiler, scope: RowScope) -> SlotFunctionMaker:
    """Return the call for a random draw. Four draws of one site come from one run of the generator."""
    site, index = node.attrs
    key = (site, index >> 2)
    fresh = key not in scope.draws
    words = scope.draws.setdefault(key, compiler.slot()) if fresh else scope.draws[key]

    def make(out: int, inputs: tuple[int, ...], buffer: int | None) -> SlotFunction:
        def run(v: SlotValues) -> None:
            if fresh:
                world, population = v[WORLD_SLOT], v[POPULATION_SLOT]
                ids = population.ids[v[scope.rows]]
                v[words] = randomness.words(world.setting.seed, world.frame, population.name, site, index >> 2, ids)
            v[out] = randomness.unit_floats(v[words][index & 3])

        return run

    return make


def pairs(node: ir.PlanNode, compiler: BlockCompiler, scope: RowScope) -> SlotFunctionMaker:
    """Return the call for the pairs of a set.

    A set that several regions use is cached for the step after it was computed for a complete chunk."""
    shared, root, rows = compiler.sets, compiler.root.rows, scope.rows

    def make(out: int, inputs: tuple[int, ...], buffer: int | None) -> SlotFunction:
        def run(v: SlotValues) -> None:
            stored_pairs, chunk, mine = v[PAIRS_SLOT], v[root], v[rows]
            known = stored_pairs.get((node, chunk.start)) if isinstance(chunk, slice) else None
            if known is not None:
                v[out] = known if mine is chunk else known.select_rows(row_numbers(mine) - chunk.start)
                return
            v[out] = sets.find_pairs(v[WORLD_SLOT], v[POPULATION_SLOT], node, mine, tuple(v[a] for a in inputs), v[THREADS_SLOT])
            if mine is chunk and isinstance(chunk, slice) and shared.get(node, 0) > 1:
                stored_pairs[node, chunk.start] = v[out]

        return run

    return make


def spread(out: int, inputs: tuple[int, ...], buffer: int | None) -> SlotFunction:
    """Return the call that repeats an agent's value for each of its pairs."""
    value, pair = inputs

    def run(v: SlotValues) -> None:
        v[out] = v[value].take(v[pair].i)

    return run


def pair_leaf(node: ir.PlanNode, scope: RowScope) -> SlotFunctionMaker:
    """Return the call for a value of the other agent of a pair, or a value that depends on that agent.

    A sense is evaluated at the position of the requesting agent."""
    sense, rows = SENSE_FUNCTIONS.get(node.op), scope.rows

    def make(out: int, inputs: tuple[int, ...], buffer: int | None) -> SlotFunction:
        def run(v: SlotValues) -> None:
            pair_set = v[inputs[0]]
            if sense is None:
                v[out] = sets.pair_leaf(pair_set, node)
            else:
                v[out] = sense(
                    v[WORLD_SLOT], v[POPULATION_SLOT], node, row_numbers(v[rows]).take(pair_set.i), *[v[a] for a in inputs[1:]]
                )

        return run

    return make


def reduction(node: ir.PlanNode) -> SlotFunctionMaker:
    """Return the call for a reduction over the pairs of a set."""
    f = sets.REDUCTION_FUNCTIONS[node.op]

    def make(out: int, inputs: tuple[int, ...], buffer: int | None) -> SlotFunction:
        def run(v: SlotValues) -> None:
            v[out] = f(v[inputs[0]], node, *[v[a] for a in inputs[1:]])

        return run

    return make
