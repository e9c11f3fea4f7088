"""The reference backend: plain Python, one agent and one operation at a time. It is slow, and it defines the meaning of plans.

It finds neighbours by measuring the distance to every agent. It shares only geometry (rays, fields, curves) with the other
backends."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from math import ldexp
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.numerics import exact_sums
from antdsl.numerics.elementwise import FUNCTION_BY_NAME
from antdsl.plan import ir
from antdsl.plan.registers import find_early_loads, number_statements
from antdsl.plan.traverse import collect_required_nodes
from antdsl.program.tables.effects import EFFECT_BY_OPERATION
from antdsl.runtime.requests import ClaimEntry, EffectRequests, FaultEntry, GiftEntry, RequestEntry
from antdsl.runtime.sensing.image_pairs import measure_offsets
from antdsl.runtime.sensing.world_senses import SENSE_FUNCTIONS, compute_uniform_leaf
from antdsl.runtime.world import AXES, Population, World
from antdsl.source import Span

SetMember = tuple[int, np.float32, np.float32, np.float32, np.float32]  # row, dx, dy, dz, distance
STEP_BLOCKS = ("decide", "act", "blend")


class ReferenceBackend:
    """The reference backend, with the same interface as the NumPy backend."""

    def __init__(self, plan: ir.Plan) -> None:
        self._orders = {name: number_statements(species) for name, species in plan.species.items()}

    def begin_step(self, world: World) -> None:
        """Do nothing, because this backend caches no data between steps."""

    def list_messages(self) -> list[str]:
        """Return an empty list, because this backend runs everything as requested."""
        return []

    def run(self, world: World, population: Population, block: str, rows: NDArray[np.intp] | None = None) -> None:
        """Run a block for the agents `rows`; None means all agents."""
        rows = np.flatnonzero(~population.quarantined) if rows is None else rows
        with np.errstate(all="ignore"):
            for row in rows:
                agent = AgentRun(
                    world, population, int(row), population.now, int(row), population.effects, self._orders[population.name]
                )
                agent.run(block)


class InvalidNodeValueError(Exception):
    """A signal that ends the repeated run of an agent as soon as it has computed the node with the faulty value."""

    def __init__(self, node: ir.PlanNode) -> None:
        super().__init__()
        self.node = node


class AgentRun:
    """The run of one block for one agent. The agent's register `name` is `now[name][at]`. All other arrays are indexed by
    `row`."""

    def __init__(
        self,
        world: World,
        population: Population,
        row: int,
        registers: dict[str, Any],
        register_index: int,
        effects: EffectRequests,
        order: dict[ir.PlanStatement, int],
    ) -> None:
        self.world, self.population, self.row = world, population, row
        self.now, self.at, self.effects, self.order = registers, register_index, effects, order
        self.rows = np.array([row])
        self.values: dict[ir.PlanNode, Any] = {}
        self.on_fault: Callable[[str, Span | None, ir.PlanNode], None] | None = None

    def run(self, block: str, plan: ir.SpeciesPlan | None = None) -> None:
        """Run a block of the agent's species, or of `plan`, another plan of the same species."""
        tree: ir.Block = getattr(plan or self.population.plan, block)
        self.block, self.values, self.early = block, {}, _find_loads_before_stores(tree)
        self._run_block(tree, ())

    # --- statements ----------------------------------------------------------------------------------------------------

    def _run_block(self, block: ir.Block, path: tuple[int, ...]) -> None:
        for k, statement in enumerate(block.statements):
            for node in self.early.get((*path, k), ()):
                self.compute_value(node)
            if isinstance(statement, ir.If):
                if self.compute_value(statement.condition):
                    self._run_block(statement.body, (*path, k))
            else:
                getattr(self, "_" + type(statement).__name__.lower())(statement)

    def _compute_finite_value(self, node: ir.PlanNode, value_name: str, span: Span | None, infinite: bool = False) -> Any:
        """Return a node's value if it may be stored, else record a fault and return None. `infinite`: whether +inf may be
        stored."""
        value = self.compute_value(node)
        if node.kind is not ir.ValueKind.F32 or np.isfinite(value) or (infinite and value == np.inf):
            return value
        if self.on_fault is not None:
            self.on_fault(value_name, span, node)
        self.effects.faults.append(FaultEntry(self.block, value_name, span, self.rows))
        return None

    def _store(self, s: ir.Store) -> None:
        value = self._compute_finite_value(s.value, s.register, s.span, s.allows_infinity)
        if value is not None:
            self.now[s.register][self.at] = value

    def _claim(self, s: ir.Claim) -> None:
        item = self.population.cells[s.target][self.row] if s.item is None else self.compute_value(s.item)
        amount = (
            np.float32(np.inf)
            if s.amount is None
            else self._compute_finite_value(s.amount, f"take {s.attribute or s.target}", s.span)
        )
        if amount is not None:
            self.effects.claims.append(ClaimEntry(s, self.order[s], self.rows, np.array([item]), np.array([amount])))

    def _give(self, s: ir.Give) -> None:
        item, had = self.compute_value(s.item), self.now[s.register][self.at]
        amount = had if s.amount is None else self._compute_finite_value(s.amount, f"give {s.register}", s.span)
        if amount is None or not 0 <= item < len(self.world.items[s.items]):
            return
        left = had - min(max(amount, np.float32(0)), max(had, np.float32(0))) + np.float32(0)  # never -0
        self.now[s.register][self.at] = left
        self.effects.gifts.append(GiftEntry(s, np.array([item]), np.array([float(had) - float(left)])))

    def _request(self, s: ir.Request) -> None:
        row = EFFECT_BY_OPERATION[s.op]
        refused = row.fault_name.format(of=s.target)
        values = [
            None if node is None else self._compute_finite_value(node, refused, s.span) if refused else self.compute_value(node)
            for node in s.args
        ]
        if any(value is None and node is not None for value, node in zip(values, s.args, strict=True)):
            return
        if row.needs_positive_operand and not (values[0] or 0) > 0:
            return
        args = tuple(None if value is None else np.array([value]) for value in values)
        self.effects.add_request(RequestEntry(s, self.order[s], self.rows, args))

    # --- values --------------------------------------------------------------------------------------------------------

    def compute_value(self, node: ir.PlanNode) -> Any:
        """Return the value of a node for this agent. Each node is computed only once."""
        pending = [node]
        while pending:
            top = pending[-1]
            missing = [] if top in self.values else [n for n in _list_operands_of_own_agent(top) if n not in self.values]
            if missing:
                pending.extend(missing)
                continue
            pending.pop()
            if top not in self.values:
                self.values[top] = self._compute_node(top)
        return self.values[node]

    def _compute_node(self, node: ir.PlanNode) -> Any:
        if node.op in FUNCTION_BY_NAME:
            return FUNCTION_BY_NAME[node.op](*[self.values[a] for a in node.args])
        if node.op == "get":
            return self.values[node.args[0]][node.attrs[0]]
        if node.op == "load":
            return self.now[node.attrs[0]][self.at]
        if node.op == "snap":
            return self.population.start[node.attrs[0]][self.row]
        if node.op.startswith("reduce."):
            return self._compute_reduction(node)
        if node.rate <= ir.UpdateRate.STEP:
            return compute_uniform_leaf(self.world, node)
        return self._compute_sense(node, [self.values[a] for a in node.args])

    def _compute_sense(self, node: ir.PlanNode, args: list[Any]) -> Any:
        results = SENSE_FUNCTIONS[node.op](self.world, self.population, node, self.rows, *[np.array([a]) for a in args])
        return tuple(part[0] for part in results) if isinstance(results, tuple) else results[0]

    # --- sets ----------------------------------------------------------------------------------------------------------

    def _compute_reduction(self, node: ir.PlanNode) -> Any:
        chosen, *parts = node.args
        members = self._find_members(chosen)
        matches: list[tuple[SetMember, Any]] = []
        for member in members:
            pair_values = self._compute_pair_values(chosen, member, parts)
            if pair_values[0]:
                matches.append((member, pair_values[1] if len(pair_values) > 1 else None))
        return _REDUCTION_FUNCTIONS[node.op](self, node, chosen, matches)

    def _find_members(self, node: ir.PlanNode) -> list[SetMember]:
        """Return the members of a set for this agent: the others within the radius and in view, at most as many as the cap."""
        own = [self.population.start[f"position.{axis}"][self.row] for axis in AXES]
        args = [self.values[a] for a in node.args]
        if node.op == "set.items":
            items = self.world.items[node.attrs[0]]
            measured = _measure_distances_to_agents(self.world, [items.visible_values[axis] for axis in AXES], own)
            return [m for m in measured if m[4] <= args[0]]
        other = self.world.populations[node.attrs[0]]
        measured = _measure_distances_to_agents(self.world, [other.start[f"position.{axis}"] for axis in AXES], own)
        if other is self.population:
            measured = [m for m in measured if m[0] != self.row]
        if node.op == "set.every":
            return measured
        measured = [m for m in measured if m[4] <= args[0]]
        if len(measured) > limits.MAX_QUERY_NEIGHBOURS:
            measured = sorted(measured, key=lambda m: (m[4], other.ids[m[0]]))[: limits.MAX_QUERY_NEIGHBOURS]
        if node.attrs[1]:
            return measured
        hx, hy, hz = (self.population.start[f"heading.{axis}"][self.row] for axis in AXES)
        return [m for m in measured if (m[1] * hx + m[2] * hy) + m[3] * hz >= args[1] * m[4]]

    def _compute_pair_values(self, set_node: ir.PlanNode, member: SetMember, roots: list[ir.PlanNode]) -> list[Any]:
        """Return the values of the nodes `roots` for one member of a set."""
        pair_values: dict[ir.PlanNode, Any] = {}
        for node in _list_pair_nodes(tuple(roots)):
            args = [pair_values[a] if a in pair_values else self.values[a] for a in node.args]
            if node.op in FUNCTION_BY_NAME:
                pair_values[node] = FUNCTION_BY_NAME[node.op](*args)
            elif node.op in SENSE_FUNCTIONS:
                pair_values[node] = self._compute_sense(node, args)
            else:
                pair_values[node] = self._read_other_value(set_node, member, node)
        return [pair_values[n] if n in pair_values else self.values[n] for n in roots]

    def _read_other_value(self, set_node: ir.PlanNode, member: SetMember, node: ir.PlanNode) -> Any:
        """Return the value of a leaf node that depends on the other agent or item of a pair."""
        row, dx, dy, dz, distance = member
        named = {"pair.x": dx, "pair.y": dy, "pair.z": dz, "pair.distance": distance, "other.row": np.int32(row)}
        if node.op in named:
            return named[node.op]
        if set_node.op == "set.items":
            return self.world.items[set_node.attrs[0]].visible_values[node.attrs[0]][row]
        other = self.world.populations[set_node.attrs[0]]
        return other.ids[row] if node.op == "other.id" else other.start[node.attrs[0]][row]

    def get_member_id(self, set_node: ir.PlanNode, member: SetMember) -> int:
        """Return the id of an agent, or the number of an item, that is a member of a set."""
        return member[0] if set_node.op == "set.items" else int(self.world.populations[set_node.attrs[0]].ids[member[0]])


