"""Finds the agents, items or cells that an aggregate such as `total(food.load)` or `share(state == carry)` is about."""

from __future__ import annotations

import re

from antdsl.program.expectations import GEOMETRY_MEASURES
from antdsl.program.model import Binding, BindingRef, ChangeRate, Dimension, TypeKind, ValueType
from antdsl.program.names.scope import Declarations, NameScope
from antdsl.program.tables.things import KIND_BY_WORD
from antdsl.program.tables.vocabulary import SENSE_TYPE_BY_NAME
from antdsl.program.traverse import iterate_nodes
from antdsl.program.typed import ThingRef
from antdsl.program.types.descriptions import quote_source
from antdsl.source import Span
from antdsl.syntax import nodes


def find_cell_field(declarations: Declarations, operand: nodes.Expr) -> str:
    """Return the name of the field of which an expression reads single cells, such as `trail` for `trail.value > 0.1`. Return ""
    for other expressions."""
    members = [part for part, _ in iterate_nodes(operand) if isinstance(part, nodes.Member) and part.name.text == "value"]
    owners = [part.owner.name.text for part in members if isinstance(part.owner, nodes.NameRef)]
    return next((name for name in owners if name in declarations.fields), "")


def find_subject(scope: NameScope, node: nodes.Call, operand: nodes.Expr) -> ValueType | None:
    """Return the type of the species or items over which an aggregate runs, or None after an error.

    If an aggregate such as `share(state == carry)` names no species, it runs over the only species that has all of its values.
    """
    declared = scope.declarations
    owners = [part.owner for part, _ in iterate_nodes(operand) if isinstance(part, nodes.Member)]
    named = [owner.name.text for owner in (*owners, operand) if isinstance(owner, nodes.NameRef)]
    things = [name for name in dict.fromkeys(named) if find_thing_kind(declared, name) is not None]
    if len(things) == 1:
        kind = find_thing_kind(declared, things[0])
        assert kind is not None
        scope.mark_used("species" if kind is TypeKind.SPECIES else "thing", things[0])
        return ValueType(kind, referent=things[0])
    if len(things) > 1:
        parts = " and ".join(f"`{name}`" for name in things)
        message = f"{quote_source(node.span)} uses values of {parts} together"
        scope.report.error("wrong-argument", message, node.span, "use each one separately, and add the results")
        return None
    if scope.species is not None:
        return ValueType(TypeKind.SPECIES, referent=scope.species.name)
    written_here = [name for name, species in declared.species.items() if species.node is not None]
    able = written_here if len(written_here) == 1 else [name for name in written_here if _has_values(declared, name, operand)]
    if len(able) == 1:
        return ValueType(TypeKind.SPECIES, referent=able[0])
    text, names = " ".join(operand.span.text.split()), sorted(able or declared.species)
    name = names[0] if names else "walker"
    if re.match(r"[a-z_][a-z0-9_]*\b(?!\s*\()", text):
        advice = f"name the species: `{node.function.span.text}({name}.{text})`"
    else:  # a sense is not an attribute, so it has no owner
        advice = f"name the species: `count(a in {name}: {text})`, or test it in `each {name} {{ … }}`"
    scope.report.error("wrong-argument", f"{quote_source(node.span)} does not say of which species", node.span, advice)
    return None


def find_thing_kind(declarations: Declarations, name: str) -> TypeKind | None:
    """Return SPECIES for the name of a species, ITEMS for the name of items, and None for other names."""
    if name in declarations.species:
        return TypeKind.SPECIES
    thing = declarations.things.get(name)
    return TypeKind.ITEMS if thing is not None and KIND_BY_WORD[thing.kind].is_item_group else None


def _has_values(declarations: Declarations, species: str, operand: nodes.Expr) -> bool:
    """Return whether a species has all values that an expression uses without an owner, such as `load`. Only the names are
    compared."""
    names = declarations.species[species]
    states = {state for machine in names.machines.values() for state in machine.states}
    mine = states.union(names.attributes, names.params, names.bindings, names.untyped_names, names.machines, names.builtins)
    words = {"state", "previous", "next", "time_in_state", "time", "frame", "dt", "true", "false", "self"}
    groups = (declarations.things, declarations.fields, declarations.species, declarations.events)
    everywhere = words.union(GEOMETRY_MEASURES, SENSE_TYPE_BY_NAME, *groups)
    called = {id(part.function) for part, _ in iterate_nodes(operand) if isinstance(part, nodes.Call)}
    bare = {p.name.text for p, _ in iterate_nodes(operand) if isinstance(p, nodes.NameRef) and id(p) not in called}
    return bare <= mine | everywhere


def make_element_scope(scope: NameScope, population: ValueType, span: Span) -> tuple[NameScope, tuple[Binding, ...]]:
    """Return the scope for expressions about one agent or item of `population`. For an item, also return the binding of its
    name."""
    name = population.referent or ""
    if population.kind is TypeKind.SPECIES:
        who = ThingRef(ValueType(TypeKind.AGENT, referent=name), ChangeRate.AGENT, span, "self")
        names, local_names = scope.declarations.species[name], {**scope.local_names, name: who}
        return scope.with_changes(species=names, machine=None, local_names=local_names), ()
    element = Binding(name, "element", ValueType(TypeKind.ITEM, Dimension(), name), ChangeRate.ELEMENT, span)
    element_value = BindingRef(element.type, ChangeRate.ELEMENT, span, element)
    return scope.with_changes(species=None, element=element, local_names={**scope.local_names, name: element_value}), (element,)
