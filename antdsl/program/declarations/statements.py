"""Checks the statements of a state or an action. A value that is added must be a rate if the line runs in every step, and an
amount if it runs once."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

from antdsl.diagnostics import Label
from antdsl.program import model
from antdsl.program.declarations.amounts import StatementContext, type_amount_or_rate
from antdsl.program.declarations.appearance import check_channel, check_look, check_play, check_wear
from antdsl.program.declarations.effect_requests import check_request
from antdsl.program.kinds import NUMBER_TYPE, PUSH_TYPE
from antdsl.program.model import Expr, TypeKind, ValueType
from antdsl.program.names.scope import NameScope, list_names, parse_type_words, suggest_name
from antdsl.program.types.arguments import type_point
from antdsl.program.types.descriptions import describe_type, is_compatible, quote_source, report_mismatch, report_operand_mismatch
from antdsl.program.types.operators import type_facing_direction, type_value, type_value_as
from antdsl.program.types.pair_values import type_set_index
from antdsl.source import Span
from antdsl.syntax import nodes


def check_statements(scope: NameScope, lines: Iterable[object], block: StatementContext) -> tuple[model.Statement, ...]:
    """Return the checked statements of a block in text order, without statements that have errors."""
    scope = scope.with_changes(is_evaluated_once=not block.is_state_body)
    checked_statements: list[model.Statement] = []
    assigned: dict[str, Span] = {}
    for line in lines:
        rule = _CHECKER_BY_STATEMENT.get(type(line))
        statement = rule(scope, line, block) if rule is not None else None
        if statement is not None:
            checked_statements.append(statement)
        if isinstance(line, nodes.Assign) and line.op == "=" and isinstance(line.target, nodes.NameRef):
            _report_duplicates(scope, line.target.name, assigned)
    return tuple(checked_statements)


def _report_duplicates(scope: NameScope, name: nodes.Name, first_spans: dict[str, Span]) -> None:
    if name.text in first_spans:
        message = f"`{name.text}` is set twice in one block; only the second applies"
        advice = f"keep one of them, or add: `{name.text} += …`"
        scope.report.error("two-writers", message, name.span, advice, labels=(Label(first_spans[name.text], "first here"),))
    first_spans.setdefault(name.text, name.span)


# --- one line each ---------------------------------------------------------------------------------------------------


def _check_steer(scope: NameScope, line: nodes.Steer, block: StatementContext) -> model.Statement | None:
    push = type_value(scope, line.push, PUSH_TYPE)
    if push.type.kind is TypeKind.BAD:
        return None
    if not is_compatible(push.type, PUSH_TYPE):
        report_mismatch(scope.report, line.push, push.type, PUSH_TYPE, "`steer`", push)
        return None
    return model.Steer(push, line.span)


def _check_face(scope: NameScope, line: nodes.Face, block: StatementContext) -> model.Statement | None:
    direction = type_facing_direction(scope, line.push)
    return None if direction.type.kind is TypeKind.BAD else model.FaceLine(direction, line.span)


def _check_assign(scope: NameScope, line: nodes.Assign, block: StatementContext) -> model.Statement | None:
    species = scope.species
    assert species is not None
    target, of, over, element, inner = line.target, None, None, None, scope
    if isinstance(target, nodes.IndexAll):
        element_access = type_set_index(scope, target)
        if element_access is None:
            return None
        pair_attribute, over, element, inner = element_access
        name, type = pair_attribute.name, pair_attribute.type
    elif isinstance(target, nodes.Index) and isinstance(target.owner, nodes.NameRef):
        checked = scope.type_expression(target)
        if not isinstance(checked, model.AttributeRef):
            type_value(scope, line.value)
            return None
        name, type, of = checked.name, checked.type, checked.owner
    elif isinstance(target, nodes.NameRef):
        own = _find_assigned_attribute(scope, target.name, block, line)
        if own is None:
            type_value(scope, line.value)
            return None
        name, type = own
    else:
        type_value(scope, line.value)
        message = f"{quote_source(target.span)} belongs to another agent; an agent sets only its own values"
        scope.report.error("not-own", message, target.span, "send an event with `emit`; the other agent can set it in `on`")
        return None
    scope.declarations.written_attributes.add(f"{species.name}.{name}")
    if line.op != "=":
        if type.kind is TypeKind.BAD:
            type_value(scope, line.value)
            return None
        if type.kind not in (TypeKind.NUMBER, TypeKind.VECTOR):
            message = f"`{name}` is {describe_type(type)}, but you can add only to numbers and vectors"
            scope.report.error("wrong-kind", message, line.span, f"set it: `{name} = …`")
            return None
        change = type_amount_or_rate(inner, line.value, type, block, f"{' '.join(target.span.text.split())} {line.op} ")
        return None if change is None else model.Assign(name, line.op, change, block.is_state_body, line.span, of, over, element)
    if (
        block.must_be_order_independent
        and name not in ("heading", "velocity")
        and type.kind not in (TypeKind.AGENT, TypeKind.ITEM)
    ):
        text, what = (" ".join(each.span.text.split()) for each in (line.value, target))
        words = f"`{what}` is set in a handler, but several events may occur at once"
        transition = f"`when … -> … {{ {what} = {text} }}`"
        advice = f"add to it: `{what} += {text}`, or set it in a transition that tests for the event: {transition}"
        scope.report.error("not-commuting", words, line.span, advice)
        return None
    new = type_value_as(inner, line.value, type, f"`{name}`")
    return None if new.type.kind is TypeKind.BAD else model.Assign(name, "=", new, False, line.span, of, over, element)


def _find_assigned_attribute(
    scope: NameScope, name: nodes.Name, block: StatementContext, line: nodes.Assign
) -> tuple[str, ValueType] | None:
    """Return the name and the type of the attribute on the left of an assignment, or None after an error."""
    species, report, text = scope.species, scope.report, name.text
    assert species is not None
    scope.record_own_name_use(name.span, name.text)
    if text in species.pair_value_species:
        report.error("wrong-kind", f"`{text}` is a value per pair: name the other agent", name.span, f"write `{text}[other]`")
        return None
    if text in species.attributes:
        return text, species.attributes[text]
    builtin = scope.builtins.get(text)
    if builtin is not None and (builtin.is_settable or text in ("velocity", "heading")):
        if not builtin.is_settable and block.is_state_body:
            example = f"`enter {{ {' '.join(line.span.text.split())} }}`"
            advice = f"steer instead, or set it once: {example}"
            report.error("set-in-body", f"`{text}` cannot be set in every step", line.span, advice)
            return None
        return text, parse_type_words(builtin.type) or ValueType(TypeKind.BAD)
    if text in species.params:
        message = f"`{text}` is a param, which has one value for all agents"
        report.error("not-settable", message, name.span, f"make it an attribute: `{text} = …` without `param`")
    elif text in species.bindings:
        message = f"`{text}` is a `let` or `latch`, which is computed from other values"
        report.error("not-settable", message, name.span, "set the values that it depends on, or make it an attribute")
    elif builtin is not None or text in ("state", "previous", "next", "time_in_state"):
        advice = "it moves by `steer`" if text in ("position", "speed") else "it is computed from other values"
        if builtin is None:
            advice = "a transition changes it: `when … -> …`"
        report.error("not-settable", f"`{text}` cannot be set", name.span, advice)
    else:
        known = [a for a in species.attributes if a not in species.pair_value_species] + [
            n for n, g in scope.builtins.items() if g.is_settable
        ]
        message = f"`{species.name}` has no attribute `{text}`"
        report.error(
            "unknown-name", message, name.span, suggest_name(text, known, f"declare it: `{text} = …` in `species {species.name}`")
        )
    return None


def _check_verb_line(scope: NameScope, line: nodes.VerbLine, block: StatementContext) -> model.Statement | None:
    return _APPEARANCE_CHECKER_BY_VERB.get(line.verb, check_request)(scope, line, block)


def _check_give(scope: NameScope, line: nodes.Give, block: StatementContext) -> model.Statement | None:
    species = scope.species
    assert species is not None
    to = type_point(scope, line.to, "`to`")
    own = _find_amount_type(scope, line.attribute, "to give from")
    amount = None
    if line.amount is not None:
        amount = type_amount_or_rate(
            scope,
            line.amount,
            own or NUMBER_TYPE,
            block,
            "give ",
            f" {line.attribute.text} to {' '.join(line.to.span.text.split())}",
        )
    if own is None or not _has_attribute(scope, line.to, to, line.attribute, own) or (line.amount is not None and amount is None):
        return None
    scope.declarations.written_attributes.add(f"{species.name}.{line.attribute.text}")
    return model.Give(line.attribute.text, amount, to, block.is_state_body, line.span)


def check_take(scope: NameScope, line: nodes.Take) -> model.Take | None:
    """Check a `take`, which is part of a transition, such as `take 1 load from meal` or `take all load from grass`.

    All agents that claim from the same item or cell in a step compete for its amount."""
    source = scope.type_expression(line.source, ValueType(TypeKind.PLACE)) if isinstance(line.source, nodes.NameRef) else None
    if source is None or source.type.kind is not TypeKind.FIELD:
        source = type_point(scope, line.source, "`from`")
    own = None if line.attribute is None else _find_amount_type(scope, line.attribute, "to take it into")
    called = line.attribute.text if line.attribute is not None else ""
    amount = None
    if line.amount is not None:
        amount = type_value_as(
            scope.with_changes(is_evaluated_once=True),
            line.amount,
            own or NUMBER_TYPE,
            " ".join(("`take …", f"{called}`" if called else "`")),
        )
        if amount.type.kind is TypeKind.BAD:
            return None
    if line.attribute is not None and own is None:
        return None
    if line.attribute is None and isinstance(line.amount, nodes.NameRef) and amount is not None:
        name, what = line.amount.name.text, " ".join(line.source.span.text.split())
        advice = f"write `take 1 {name} from {what}`, or `take all {name} from {what}`"
        scope.report.error("missing-argument", f"`take {name}` does not state an amount", line.amount.span, advice)
        return None
    if source.type.kind is TypeKind.FIELD:
        if (
            line.attribute is not None
            and own is not None
            and not _is_field_amount(scope, line.source, source, line.attribute, own)
        ):
            return None
    elif line.attribute is None:
        if source.type.kind is not TypeKind.BAD:
            message = f"`take` does not name the attribute to take from {quote_source(line.source.span)}"
            advice = f"name the attribute: `take 1 load from {' '.join(line.source.span.text.split())}`"
            scope.report.error("missing-argument", message, line.span, advice)
        return None
    elif own is None or not _has_attribute(scope, line.source, source, line.attribute, own):
        return None
    assert scope.species is not None
    if called:
        scope.declarations.written_attributes.add(f"{scope.species.name}.{called}")
    return model.Take(called or None, amount, source, line.span)


def _is_field_amount(scope: NameScope, node: nodes.Expr, expr: Expr, attribute: nodes.Name, own_type: ValueType) -> bool:
    """Return whether the agent's attribute is a plain number, as in the cells of a field. If not, report an error."""
    if own_type.kind is TypeKind.BAD or is_compatible(NUMBER_TYPE, own_type):
        return own_type.kind is not TypeKind.BAD
    a = model.AttributeRef(own_type, model.ChangeRate.AGENT, attribute.span, None, attribute.text)
    report_operand_mismatch(
        scope.report,
        "take",
        attribute.span,
        (nodes.NameRef(attribute, attribute.span), a),
        (node, replace(expr, type=NUMBER_TYPE)),
    )
    return False