@cache
def _find_loads_before_stores(block: ir.Block) -> dict[tuple[int, ...], list[ir.PlanNode]]:
    return find_early_loads(block)


@cache
def _list_pair_nodes(roots: tuple[ir.PlanNode, ...]) -> tuple[ir.PlanNode, ...]:
    """Return those of the nodes `roots` and their operands that have one value per pair. Operands come first."""
    return tuple(n for n in collect_required_nodes(roots) if n.rate == ir.UpdateRate.PAIR)


@cache
def _list_operands_of_own_agent(node: ir.PlanNode) -> tuple[ir.PlanNode, ...]:
    """Return the nodes with one value per agent on which a node depends, directly or through sets and reductions."""
    operands: list[ir.PlanNode] = []
    pending = list(node.args)
    while pending:
        top = pending.pop()
        if top.rate == ir.UpdateRate.PAIR or top.kind is ir.ValueKind.SET:
            pending.extend(top.args)
        else:
            operands.append(top)
    return tuple(dict.fromkeys(operands))


def _measure_distances_to_agents(world: World, positions: list[Any], own_position: list[Any]) -> list[SetMember]:
    """Return every agent as a set member: its row, and its offset and distance (mm) from `own_position`."""
    dx, dy, dz = measure_offsets(world, positions, own_position)
    distance = np.sqrt((dx * dx + dy * dy) + dz * dz)
    return [(k, dx[k], dy[k], dz[k], distance[k]) for k in range(len(distance))]


