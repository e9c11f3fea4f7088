"""The lowering rules, one for each operation of the vocabulary. A rule turns an `OperationExpr` of the typed tree into nodes."""

from __future__ import annotations

from collections.abc import Callable

from antdsl.plan.lowering import clips, pair_values
from antdsl.plan.lowering.rules import chance, logic, numbers, places, senses
from antdsl.plan.lowering.sets import lower_reduction, lower_set
from antdsl.plan.lowering.values import LoweredValue
from antdsl.plan.lowering.writer import LoweringRules, PlanWriter
from antdsl.program import model

OPERATION_RULES: dict[str, Callable[[PlanWriter, model.OperationExpr], LoweredValue]] = {
    **numbers.NUMBER_RULES,
    **numbers.VECTOR_RULES,
    **logic.LOGIC_RULES,
    **chance.CHANCE_RULES,
    **places.PLACE_RULES,
    **senses.SENSE_RULES,
}
LOWERING_RULES = LoweringRules(
    OPERATION_RULES, lower_set, lower_reduction, pair_values.read_pair_attribute, clips.lower_clip_test, places.locate_point
)
