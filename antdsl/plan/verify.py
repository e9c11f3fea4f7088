"""The rules of a valid plan, checked between passes and in tests. A broken plan is an internal error, so it raises an
exception."""

from __future__ import annotations

from collections.abc import Container, Iterator

from antdsl.plan.builder import PlanError, find_operand_problem, infer_result_kind, infer_result_rate
from antdsl.plan.ir import (
    Block,
    Claim,
    Give,
    If,
    ItemsPlan,
    Plan,
    PlanNode,
    PlanStatement,
    Request,
    SpeciesPlan,
    Store,
    UpdateRate,
    ValueKind,
)
from antdsl.plan.traverse import (
    collect_required_nodes,
    iterate_statements,
    list_blocks,
    list_field_nodes,
    list_operands,
    list_root_nodes,
)
from antdsl.program.tables.effects import EFFECT_BY_OPERATION
from antdsl.program.tables.senses import SENSE_BY_OPERATION
from antdsl.program.tables.things import KIND_BY_WORD, list_replacements

_READ_OPERATIONS = ("snap", "load")
# whether the operation reduces over items
_READS_ITEMS_BY_OPERATION = {"reduce.agent": False, "reduce.nth_agent": False, "reduce.item": True, "reduce.nth_item": True}
_BUILTIN_ITEM_VALUES = {"position", "velocity", "heading", "up"}


def verify_plan(plan: Plan) -> None:
    """Raise PlanError if the plan breaks a rule. The message lists all errors."""
    wrong = [*_check_nodes(plan), *_check_names(plan)]
    for species in plan.species.values():
        wrong += [f"{species.name}: {text}" for text in _check_species(plan, species)]
    for field in plan.fields.values():
        wrong += [f"field {field.name}: {n!r} changes within a run" for n in list_field_nodes(field) if n.rate > UpdateRate.RUN]
    for param in plan.params.values():
        if param.default.rate > UpdateRate.RUN:
            wrong.append(f"param {param.name}: its default changes within a run")
    if wrong:
        raise PlanError("\n".join(wrong))


# --- nodes -----------------------------------------------------------------------------------------------------------


def _check_nodes(plan: Plan) -> Iterator[str]:
    """Yield an error for each node that does not match the table of operations, precedes an operand, or is not in the plan's
    list."""
    known = set(plan.nodes)
    for node in list_root_nodes(plan):
        if node not in known:
            yield f"{node!r} is not in the plan's list"
    for place, node in enumerate(plan.nodes):
        text = find_operand_problem(node.op, node.args, node.attrs)
        if text:
            yield f"{node!r}: {text}"
            continue
        if node.number != place:
            yield f"{node!r} has the number {node.number} at index {place}"
        if any(a.number >= node.number or a not in known for a in node.args):
            yield f"{node!r} comes before one of its operands"
        if node.kind is not infer_result_kind(node.op, node.args, node.attrs, node.kind):
            yield f"{node!r} is declared as {node.kind.value}"
        if node.rate != infer_result_rate(node.op, node.args):
            yield f"{node!r} is declared to change per {node.rate.name}"
        if node.op.startswith("set.") and any(a.rate > UpdateRate.AGENT for a in node.args):
            yield f"{node!r}: a set's size depends on an element"


def _check_names(plan: Plan) -> Iterator[str]:
    """Yield an error for each name in a node that does not exist. Unknown names of species are allowed, because a species may be
    in another file."""
    things = collect_names_by_kind(plan)
    known: dict[str, Container[str]] = {
        **{
            row.op: things[row.thing_kind] for row in SENSE_BY_OPERATION.values() if row.thing_kind not in ("", "species")
        },
        "item.get": plan.items, "item.alive": plan.items, "set.items": plan.items,
        "surface.touching": plan.list_things_of_kind("surface"), "param": plan.params,
    }  # fmt: skip
    for node in plan.nodes:
        if node.op in known and node.attrs[0] not in known[node.op]:
            yield f"{node!r} names {node.attrs[0]!r}, which does not exist"
        if node.op == "item.get" and node.attrs[0] in plan.items:
            yield from _check_item_value(plan.items[node.attrs[0]], node, node.attrs[1])
        if node.op == "agent.get" and node.attrs[0] in plan.species:
            yield from _check_register(plan.species[node.attrs[0]], node, node.attrs[1])
        if node.op.startswith("reduce."):
            yield from _check_elements(plan, node)


