"""Checks the things of the world and the fields, which are everything that a program requires of a scene. No scene is read."""

from __future__ import annotations

from antdsl.diagnostics import Label
from antdsl.program import model
from antdsl.program.model import TypeKind
from antdsl.program.names.collect import check_free_name
from antdsl.program.names.scope import (
    Declarations,
    FileNames,
    NameScope,
    SpeciesNames,
    StableKeys,
    list_names,
    report_duplicate,
    suggest_name,
)
from antdsl.program.tables.things import KIND_BY_WORD
from antdsl.program.tables.units import make_number
from antdsl.program.tables.vocabulary import ITEM_ATTRIBUTE_TYPES, get_builtin_attributes
from antdsl.program.types.descriptions import is_compatible, quote_source, report_mismatch
from antdsl.program.types.folding import find_constant
from antdsl.program.types.operators import type_value
from antdsl.syntax import nodes


def make_outer_scope(declarations: Declarations, names: FileNames, path: str) -> NameScope:
    """Return a scope for text outside of all species. `path`: the start of the keys of draws and memories."""
    return NameScope(
        declarations, names, StableKeys(path), declarations.report, no_keep_reason="values can be stored only within a species"
    )


# --- things ----------------------------------------------------------------------------------------------------------


def declare_world(declarations: Declarations, names: FileNames) -> None:
    """Add the `world` of a file to the declarations. If two files declare the same thing, report an error unless both
    declarations agree."""
    for item in names.node.items:
        if isinstance(item, nodes.World):
            for thing in item.items:
                _declare_thing(declarations, names, thing)


def _declare_thing(declarations: Declarations, names: FileNames, item: nodes.WorldItem) -> None:
    report, kind, name = declarations.report, item.kind.text, item.name.text
    if kind not in KIND_BY_WORD:
        report.error(
            "unknown-kind",
            f"no kind of thing `{kind}`",
            item.kind.span,
            suggest_name(kind, KIND_BY_WORD, f"kinds are {list_names(tuple(KIND_BY_WORD))}"),
        )
        declarations.unclear_things.add(name)
        return
    known = declarations.things.get(name)
    if known is not None and (known.kind != kind or known.span.source.path == item.span.source.path):
        report_duplicate(report, kind, item.name, known.span)
        return
    if not KIND_BY_WORD[kind].has_values and item.attributes:
        message = f"{kind} `{name}` has no values"
        report.error("wrong-kind", message, item.attributes[0].span, "only `items` and `species` can have attributes")
    if known is None and not check_free_name(report, item.name):
        return
    attributes = tuple(_check_attribute(declarations, names, item, each) for each in item.attributes)
    if known is not None:
        have = {a.name for a in known.attributes}
        attributes = known.attributes + tuple(a for a in attributes if a.name not in have)
    declarations.things[name] = model.WorldThing(name, kind, attributes, item.help.text if item.help else "", item.name.span)
    if kind == "species":
        species = declarations.species.setdefault(name, SpeciesNames(name, None, edition=names.node.edition_number))
        if species.node is None:
            species.attributes.update({a.name: a.type for a in attributes})


def _check_attribute(
    declarations: Declarations, names: FileNames, item: nodes.WorldItem, node: nodes.Declaration
) -> model.ItemAttribute:
    report, name = declarations.report, node.name.text
    twice = [d for d in item.attributes if d.name.text == name]
    if twice[0] is not node:
        report_duplicate(report, "attribute", node.name, twice[0].name.span)
    taken = ITEM_ATTRIBUTE_TYPES if item.kind.text == "items" else get_builtin_attributes(names.node.edition_number)
    if name in taken:
        message = f"all `{item.name.text}` have a `{name}` already"
        report.error("reserved-name", message, node.name.span, f"choose another name, such as `my_{name}`")
    expr = type_value(make_outer_scope(declarations, names, f"world.{item.name.text}"), node.value)
    constant = find_constant(expr)
    if constant is None or constant.type.kind is not TypeKind.NUMBER:
        if expr.type.kind is not TypeKind.BAD:
            words = f"{quote_source(node.value.span)} is not a plain number, but attributes of `{item.name.text}` start with one"
            report.error("wrong-rate", words, node.value.span, f"write a number: `{name} = 0`")
        constant = make_number(0, node.value.span)
    return model.ItemAttribute(name, constant.type, constant, node.help.text if node.help else "", node.name.span)


def check_world_species(declarations: Declarations) -> None:
    """Check that `world { species rabbit { … } }` agrees with the declaration of the species, if both are in the checked
    files."""
    for thing in declarations.things.values():
        species = declarations.species.get(thing.name)
        if thing.kind != "species" or species is None or species.node is None:
            continue
        for attribute in thing.attributes:
            own = species.attributes.get(attribute.name)
            labels = (Label(species.node.name.span, f"`{thing.name}` is declared here"),)
            if own is None:
                message = f"species `{thing.name}` has no attribute `{attribute.name}`"
                declarations.report.error(
                    "unknown-name", message, attribute.span, suggest_name(attribute.name, species.attributes), labels=labels
                )
            elif not is_compatible(own, attribute.type):
                report_mismatch(
                    declarations.report,
                    nodes.NameRef(nodes.Name(attribute.name, attribute.span), attribute.span),
                    attribute.type,
                    own,
                    f"species `{thing.name}`",
                )
