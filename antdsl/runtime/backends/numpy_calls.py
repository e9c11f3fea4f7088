"""Function calls for the instructions of compiled blocks.

Each public `make_…` function returns a maker, which is a function that creates a call. A call takes `v`, the list of slots of one
run. The first slots hold the world, the population, the effects, the buffers and the cached senses."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import randomness
from antdsl.numerics.elementwise import FUNCTION_BY_NAME, UFUNC_BY_NAME
from antdsl.plan import ir
from antdsl.runtime.backends.block_compiler import (
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
from antdsl.runtime.backends.numpy_statements import convert_to_row_array, make_statement_call
from antdsl.runtime.sensing import pairs as sets
from antdsl.runtime.sensing.world_senses import SENSE_FUNCTIONS


def make_call(instruction: BlockInstruction, compiler: BlockCompiler) -> SlotFunctionMaker:
    """Return the maker of an instruction's call. The maker takes the output slot, the input slots and the buffer, and returns the
    call."""
    scope, what = instruction.scope, instruction.subject
    if not isinstance(what, ir.PlanNode):
        return (
            make_statement_call(instruction)
            if instruction.inner_scope is None
            else make_region_call(scope, instruction.inner_scope)
        )
    match instruction.kind:
        case InstructionKind.VALUE | InstructionKind.PAIR_OPERATION:
            return make_elementwise_call(what) or make_leaf_call(what, compiler, scope)
        case InstructionKind.GATHER:
            return make_gather_call(scope, what.kind is ir.ValueKind.TUPLE)
        case InstructionKind.CACHED_SENSE:
            assert instruction.inner_scope is not None
            return make_cached_sense_call(what, scope, instruction.inner_scope, instruction.inner_result_slot)
        case InstructionKind.PAIRS:
            return make_pairs_call(what, compiler, scope)
        case InstructionKind.REPEAT_FOR_PAIRS:
            return make_spread_call
        case InstructionKind.PAIR_LEAF:
            return make_pair_leaf_call(what, scope)
        case InstructionKind.REDUCE:
            return make_reduction_call(what)
    raise AssertionError(f"no call for {instruction.kind}")


def set_scope_rows(v: SlotValues, scope: RowScope, rows: Any, size: int, parent_rows: NDArray[np.intp] | None) -> None:
    """Write the rows of a scope to `v`, with their number `size`, indices within the parent's rows, and views of buffers."""
    v[scope.rows_slot], v[scope.row_count_slot], v[scope.parent_indices_slot] = rows, size, parent_rows
    buffers = v[BUFFERS_SLOT]
    for (dtype, number), slot in scope.view_slots.items():
        v[slot] = buffers[dtype][number][:size]


def run_inner_scope(v: SlotValues, scope: RowScope, inner: RowScope, parent_rows: NDArray[np.intp] | None) -> None:
    """Run an inner scope for some rows of the enclosing scope (None: all)."""
    rows = v[scope.rows_slot]
    if parent_rows is None:
        set_scope_rows(v, inner, rows, v[scope.row_count_slot], None)
    elif isinstance(rows, slice):
        set_scope_rows(v, inner, parent_rows + rows.start if rows.start else parent_rows, len(parent_rows), parent_rows)
    else:
        set_scope_rows(v, inner, rows.take(parent_rows), len(parent_rows), parent_rows)
    for call in inner.bound_calls:
        call(v)


def make_region_call(scope: RowScope, inner: RowScope) -> SlotFunctionMaker:
    """Return the maker of the call for an `If`, which runs the inner scope for the rows where the condition holds."""

    def make_region(result_slot: int, inputs: tuple[int, ...], buffer: int | None) -> SlotFunction:
        (a,) = inputs

        def run_region(v: SlotValues) -> None:
            condition = v[a]
            if condition.ndim == 0:
                if condition:
                    run_inner_scope(v, scope, inner, None)
                return
            picked = condition.nonzero()[0]
            if len(picked):
                run_inner_scope(v, scope, inner, None if len(picked) == len(condition) else picked)

        return run_region

    return make_region


