"""What an editor shows about a name: its declaration in the language's own form, type, range, default and help."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from antdsl.lsp.features.navigation import find_declaration
from antdsl.lsp.language import LANGUAGE, flat, markdown, signature
from antdsl.lsp.words import KINDS
from antdsl.lsp.workspace import Document, Workspace
from antdsl.program.kinds import Kind, Type
from antdsl.program.model import Program
from antdsl.program.names.bindings import Key
from antdsl.program.names.declared import declaration
from antdsl.program.tables.units import default_unit
from antdsl.program.types.descriptions import type_words
from antdsl.syntax import nodes


def describe(workspace: Workspace, document: Document, key: Key) -> str | None:
    """What to show for a symbol, as Markdown; None when nothing is known."""
    if key[0] in LANGUAGE:
        return LANGUAGE[key[0]](key)
    rule = _RULES.get(key[0])
    return rule(workspace, document, key) if rule is not None else None


def _help(node: Any) -> str:
    help = getattr(node, "help", None)
    return help.text if help is not None else ""


def _checked_type(program: Program | None, key: Key) -> Type | None:
    """The type that the checker found for a name of a species."""
    species = program.species.get(key[1]) if program is not None else None
    if species is None:
        return None
    return species.own_types.get(key[-1]) or next((p.type for p in species.params if p.name == f"{key[1]}.{key[-1]}"), None)


def _kind_line(type: Type | None, *details: str) -> str:
    if type is None or type.kind is Kind.BAD:
        return "; ".join(details)
    unit = default_unit(type.dim) if type.kind in (Kind.NUMBER, Kind.VECTOR) else ""
    return "; ".join([type_words(type) + (f", in `{unit}`" if unit else ""), *details])


def _own(workspace: Workspace, document: Document, key: Key) -> str | None:
    target = find_declaration(workspace, document, key)
    if target is None:
        return None
    where, node = target[0], declaration(target[1].node) or target[1].node
    typed = _checked_type(workspace.last_good_program(where.path), key)
    word = {nodes.ParamDecl: "param ", nodes.Let: "let ", nodes.Latch: "latch ", nodes.Fuzzy: "fuzzy "}.get(
        type(target[1].node), ""
    )
    if isinstance(node, nodes.Latch):
        form = f"latch {node.name.text} = {flat(node.on.span.text)} until {flat(node.until.span.text)}"
    elif isinstance(node, nodes.Fuzzy):
        form = f"fuzzy {node.name.text} {{ … }}"
    else:
        form = f"{word}{node.name.text} = {flat(node.value.span.text)}"
    details = []
    if isinstance(node, nodes.Declaration):
        if node.range is not None:
            form += f" in {flat(node.range.span.text)}"
            details.append(f"from {flat(node.range.low.span.text)} to {flat(node.range.high.span.text)}")
        details.append(f"default {flat(node.value.span.text)}" if word else f"{flat(node.value.span.text)} at birth")
        if node.each is not None:
            details.append(f"one value about each {node.each.species.text}")
    return markdown(
        form,
        _kind_line(typed, *details),
        _help(node),
        f"{'param' if word == 'param ' else word.strip() or 'attribute'} of `{key[1]}`",
    )


def _thing(workspace: Workspace, document: Document, key: Key) -> str | None:
    target = find_declaration(workspace, document, key)
    node = target[1].node if target is not None else None
    if not isinstance(node, nodes.WorldItem):
        return None
    inner = "; ".join(flat(each.span.text) for each in node.attributes)
    return markdown(
        f"{node.kind.text} {node.name.text}" + (f" {{ {inner} }}" if inner else ""), KINDS.get(node.kind.text, ""), _help(node)
    )


def _attribute(workspace: Workspace, document: Document, key: Key) -> str | None:
    target = find_declaration(workspace, document, key)
    if target is None:
        return None
    program = workspace.last_good_program(target[0].path)
    thing = program.world.get(key[1]) if program is not None else None
    type = next((each.type for each in thing.attributes if each.name == key[2]), None) if thing is not None else None
    node = target[1].node
    value = flat(node.value.span.text)
    return markdown(f"{key[2]} = {value}", _kind_line(type, f"default {value}"), _help(node), f"value of each of `{key[1]}`")


def _field(workspace: Workspace, document: Document, key: Key) -> str | None:
    target = find_declaration(workspace, document, key)
    node = target[1].node if target is not None else None
    if not isinstance(node, nodes.FieldDecl):
        return None
    surfaces = ", ".join(name.text for name in node.surfaces)
    settings = "; ".join(flat(each.span.text) for each in node.settings)
    return markdown(f"field {key[1]} on {surfaces} {{ {settings} }}", "a field; its name is its value here", _help(node))


def _species(workspace: Workspace, document: Document, key: Key) -> str | None:
    target = find_declaration(workspace, document, key)
    if target is None:
        return None
    table = target[0].names.species.get(key[1])
    machines = table.machines if table is not None else {}
    states = "; ".join(f"{name}: {', '.join(f'`{s}`' for s in states)}" for name, states in machines.items())
    return markdown(f"species {key[1]}", _help(target[1].node), f"states of {states}" if states else "")


def _state(workspace: Workspace, document: Document, key: Key) -> str | None:
    target = find_declaration(workspace, document, key)
    node = target[1].node if target is not None else None
    if not isinstance(node, nodes.State):
        return None
    label = f' "{node.label.text}"' if node.label is not None else ""
    colour = f" {node.colour.text}" if node.colour is not None else ""
    least = f"at least {flat(node.at_least.span.text)}" if node.at_least is not None else ""
    target_names = []
    for line in node.body:
        if isinstance(line, nodes.Change):
            target_names += (
                [line.target.name.text] if line.target.name is not None else [c.target.text for c in line.target.choices]
            )
    leads = (
        "leads to " + ", ".join(f"`{target_name}`" for target_name in dict.fromkeys(target_names))
        if target_names
        else "nothing leads out of it"
    )
    where = f"state of `{key[1]}`" + (f", machine `{key[2]}`" if key[2] != "main" else "")
    still = "does not move: no line in it steers" if _is_resting_state(workspace, document, key, node) else ""
    return markdown(f"state {node.name.text}{label}{colour}", least, leads, still, where)


def _is_resting_state(workspace: Workspace, document: Document, key: Key, state: nodes.State) -> bool:
    """Return whether a state has no steering while another state of its machine steers."""
    target = find_declaration(workspace, document, ("species", key[1]))
    members = target[1].node.members if target is not None else ()
    beside = next((m.members for m in members if isinstance(m, nodes.Machine) and m.name.text == key[2]), members)
    silent = not any(isinstance(line, nodes.Steer) for line in state.body)
    return silent and any(isinstance(line, nodes.Steer) for m in beside if isinstance(m, nodes.State) for line in m.body)


def _behaviour(workspace: Workspace, document: Document, key: Key) -> str | None:
    target = find_declaration(workspace, document, key)
    node = target[1].node if target is not None else None
    if not isinstance(node, nodes.Behaviour) or target is None:
        return None
    return markdown(f"behaviour {signature(node)}", _help(node), f"in `{target[0].path.name}`")


def _inner(workspace: Workspace, document: Document, key: Key) -> str | None:
    target = find_declaration(workspace, document, key)
    if target is None:
        return None
    node = target[1].node
    if isinstance(node, nodes.BehaviourArgument):
        default = flat(node.default.span.text) if node.default is not None else ""
        form = f"{node.name.text}: {flat(node.type.span.text)}" + (f" = {default}" if default else "")
        return markdown(form, f"default {default}" if default else "must be given", f"argument of `{key[2]}`")
    return markdown(flat(node.span.text), _help(node), f"in behaviour `{key[2]}`")


def _let(workspace: Workspace, document: Document, key: Key) -> str | None:
    target = find_declaration(workspace, document, key)
    return markdown(flat(target[1].node.span.text), f"in state `{key[3]}`") if target is not None else None


def _machine(workspace: Workspace, document: Document, key: Key) -> str | None:
    target = find_declaration(workspace, document, key)
    node = target[1].node if target is not None else None
    if not isinstance(node, nodes.Machine):
        return None
    states = ", ".join(f"`{m.name.text}`" for m in node.members if isinstance(m, nodes.State))
    return markdown(f"machine {node.name.text}", _help(node), f"states {states}" if states else "")


_RULES: dict[str, Callable[[Workspace, Document, Key], str | None]] = {
    "own": _own, "thing": _thing, "attribute": _attribute, "field": _field, "species": _species, "state": _state,
    "behaviour": _behaviour, "inner": _inner, "let": _let, "machine": _machine,
}  # fmt: skip
