"""Checks lines that begin with a verb of the world, such as `deposit`. The rules are in the verb's row of the effects table.

The row defines what the line names, its arguments, and the blocks in which it may appear."""

from __future__ import annotations

from antdsl.program import model
from antdsl.program.declarations.amounts import StatementContext, type_amount_or_rate
from antdsl.program.kinds import BAD_TYPE, PUSH_TYPE, TypeKind, ValueType
from antdsl.program.names.collect import BUILTIN_EVENTS
from antdsl.program.names.scope import NameScope, is_known_missing, make_bad_expression, parse_type_words, suggest_name
from antdsl.program.tables.defaults import parse_default_values
from antdsl.program.tables.effects import EFFECT_BY_OPERATION, EffectRow
from antdsl.program.tables.rows import ArgumentRow
from antdsl.program.tables.things import list_replacements
from antdsl.program.tables.units import choose_default_unit, find_unit_measure
from antdsl.program.typed import Expr
from antdsl.program.types.arguments import ArgumentSlot, arrange_arguments, type_arguments
from antdsl.program.types.calls import check_row_limits
from antdsl.program.types.descriptions import quote_source, report_mismatch
from antdsl.program.types.operators import type_value, type_value_as
from antdsl.syntax import nodes

WrittenArguments = dict[str, nodes.Expr]


def check_request(scope: NameScope, line: nodes.VerbLine, block: StatementContext) -> model.EffectRequest | None:
    """Check a line with a verb of the world, such as `deposit trail 2 /s`. Return None after an error."""
    row = EFFECT_BY_OPERATION[line.verb]
    of = line.name.text if line.name is not None else ""
    form = f"{row.op} {of}".rstrip()
    written = _match_arguments(scope, row, line, form)
    argument_nodes = written or {}
    args = [_type_argument(scope, row, line, arg, argument_nodes, block, form) for arg in row.computed_arguments]
    own = next(
        (
            _find_own_attribute(scope, row, arg, argument_nodes[arg.name])
            for arg in row.args
            if arg not in row.computed_arguments and arg.name in argument_nodes
        ),
        None,
    )
    if not _is_declared(scope, row, line.name) or written is None or _report_missing_arguments(scope, row, line, written, form):
        return None
    if row.state_body_error and block.is_state_body:
        advice = f"do it once: `enter {{ {row.op} … }}`, or in a change: `when chance 10 %/s -> … {{ {row.op} … }}`"
        scope.report.error("not-a-rate", f"`{form}` here {row.state_body_error}", line.span, advice)
        return None
    for arg, arg_value in zip(row.computed_arguments, args, strict=True):
        if arg_value is not None:
            sample = f"{form}({arg.name}: {arg.sample})" if arg.sample else ""
            check_row_limits(scope, arg, f"`{arg.name}` of `{row.op}`", arg_value.span, arg_value, sample)
    if any(arg_value is not None and arg_value.type.kind is TypeKind.BAD for arg_value in args):
        return None
    per_second = (
        block.is_state_body
        and line.amount is not None
        and args[0] is not None
        and args[0].type.dimension != find_argument_type(row.computed_arguments[0]).dimension
    )
    key = scope.keys.make_key(row.op) if row.uses_draws else ""
    return model.EffectRequest(row.op, of, tuple(args), line.span, own, per_second, key)


def find_argument_type(arg: ArgumentRow) -> ValueType:
    """Return the type of an argument. For the type words `added T` and `own U`, this is the type T or U."""
    first, _, rest = arg.type.partition(" ")
    if first == "own" and (unit := find_unit_measure(rest)) is not None:
        return ValueType(TypeKind.NUMBER, unit.dim)
    return parse_type_words(rest if first in ("added", "own") else arg.type) or BAD_TYPE


def _match_arguments(scope: NameScope, row: EffectRow, line: nodes.VerbLine, form: str) -> WrittenArguments | None:
    """Return the nodes of the arguments by name, or None after an error."""
    if line.amount is not None:
        return {row.args[0].name: line.amount}
    behind = {} if line.to is None else {"to": line.to}
    if not line.arguments:
        return behind
    slots = [
        ArgumentSlot(arg.name, is_required=arg.default is None and not arg.is_optional) for arg in row.args if arg.type != "agent"
    ]
    arguments_by_slot = arrange_arguments(scope, row.op, slots, line, form)
    if arguments_by_slot is None:
        type_arguments(scope, line)
        return None
    return {name: arguments[0].value for name, arguments in arguments_by_slot.items()} | behind


def _type_argument(
    scope: NameScope,
    row: EffectRow,
    line: nodes.VerbLine,
    arg: ArgumentRow,
    written_arguments: WrittenArguments,
    block: StatementContext,
    form: str,
) -> Expr | None:
    """Return the typed value of an argument of a line. Return None if the argument is absent, and BAD after an error."""
    node = written_arguments.get(arg.name)
    if node is None:
        return None if arg.default is None else parse_default_values(scope, arg.default, line.span)[0]
    if arg.type == "agent":
        return _type_recipient(scope, row, line, node)
    if not arg.type.startswith("added "):
        return type_value_as(scope, node, find_argument_type(arg), f"`{arg.name}` of `{row.op}`")
    field = scope.declarations.fields.get(line.name.text) if row.target == "field" and line.name is not None else None
    type = PUSH_TYPE if field is not None and field.has_vectors else find_argument_type(arg)
    return type_amount_or_rate(
        scope, node, type, block, f"{form} ", is_always_amount=field is not None and _has_max_combination(field)
    ) or make_bad_expression(node.span)


