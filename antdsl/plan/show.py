"""Formats a plan as readable text: the statements of each species at birth and in the phases of a step."""

from __future__ import annotations

import math
from collections import Counter

from antdsl.plan.ir import (
    OPERATION_BY_NAME,
    SENSE_OPERATIONS,
    Block,
    Claim,
    Give,
    If,
    Plan,
    PlanNode,
    PlanStatement,
    Request,
    SpeciesPlan,
    Store,
    UpdateRate,
    ValueKind,
)
from antdsl.plan.traverse import collect_required_nodes, iterate_statements, list_blocks, list_operands
from antdsl.program.tables.effects import EFFECT_BY_OPERATION, fill_template

_INFIX_SYMBOLS = {
    "add": "+", "sub": "-", "mul": "*", "div": "/", "lt": "<", "le": "<=", "gt": ">", "ge": ">=", "eq": "==", "ne": "!=",
    "and": "and", "or": "or",
}  # fmt: skip
_LEAF_OPERATIONS = frozenset(name for name, row in OPERATION_BY_NAME.items() if not row.args and name not in SENSE_OPERATIONS)
_MAX_EXPRESSION_CHARACTERS = 100  # longer expressions are split: their parts get names


def format_plan(plan: Plan) -> str:
    """Return a readable text of a plan. Equal plans have equal texts.

    A value that is used several times gets a name, `a1 = …`, at its first use."""
    parts = [_format_head(plan)]
    for species in plan.species.values():
        parts.append("\n".join(_format_species(species)))
    return "\n\n".join(part for part in parts if part) + "\n"


def _format_head(plan: Plan) -> str:
    """Return the text of a plan's declarations: params, items, fields and things."""
    lines = []
    for param in plan.params.values():
        lines.append(f"param {param.name} = {_ExpressionFormatter().format_node(param.default)}")
    for field in plan.fields.values():
        names = _ExpressionFormatter()
        properties = (field.combine, f"stencil {field.stencil}", f"deposits {field.deposits}")
        lines.append(f"field {field.name} on {', '.join(field.surfaces)} ({', '.join(properties)})")
        for word, node in (
            ("cell", field.cell),
            ("keep", field.retained_share),
            ("diffuse", field.diffuse),
            ("limit", field.limit),
        ):
            if node is not None:
                lines.append(f"  {word} {names.format_node(node)}")
    for items in plan.items.values():
        values = ", ".join(f"{name} = {_format_number(value)}" for name, value in items.attributes.items())
        lines.append(f"items {items.name} {{ {values} }}" if values else f"items {items.name}")
    for kind, thing_names in plan.thing_names_by_kind.items():
        lines += [f"{kind} {name}" for name in thing_names]
    return "\n".join(lines)


def _format_species(species: SpeciesPlan) -> list[str]:
    """Return the lines of text of one species."""
    lines = [f"species {species.name}"]
    for role in ("attribute", "pair", "memory", "temp"):
        mine = [r for r in species.registers.values() if r.role == role]
        names = [r.name if r.kind is ValueKind.F32 else f"{r.name}:{r.kind.value}" for r in mine]
        if names:
            lines.append(f"  {role}: {' '.join(_join_axes(names))}")
    for machine in species.machines:
        lines.append(f"  machine {machine.name}: {' '.join(f'{i}={s}' for i, s in enumerate(machine.states))}")
    if species.event_names:
        lines.append(f"  handles: {' '.join(species.event_names)}")
    for number, layer in enumerate(species.layers, 1):
        lines.append(f"  layer {number}: {' '.join(layer.text.split())}")
    for phase, block in list_blocks(species):
        nodes = collect_required_nodes(n for _, s in iterate_statements(block) for n in list_operands(s))
        lines.append(f"  {phase} ({_format_cost(nodes)})")
        lines += _PhaseFormatter(block, species).format_block(block, "    ")
    return lines


def _join_axes(names: list[str]) -> list[str]:
    """Return the names with the components of each vector joined into one: position.x position.y position.z becomes
    position.xyz."""
    joined: list[str] = []
    for name in names:
        if name.endswith(".x") and f"{name[:-1]}y" in names:
            joined.append(f"{name}yz")
        elif not (name.endswith((".y", ".z")) and f"{name[:-1]}x" in names):
            joined.append(name)
    return joined


def _format_cost(nodes: list[PlanNode]) -> str:
    """Return text with the number of operations per step, per agent and per pair, and the number of senses."""
    work = [n for n in nodes if n.op not in _LEAF_OPERATIONS]
    plain = [n.rate for n in work if n.op not in SENSE_OPERATIONS and n.op != "get"]
    count = Counter("pair" if rate is UpdateRate.PAIR else "agent" if rate is UpdateRate.AGENT else "step" for rate in plain)
    senses = Counter(n.op for n in work if n.op in SENSE_OPERATIONS)
    parts = [f"{count[rate]} per {rate}" for rate in ("step", "agent", "pair") if count[rate]]
    parts += [f"{number} {name}" for name, number in sorted(senses.items())]
    return ", ".join(parts) if parts else "nothing"


def _format_number(x: float) -> str:
    if math.isinf(x):
        return "inf" if x > 0 else "-inf"
    return f"{x:.7g}"