MemberMatches = list[tuple[SetMember, Any]]
_INFINITY = np.float32(np.inf)


def _reduce_sum(agent: AgentRun, node: ir.PlanNode, set_node: ir.PlanNode, matches: MemberMatches) -> Any:
    quantum = int(node.attrs[0])
    terms = [float(exact_sums.quantise_terms(body, quantum)) for _, body in matches]
    if any(term != term for term in terms):
        return np.float32(np.nan)
    return np.float32(ldexp(sum(int(ldexp(term, -quantum)) for term in terms), quantum))  # integer multiples of the quantum


def _reduce_min(agent: AgentRun, node: ir.PlanNode, set_node: ir.PlanNode, matches: MemberMatches) -> Any:
    least = _INFINITY
    for _, body in matches:
        least = body if body < least else least
    return least + np.float32(0)


def _reduce_max(agent: AgentRun, node: ir.PlanNode, set_node: ir.PlanNode, matches: MemberMatches) -> Any:
    greatest = -_INFINITY
    for _, body in matches:
        greatest = body if body > greatest else greatest
    return greatest + np.float32(0)


def _find_best_label(agent: AgentRun, set_node: ir.PlanNode, matches: MemberMatches) -> int:
    sound = [(body, agent.get_member_id(set_node, member)) for member, body in matches if body == body]
    return min(sound)[1] if sound else -1