def collect_names_by_kind(plan: Plan) -> dict[str, Container[str]]:
    """Return the names of the plan's things, by the kind of thing."""
    return {
        **{kind: plan.list_things_of_kind(kind) for kind in KIND_BY_WORD}, "items": plan.items, "species": plan.species,
        "field": plan.fields, "target": plan.list_things_of_kind(*list_replacements("obstacle")),
    }  # fmt: skip


def _check_elements(plan: Plan, reduction: PlanNode) -> Iterator[str]:
    """Yield an error for each value that a reduction reads but that its elements do not have."""
    source = reduction.args[0]
    of_items = source.op == "set.items"
    labels = _READS_ITEMS_BY_OPERATION.get(reduction.op)
    if labels is not None and labels != of_items:
        yield f"{reduction!r} over {source.op}"
    for node in _iterate_pair_nodes(reduction.args[1:]):
        if node.op == ("other.id" if of_items else "other.row"):
            yield f"{reduction!r} reads {node.op} over {source.op}"
        if node.op != "other":
            continue
        if of_items:
            items = plan.items.get(source.attrs[0])
            if items is not None:
                yield from _check_item_value(items, node, node.attrs[0])
        elif source.attrs[0] in plan.species:
            yield from _check_register(plan.species[source.attrs[0]], node, node.attrs[0])


def _iterate_pair_nodes(nodes: tuple[PlanNode, ...]) -> Iterator[PlanNode]:
    """Yield the nodes of a reduction that are evaluated for each pair, without the nodes of nested reductions.

    `nodes`: the operands of the reduction."""
    stack, visited = list(nodes), set()
    while stack:
        node = stack.pop()
        if node in visited or node.rate is not UpdateRate.PAIR:
            continue
        visited.add(node)
        yield node
        stack += node.args


def _check_item_value(items: ItemsPlan, node: PlanNode, attribute: str) -> Iterator[str]:
    if attribute not in ("x", "y", "z", "radius", *items.attributes):
        yield f"{node!r}: {items.name} have no {attribute}"


def _check_register(species: SpeciesPlan, node: PlanNode, name: str) -> Iterator[str]:
    register = species.registers.get(name)
    if register is None:
        yield f"{node!r}: {species.name} has no register {name}"
    elif register.kind is not node.kind:
        yield f"{node!r}: register {name} of {species.name} is a {register.kind.value}"


# --- statements ------------------------------------------------------------------------------------------------------


def _check_species(plan: Plan, species: SpeciesPlan) -> Iterator[str]:
    for name, register in species.registers.items():
        if name != register.name:
            yield f"register {register.name} is stored under the name {name}"
    for vector in _BUILTIN_ITEM_VALUES | {"push"}:
        for axis in "xyz":
            if f"{vector}.{axis}" not in species.registers:
                yield f"no register {vector}.{axis}"
    for phase, block in list_blocks(species):
        for _, statement in iterate_statements(block):
            yield from (f"{phase}: {text}" for text in _check_statement(plan, species, statement))
        for node in collect_required_nodes(n for _, s in iterate_statements(block) for n in list_operands(s)):
            if node.op in _READ_OPERATIONS:
                yield from (f"{phase}: {text}" for text in _check_register(species, node, node.attrs[0]))
            if phase == "born" and node.op == "snap":
                yield f"born: {node!r} reads a value from before the birth"
    yield from _check_load_order(Block((*species.decide.statements, *species.act.statements, *species.blend.statements)))
    yield from _check_load_order(species.born)


