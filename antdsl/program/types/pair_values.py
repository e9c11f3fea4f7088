"""Types of values per pair: what an agent holds of another one, `likes[other]`."""

from __future__ import annotations

from antdsl.program.model import Attribute, Expr, Kind, Rate, Type
from antdsl.program.names.scope import Scope, bad
from antdsl.program.types.descriptions import fits, mismatch, quoted
from antdsl.syntax import nodes


def index_of(scope: Scope, node: nodes.Index, want: Type | None) -> Expr:
    """`likes[other]`: the agent's own value about another agent."""
    species, owner = scope.species, node.owner
    index = scope.typed(node.index)
    if isinstance(owner, nodes.NameRef) and species is not None and scope.behaviour is None and owner.name.text in species.each:
        name = owner.name.text
        scope.use("attribute", f"{species.name}.{name}")
        scope.bind(owner.span, "own", species.name, name)
        wanted = Type(Kind.AGENT, of=species.each[name])
        if not fits(index.type, wanted):
            mismatch(scope.report, node.index, index.type, wanted, f"`{name}[…]`")
        return Attribute(species.attributes[name], max(index.rate, Rate.AGENT), node.span, index, name)
    if scope.typed(owner).type.kind is Kind.BAD:
        return bad(node.span)
    scope.report.error(
        "wrong-kind",
        f"{quoted(owner.span)} has no value per agent",
        node.span,
        "a value per pair is declared so: `likes = 0 for each roach, strongest 8`",
    )
    return bad(node.span)


def pair_of(scope: Scope, node: nodes.PairOf, want: Type | None) -> Expr:
    scope.report.error(
        "not-yet", "`… to …` as a pair of two things does not work yet", node.span, "a value per pair is written `likes[other]`"
    )
    return bad(node.span)
