"""Measures the time of each call of a compiled block, without the time of the calls nested in it."""

from __future__ import annotations

from collections.abc import Iterator
from time import perf_counter

from antdsl.runtime.backends.block_compiler import (
    CALL_SECONDS_SLOT,
    BlockCompiler,
    BlockInstruction,
    RowScope,
    SlotFunction,
    SlotValues,
)


class BlockCallMeter:
    """A compiled block with calls that are timed until `stop_metering` is called.

    `seconds`: the time of each of `instructions`. If several threads run, times are scaled so that their sum does not exceed the
    elapsed time."""

    def __init__(self, compiler: BlockCompiler) -> None:
        self.instructions: list[BlockInstruction] = []
        self.seconds: list[float] = []
        self._original_calls: list[tuple[RowScope, list[SlotFunction]]] = []
        for scope in _iterate_scopes(compiler.root_scope):
            first = len(self.instructions)
            self.instructions += scope.code  # in the order of `list_scope_instructions`
            self._original_calls.append((scope, scope.bound_calls))
            scope.bound_calls = [_make_timed_call(call, first + k) for k, call in enumerate(scope.bound_calls)]
        self.reset_counters()

    def reset_counters(self) -> None:
        """Set all counters to 0."""
        self.seconds = [0.0] * len(self.instructions)

    def make_counters(self) -> list[float]:
        """Return counters for one chunk, all 0: one time (s) for each instruction, and a last one for the calls nested in the
        current call."""
        return [0.0] * (len(self.instructions) + 1)

    def add_counters(self, counters: list[list[float]], elapsed: float) -> None:
        """Add the times of one run of the block to `seconds`. `counters`: those of all chunks. `elapsed`: the wall time (s) of
        the run."""
        share = min(1.0, elapsed / max(sum(lane[-1] for lane in counters), 1e-12))
        for lane in counters:
            for k, seconds in enumerate(lane[:-1]):
                self.seconds[k] += seconds * share

    def stop_metering(self) -> None:
        """Replace the timed calls by the block's original calls."""
        for scope, calls in self._original_calls:
            scope.bound_calls = calls


def list_scope_instructions(root: RowScope) -> list[BlockInstruction]:
    """Return the instructions of a scope and its inner scopes, in the order of `BlockCallMeter.instructions`."""
    return [each for scope in _iterate_scopes(root) for each in scope.code]


def _iterate_scopes(root: RowScope) -> Iterator[RowScope]:
    pending = [root]
    while pending:
        scope = pending.pop()
        yield scope
        pending += [each.inner_scope for each in scope.code if each.inner_scope is not None]


def _make_timed_call(call: SlotFunction, counter_index: int) -> SlotFunction:
    """Return `call` wrapped in a function that adds its time, without nested calls, to counter `counter_index`."""

    def run_timed(v: SlotValues) -> None:
        spent = v[CALL_SECONDS_SLOT]
        around, spent[-1] = spent[-1], 0.0
        began = perf_counter()
        call(v)
        took = perf_counter() - began
        spent[counter_index] += took - spent[-1]
        spent[-1] = around + took

    return run_timed
