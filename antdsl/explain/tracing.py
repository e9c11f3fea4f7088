"""Traces of one agent's step, made with the reference backend.

A trace has the values of all nodes with notes, the random draws, the assignments and the senses. It is made in addition to the
step, on copies of the agent's registers, so nothing in the world changes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from antdsl.plan import ir
from antdsl.plan.lowering.source_map import ChangeNote, ExpressionNote, LayerNote, SourceNotes
from antdsl.plan.registers import number_statements
from antdsl.program.tables.senses import SENSE_BY_OPERATION
from antdsl.runtime.backends.reference import STEP_BLOCKS, AgentRun, SetMember, apply_claim_results
from antdsl.runtime.requests import ClaimEntry, EffectRequests
from antdsl.runtime.world import DTYPE_BY_KIND, Population, World

_DRAW_OPERATIONS = frozenset(("draw", "draw.agent"))


@dataclass(slots=True, eq=False)
class AgentTrace:
    """What an agent computed and requested in one step.

    - `row`: the row of the agent in its population.
    - `start_registers`, `end_registers`: the registers of the agent at the start of the step, and after all blocks.
    - `values`: the values of nodes that have notes. `draw_values`: the values of random draws.
    - `set_members`: the members of the sets that the agent searched. `senses`: the results of other senses.
    - `claims`: the claims of the agent, in text order. `effects`: its other requests to the world."""

    row: int
    start_registers: dict[str, Any]
    end_registers: dict[str, Any]
    values: dict[ir.PlanNode, Any] = field(default_factory=dict)
    set_members: dict[ir.PlanNode, list[SetMember]] = field(default_factory=dict)
    senses: dict[ir.PlanNode, Any] = field(default_factory=dict)
    draw_values: dict[ir.PlanNode, Any] = field(default_factory=dict)
    claims: list[ClaimEntry] = field(default_factory=list)
    effects: EffectRequests = field(default_factory=EffectRequests)


class TracedAgent(AgentRun):
    """An agent that records the values of nodes with notes while it runs the blocks of a step."""

    def __init__(
        self,
        world: World,
        population: Population,
        plan: ir.SpeciesPlan,
        row: int,
        registers: dict[str, Any],
        notes: SourceNotes,
        replacement_by_node: Mapping[ir.PlanNode, ir.PlanNode],
    ) -> None:
        super().__init__(world, population, row, registers, 0, EffectRequests(), number_statements(plan))
        self.plan, self.notes, self.replacement_by_node = plan, notes, replacement_by_node
        self.trace = AgentTrace(row, {name: array[0] for name, array in registers.items()}, {})

    def run_step_blocks(self) -> AgentTrace:
        """Run the blocks of a step in order. The claims of the agent get the results that they had in the actual step of the
        world. Return the trace."""
        for block in STEP_BLOCKS:
            self.run(block, self.plan)
            if block == "decide":
                self._fill_impossible_changes()
                self.trace.claims = list(self.effects.claims)
                apply_claim_results(self, self.population)
            self._record_block_values(block)
        self.trace.end_registers = {name: array[0] for name, array in self.now.items()}
        self.trace.effects = self.effects
        return self.trace

    def _fill_impossible_changes(self) -> None:
        """Compute the values of transitions that can never happen. They are missing in the record, because no register stores
        them."""
        for note in self.notes.changes:
            if note.state.index == int(self.trace.start_registers[f"{note.machine}.state"]):
                for node in list_change_nodes(note):
                    if node not in self.trace.values:
                        self.trace.values[node] = self.compute_value(self.replacement_by_node.get(node, node))

    def _store(self, s: ir.Store) -> None:
        super()._store(s)
        machine = s.register.removeprefix("~").removesuffix(".pending")
        if s.register == f"~{machine}.pending":
            state = int(self.trace.start_registers[f"{machine}.state"])
            for note in self.notes.changes:
                if note.machine == machine and note.state.index == state:
                    for node in list_change_nodes(note):
                        self.trace.values[node] = self.compute_value(self.replacement_by_node[node])

    def _find_members(self, node: ir.PlanNode) -> list[SetMember]:
        self.trace.set_members[node] = super()._find_members(node)
        return self.trace.set_members[node]

    def _record_block_values(self, block: str) -> None:
        """Record the values that a block has computed. Values that were not computed, such as the senses of a layer without
        strength, are omitted."""
        for node, value in self.values.items():
            if node.op in SENSE_BY_OPERATION:
                self.trace.senses[node] = value
            elif node.op in _DRAW_OPERATIONS:
                self.trace.draw_values[node] = value
        if block == "act":
            self._record_values(list_act_nodes(self.notes))
        elif block == "blend":
            self._record_values([node for note in self.notes.layers for node in list_layer_nodes(note)])

    def _record_values(self, nodes: list[ir.PlanNode]) -> None:
        for node in nodes:
            current_node = self.replacement_by_node[node]
            if current_node in self.values:
                self.trace.values[node] = self.values[current_node]
            elif current_node.rate <= ir.UpdateRate.STEP:
                self.trace.values[node] = self.compute_value(current_node)


def trace_agent(
    world: World,
    population: Population,
    plan: ir.SpeciesPlan,
    row: int,
    notes: SourceNotes,
    replacement_by_node: Mapping[ir.PlanNode, ir.PlanNode],
) -> AgentTrace:
    """Return the trace of the agent in `row`. Its current step must have run all blocks but not yet applied any effects.

    `plan`, `notes`: the result of lowering the same program again, with notes. `replacement_by_node`: for each node with a note,
    the node that replaced it in the plan."""
    now = {}
    for name, register in plan.registers.items():
        if register.role == "temp":
            now[name] = np.full(1, register.initial_value, DTYPE_BY_KIND[register.kind])
        else:
            now[name] = population.start[name][row : row + 1].copy()
    with np.errstate(all="ignore"):
        return TracedAgent(world, population, plan, row, now, notes, replacement_by_node).run_step_blocks()


def list_part_nodes(note: ExpressionNote | None) -> list[ir.PlanNode]:
    """Return all nodes that have values in a note about a condition, including its parts."""
    if note is None:
        return []
    return [*note.nodes, *(node for part in note.parts for node in list_part_nodes(part))]


def list_change_nodes(note: ChangeNote) -> list[ir.PlanNode]:
    """Return all nodes of a transition, from its note."""
    timers = [node for timer in note.timers for node in (timer.elapsed, timer.required, timer.is_over)]
    condition_nodes = [note.is_taken] if note.condition_value is None else [note.is_taken, note.condition_value]
    return [*condition_nodes, *timers, *list_part_nodes(note.condition), *list_part_nodes(note.take_note)]


def list_layer_nodes(note: LayerNote) -> list[ir.PlanNode]:
    """Return all nodes of a layer, from its note."""
    return [note.budget_left, note.has_budget, note.condition_value, *note.push, *list_part_nodes(note.condition)]


def list_act_nodes(notes: SourceNotes) -> list[ir.PlanNode]:
    """Return the nodes with notes that run in the block `act`: those of `steer` and `face` lines, and of choices of a state."""
    chosen = [node for note in notes.choices.values() for node in (note.draw, *(n for _, n in note.weights))]
    steered = [
        node for note in notes.steers for node in (*note.push, *([] if note.condition_value is None else [note.condition_value]))
    ]
    return [*steered, *chosen]


def list_noted_nodes(notes: SourceNotes) -> list[ir.PlanNode]:
    """Return all nodes of a species that have notes."""
    changes = [node for note in notes.changes for node in list_change_nodes(note)]
    return [*changes, *list_act_nodes(notes), *(node for note in notes.layers for node in list_layer_nodes(note))]