def _find_amount_type(scope: NameScope, name: nodes.Name, purpose: str) -> ValueType | None:
    species = scope.species
    assert species is not None
    type = species.attributes.get(name.text)
    scope.record_own_name_use(name.span, name.text)
    if type is None or name.text in species.pair_value_species:
        known = [a for a in species.attributes if a not in species.pair_value_species]
        scope.report.error(
            "unknown-name",
            f"`{species.name}` has no attribute `{name.text}` {purpose}",
            name.span,
            suggest_name(name.text, known, f"declare it: `{name.text} = 0` in `species {species.name}`"),
        )
        return None
    scope.mark_used("attribute", f"{species.name}.{name.text}")
    if type.kind not in (TypeKind.NUMBER, TypeKind.BAD):
        report_mismatch(scope.report, nodes.NameRef(name, name.span), type, NUMBER_TYPE, "what is taken or given")
        return None
    return type


def _has_attribute(scope: NameScope, node: nodes.Expr, item_expr: Expr, attribute: nodes.Name, own_type: ValueType) -> bool:
    """Return whether an item has the attribute with the dimension of `own_type`. If not, report an error."""
    if item_expr.type.kind is TypeKind.BAD:
        return False
    if item_expr.type.kind is not TypeKind.ITEM:
        report_mismatch(scope.report, node, item_expr.type, ValueType(TypeKind.ITEM), "`take` or `give`")
        return False
    thing = scope.declarations.things.get(item_expr.type.referent or "")
    held = {a.name: a.type for a in thing.attributes} if thing else {}
    if attribute.text not in held:
        scope.report.error(
            "unknown-name",
            f"items `{item_expr.type.referent}` have no `{attribute.text}`",
            attribute.span,
            suggest_name(
                attribute.text,
                held,
                f"declare it: `items {item_expr.type.referent} {{ {attribute.text} = 0 }}`"
                if not held
                else f"they have {list_names(held)}",
            ),
        )
        return False
    scope.record_value_use(attribute.span, item_expr.type, attribute.text)
    if not is_compatible(held[attribute.text], own_type):
        a = model.AttributeRef(own_type, model.ChangeRate.AGENT, attribute.span, None, attribute.text)
        b = model.AttributeRef(held[attribute.text], model.ChangeRate.AGENT, node.span, item_expr, attribute.text)
        report_operand_mismatch(
            scope.report, "take and give", attribute.span, (nodes.NameRef(attribute, attribute.span), a), (node, b)
        )
        return False
    return True


_APPEARANCE_CHECKER_BY_VERB: dict[str, Callable[..., model.Statement | None]] = {
    "play": check_play,
    "wear": check_wear,
    "channel": check_channel,
    "look": check_look,
}
_CHECKER_BY_STATEMENT: dict[type, Callable[..., model.Statement | None]] = {
    nodes.Steer: _check_steer, nodes.Face: _check_face, nodes.Assign: _check_assign, nodes.VerbLine: _check_verb_line,
    nodes.Give: _check_give,
}  # fmt: skip
