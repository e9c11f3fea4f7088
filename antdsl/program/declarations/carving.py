"""`carve SOLID(radius: R, toward: WAY, into: ATTRIBUTE)`, checked."""

from __future__ import annotations

from antdsl.program import model
from antdsl.program.model import Dim, Kind, Type
from antdsl.program.names.scope import LENGTH, PUSH, Scope, did_you_mean
from antdsl.program.types.arguments import Slot, arranged, type_all
from antdsl.program.types.descriptions import mismatch, quoted
from antdsl.program.types.folding import constant_behind
from antdsl.program.types.operators import wanted
from antdsl.syntax import nodes

_SLOTS = (Slot("radius", required=True), Slot("toward", required=False), Slot("into", required=False))


def carve(scope: Scope, line: nodes.Carve, block: object) -> model.Statement | None:
    """The statement, or None after a complaint. It says the same in a body and in an action: a ball of that size, now."""
    thing = scope.declared.things.get(line.solid.text)
    found = arranged(scope, "carve", _SLOTS, line, f"carve {line.solid.text}") if line.arguments else {}
    if found is None:
        type_all(scope, line)
        found = {}
    values = {slot: arguments[0].value for slot, arguments in found.items()}
    radius = wanted(scope, values["radius"], LENGTH, "`radius` of `carve`") if "radius" in values else None
    toward = wanted(scope, values["toward"], PUSH, "`toward` of `carve`") if "toward" in values else None
    into = _soil(scope, values["into"]) if "into" in values else None
    if thing is None or thing.kind != "solid":
        solids = [t.name for t in scope.declared.things.values() if t.kind == "solid"]
        scope.report.error(
            "unknown-name",
            f"no solid `{line.solid.text}` to carve",
            line.solid.span,
            did_you_mean(line.solid.text, solids, f"declare it: `world {{ solid {line.solid.text} }}`"),
        )
        return None
    scope.use("thing", thing.name)
    if radius is None:
        if not line.arguments:
            scope.report.error(
                "missing-argument", "`carve` wants a radius", line.span, f"write `carve {thing.name}(radius: size / 2)`"
            )
        return None
    known = constant_behind(radius)
    if known is not None and known.number <= 0:
        words = f"{quoted(radius.span)} is no radius of a ball to dig"
        scope.report.error("out-of-range", words, radius.span, f"write a length above 0: `carve {thing.name}(radius: size / 2)`")
    if radius.type.kind is Kind.BAD or (toward is not None and toward.type.kind is Kind.BAD):
        return None
    return model.Carve(thing.name, radius, line.span, toward, into)


def _soil(scope: Scope, node: nodes.Expr) -> str | None:
    """The attribute, a volume, that takes what is dug out."""
    species = scope.species
    assert species is not None
    type = species.attributes.get(node.name.text) if isinstance(node, nodes.NameRef) else None
    if isinstance(node, nodes.NameRef):
        scope.bind_own(node.span, node.name.text)
    if isinstance(node, nodes.NameRef) and type == Type(Kind.NUMBER, Dim(length=3)):
        scope.declared.written.add(f"{species.name}.{node.name.text}")
        return node.name.text
    word = node.name.text if isinstance(node, nodes.NameRef) else "soil"
    if type is not None:
        mismatch(scope.report, node, type, Type(Kind.NUMBER, Dim(length=3)), "`into` of `carve`")
    else:
        scope.report.error(
            "unknown-name", f"`into` of `carve` names an attribute of `{species.name}`, and {quoted(node.span)} is none",
            node.span, f"declare it: `{word} = 0 mm^3` in `species {species.name}`",
        )  # fmt: skip
    return None