def make_gather_call(scope: RowScope, is_tuple: bool) -> SlotFunctionMaker:
    """Return the maker of a call that copies a value of the enclosing scope for the rows of this scope."""
    picked = scope.parent_indices_slot

    def make_gather(result_slot: int, inputs: tuple[int, ...], buffer: int | None) -> SlotFunction:
        (a,) = inputs

        def gather_value(v: SlotValues) -> None:
            p = v[picked]
            if p is None:
                v[result_slot] = v[a]
            elif is_tuple:
                v[result_slot] = tuple(part.take(p) for part in v[a])
            else:
                v[result_slot] = v[a].take(p)

        return gather_value

    return make_gather


def make_cached_sense_call(node: ir.PlanNode, scope: RowScope, inner: RowScope, result: int) -> SlotFunctionMaker:
    """Return the maker of the call for a sense that is stored for the step and computed only for rows without a stored value."""

    def make_sense(result_slot: int, inputs: tuple[int, ...], buffer: int | None) -> SlotFunction:
        def read_cached_sense(v: SlotValues) -> None:
            has, arrays = v[LAZY_VALUES_SLOT][node]
            rows = v[scope.rows_slot]
            missing = (~has[rows]).nonzero()[0]
            if len(missing):
                run_inner_scope(v, scope, inner, None if len(missing) == v[scope.row_count_slot] else missing)
                new = v[inner.rows_slot]
                has[new] = True
                for array, part in zip(arrays, v[result] if node.kind is ir.ValueKind.TUPLE else (v[result],), strict=True):
                    array[new] = part
            v[result_slot] = tuple(array[rows] for array in arrays) if node.kind is ir.ValueKind.TUPLE else arrays[0][rows]

        return read_cached_sense

    return make_sense


def make_elementwise_call(node: ir.PlanNode) -> SlotFunctionMaker | None:
    """Return the maker of the call for an elementwise operation; None for any other node."""
    f = FUNCTION_BY_NAME.get(node.op)
    if f is None:
        return None
    buffered = node.op in UFUNC_BY_NAME

    def make_operation(result_slot: int, inputs: tuple[int, ...], buffer: int | None) -> SlotFunction:
        a = inputs[0]
        b = inputs[1] if len(inputs) > 1 else -1
        if len(inputs) == 3:
            c = inputs[2]

            def compute_operation(v: SlotValues) -> None:
                v[result_slot] = f(v[a], v[b], v[c])
        elif len(inputs) == 2 and buffered and buffer is not None:

            def compute_operation(v: SlotValues) -> None:
                v[result_slot] = f(v[a], v[b], v[buffer])
        elif len(inputs) == 2:

            def compute_operation(v: SlotValues) -> None:
                v[result_slot] = f(v[a], v[b])
        elif buffered and buffer is not None:

            def compute_operation(v: SlotValues) -> None:
                v[result_slot] = f(v[a], v[buffer])
        else:

            def compute_operation(v: SlotValues) -> None:
                v[result_slot] = f(v[a])

        return compute_operation

    return make_operation


def make_leaf_call(node: ir.PlanNode, compiler: BlockCompiler, scope: RowScope) -> SlotFunctionMaker:
    """Return the maker of the call for a register, a random draw, a part of a tuple, or a sense."""
    rows = scope.rows_slot
    if node.op == "get":
        index = node.attrs[0]
        return lambda result_slot, inputs, buffer: lambda v: v.__setitem__(result_slot, v[inputs[0]][index])
    if node.op in ("snap", "load"):
        name, copied = node.attrs[0], node.op == "load" and node.attrs[0] in compiler.stored_registers

        def make_register_read(result_slot: int, inputs: tuple[int, ...], buffer: int | None) -> SlotFunction:
            def compute_leaf(v: SlotValues) -> None:
                population = v[POPULATION_SLOT]
                value = (population.now if node.op == "load" else population.start)[name][v[rows]]
                v[result_slot] = value.copy() if copied and isinstance(v[rows], slice) else value

            return compute_leaf

        return make_register_read
    if node.op == "draw":
        return _make_draw_call(node, compiler, scope)
    sense = SENSE_FUNCTIONS[node.op]

    def make_sense(result_slot: int, inputs: tuple[int, ...], buffer: int | None) -> SlotFunction:
        def compute_leaf(v: SlotValues) -> None:
            v[result_slot] = sense(v[WORLD_SLOT], v[POPULATION_SLOT], node, v[rows], *[v[a] for a in inputs])

        return compute_leaf

    return make_sense