def _check_statement(plan: Plan, species: SpeciesPlan, statement: PlanStatement) -> Iterator[str]:
    for node in list_operands(statement):
        if node.rate is UpdateRate.PAIR:
            yield f"{type(statement).__name__} of {node!r}, which depends on an element of a set"
    match statement:
        case If():
            if statement.condition.kind is not ValueKind.BOOL:
                yield f"the condition of If is {statement.condition!r}"
        case Store():
            register = species.registers.get(statement.register)
            if register is None:
                yield f"Store to {statement.register}, which does not exist"
            elif register.kind is not statement.value.kind:
                yield f"Store of {statement.value!r} to {register.name}, a {register.kind.value}"
        case Claim() | Give():
            of = statement.target if isinstance(statement, Claim) else statement.items
            items = plan.items.get(of)
            if statement.item is None:
                if of not in plan.fields:
                    yield f"Claim of {of}, which does not exist"
            elif items is None or statement.attribute not in items.attributes:
                yield f"{type(statement).__name__} of {of}.{statement.attribute}, which does not exist"
            if statement.register is not None and statement.register not in species.registers:
                yield f"{type(statement).__name__} for {statement.register}, which does not exist"
            if statement.item is not None and statement.item.kind is not ValueKind.I32:
                yield f"{type(statement).__name__} with {statement.item!r} for an item"
        case Request():
            yield from _check_request(plan, species, statement)


def _check_request(plan: Plan, species: SpeciesPlan, statement: Request) -> Iterator[str]:
    """Yield an error if a request does not match its row in the table of effects, or names a thing that does not exist."""
    row = EFFECT_BY_OPERATION.get(statement.op)
    if row is None:
        yield f"no effect {statement.op}"
        return
    word, known_names = row.op.capitalize(), collect_names_by_kind(plan).get(row.target)
    if known_names is not None and statement.target not in known_names:
        yield f"{word} of {statement.target}, which does not exist"
    if statement.register is not None and statement.register not in species.registers:
        yield f"{word} for {statement.register}, which does not exist"
    if len(statement.args) != len(row.operand_names):
        yield f"{word} takes {row.operand_names}, not {statement.args!r}"
    for name, node in zip(row.operand_names, statement.args, strict=False):
        if node is None and name not in row.optional_operands:
            yield f"{word} without {name}"
        elif node is not None and node.kind is not (ValueKind.I64 if name in row.agent_operands else ValueKind.F32):
            yield f"{word} with {node!r} for {name}"
        elif node is not None and name in row.agent_operands and statement.target_species is None:
            yield f"{word} does not name the species of the agent for {name}"


class _RegisterLoadState:
    """The loads and stores seen so far while a block is checked.

    `version`: by register, the number of stores before the last load. `stale_registers`: the registers that have been stored to
    since their last load."""

    def __init__(self) -> None:
        self.version: dict[str, int] = {}
        self.stale_registers: set[str] = set()


def _check_load_order(block: Block) -> Iterator[str]:
    """Yield an error for each load that is used both before and after a store to its register. Also yield an error for each load
    with a lower version than an earlier one."""
    state = _RegisterLoadState()
    yield from _check_block_order(block, state)


def _check_block_order(block: Block, state: _RegisterLoadState) -> Iterator[str]:
    for statement in block.statements:
        for node in collect_required_nodes(list_operands(statement)):
            if node.op != "load":
                continue
            name, version = node.attrs
            last = state.version.get(name)
            if last is not None and version < last:
                yield f"{node!r} is older than a load before it, of version {last}"
            elif last == version and name in state.stale_registers:
                yield f"{node!r} is loaded before and after a store"
            state.version[name] = max(version, last or 0)
            state.stale_registers.discard(name)
        for name in find_written_registers(statement):
            state.stale_registers.add(name)
        if isinstance(statement, If):
            yield from _check_block_order(statement.body, state)


def find_written_registers(statement: PlanStatement) -> tuple[str, ...]:
    """Return the registers that a statement may change. Statements nested inside it are not considered."""
    match statement:
        case Store():
            return (statement.register,)
        case Claim():
            return (statement.won_register,) if statement.register is None else (statement.won_register, statement.register)
        case Give():
            return (statement.register,)
        case _:
            return ()
