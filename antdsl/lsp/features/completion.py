"""Completion at a position in a program: for example states after `->`, units after a number, and arguments inside brackets."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator

from antdsl.lsp.features.context import find_context
from antdsl.lsp.features.expression_completion import (
    CompletionItem,
    CompletionRequest,
    make_thing_proposer,
    propose_argument_names,
    propose_behaviours,
    propose_fields,
    propose_members,
    propose_own_names,
    propose_species,
    propose_values,
)
from antdsl.lsp.word_descriptions import FORM_HELP, SETTING_HELP
from antdsl.lsp.workspace import OpenDocument, Workspace
from antdsl.program.expectations import MOTION_MEASURES
from antdsl.program.tables.colours import COLOUR_BY_NAME
from antdsl.program.tables.editions import SWITCH_EDITION, SWITCH_HELP, find_setting_defaults
from antdsl.program.tables.effects import EFFECT_BY_OPERATION
from antdsl.program.tables.things import KIND_BY_WORD, KINDS_WITH_FACES, list_replacements
from antdsl.program.tables.vocabulary import TYPE_BY_WORD, get_builtin_attributes
from antdsl.syntax import nodes
from antdsl.syntax.words import EXAMPLE_LINES, FIXED_FIELD_SETTINGS, LINE_WORDS_BY_RULE, UNIT_NAMES


def complete_program(workspace: Workspace, document: OpenDocument, offset: int) -> list[CompletionItem]:
    """Return the completion proposals at an offset of a program. No two have the same label."""
    context = find_context(document.text.text, offset)
    if context.is_in_text_or_comment:
        return []
    names = document.names
    items_by_label: dict[str, CompletionItem] = {}
    for item in _propose_items(CompletionRequest(workspace, document, names, context)):
        items_by_label.setdefault(item.label, item)
    return list(items_by_label.values())


def _propose_items(request: CompletionRequest) -> Iterator[CompletionItem]:
    """Yield the proposals for a position, possibly with repeated labels."""
    prefix, rule = request.prefix, request.context.rule
    number = re.search(r"(?<![A-Za-z_0-9.])[0-9][0-9.]*[ \t]*([a-zA-Z%/*^0-9]*)$", request.context.line)
    if number is not None and not prefix.endswith(".."):
        if re.search(r"\b(take|give)[ \t]+[^ \t]+[ \t]+$", prefix):
            yield from _propose_amounts(request)
        yield from _propose_units(number.group(1))
        return
    for pattern, give in _RULE_BY_LINE_PATTERN:
        if re.search(pattern, prefix):
            yield from give(request)
            return
    if prefix.endswith(".") and not prefix.endswith(".."):
        yield from propose_members(request)
        return
    if not prefix.strip() and request.context.called_function is None:
        yield from _propose_line_start(request, rule)
        return
    if rule in ("world_item",) or (rule == "top" and not prefix.startswith(("behaviour", "measure"))):
        return
    if request.context.called_function is not None:
        yield from propose_argument_names(request)
    yield from propose_values(request)


# --- at the beginning of a line --------------------------------------------------------------------------------------


def _propose_line_start(request: CompletionRequest, rule: str) -> Iterator[CompletionItem]:
    """Propose the words and names that may begin a line. `rule`: the grammar rule for lines of this block."""
    if rule == "top" and not request.document.text.text[: _find_first_text(request)].strip():
        yield _make_keyword_item("ant")
    for word in LINE_WORDS_BY_RULE.get(rule, ()):
        yield _make_keyword_item(word)
    if rule == "world_item":
        for word, kind in KIND_BY_WORD.items():
            yield CompletionItem(word, "keyword", "kind of thing", kind.help)
    elif rule == "setting":
        for word, setting in SETTING_HELP.items():
            yield CompletionItem(word, "property", "setting of a field", setting.help)
    elif rule == "member":
        defaults = find_setting_defaults(request.edition, False)
        for word, row in get_builtin_attributes(request.edition).items():
            default = defaults.get(word, row.default)
            if row.is_settable:
                yield CompletionItem(word, "property", row.type, row.help + (f"; default {default}" if default else ""))
        for word, help in SWITCH_HELP.items() if request.edition >= SWITCH_EDITION else ():
            yield CompletionItem(word, "property", "bool", f"{help}; default {defaults[word]}")
    elif rule in ("statement", "action"):
        yield from propose_own_names(request, only_assignable=True)
    elif rule == "weight":
        yield from _propose_states(request)
    elif rule == "layer":
        yield CompletionItem("state", "keyword", "the push of the current state")
        yield from propose_behaviours(request)
    elif rule in ("behaviour_line", "rule"):
        yield from propose_values(request)


def _find_first_text(request: CompletionRequest) -> int:
    return len(request.document.text.text) - len(request.document.text.text.lstrip())


_SNIPPET_BY_WORD = {
    "species": "species ${1:name} {\n\t$0\n}", "world": "world {\n\tsurface ${1:ground}\n}",
    "field": "field ${1:trail} on ${2:ground} { cell ${3:4 mm}; half_life ${4:8 s} }",
    "behaviour": 'behaviour ${1:name}(${2:target}: ${3:place}) -> ${4:push} {\n\t"$5"\n\t$0\n}',
    "state": 'state ${1:name} "${2:label}" ${3:amber} {\n\tsteer $0\n}', "layers": "layers {\n\t${0:state}\n}",
    "spec": 'spec "${1:what it shows}" on "${2:scene.yaml}" {\n\tfor ${3:20 s}\n\talways: $0\n}',
    "measure": "measure ${1:name} = $0",
    "param": "param ${1:name} = ${2:1} in ${3:0} .. ${4:10}", "when": "when ${1:condition} -> ${2:state}",
}  # fmt: skip


def _make_keyword_item(word: str) -> CompletionItem:
    return CompletionItem(word, "keyword", EXAMPLE_LINES.get(word, "").partition("` or")[0], FORM_HELP.get(word, ""),
    _SNIPPET_BY_WORD.get(word, ""),
                word in _SNIPPET_BY_WORD)  # fmt: skip


# --- after certain words ---------------------------------------------------------------------------------------------


def _propose_units(prefix: str) -> Iterator[CompletionItem]:
    from antdsl.program.tables.units import describe_dimension, find_unit_measure

    head = prefix[: max(prefix.rfind("/"), prefix.rfind("*")) + 1]
    units = (*UNIT_NAMES, "%", "mm/s", "deg/s", "/s", "%/s", "/step") if not head else UNIT_NAMES
    for unit in units:
        measure = find_unit_measure(head + unit)
        if measure is not None:
            yield CompletionItem(unit, "unit", describe_dimension(measure.dim))


def _propose_targets(request: CompletionRequest) -> Iterator[CompletionItem]:
    """Propose what may follow `->`: states, types or values."""
    if re.match(r"behaviour\b", request.prefix):
        yield from _propose_types(request)
    elif request.context.rule == "rule":
        yield from propose_values(request)
    else:
        yield from _propose_states(request)
        yield CompletionItem("previous", "keyword", "the previous state")
        yield CompletionItem("choose", "keyword", "one of several, by weight", "", "choose { ${1:state}: ${2:1} }", True)


def _propose_states(request: CompletionRequest, all_machines: bool = False) -> Iterator[CompletionItem]:
    """Propose states of the machine around the position. `all_machines`: whether to propose the states of all machines."""
    table = request.names.species.get(request.species or "")
    tables = [table] if table is not None else list(request.names.species.values())
    for each in tables:
        own_machine = request.machine if request.machine in each.machines and not all_machines and table is not None else None
        for machine, states in each.machines.items():
            if own_machine is None or machine == own_machine:
                for name, state in states.items():
                    yield CompletionItem(
                        name, "state", f"state of {each.name}", state.label.text if state.label is not None else ""
                    )


def _propose_all_states(request: CompletionRequest) -> Iterator[CompletionItem]:
    """Propose the states of all machines, because a state may be compared with any of them."""
    return _propose_states(request, all_machines=True)


def _propose_handled_events(request: CompletionRequest) -> Iterator[CompletionItem]:
    """Propose the events that may follow `on` in a handler."""
    yield CompletionItem("spawn", "keyword", "once, at birth")
    yield CompletionItem(
        "collision", "keyword", "the agent's body begins to touch another one", "", "collision(${1:other})", True
    )
    yield from _propose_events(request)


def _propose_events(request: CompletionRequest) -> Iterator[CompletionItem]:
    for name in request.names.events:
        yield CompletionItem(name, "thing", "event")


def _propose_types(request: CompletionRequest) -> Iterator[CompletionItem]:
    for word in TYPE_BY_WORD:
        yield CompletionItem(word, "type", "type")


def _propose_colours(request: CompletionRequest) -> Iterator[CompletionItem]:
    for colour in COLOUR_BY_NAME:
        yield CompletionItem(colour, "colour", "colour")
    yield CompletionItem("for at least", "keyword", "the minimum time in this state")


def _propose_library_names(request: CompletionRequest) -> Iterator[CompletionItem]:
    from antdsl.resources import list_library_names

    for name in list_library_names():
        yield CompletionItem(name, "file", "library of behaviours")


def _propose_amounts(request: CompletionRequest) -> Iterator[CompletionItem]:
    """Propose the attributes of the animal, as amounts that it may take or give."""
    return propose_own_names(request, only_assignable=True)


def _propose_take_sources(request: CompletionRequest) -> Iterator[CompletionItem]:
    """Propose what may follow `from`: `any` in a transition, otherwise a value to take from."""
    if re.match(r"(from|machine)\b", request.prefix.strip()) and "take" not in request.prefix:
        yield CompletionItem("any", "keyword", "from every state except …")
    else:
        yield from propose_values(request)


def _propose_motion_measures(request: CompletionRequest) -> Iterator[CompletionItem]:
    for name, type in MOTION_MEASURES.items():
        yield CompletionItem(name, "property", type)


def _propose_spec_settings(request: CompletionRequest) -> Iterator[CompletionItem]:
    """Propose what a spec may set: params and settings of fields, with their current value."""
    for table in request.names.species.values():
        for name, member in table.own_members.items():
            if isinstance(member, nodes.ParamDecl):
                yield _make_setting_item(f"{table.name}.{name}", member.declaration.value, member.declaration.help)
    for field, node in request.names.fields.items():
        for setting in node.settings:
            if setting.name.text not in FIXED_FIELD_SETTINGS:
                yield _make_setting_item(f"{field}.{setting.name.text}", setting.value, node.help)


def _make_setting_item(name: str, value: nodes.Expr, help: nodes.Text | None) -> CompletionItem:
    text = " ".join(value.span.text.split())
    return CompletionItem(name, "property", text, help.text if help is not None else "", f"{name} = {text}")


def _propose_items_and_animals(request: CompletionRequest) -> Iterator[CompletionItem]:
    """Propose items and species: the things that a reference may fail to find."""
    yield from make_thing_proposer("items")(request)
    yield from propose_species(request)


def _make_kind_rule(kind: str) -> Callable[[CompletionRequest], Iterator[CompletionItem]]:
    """Return the function that proposes names for a statement. `kind`: the kind of name, from the table row of the statement."""
    others = {"field": propose_fields, "event": _propose_events, "species": propose_species}
    return others.get(kind) or make_thing_proposer(*list_replacements(kind))


_RULE_BY_LINE_PATTERN: tuple[tuple[str, Callable[[CompletionRequest], Iterator[CompletionItem]]], ...] = (
    (r"->[ \t]*$", _propose_targets),
    (r"^start[ \t]+$", _propose_states),
    (r"^from any except ([a-z_0-9]+, *)*$", _propose_states),
    (r"(\b|\.)(state|previous|next)[ \t]*[!=]=[ \t]*$", _propose_all_states),
    (r"^field[ \t]+[a-z_0-9]+[ \t]+on[ \t]+([a-z_0-9]+,[ \t]*)*$", make_thing_proposer(*KINDS_WITH_FACES)),
    (r"^on[ \t]+$", _propose_handled_events),
    (r"^each[ \t]+$", propose_species),
    *((rf"^{row.op}[ \t]+$", _make_kind_rule(row.target)) for row in EFFECT_BY_OPERATION.values() if row.target),
    (r"^use[ \t]+$", _propose_library_names),
    (r"^state[ \t]+[a-z_0-9]+[ \t]+(\"[^\"]*\"[ \t]+)$", _propose_colours),
    (
        r"^(behaviour\b.*[(,][ \t]*[a-z_0-9]+|keep[ \t]+[a-z_0-9]+|[a-z_0-9]+):[ \t]*$",
        lambda request: _propose_after_colon(request),
    ),
    (r"\b(take|give)[ \t]+(all|[^ \t]+([ \t]+[a-z%/]+)?)[ \t]+$", _propose_amounts),
    (r"\bfrom[ \t]+$", _propose_take_sources),
    (r"\bmotion\.$", _propose_motion_measures),
    (r"\bnone[ \t]+of[ \t]+$", _propose_items_and_animals),
    (r"(^|\{[ \t]*)set[ \t]+$", _propose_spec_settings),
)


def _propose_after_colon(request: CompletionRequest) -> Iterator[CompletionItem]:
    """Propose what may follow `name:`, which is a type in a declaration, a condition in a spec, or a weight in `choose`."""
    if request.context.rule in ("spec_line", "weight"):
        return propose_values(request)
    return _propose_types(request)