class _ExpressionFormatter:
    """Formatter of expressions. In the text, a node that has a name is replaced by its name."""

    def __init__(self) -> None:
        self.names: dict[PlanNode, str] = {}

    def format_node(self, node: PlanNode) -> str:
        """Return the name of a node or, if it has no name, its expression as text."""
        if node in self.names:
            return self.names[node]
        return self.format_expression(node)

    def format_expression(self, node: PlanNode) -> str:
        """Return the expression of a node as text. A name of the node itself is ignored."""
        inner = [self.format_node(a) for a in node.args]
        op, attrs = node.op, node.attrs
        if op in _INFIX_SYMBOLS:
            left, right = (f"({text})" if _needs_brackets(text) else text for text in inner)
            return f"{left} {_INFIX_SYMBOLS[op]} {right}"
        match op:
            case "const":
                return _format_number(attrs[0])
            case "const.bool":
                return "true" if attrs[0] else "false"
            case "const.i32" | "const.i64":
                return "none" if attrs[0] == -1 else f"#{attrs[0]}"
            case "param" | "run" | "step":
                return str(attrs[0])
            case "snap":
                return f"{attrs[0]}"
            case "load":
                return f"{attrs[0]}'{attrs[1]}"
            case "get":
                return f"{inner[0]}[{attrs[0]}]"
            case "not":
                return f"not({inner[0]})"
            case "other":
                return f"other.{attrs[0]}"
            case "where":
                return f"where({', '.join(inner)})"
        words = [str(a) for a in attrs] + inner
        return f"{op}({', '.join(words)})" if words else op


def _needs_brackets(text: str) -> bool:
    """Return whether text such as `a(b) + c(d)` needs brackets as an operand."""
    depth = 0
    for character in text:
        depth += (character in "([") - (character in ")]")
        if depth == 0 and character == " ":
            return True
    return False


class _PhaseFormatter(_ExpressionFormatter):
    """Formatter of the statements of one phase."""

    def __init__(self, block: Block, species: SpeciesPlan) -> None:
        super().__init__()
        self.species = species
        users: Counter[PlanNode] = Counter()
        everything = [list_operands(s) for _, s in iterate_statements(block)]
        roots = [n for group in everything for n in group]
        for node in collect_required_nodes(roots):
            users.update(node.args)
        users.update(roots)
        self.shared_nodes = {n for n, count in users.items() if count > 1 and n.op not in _LEAF_OPERATIONS and n.op != "get"}
        self.shared_nodes |= {n for n in users if n.op in SENSE_OPERATIONS}
        self.shared_nodes |= self._find_nodes_to_name(collect_required_nodes(roots))

    def _find_nodes_to_name(self, nodes: list[PlanNode]) -> set[PlanNode]:
        """Return the nodes that need a name. Without these names, some expressions would not fit into a line."""
        named: set[PlanNode] = set()
        size: dict[PlanNode, int] = {}
        for node in nodes:
            inner = sum(4 if a in named or a in self.shared_nodes else size[a] for a in node.args)
            size[node] = len(node.op) + sum(len(str(a)) for a in node.attrs) + inner + 3
            if size[node] > _MAX_EXPRESSION_CHARACTERS:
                named.add(node)
        return named

    def format_block(self, block: Block, indent: str) -> list[str]:
        """Return the lines of text of a block. Each name is defined before its first use."""
        result: list[str] = []
        for statement in block.statements:
            result += [indent + line for line in self._format_definitions(statement)]
            place = f"    # {_find_source_line(statement)}" if _find_source_line(statement) else ""
            result.append(indent + self._format_statement(statement) + place)
            if isinstance(statement, If):
                result += self.format_block(statement.body, indent + "  ")
        return result

    def _format_definitions(self, statement: PlanStatement) -> list[str]:
        lines = []
        for node in collect_required_nodes(list_operands(statement)):
            if node in self.shared_nodes and node not in self.names and node.rate is not UpdateRate.PAIR:
                text = self.format_expression(node)
                keep = " (kept)" if node in self.species.memoised_senses else ""
                self.names[node] = f"{'s' if node.op in SENSE_OPERATIONS else 'a'}{len(self.names) + 1}"
                lines.append(f"{self.names[node]} = {text}{keep}")
        return lines

    def _format_statement(self, statement: PlanStatement) -> str:
        match statement:
            case If():
                return f"where {self.format_node(statement.condition)}:"
            case Store():
                return f"{statement.register} := {self.format_node(statement.value)}"
            case Claim():
                amount = "all" if statement.amount is None else self.format_node(statement.amount)
                if statement.item is None:
                    receiver = f" for {statement.register}" if statement.register else ""
                    return f"claim {amount} of {statement.target} here{receiver} -> {statement.won_register}"
                item = self.format_node(statement.item)
                return f"claim {amount} of {statement.target}.{statement.attribute} from {item} -> {statement.won_register}"
            case Give():
                amount = "all" if statement.amount is None else self.format_node(statement.amount)
                target = f"{statement.items}.{statement.attribute} of {self.format_node(statement.item)}"
                return f"give {amount} of {statement.register} to {target}"
            case Request():
                row = EFFECT_BY_OPERATION[statement.op]
                values = {
                    name: None if arg is None else self.format_node(arg)
                    for name, arg in zip(row.operand_names, statement.args, strict=True)
                }
                return fill_template(row.plan_template, {**values, "of": statement.target, "own": statement.register})


def _find_source_line(statement: PlanStatement) -> str:
    """Return the line of source text from which a statement was lowered."""
    if statement.span is None:
        return ""
    return f"line {statement.span.source.find_line_column(statement.span.start)[0]}"
