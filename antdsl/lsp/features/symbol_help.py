"""Hover help for a name: its declaration in the language, with its type, range, default and help text."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from antdsl.lsp.features.navigation import find_declaration
from antdsl.lsp.word_help import HELP_RULES, MEMBER_WORDS, collapse_whitespace, find_help_text, format_markdown, format_signature
from antdsl.lsp.workspace import OpenDocument, Workspace
from antdsl.program.kinds import TypeKind, ValueType
from antdsl.program.model import Program
from antdsl.program.names.bindings import NameKey
from antdsl.program.names.file_declarations import find_declaring_node
from antdsl.program.tables.things import KIND_BY_WORD
from antdsl.program.tables.units import choose_default_unit
from antdsl.program.types.descriptions import describe_type
from antdsl.syntax import nodes


def describe_symbol(workspace: Workspace, document: OpenDocument, key: NameKey) -> str | None:
    """Return the help for a symbol as Markdown; None if there is none."""
    if key[0] in HELP_RULES:
        return HELP_RULES[key[0]](key)
    if key[0] not in _DESCRIPTION_RULES:
        return None
    node_type, rule = _DESCRIPTION_RULES[key[0]]
    target = find_declaration(workspace, document, key)
    if target is None or not isinstance(target[1].node, node_type):
        return None
    return rule(SymbolDeclaration(workspace, document, target[0], key), target[1].node)


class SymbolDeclaration(NamedTuple):
    """A symbol that occurs in `document` and is declared in `file`."""

    workspace: Workspace
    document: OpenDocument
    file: OpenDocument
    key: NameKey


def _find_checked_type(program: Program | None, key: NameKey) -> ValueType | None:
    """Return the type that the checker determined for a name of a species, or None."""
    species = program.species.get(key[1]) if program is not None else None
    if species is None:
        return None
    return species.own_types.get(key[-1]) or next((p.type for p in species.params if p.name == f"{key[1]}.{key[-1]}"), None)


def _format_kind_line(type: ValueType | None, *details: str) -> str:
    """Return one line with a type, its unit, and further details."""
    if type is None or type.kind is TypeKind.BAD:
        return "; ".join(details)
    unit = choose_default_unit(type.dimension) if type.kind in (TypeKind.NUMBER, TypeKind.VECTOR) else ""
    return "; ".join([describe_type(type) + (f", in `{unit}`" if unit else ""), *details])


def _describe_own_member(symbol: SymbolDeclaration, member: Any) -> str:
    """Return the help for a param, attribute, let, latch or fuzzy value of a species."""
    key, node = symbol.key, find_declaring_node(member) or member
    typed = _find_checked_type(symbol.workspace.find_last_good_program(symbol.file.path), key)
    word = MEMBER_WORDS.get(type(member), "")
    if isinstance(node, nodes.Latch):
        form = (
            f"latch {node.name.text} = {collapse_whitespace(node.on.span.text)} until {collapse_whitespace(node.until.span.text)}"
        )
    elif isinstance(node, nodes.Fuzzy):
        form = f"fuzzy {node.name.text} {{ … }}"
    else:
        form = f"{word} {node.name.text} = {collapse_whitespace(node.value.span.text)}".lstrip()
    details = []
    if isinstance(node, nodes.Declaration):
        if node.range is not None:
            form += f" in {collapse_whitespace(node.range.span.text)}"
            details.append(
                f"from {collapse_whitespace(node.range.low.span.text)} to {collapse_whitespace(node.range.high.span.text)}"
            )
        details.append(
            f"default {collapse_whitespace(node.value.span.text)}"
            if word
            else f"{collapse_whitespace(node.value.span.text)} at birth"
        )
        if node.each is not None:
            details.append(f"one value about each {node.each.species.text}")
    return format_markdown(form, _format_kind_line(typed, *details), find_help_text(node), f"{word or 'attribute'} of `{key[1]}`")


def _describe_thing(symbol: SymbolDeclaration, node: nodes.WorldItem) -> str:
    inner = "; ".join(collapse_whitespace(each.span.text) for each in node.attributes)
    kind = KIND_BY_WORD.get(node.kind.text)
    form = f"{node.kind.text} {node.name.text}" + (f" {{ {inner} }}" if inner else "")
    return format_markdown(form, kind.help if kind is not None else "", find_help_text(node))


def _describe_item_attribute(symbol: SymbolDeclaration, node: Any) -> str:
    key = symbol.key
    program = symbol.workspace.find_last_good_program(symbol.file.path)
    thing = program.world.get(key[1]) if program is not None else None
    type = next((each.type for each in thing.attributes if each.name == key[2]), None) if thing is not None else None
    value = collapse_whitespace(node.value.span.text)
    return format_markdown(
        f"{key[2]} = {value}", _format_kind_line(type, f"default {value}"), find_help_text(node), f"value of each of `{key[1]}`"
    )


def _describe_field(symbol: SymbolDeclaration, node: nodes.FieldDecl) -> str:
    surfaces = ", ".join(name.text for name in node.surfaces)
    settings = "; ".join(collapse_whitespace(each.span.text) for each in node.settings)
    value_type = "" if node.value_type is None else f": {collapse_whitespace(node.value_type.span.text)}"
    form = f"field {symbol.key[1]}{value_type} on {surfaces} {{ {settings} }}"
    return format_markdown(form, "a field; its name is its value here", find_help_text(node))


def _describe_species(symbol: SymbolDeclaration, node: Any) -> str:
    name = symbol.key[1]
    table = symbol.file.names.species.get(name)
    machines = table.machines if table is not None else {}
    states = "; ".join(f"{name}: {', '.join(f'`{s}`' for s in states)}" for name, states in machines.items())
    return format_markdown(f"species {name}", find_help_text(node), f"states of {states}" if states else "")


def _describe_state(symbol: SymbolDeclaration, node: nodes.State) -> str:
    key = symbol.key
    label = f' "{node.label.text}"' if node.label is not None else ""
    colour = f" {node.colour.text}" if node.colour is not None else ""
    min_time = f"at least {collapse_whitespace(node.at_least.span.text)}" if node.at_least is not None else ""
    targets = [line.target for line in node.body if isinstance(line, nodes.Change)]
    names = dict.fromkeys(n.text for t in targets for n in ([t.name] if t.name is not None else [c.target for c in t.choices]))
    leads = f"leads to {', '.join(f'`{name}`' for name in names)}" if names else "no transition leaves it"
    where = f"state of `{key[1]}`" + (f", machine `{key[2]}`" if key[2] != "main" else "")
    resting = "agents stand still: no line steers" if _is_resting_state(symbol, node) else ""
    return format_markdown(f"state {node.name.text}{label}{colour}", min_time, leads, resting, where)


def _is_resting_state(symbol: SymbolDeclaration, state: nodes.State) -> bool:
    """Return whether a state does not steer, although another state of its machine does."""
    key = symbol.key
    target = find_declaration(symbol.workspace, symbol.document, ("species", key[1]))
    members = target[1].node.members if target is not None else ()
    machine_members = next((m.members for m in members if isinstance(m, nodes.Machine) and m.name.text == key[2]), members)
    silent = not any(isinstance(line, nodes.Steer) for line in state.body)
    return silent and any(isinstance(line, nodes.Steer) for m in machine_members if isinstance(m, nodes.State) for line in m.body)


def _describe_behaviour(symbol: SymbolDeclaration, node: nodes.Behaviour) -> str:
    return format_markdown(f"behaviour {format_signature(node)}", find_help_text(node), f"in `{symbol.file.path.name}`")


def _describe_behaviour_part(symbol: SymbolDeclaration, node: Any) -> str:
    """Return the help for an argument or a local value of a behaviour."""
    key = symbol.key
    if isinstance(node, nodes.BehaviourArgument):
        default = collapse_whitespace(node.default.span.text) if node.default is not None else ""
        form = f"{node.name.text}: {collapse_whitespace(node.type.span.text)}" + (f" = {default}" if default else "")
        return format_markdown(form, f"default {default}" if default else "must be given", f"argument of `{key[2]}`")
    return format_markdown(collapse_whitespace(node.span.text), find_help_text(node), f"in behaviour `{key[2]}`")


def _describe_measure(symbol: SymbolDeclaration, node: nodes.Measure) -> str:
    value = collapse_whitespace(node.value.span.text)
    return format_markdown(f"measure {node.name.text} = {value}", find_help_text(node), "reported by each run")


def _describe_let(symbol: SymbolDeclaration, node: Any) -> str:
    return format_markdown(collapse_whitespace(node.span.text), f"in state `{symbol.key[3]}`")


def _describe_machine(symbol: SymbolDeclaration, node: nodes.Machine) -> str:
    states = ", ".join(f"`{m.name.text}`" for m in node.members if isinstance(m, nodes.State))
    return format_markdown(f"machine {node.name.text}", find_help_text(node), f"states {states}" if states else "")


# By the kind of a symbol: the nodes that may declare it, and the function that describes it.
_DESCRIPTION_RULES: dict[str, tuple[type, Callable[[SymbolDeclaration, Any], str]]] = {
    "own": (object, _describe_own_member), "thing": (nodes.WorldItem, _describe_thing),
    "attribute": (object, _describe_item_attribute),
    "field": (nodes.FieldDecl, _describe_field), "species": (object, _describe_species), "state": (nodes.State, _describe_state),
    "behaviour": (nodes.Behaviour, _describe_behaviour), "inner": (object, _describe_behaviour_part), 
    "let": (object, _describe_let), "measure": (nodes.Measure, _describe_measure), "machine": (nodes.Machine, _describe_machine),
}  # fmt: skip
