"""Types pair values, such as `likes[other]`, in declarations, reads and assignments. A pair value is an agent's value about
another agent."""

from __future__ import annotations

from antdsl.program.model import AttributeDecl, AttributeRef, Binding, ChangeRate, Expr, SetExpr, TypeKind, ValueType
from antdsl.program.names.scope import NameScope, make_bad_expression
from antdsl.program.types.descriptions import describe_type, is_compatible, quote_source, report_mismatch
from antdsl.program.types.folding import find_constant
from antdsl.program.types.sets import make_complete_set, make_element_scope
from antdsl.syntax import nodes


def type_pair_index(scope: NameScope, node: nodes.Index, expected_type: ValueType | None) -> Expr:
    """Type `likes[other]`, the agent's own value about another agent."""
    species, owner = scope.species, node.owner
    index = scope.type_expression(node.index)
    if (
        isinstance(owner, nodes.NameRef)
        and species is not None
        and scope.behaviour is None
        and owner.name.text in species.pair_value_species
    ):
        name = owner.name.text
        scope.mark_used("attribute", f"{species.name}.{name}")
        scope.record_name_use(owner.span, "own", species.name, name)
        expected = ValueType(TypeKind.AGENT, referent=species.pair_value_species[name])
        if not is_compatible(index.type, expected):
            report_mismatch(scope.report, node.index, index.type, expected, f"`{name}[…]`")
        return AttributeRef(species.attributes[name], max(index.rate, ChangeRate.AGENT), node.span, index, name)
    if scope.type_expression(owner).type.kind is TypeKind.BAD:
        return make_bad_expression(node.span)
    advice = "declare a value per pair like this: `likes = 0 for each roach, strongest 8`"
    return scope.report_error("wrong-kind", f"{quote_source(owner.span)} has no value per agent", node.span, advice)


def reject_pair(scope: NameScope, node: nodes.PairOf, expected_type: ValueType | None) -> Expr:
    message = "`… to …` as a pair of two things does not work yet"
    return scope.report_error("not-yet", message, node.span, "a value per pair is written `likes[other]`")


def check_pair_value(scope: NameScope, attribute: AttributeDecl, rest_value: Expr | None) -> None:
    """Report an invalid pair value. It must be a number, and its initial value must not depend on the agent.

    It may relax only to its initial value, because this is the value for all agents that have no slot."""
    name, default = attribute.name, attribute.default
    if TypeKind.BAD in (attribute.type.kind, default.type.kind):
        return
    text = " ".join(default.span.text.split())
    if attribute.type.kind is not TypeKind.NUMBER:
        message = f"`{name}` is {describe_type(attribute.type)}, but a value per pair must be a number"
        scope.report.error("wrong-kind", message, default.span, f"start with a number: `{name} = 0 for each …`")
    elif default.rate > ChangeRate.RUN:
        message = f"`{name}` begins with {quote_source(default.span)}, but its first value must be equal for all"
        scope.report.error("wrong-rate", message, default.span, "write a number or a param, and set it where the agents meet")
    elif rest_value is not None and rest_value.type.kind is not TypeKind.BAD and not _is_same(default, rest_value):
        message = f"`{name}` begins at {text} for all others, so it cannot relax to {quote_source(rest_value.span)}"
        scope.report.error("wrong-argument", message, rest_value.span, f"write `relax to {text}`")


def _is_same(first: Expr, second: Expr) -> bool:
    known = [find_constant(each) for each in (first, second)]
    if known[0] is not None and known[1] is not None:
        return (known[0].number, known[0].unit_power, known[0].step) == (known[1].number, known[1].unit_power, known[1].step)
    return " ".join(first.span.text.split()) == " ".join(second.span.text.split())


def type_set_index(scope: NameScope, node: nodes.IndexAll) -> tuple[AttributeRef, SetExpr, Binding, NameScope] | None:
    """Return the parts of `likes[n in SET]`, or None after an error. They are the pair value, the set, the binding of an
    element, and the scope in which the name of the element is visible."""
    over = scope.type_expression(node.over)
    if over.type.kind in (TypeKind.SPECIES, TypeKind.ITEMS):
        over = make_complete_set(over)
    if not isinstance(over, SetExpr):
        if over.type.kind is not TypeKind.BAD:
            message = f"`… in …` needs a set, but {quote_source(over.span)} is {describe_type(over.type)}"
            scope.report.error("wrong-kind", message, over.span, "write a set, such as `neighbours(20 mm)`")
        return None
    element, inner = make_element_scope(scope, over, node.variable)
    index = nodes.Index(node.owner, nodes.NameRef(node.variable, node.variable.span), node.span)
    checked = type_pair_index(inner, index, None)
    return (checked, over, element, inner) if isinstance(checked, AttributeRef) else None