def _make_draw_call(node: ir.PlanNode, compiler: BlockCompiler, scope: RowScope) -> SlotFunctionMaker:
    """Return the maker of the call for a random draw. One run of the generator serves four draws of the same site."""
    site, index = node.attrs
    key = (site, index >> 2)
    fresh = key not in scope.draw_slots
    words = scope.draw_slots.setdefault(key, compiler.allocate_slot()) if fresh else scope.draw_slots[key]

    def make_draw(result_slot: int, inputs: tuple[int, ...], buffer: int | None) -> SlotFunction:
        def draw_numbers(v: SlotValues) -> None:
            if fresh:
                world, population = v[WORLD_SLOT], v[POPULATION_SLOT]
                ids = population.ids[v[scope.rows_slot]]
                v[words] = randomness.draw_four_words(world.setting.seed, world.frame, population.name, site, index >> 2, ids)
            v[result_slot] = randomness.to_unit_floats(v[words][index & 3])

        return draw_numbers

    return make_draw


def make_pairs_call(node: ir.PlanNode, compiler: BlockCompiler, scope: RowScope) -> SlotFunctionMaker:
    """Return the maker of the call that finds the pairs of a set.

    If several regions use the set, its pairs are stored for the step as soon as they are computed for a complete chunk."""
    shared, root, rows = compiler.region_count_by_set, compiler.root_scope.rows_slot, scope.rows_slot

    def make_pairs(result_slot: int, inputs: tuple[int, ...], buffer: int | None) -> SlotFunction:
        def find_set_pairs(v: SlotValues) -> None:
            stored_pairs, chunk, mine = v[PAIRS_SLOT], v[root], v[rows]
            known = stored_pairs.get((node, chunk.start)) if isinstance(chunk, slice) else None
            if known is not None:
                v[result_slot] = known if mine is chunk else known.select_rows(convert_to_row_array(mine) - chunk.start)
                return
            v[result_slot] = sets.find_pairs(
                v[WORLD_SLOT], v[POPULATION_SLOT], node, mine, tuple(v[a] for a in inputs), v[THREADS_SLOT]
            )
            if mine is chunk and isinstance(chunk, slice) and shared.get(node, 0) > 1:
                stored_pairs[node, chunk.start] = v[result_slot]

        return find_set_pairs

    return make_pairs


def make_spread_call(result_slot: int, inputs: tuple[int, ...], buffer: int | None) -> SlotFunction:
    """Return a call that repeats the value of an agent for each of its pairs."""
    value, pair = inputs

    def spread_value(v: SlotValues) -> None:
        v[result_slot] = v[value].take(v[pair].agent_indices)

    return spread_value


def make_pair_leaf_call(node: ir.PlanNode, scope: RowScope) -> SlotFunctionMaker:
    """Return the maker of a call that reads a value of the other agent of each pair.

    A sense is evaluated at the position of the requesting agent."""
    sense, rows = SENSE_FUNCTIONS.get(node.op), scope.rows_slot

    def make_pair_leaf(result_slot: int, inputs: tuple[int, ...], buffer: int | None) -> SlotFunction:
        def read_pair_leaf(v: SlotValues) -> None:
            pair_set = v[inputs[0]]
            if sense is None:
                v[result_slot] = sets.read_pair_value(pair_set, node)
            else:
                v[result_slot] = sense(
                    v[WORLD_SLOT],
                    v[POPULATION_SLOT],
                    node,
                    convert_to_row_array(v[rows]).take(pair_set.agent_indices),
                    *[v[a] for a in inputs[1:]],
                )

        return read_pair_leaf

    return make_pair_leaf


def make_reduction_call(node: ir.PlanNode) -> SlotFunctionMaker:
    """Return the maker of the call for a reduction over the pairs of a set."""
    f = sets.REDUCTION_FUNCTIONS[node.op]

    def make_reduction(result_slot: int, inputs: tuple[int, ...], buffer: int | None) -> SlotFunction:
        def reduce_pairs(v: SlotValues) -> None:
            v[result_slot] = f(v[inputs[0]], node, *[v[a] for a in inputs[1:]])

        return reduce_pairs

    return make_reduction
