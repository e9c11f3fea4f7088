"""Function calls for the statements of compiled blocks, which store values in registers or request something of the world."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.plan import ir
from antdsl.program.tables import effects
from antdsl.runtime.backends.block_compiler import (
    EFFECTS_SLOT,
    POPULATION_SLOT,
    WORLD_SLOT,
    BlockInstruction,
    RowScope,
    SlotFunction,
    SlotFunctionMaker,
    SlotValues,
)
from antdsl.runtime.requests import ClaimEntry, FaultEntry, GiftEntry, RequestEntry

ALL_ROWS = slice(None)


def convert_to_row_array(rows: Any) -> NDArray[np.intp]:
    """Return rows as an array, given a slice or an array."""
    return np.arange(rows.start, rows.stop) if isinstance(rows, slice) else rows


def _copy_row_values(v: SlotValues, scope: RowScope, value: Any) -> NDArray[Any]:
    """Return a new array with one value for each row of a scope. A copy is needed because buffers are reused."""
    return np.full(v[scope.row_count_slot], value) if value.ndim == 0 else value.copy()


def is_storable(value: NDArray[Any], allows_infinity: bool) -> NDArray[np.bool_]:
    """Return a mask of the values that may be stored: finite values, and +inf if `allows_infinity`."""
    good: NDArray[np.bool_] = np.isfinite(value)
    return good | (value == np.inf) if allows_infinity else good


def _record_fault(v: SlotValues, block: str, register: str, span: Any, rows: NDArray[np.intp]) -> None:
    v[EFFECTS_SLOT].faults.append(FaultEntry(block, register, span, rows))


def _make_store_call(statement: ir.Store, block: str, scope: RowScope) -> SlotFunctionMaker:
    """Return the maker of the call that stores a value in a register. A value that may not be stored is a fault."""
    name, infinite, span = statement.register, statement.allows_infinity, statement.span
    number = statement.value.kind is ir.ValueKind.F32

    def make_store(result_slot: int, inputs: tuple[int, ...], buffer: int | None) -> SlotFunction:
        (a,) = inputs

        def store_rows(v: SlotValues) -> None:
            value, rows = v[a], v[scope.rows_slot]
            target = v[POPULATION_SLOT].now[name]
            good = is_storable(value, infinite) if number else None
            if good is None or good.all():
                target[rows] = value
                return
            rows = convert_to_row_array(rows)
            if value.ndim == 0:
                _record_fault(v, block, name, span, rows)
                return
            target[rows[good]] = value[good]
            _record_fault(v, block, name, span, rows[~good])

        return store_rows

    return make_store


def _select_finite_amounts(
    v: SlotValues, scope: RowScope, block: str, value_name: str, span: Any, value: Any
) -> tuple[NDArray[np.intp], NDArray[Any], Any]:
    """Return the rows with finite values, these values, and the indices of these rows in the scope.

    Record a fault for each of the other rows."""
    rows, value = convert_to_row_array(v[scope.rows_slot]), _copy_row_values(v, scope, value)
    good = np.isfinite(value)
    if good.all():
        return rows, value, ALL_ROWS
    _record_fault(v, block, value_name, span, rows[~good])
    return rows[good], value[good], good


def _make_claim_call(statement: ir.Claim, block: str, scope: RowScope, order: int) -> SlotFunctionMaker:
    """Return the maker of the call that adds claims to the effects of the step."""

    def make_claim(result_slot: int, inputs: tuple[int, ...], buffer: int | None) -> SlotFunction:
        slots = iter(inputs)
        which, much = (None if node is None else next(slots) for node in (statement.item, statement.amount))
        what = f"take {statement.attribute or statement.target}"

        def add_claims(v: SlotValues) -> None:
            if much is None:
                rows = convert_to_row_array(v[scope.rows_slot])
                amount, good = np.full(len(rows), np.inf, np.float32), ALL_ROWS
            else:
                rows, amount, good = _select_finite_amounts(v, scope, block, what, statement.span, v[much])
            if which is None:
                item = v[POPULATION_SLOT].cells[statement.target][rows]
            else:
                item = _copy_row_values(v, scope, v[which])[good]
            v[EFFECTS_SLOT].claims.append(ClaimEntry(statement, order, rows, item, amount))

        return add_claims

    return make_claim


def _make_gift_call(statement: ir.Give, block: str, scope: RowScope) -> SlotFunctionMaker:
    """Return the maker of the call that subtracts gifts from the agents' registers, and adds them to the effects of the step."""

    def make_gift(result_slot: int, inputs: tuple[int, ...], buffer: int | None) -> SlotFunction:
        def add_gifts(v: SlotValues) -> None:
            own = v[POPULATION_SLOT].now[statement.register]
            item = _copy_row_values(v, scope, v[inputs[0]])
            if statement.amount is None:
                rows = convert_to_row_array(v[scope.rows_slot])
                amount = own[rows]
            else:
                rows, amount, good = _select_finite_amounts(
                    v, scope, block, f"give {statement.register}", statement.span, v[inputs[1]]
                )
                item = item[good]
            has_item = (item >= 0) & (item < len(v[WORLD_SLOT].items[statement.items]))
            rows, amount, item = rows[has_item], amount[has_item], item[has_item]
            had = own[rows]
            left = had - np.clip(amount, np.float32(0), np.maximum(had, np.float32(0))) + np.float32(0)  # never -0
            own[rows] = left
            v[EFFECTS_SLOT].gifts.append(GiftEntry(statement, item, had.astype(np.float64) - left.astype(np.float64)))

        return add_gifts

    return make_gift


def _make_request_call(statement: ir.Request, block: str, scope: RowScope, order: int) -> SlotFunctionMaker:
    """Return the maker of the call that adds a request to the effects of the step. Values that are not finite are faults."""
    row = effects.EFFECT_BY_OPERATION[statement.op]
    refused = row.fault_name.format(of=statement.target)

    def make_request(result_slot: int, inputs: tuple[int, ...], buffer: int | None) -> SlotFunction:
        slots = iter(inputs)
        which = [None if node is None else next(slots) for node in statement.args]

        def add_requests(v: SlotValues) -> None:
            rows = convert_to_row_array(v[scope.rows_slot])
            args = [None if slot is None else _copy_row_values(v, scope, v[slot]) for slot in which]
            good = np.ones(len(rows), np.bool_)
            for arg in args if refused else ():
                good &= True if arg is None else np.isfinite(arg)
            if not good.all():
                _record_fault(v, block, refused, statement.span, rows[~good])
            if row.needs_positive_operand and args[0] is not None:
                good &= args[0] > 0
            if good.all():
                v[EFFECTS_SLOT].add_request(RequestEntry(statement, order, rows.copy(), tuple(args)))
            else:
                finite_args = tuple(None if arg is None else arg[good] for arg in args)
                v[EFFECTS_SLOT].add_request(RequestEntry(statement, order, rows[good], finite_args))

        return add_requests

    return make_request


def make_statement_call(instruction: BlockInstruction) -> SlotFunctionMaker:
    """Return the maker of the call for any statement except `If`."""
    what, block, scope, order = instruction.subject, instruction.block, instruction.scope, instruction.statement_order
    match what:
        case ir.Store():
            return _make_store_call(what, block, scope)
        case ir.Claim():
            return _make_claim_call(what, block, scope, order)
        case ir.Give():
            return _make_gift_call(what, block, scope)
        case ir.Request():
            return _make_request_call(what, block, scope, order)
    raise AssertionError(f"no call for {what!r}")