def _type_recipient(scope: NameScope, row: EffectRow, line: nodes.VerbLine, node: nodes.Expr) -> Expr:
    """Return the agent to which a line with `to` sends its request. Report an error if it is not a single agent of a known
    species."""
    expr = type_value(scope, node)
    if expr.type.kind is TypeKind.BAD:
        return expr
    text = " ".join(node.span.text.split())
    if expr.type.kind is TypeKind.SPECIES:
        message = f"`{text}` means all agents of a species, but `{row.op} … to` needs one agent"
        return scope.report_error("wrong-kind", message, node.span, f"name one: `to nearest({text})`")
    if expr.type.kind is not TypeKind.AGENT:
        return report_mismatch(scope.report, node, expr.type, ValueType(TypeKind.AGENT), f"`{row.op} … to`")
    if expr.type.referent is None:
        advice = "name the species where you search for the agent, such as `nearest(neighbours(20 mm, of: rabbit))`"
        return scope.report_error("wrong-argument", f"no species is known for {quote_source(node.span)} is", node.span, advice)
    if line.name is not None:
        scope.mark_used("told", f"{line.name.text} {expr.type.referent}")
    return expr


def _find_own_attribute(scope: NameScope, row: EffectRow, arg: ArgumentRow, node: nodes.Expr) -> str | None:
    """Return the agent's own attribute that an argument names, or None after an error."""
    species, want = scope.species, find_argument_type(arg)
    assert species is not None
    name = node.name.text if isinstance(node, nodes.NameRef) else ""
    type = species.attributes.get(name)
    if name:
        scope.record_own_name_use(node.span, name)
    if type == want:
        scope.declarations.written_attributes.add(f"{species.name}.{name}")
        return name
    who = f"`{arg.name}` of `{row.op}`"
    if type is not None:
        report_mismatch(scope.report, node, type, want, who)
    else:
        message = f"{who} names an attribute of `{species.name}`, but {quote_source(node.span)} is not one"
        advice = f"declare it: `{name or arg.sample} = 0 {choose_default_unit(want.dimension)}` in `species {species.name}`"
        scope.report.error("unknown-name", message, node.span, advice)
    return None


def _report_missing_arguments(
    scope: NameScope, row: EffectRow, line: nodes.VerbLine, written_arguments: WrittenArguments, form: str
) -> bool:
    """Report the required arguments that are missing in a line. Return whether at least one is missing."""
    missing = [arg for arg in row.args if arg.default is None and not arg.is_optional and arg.name not in written_arguments]
    if missing:
        shape = ", ".join(f"{arg.name}: {arg.sample or '…'}" for arg in missing)
        wants = " and ".join(f"a {arg.name}" for arg in missing)
        scope.report.error("missing-argument", f"`{row.op}` needs {wants}", line.span, f"write `{form}({shape})`")
    return bool(missing)


def _is_declared(scope: NameScope, row: EffectRow, name: nodes.Name | None) -> bool:
    """Return whether the thing that a line names is declared. If not, report an error.

    An event needs no declaration, but must not have the name of a built-in event."""
    if name is None:
        return True
    declared, text = scope.declarations, name.text
    scope.mark_used(row.op, text)
    match row.target:
        case "event":
            if text in BUILTIN_EVENTS:
                words = f"`{text}` is a computed event, so no agent can `{row.op}` it"
                scope.report.error("wrong-argument", words, name.span, f"give the event another name, such as `{row.op} bump`")
            return text not in BUILTIN_EVENTS
        case "field":
            known, otherwise = list(declared.fields), f"field {text} on … {{ cell 4 mm; half_life 8 s }}"
            kind, code, message = "field", "unknown-field", f"no field `{text}`"
        case "species":
            known, otherwise = list(declared.species), ""
            kind, code, message = "species", "unknown-species", f"no species `{text}`"
        case word:
            kinds = list_replacements(word)
            known, otherwise = [t.name for t in declared.things.values() if t.kind in kinds], f"world {{ {word} {text} }}"
            kind, code, message = "thing", "unknown-name", f"no {word} `{text}` to {row.op}"
    if text in known:
        scope.mark_used(kind, text)
    elif kind != "field" or not is_known_missing(scope, "name", name):
        scope.report.error(code, message, name.span, suggest_name(text, known, otherwise and f"declare it: `{otherwise}`"))
    return text in known


def _has_max_combination(field: nodes.FieldDecl) -> bool:
    """Return whether a field has `combine max`.

    Such a field does not add up deposits. Therefore a line in a state's body may deposit an amount instead of a rate. The
    agent's cell then has at least this amount."""
    said = [s.value for s in field.settings if s.name.text == "combine"]
    return any(isinstance(each, nodes.NameRef) and each.name.text == "max" for each in said)