def _find_nth_label(agent: AgentRun, node: ir.PlanNode, set_node: ir.PlanNode, matches: MemberMatches) -> int:
    number = np.floor(agent.values[node.args[3]])
    sound = sorted((body, agent.get_member_id(set_node, member)) for member, body in matches if body == body)
    return sound[int(number) - 1][1] if 1 <= number <= len(sound) else -1


_REDUCTION_FUNCTIONS: dict[str, Callable[[AgentRun, ir.PlanNode, ir.PlanNode, MemberMatches], Any]] = {
    "reduce.sum": _reduce_sum,
    "reduce.min": _reduce_min,
    "reduce.max": _reduce_max,
    "reduce.count": lambda agent, node, set_node, matches: np.float32(len(matches)),
    "reduce.any": lambda agent, node, set_node, matches: np.bool_(bool(matches)),
    "reduce.agent": lambda agent, node, set_node, matches: np.int64(_find_best_label(agent, set_node, matches)),
    "reduce.nth_agent": lambda agent, node, set_node, matches: np.int64(_find_nth_label(agent, node, set_node, matches)),
    "reduce.nth_item": lambda agent, node, set_node, matches: np.int32(_find_nth_label(agent, node, set_node, matches)),
    "reduce.item": lambda agent, node, set_node, matches: np.int32(_find_best_label(agent, set_node, matches)),
}


# --- telling a fault -------------------------------------------------------------------------------------------------


def find_fault_operands(
    world: World, population: Population, row: int, block: str, value_name: str, span: Span | None
) -> tuple[tuple[str, str], ...]:
    """Return the operands, as (text, value), of the operation that first produced the non-finite value.

    To find it, the agent's step is repeated without effects, up to that value."""
    now = {name: population.start[name][row : row + 1].copy() for name in population.now}
    for name, register in population.plan.registers.items():
        if register.role == "temp":
            now[name][0] = register.initial_value
    agent = AgentRun(world, population, row, now, 0, EffectRequests(), number_statements(population.plan))

    def check_stored_value(register: str, operand_span: Span | None, node: ir.PlanNode) -> None:
        if agent.block == block and register == value_name and operand_span == span:
            raise InvalidNodeValueError(node)

    agent.on_fault = check_stored_value
    with np.errstate(all="ignore"):
        try:
            for name in ("born",) if block == "born" else STEP_BLOCKS:
                agent.run(name)
                if name == "decide":
                    apply_claim_results(agent, population)
        except InvalidNodeValueError as met:
            return _find_fault_origin(agent, met.node)
    return ()


def apply_claim_results(agent: AgentRun, population: Population) -> None:
    """Set the registers of an agent to the results of its claims, before its step is repeated."""
    for claim in agent.effects.claims:
        won = bool(population.now[claim.statement.won_register][agent.row])
        agent.now[claim.statement.won_register][0] = won
        if won and claim.statement.register is not None:
            if np.isinf(claim.amount[0]):
                got = population.claimed_totals[claim.statement.site][agent.row]
                agent.now[claim.statement.register][0] = float(agent.now[claim.statement.register][0]) + got
            else:
                agent.now[claim.statement.register][0] += claim.amount[0]


def _find_fault_origin(agent: AgentRun, node: ir.PlanNode) -> tuple[tuple[str, str], ...]:
    """Return the operands of the first operation, in evaluation order, with finite operands and a result that is not finite."""

    def is_valid(n: ir.PlanNode) -> bool:
        value = agent.values.get(n)
        return n.kind is not ir.ValueKind.F32 or value is None or bool(np.isfinite(value))

    while True:
        worse = [a for a in node.args if a.op != "const" and not is_valid(a)]  # a constant has the span of its first use
        if not worse:
            break
        node = worse[0]
    operands = {
        a.span.text: agent.values.get(a) for a in node.args if a.span and a.kind is not ir.ValueKind.SET and a.op != "const"
    }
    place = node.span.text if node.span else node.op
    entries = [(place, agent.values.get(node))] + [(text, value) for text, value in operands.items() if text != place]
    return tuple((text, f"{float(value):g}") for text, value in entries if value is not None and not isinstance(value, tuple))
