"""Machine code for reductions over items and over `every`: loops over all members, for eight requesting agents at a time.

`search` contains reductions over neighbours, and `accumulators` the accumulation of results."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from antdsl.machine_code.lanes import Lanes
from antdsl.machine_code.number_kinds import F32, I32, I64
from antdsl.numerics.elementwise import FUNCTION_BY_NAME
from antdsl.plan import ir
from antdsl.plan.traverse import collect_required_nodes
from antdsl.runtime.backends.block_compiler import BlockInstruction, InstructionKind
from antdsl.runtime.backends.native.accumulators import INITIAL_VALUES, LaneReduction
from antdsl.runtime.backends.native.address_layout import LANE_TYPE_BY_KIND
from antdsl.runtime.backends.native.block_writer import BlockWriter, FunctionWriter
from antdsl.runtime.backends.native.stage_schedule import PAIR_INSTRUCTION_KINDS
from antdsl.runtime.world import AXES


def can_compile_node(node: ir.PlanNode, leaves: frozenset[str]) -> bool:
    """Return whether a reduction can be compiled to machine code.

    This is the case if each node that depends on the other agent or item is an elementwise operation or one of `leaves`."""
    known = {"pair.x", "pair.y", "pair.z", "pair.distance", "other", "other.id", "other.row"} | leaves
    pairs = [each for each in collect_required_nodes(node.args[1:]) if each.rate is ir.UpdateRate.PAIR]
    return node.op in INITIAL_VALUES and all(each.op in FUNCTION_BY_NAME or each.op in known for each in pairs)


# --- values of a pair ------------------------------------------------------------------------------------------------


class PairValueCache:
    """The values of nodes for eight pairs. `own_value`: returns the value of a node for the requesting agents. `leaf_value`:
    returns the value of a leaf node for the pairs."""

    def __init__(
        self,
        w: FunctionWriter,
        own_value: Callable[[ir.PlanNode], Lanes],
        leaf_value: Callable[[ir.PlanNode], Lanes],
        senses: Any,
    ) -> None:
        self.w, self.own_value, self.leaf_value, self.senses = w, own_value, leaf_value, senses

    def emit_value(self, node: ir.PlanNode) -> Lanes:
        """Return the value of a node for eight pairs. The code for a node is emitted only once."""

        def emit_node() -> Lanes:
            if node.rate <= ir.UpdateRate.STEP:
                return self.w.emit_uniform_value(LANE_TYPE_BY_KIND[node.kind], "node", node)
            if node.rate is not ir.UpdateRate.PAIR:
                return self.own_value(node)
            if node.op in FUNCTION_BY_NAME:
                result: Lanes = self.w.emit_operation(node.op, *(self.emit_value(each) for each in node.args))
                return result
            if node.op in self.senses:
                result = self.senses[node.op](self.w, node, tuple(self.emit_value(each) for each in node.args))
                return result
            return self.leaf_value(node)

        pair_value: Lanes = self.w.builder.get_or_make(("pair", node), emit_node)
        return pair_value


# --- one by one ------------------------------------------------------------------------------------------------------


def emit_member_loop(b: BlockWriter, first: BlockInstruction) -> None:
    """Emit a loop over all members of a set, for eight requesting agents."""
    e, instructions = b.builder, [first, *b.find_joint_reductions(first)]
    nodes = [each.subject for each in instructions if isinstance(each.subject, ir.PlanNode)]
    sets = find_reduction_sets(instructions)
    own = find_own_values(b, instructions)
    of_items = nodes[0].args[0].op == "set.items"
    name = nodes[0].args[0].attrs[0]
    place = [e.load_lanes(b.emit_array_address("start", f"position.{axis}"), b.row, F32) for axis in AXES]
    reach = {chosen: b.find_slot_value(slots[0]) if of_items else None for chosen, slots in sets.items()}
    for make in own.values():
        make()  # computed before the loop
    mask = b.mask[-1]
    itself = None if of_items or name != b.species else e.load_lanes(b.emit_array_address("ids"), b.row, I64)
    sums = [LaneReduction(e, node, needs_two_words=True) for node in nodes]
    for each in sums:
        each.allocate_values()
    count = b.emit_uniform_value(I64, "items" if of_items else "agents", name, is_scalar=True)
    with e.write_loop(count) as number:

        def load_attribute(attribute: str, kind: str = F32) -> Lanes:
            key = ("item", name, attribute) if of_items else ("other", name, attribute)
            return e.broadcast(e.load_scalar(b.emit_array_address(*key), number, kind))

        dx, dy, dz = (
            load_attribute(axis if of_items else f"position.{axis}") - mine for axis, mine in zip(AXES, place, strict=True)
        )
        distance = np.sqrt((dx * dx + dy * dy) + dz * dz)
        of_pair: dict[str, Lanes] = {"pair.x": dx, "pair.y": dy, "pair.z": dz, "pair.distance": distance}

        def emit_leaf(node: ir.PlanNode) -> Lanes:
            if node.op in of_pair:
                return of_pair[node.op]
            if node.op == "other.row":
                return e.broadcast(e.convert(number, I32))
            if node.op == "other.id":
                return load_attribute("unsorted ids", I64)
            return load_attribute(node.attrs[0], LANE_TYPE_BY_KIND[node.kind])

        pairs = PairValueCache(b, lambda node: own[node](), emit_leaf, b.senses)
        for each, node in zip(sums, nodes, strict=True):
            near = mask
            if of_items:
                near = near & (distance <= reach[node.args[0]])
            elif itself is not None:
                near = near & (load_attribute("unsorted ids", I64) != itself)
            emit_pair_accumulation(
                each,
                node,
                pairs,
                near,
                (lambda: e.broadcast(number)) if of_items else (lambda: load_attribute("unsorted ids", I64)),
            )
    for each, instruction in zip(sums, instructions, strict=True):
        b.record_slot_value(instruction.slot, each.emit_result())


def emit_pair_condition_and_body(node: ir.PlanNode, pairs: PairValueCache, near_mask: Lanes) -> tuple[Lanes, Lanes | None]:
    """Return a mask of the pairs that a reduction includes, and the value of its body for these pairs (None if it has no body).

    `near_mask`: the pairs that are in the set."""
    condition = node.args[1]
    if condition.op != "const.bool" or not condition.attrs[0]:
        near_mask = near_mask & pairs.emit_value(condition)
    return near_mask, pairs.emit_value(node.args[2]) if len(node.args) > 2 else None


def emit_pair_accumulation(
    reduction: LaneReduction, node: ir.PlanNode, pairs: PairValueCache, near_mask: Lanes, label: Callable[[], Lanes]
) -> None:
    """Emit code that adds the pairs that a reduction includes to its intermediate values. `near_mask`: the pairs that are in the
    set."""
    reduction.emit_add_term(
        *emit_pair_condition_and_body(node, pairs, near_mask), label() if node.op in ("reduce.agent", "reduce.item") else None
    )


def find_reduction_sets(instructions: list[BlockInstruction]) -> dict[ir.PlanNode, tuple[int, ...]]:
    """Return, for each set that the given reductions use, the slots of the operands that these reductions need."""
    known = {each.subject: each.inputs for each in instructions[0].scope.code if each.kind is InstructionKind.PAIRS}
    slots_by_set: dict[ir.PlanNode, tuple[int, ...]] = {}
    for each in instructions:
        assert isinstance(each.subject, ir.PlanNode)
        chosen = each.subject.args[0]
        slots_by_set[chosen] = known[chosen]
    return slots_by_set


def find_own_values(b: BlockWriter, instructions: list[BlockInstruction]) -> dict[ir.PlanNode, Callable[[], Any]]:
    """Return, for each node of the requesting agents that the reductions need, a function that returns its value."""
    makers = {each.slot: each for each in instructions[0].scope.code if each.kind in PAIR_INSTRUCTION_KINDS}
    value_makers: dict[ir.PlanNode, Callable[[], Any]] = {}
    for instruction in instructions:
        pending, visited = list(instruction.inputs), set()
        while pending:
            slot = pending.pop()
            producer = makers.get(slot)
            if producer is None or slot in visited:
                continue
            visited.add(slot)
            if producer.kind is InstructionKind.REPEAT_FOR_PAIRS and isinstance(producer.subject, ir.PlanNode):
                value_makers[producer.subject] = lambda source=producer.inputs[0]: b.find_slot_value(source)  # type: ignore[misc]
            elif producer.kind is not InstructionKind.PAIRS:
                pending += producer.inputs
    return value_makers
