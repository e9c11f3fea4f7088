"""`on collision(other)`: whom an agent's body has begun to touch, one other in each step.

Whom it touches already is kept in registers of ids, so that a contact is noticed when it begins and not as long as it lasts. Of
several that begin at once the deepest is noticed first, and the others in the steps after it, while they last: every line of a
handler is about one other."""

from __future__ import annotations

from collections.abc import Sequence

from antdsl import limits
from antdsl.plan.ir import Kind, Node
from antdsl.plan.lowering.values import Ref
from antdsl.plan.lowering.writer import Writer
from antdsl.program import model


def declare(w: Writer) -> None:
    """The ids of those whom an agent touches, of each species that a handler is about."""
    for of in _met(w.species):
        for name in _touched(w.species, of):
            w.declare(name, Kind.I64, "memory", -1, of)


def notice(w: Writer) -> dict[str, Node]:
    """The id of whom an agent has begun to touch, -1 for nobody, by species; from here on that one is touched."""
    found = {}
    for of, handler in _met(w.species).items():
        names = _touched(w.species, of)
        w.b.span = handler.span
        contact = w.b("contact", *(w.before(name) for name in names), attrs=(of,))
        for number, name in enumerate(names, 1):
            w.store(name, w.b("get", contact, attrs=(number,)), handler.span)
        found[of] = w.b("get", contact, attrs=(0,))
    return found


def bind(w: Writer, handler: model.Handler, whom: Node) -> None:
    """Let the name in the brackets of a handler stand for whom it is about."""
    if handler.other is not None:
        w.environment[handler.other] = Ref(model.Kind.AGENT, handler.of, whom)


def _met(species: model.Species) -> dict[str, model.Handler]:
    """The first handler of collisions with each species."""
    found: dict[str, model.Handler] = {}
    for handler in species.handlers:
        if handler.event == "collision":
            found.setdefault(handler.of, handler)
    return found


def _touched(species: model.Species, of: str) -> Sequence[str]:
    return [f"{species.name}.touched.{of}#{number}" for number in range(1, limits.TOUCHED + 1)]
