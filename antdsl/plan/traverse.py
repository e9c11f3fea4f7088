"""Iterates over a plan: the statements in order, the nodes that a statement uses directly, and all nodes that these depend on."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from antdsl.plan.ir import (
    SENSE_OPERATIONS,
    Block,
    Claim,
    FieldPlan,
    Give,
    If,
    Plan,
    PlanNode,
    PlanStatement,
    Request,
    SpeciesPlan,
    Store,
)

PHASES = ("born", "decide", "act", "blend")


def list_operands(statement: PlanStatement) -> tuple[PlanNode, ...]:
    """Return the nodes that a statement uses directly."""
    match statement:
        case If():
            return (statement.condition,)
        case Store():
            return (statement.value,)
        case Claim():
            return tuple(node for node in (statement.item, statement.amount) if node is not None)
        case Give():
            return (statement.item,) if statement.amount is None else (statement.item, statement.amount)
        case Request():
            return tuple(node for node in statement.args if node is not None)


def iterate_statements(block: Block) -> Iterator[tuple[Block, PlanStatement]]:
    """Yield each statement in order, together with the block that contains it. An If comes before the statements inside it."""
    for statement in block.statements:
        yield block, statement
        if isinstance(statement, If):
            yield from iterate_statements(statement.body)


def iterate_with_positions(block: Block, path: tuple[int, ...] = ()) -> Iterator[tuple[tuple[int, ...], PlanStatement]]:
    """Yield each statement in order, together with its position. The position is a tuple of indices: one in each block that
    contains the statement, outermost first."""
    for k, statement in enumerate(block.statements):
        yield (*path, k), statement
        if isinstance(statement, If):
            yield from iterate_with_positions(statement.body, (*path, k))


def list_blocks(species: SpeciesPlan) -> tuple[tuple[str, Block], ...]:
    """Return the name of each phase in PHASES, with the block of the species that runs in this phase."""
    return tuple((phase, getattr(species, phase)) for phase in PHASES)


def collect_required_nodes(roots: Iterable[PlanNode]) -> list[PlanNode]:
    """Return the nodes `roots` and all nodes on which they depend, without duplicates. Operands come before the operations that
    use them."""
    nodes_by_number: dict[int, PlanNode] = {}
    stack = list(roots)
    while stack:
        node = stack.pop()
        if node.number not in nodes_by_number:
            nodes_by_number[node.number] = node
            stack += node.args
    return [nodes_by_number[number] for number in sorted(nodes_by_number)]


def list_field_nodes(field: FieldPlan) -> tuple[PlanNode, ...]:
    """Return the nodes of a field's settings."""
    return tuple(n for n in (field.cell, field.retained_share, field.diffuse, field.limit) if n is not None)


def list_root_nodes(plan: Plan) -> list[PlanNode]:
    """Return every node that the plan uses directly, that is, not only as an operand of another node."""
    nodes: list[PlanNode] = []
    for species in plan.species.values():
        for _, block in list_blocks(species):
            for _, statement in iterate_statements(block):
                nodes += list_operands(statement)
        nodes += species.memoised_senses
    for field in plan.fields.values():
        nodes += list_field_nodes(field)
    return nodes + [p.default for p in plan.params.values()]


def find_registers_read(nodes: Iterable[PlanNode]) -> set[str]:
    """Return the names of the agent's own registers that the nodes read."""
    return {node.attrs[0] for node in nodes if node.op in ("snap", "load")}


def find_shared_senses(*phases: Block) -> tuple[PlanNode, ...]:
    """Return the senses that are used at least twice, in order of their node numbers.

    Every block that uses a sense counts as one use. So does every shared sense that has the sense as an operand."""
    users: dict[PlanNode, set[object]] = {}
    for phase in phases:
        for block, statement in iterate_statements(phase):
            for sense in find_nearest_senses(list_operands(statement)):
                users.setdefault(sense, set()).add(block)
    shared_senses: list[PlanNode] = []
    waiting = set(users)
    while waiting:
        sense = max(waiting, key=lambda node: node.number)  # its users have greater numbers, so they were processed before
        waiting.remove(sense)
        alone = len(users[sense]) == 1
        if not alone:
            shared_senses.append(sense)
        for inner in find_nearest_senses(sense.args):
            users.setdefault(inner, set()).update(users[sense] if alone else (sense,))
            waiting.add(inner)
    return tuple(reversed(shared_senses))


def find_nearest_senses(roots: Iterable[PlanNode]) -> set[PlanNode]:
    """Return the senses that the nodes `roots` use directly or through operations, but not through another sense."""
    senses: set[PlanNode] = set()
    visited: set[PlanNode] = set()
    stack = list(roots)
    while stack:
        node = stack.pop()
        if node in visited:
            continue
        visited.add(node)
        if node.op in SENSE_OPERATIONS:
            senses.add(node)
        else:
            stack += node.args
    return senses
