"""The calls that statements become in compiled blocks: what is stored, and what is asked of the rest of the world."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.plan import ir
from antdsl.runtime.backends.compile import EFFECTS, POPULATION, WORLD, BlockCompiler, Run, Scope, Slots
from antdsl.runtime.backends.numpy_calls import ALL, Make, row_numbers
from antdsl.runtime.effects import CarveEntry, ClaimEntry, DepositEntry, EmitEntry, FaultEntry, GiveEntry, SpawnEntry


def _each(v: Slots, scope: Scope, value: Any) -> NDArray[Any]:
    """One value for each row, in an array of its own: buffers are written again."""
    return np.full(v[scope.size], value) if value.ndim == 0 else value.copy()


def sound(value: NDArray[Any], infinite: bool) -> NDArray[np.bool_]:
    """Which values may be kept."""
    good: NDArray[np.bool_] = np.isfinite(value)
    return good | (value == np.inf) if infinite else good


def _refuse(v: Slots, block: str, register: str, span: Any, rows: NDArray[np.intp]) -> None:
    v[EFFECTS].faults.append(FaultEntry(block, register, span, rows))


def _store(statement: ir.Store, block: str, scope: Scope) -> Make:
    name, infinite, span = statement.register, statement.infinite, statement.span
    number = statement.value.kind is ir.Kind.F32

    def make(out: int, inputs: tuple[int, ...], buffer: int | None) -> Run:
        (a,) = inputs

        def run(v: Slots) -> None:
            value, rows = v[a], v[scope.rows]
            target = v[POPULATION].now[name]
            good = sound(value, infinite) if number else None
            if good is None or good.all():
                target[rows] = value
                return
            rows = row_numbers(rows)
            if value.ndim == 0:
                _refuse(v, block, name, span, rows)
                return
            target[rows[good]] = value[good]
            _refuse(v, block, name, span, rows[~good])

        return run

    return make


def _amounts(v: Slots, scope: Scope, block: str, what: str, span: Any, value: Any) -> tuple[NDArray[np.intp], NDArray[Any], Any]:
    """Rows and values of those whose value is finite; the others are at fault. Last: which they are of the scope's rows."""
    rows, value = row_numbers(v[scope.rows]), _each(v, scope, value)
    good = np.isfinite(value)
    if good.all():
        return rows, value, ALL
    _refuse(v, block, what, span, rows[~good])
    return rows[good], value[good], good


def _deposit(statement: ir.Deposit, block: str, scope: Scope) -> Make:
    def make(out: int, inputs: tuple[int, ...], buffer: int | None) -> Run:
        def run(v: Slots) -> None:
            rows, amount, _ = _amounts(v, scope, block, f"deposit {statement.field}", statement.span, v[inputs[0]])
            v[EFFECTS].deposits.append(DepositEntry(statement.field, rows, amount))

        return run

    return make


def _claim(statement: ir.Claim, block: str, scope: Scope, order: int) -> Make:
    def make(out: int, inputs: tuple[int, ...], buffer: int | None) -> Run:
        def run(v: Slots) -> None:
            rows, amount, good = _amounts(v, scope, block, f"take {statement.attribute}", statement.span, v[inputs[1]])
            item = _each(v, scope, v[inputs[0]])[good]
            v[EFFECTS].claims.append(ClaimEntry(statement, order, rows, item, amount))

        return run

    return make


def _give(statement: ir.Give, block: str, scope: Scope) -> Make:
    def make(out: int, inputs: tuple[int, ...], buffer: int | None) -> Run:
        def run(v: Slots) -> None:
            own = v[POPULATION].now[statement.own]
            item = _each(v, scope, v[inputs[0]])
            if statement.amount is None:
                rows = row_numbers(v[scope.rows])
                amount = own[rows]
            else:
                rows, amount, good = _amounts(v, scope, block, f"give {statement.own}", statement.span, v[inputs[1]])
                item = item[good]
            there = (item >= 0) & (item < len(v[WORLD].items[statement.items]))
            rows, amount, item = rows[there], amount[there], item[there]
            had = own[rows]
            left = had - np.clip(amount, np.float32(0), np.maximum(had, np.float32(0)))
            own[rows] = left
            v[EFFECTS].gives.append(GiveEntry(statement, item, had.astype(np.float64) - left.astype(np.float64)))

        return run

    return make


def _carve(statement: ir.Carve, block: str, scope: Scope, order: int) -> Make:
    def make(out: int, inputs: tuple[int, ...], buffer: int | None) -> Run:
        def run(v: Slots) -> None:
            rows = row_numbers(v[scope.rows])
            parts = np.stack([_each(v, scope, v[slot]) for slot in inputs])
            good = np.isfinite(parts).all(axis=0)
            if not good.all():
                _refuse(v, block, f"carve {statement.solid}", statement.span, rows[~good])
            dug = good & (parts[0] > 0)
            v[EFFECTS].carves.append(CarveEntry(statement, order, rows[dug], parts[0, dug], parts[1:, dug].T.copy()))

        return run

    return make


def _emit(statement: ir.Emit, block: str, scope: Scope) -> Make:
    def make(out: int, inputs: tuple[int, ...], buffer: int | None) -> Run:
        def run(v: Slots) -> None:
            within = _each(v, scope, v[inputs[0]]) if inputs else None
            v[EFFECTS].emits.append(EmitEntry(statement.event, row_numbers(v[scope.rows]).copy(), within))

        return run

    return make


def _spawn(statement: ir.Spawn, order: int, scope: Scope) -> Make:
    return lambda out, inputs, buffer: (
        lambda v: v[EFFECTS].spawns.append(SpawnEntry(statement.species, order, row_numbers(v[scope.rows]).copy()))
    )


def _die(scope: Scope) -> Make:
    return lambda out, inputs, buffer: lambda v: v[EFFECTS].deaths.append(row_numbers(v[scope.rows]).copy())


def statement(what: ir.Statement, compiler: BlockCompiler, scope: Scope) -> Make:
    """The maker of any statement but `If`."""
    block = compiler.name
    match what:
        case ir.Store():
            return _store(what, block, scope)
        case ir.Deposit():
            return _deposit(what, block, scope)
        case ir.Claim():
            return _claim(what, block, scope, compiler.place(what))
        case ir.Give():
            return _give(what, block, scope)
        case ir.Carve():
            return _carve(what, block, scope, compiler.place(what))
        case ir.Emit():
            return _emit(what, block, scope)
        case ir.Spawn():
            return _spawn(what, compiler.place(what), scope)
        case ir.Die():
            return _die(scope)
    raise AssertionError(f"no call for {what!r}")
