"""One rule for each operation of the vocabulary: from the typed tree's `Op` to nodes."""

from __future__ import annotations

from collections.abc import Callable

from antdsl.plan.lowering import clips, pair_values
from antdsl.plan.lowering.rules import chance, logic, numbers, places, senses
from antdsl.plan.lowering.sets import lower_set, reduce
from antdsl.plan.lowering.values import Value
from antdsl.plan.lowering.writer import Rules, Writer
from antdsl.program import model

OPERATIONS: dict[str, Callable[[Writer, model.Op], Value]] = {
    **numbers.RULES,
    **numbers.VECTOR_RULES,
    **logic.RULES,
    **chance.RULES,
    **places.RULES,
    **senses.RULES,
}
RULES = Rules(OPERATIONS, lower_set, reduce, pair_values.read, clips.lower_clip_test)
