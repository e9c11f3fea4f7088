"""Types pair values such as `likes[other]`, an agent's value about another agent, in declarations, reads and assignments."""

from __future__ import annotations

from antdsl.program.model import AttributeDecl, AttributeRef, Binding, ChangeRate, Expr, SetExpr, TypeKind, ValueType
from antdsl.program.names.scope import NameScope, bad_expression
from antdsl.program.types.descriptions import is_compatible, quote_source, report_mismatch, type_words
from antdsl.program.types.folding import constant_behind
from antdsl.program.types.sets import complete_set, element_scope
from antdsl.syntax import nodes


def index_of(scope: NameScope, node: nodes.Index, want: ValueType | None) -> Expr:
    """Type `likes[other]`, the agent's own value about another agent."""
    species, owner = scope.species, node.owner
    index = scope.type_expression(node.index)
    if isinstance(owner, nodes.NameRef) and species is not None and scope.behaviour is None and owner.name.text in species.each:
        name = owner.name.text
        scope.mark_used("attribute", f"{species.name}.{name}")
        scope.bind(owner.span, "own", species.name, name)
        expected = ValueType(TypeKind.AGENT, of=species.each[name])
        if not is_compatible(index.type, expected):
            report_mismatch(scope.report, node.index, index.type, expected, f"`{name}[…]`")
        return AttributeRef(species.attributes[name], max(index.rate, ChangeRate.AGENT), node.span, index, name)
    if scope.type_expression(owner).type.kind is TypeKind.BAD:
        return bad_expression(node.span)
    advice = "a value per pair is declared so: `likes = 0 for each roach, strongest 8`"
    return scope.reject("wrong-kind", f"{quote_source(owner.span)} has no value per agent", node.span, advice)


def pair_of(scope: NameScope, node: nodes.PairOf, want: ValueType | None) -> Expr:
    message = "`… to …` as a pair of two things does not work yet"
    return scope.reject("not-yet", message, node.span, "a value per pair is written `likes[other]`")


def check_pair_value(scope: NameScope, attribute: AttributeDecl, to: Expr | None) -> None:
    """Report an invalid pair value. It must be a number, with an initial value that does not depend on the agent. It may relax
    only to the initial value.
    The value about an agent without a slot is always the initial value."""
    name, default = attribute.name, attribute.default
    if TypeKind.BAD in (attribute.type.kind, default.type.kind):
        return
    text = " ".join(default.span.text.split())
    if attribute.type.kind is not TypeKind.NUMBER:
        message = f"`{name}` is {type_words(attribute.type)}, and a value per pair is a number"
        scope.report.error("wrong-kind", message, default.span, f"start with a number: `{name} = 0 for each …`")
    elif default.rate > ChangeRate.RUN:
        message = f"`{name}` begins with {quote_source(default.span)}, and it has to begin the same about all"
        scope.report.error("wrong-rate", message, default.span, "write a number or a param, and set it where the agents meet")
    elif to is not None and to.type.kind is not TypeKind.BAD and not _is_same(default, to):
        message = f"`{name}` begins at {text} for all others, and cannot return to {quote_source(to.span)}"
        scope.report.error("wrong-argument", message, to.span, f"write `relax to {text}`")


def _is_same(one: Expr, other: Expr) -> bool:
    known = [constant_behind(each) for each in (one, other)]
    if known[0] is not None and known[1] is not None:
        return (known[0].number, known[0].u, known[0].step) == (known[1].number, known[1].u, known[1].step)
    return " ".join(one.span.text.split()) == " ".join(other.span.text.split())


def pair_values_of(scope: NameScope, node: nodes.IndexAll) -> tuple[AttributeRef, SetExpr, Binding, NameScope] | None:
    """Return the parts of `likes[n in SET]`: the value, the set, the binding of an element, and the scope of the element. None
    after an error."""
    over = scope.type_expression(node.over)
    if over.type.kind in (TypeKind.SPECIES, TypeKind.ITEMS):
        over = complete_set(over)
    if not isinstance(over, SetExpr):
        if over.type.kind is not TypeKind.BAD:
            message = f"`… in …` goes over a set, and {quote_source(over.span)} is {type_words(over.type)}"
            scope.report.error("wrong-kind", message, over.span, "write a set, such as `neighbours(20 mm)`")
        return None
    element, inner = element_scope(scope, over, node.variable)
    index = nodes.Index(node.owner, nodes.NameRef(node.variable, node.variable.span), node.span)
    checked = index_of(inner, index, None)
    return (checked, over, element, inner) if isinstance(checked, AttributeRef) else None
