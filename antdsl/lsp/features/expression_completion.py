"""Completion inside an expression: values in scope, members after a dot, and arguments inside brackets."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from antdsl.lsp.features.context import CursorContext
from antdsl.lsp.names import ProgramNames
from antdsl.lsp.word_descriptions import VALUE_HELP
from antdsl.lsp.word_help import MEMBER_WORDS, find_help_text, format_builtin, format_signature
from antdsl.lsp.workspace import OpenDocument, Workspace
from antdsl.program.kinds import TypeKind, ValueType
from antdsl.program.names.file_declarations import find_declaring_node
from antdsl.program.names.scope import parse_type_words
from antdsl.program.tables import vocabulary
from antdsl.program.tables.effects import EFFECT_BY_OPERATION
from antdsl.program.types.states import STATE_WORDS
from antdsl.syntax import nodes
from antdsl.syntax.editions import NEWEST_EDITION
from antdsl.syntax.verbs import VERB_BY_WORD


@dataclass(frozen=True, slots=True)
class CompletionItem:
    """One completion proposal. `kind`: keyword, state, unit, function, argument, variable, property, thing, type, colour or
    file. `is_snippet`: whether `insert_text` may contain placeholders such as `${1:name}`."""

    label: str
    kind: str
    detail: str = ""
    help: str = ""
    insert_text: str = ""
    is_snippet: bool = False


@dataclass(frozen=True, slots=True)
class CompletionRequest:
    """A request for completion at a position in a program."""

    workspace: Workspace
    document: OpenDocument
    names: ProgramNames
    context: CursorContext

    @property
    def prefix(self) -> str:
        """Return the statement up to the start of the unfinished word."""
        return self.context.line.removesuffix(self.context.word_prefix)

    @property
    def species(self) -> str | None:
        """Return the name of the species around the position, or None."""
        return self.context.find_enclosing_name("top", "species") or self.context.find_enclosing_name("spec_line", "each")

    @property
    def edition(self) -> int:
        """Return the edition of the language that the file names."""
        return self.document.parsed[0].edition_number if self.document.is_program else NEWEST_EDITION

    @property
    def machine(self) -> str:
        """Return the name of the machine around the position; `main` outside a named machine."""
        return self.context.find_enclosing_name("member", "machine") or "main"


def make_thing_proposer(*kinds: str) -> Callable[[CompletionRequest], Iterator[CompletionItem]]:
    """Return a function that proposes the things of the given kinds, or all things if the file has none of these kinds."""

    def propose_things(request: CompletionRequest) -> Iterator[CompletionItem]:
        for name, item in request.names.things.items():
            if not kinds or item.kind.text in kinds:
                yield CompletionItem(name, "thing", item.kind.text, find_help_text(item))

    return propose_things


def propose_fields(request: CompletionRequest) -> Iterator[CompletionItem]:
    """Propose the fields of the file."""
    for name, node in request.names.fields.items():
        yield CompletionItem(name, "thing", "field", find_help_text(node))


def propose_species(request: CompletionRequest) -> Iterator[CompletionItem]:
    """Propose the species of the file."""
    for name in request.names.species:
        yield CompletionItem(name, "thing", "species")


def _find_local_names(request: CompletionRequest) -> dict[str, tuple[str, ValueType | None]]:
    """Return the local names that are visible at this position. For each name, return a description, and its type if that is
    known."""
    behaviour = request.names.behaviours.get(request.context.find_enclosing_name("top", "behaviour") or "")
    known_names: dict[str, tuple[str, ValueType | None]] = {}
    for each in (*behaviour.arguments, *behaviour.body) if behaviour is not None else ():
        declared_type = each.type if isinstance(each, nodes.BehaviourArgument) else None
        element = declared_type.of.text if declared_type is not None and declared_type.of is not None else None
        known_names[each.name.text] = (
            "argument",
            parse_type_words(declared_type.name.text, element) if declared_type is not None else None,
        )
    for variable, set_name, first in re.findall(r"\(\s*(\w+)\s+in\s+(\w+)(?:\(\s*([a-z_]\w*))?", request.context.line):
        type: ValueType | None
        if set_name == "neighbours":
            type = ValueType(TypeKind.AGENT, referent=request.species)
        elif set_name in ("feelers", "ray"):
            type = ValueType(TypeKind.HIT)
        else:
            type = _find_type(request, first if set_name in ("all", "nearest") else set_name, {})
        known_names[variable] = ("element", type)
    return known_names


def _find_type(
    request: CompletionRequest, name: str, local_names: Mapping[str, tuple[str, ValueType | None]]
) -> ValueType | None:
    """Return the type that a name has in the last check, or else in the last check without errors. Return None if neither knows
    the name."""
    if name in local_names:
        return local_names[name][1]
    if name == "self" and request.species:
        return ValueType(TypeKind.AGENT, referent=request.species)
    check_result, path = request.workspace.check_document(request.document.path), request.document.path
    for program in (check_result.program if check_result is not None else None, request.workspace.find_last_good_program(path)):
        species = program.species.get(request.species or "") if program is not None else None
        known_type = species.own_types.get(name) if species is not None else None
        if known_type is not None and known_type.kind is not TypeKind.BAD:
            return known_type
    if name in request.names.species:
        return ValueType(TypeKind.SPECIES, referent=name)
    return ValueType(TypeKind.ITEMS, referent=name) if name in request.names.things else None


def propose_members(request: CompletionRequest) -> Iterator[CompletionItem]:
    """Propose the members of the value that stands before a dot."""
    prefix = request.prefix[:-1].rstrip()
    call = re.search(r"\b(?:nearest|random|first|pick)\(\s*([a-z_][a-z_0-9]*)[^()]*\)$", prefix)
    name = call or re.search(r"([a-z_][a-z_0-9]*)$", prefix)
    if name is None:
        return
    word = name.group(1)
    local = _find_local_names(request)
    table = request.names.species.get(request.species or "")
    if word in request.names.modules and word not in local:
        module = request.workspace.find_document(request.names.modules[word])
        for behaviour in module.names.behaviours.values() if module is not None else ():
            yield _make_call_item(behaviour)
        return
    if table is not None and word in table.machines:
        for each in STATE_WORDS:
            yield CompletionItem(each, "property", f"of machine {word}")
        return
    owner = _find_type(request, word, local)
    if owner is None:
        return
    owner_name = owner.referent or ""
    if owner.kind in (TypeKind.ITEM, TypeKind.ITEMS):
        thing = request.names.things.get(owner_name)
        for attribute in thing.attributes if thing is not None else ():
            yield CompletionItem(attribute.name.text, "property", f"value of {owner_name}", find_help_text(attribute))
        for member_name, type in vocabulary.ITEM_ATTRIBUTE_TYPES.items():
            yield CompletionItem(member_name, "property", type)
    elif owner.kind is TypeKind.HIT:
        for member_name, type in vocabulary.HIT_ATTRIBUTE_TYPES.items():
            yield CompletionItem(member_name, "property", type)
    elif owner.kind in (TypeKind.AGENT, TypeKind.SPECIES):
        other = request.names.species.get(owner_name)
        for own, member in (other.own_members if other is not None else {}).items():
            node = find_declaring_node(member)
            yield CompletionItem(own, "property", f"of {owner_name}", find_help_text(node))
        if owner.kind is TypeKind.AGENT:
            for member_name, row in vocabulary.get_builtin_attributes(request.edition).items():
                yield CompletionItem(member_name, "property", row.type, row.help)


def propose_argument_names(request: CompletionRequest) -> Iterator[CompletionItem]:
    """Propose the arguments of the current call that have no value yet."""
    context = request.context
    if not re.search(r"(^|[,(])\s*[a-z_0-9]*$", "(" + context.arguments):
        return
    passed_names = set(re.findall(r"([a-z_][a-z_0-9]*)\s*:", context.arguments))
    function_name = context.called_function or ""
    behaviour = find_behaviour(request, function_name)
    if behaviour is not None:
        for argument in behaviour.arguments:
            if argument.name.text not in passed_names:
                default = f" = {argument.default.span.text}" if argument.default is not None else ""
                yield _make_argument_item(argument.name.text, argument.type.span.text + default)
        return
    for row in vocabulary.BUILTINS_BY_NAME.get(function_name, ()):
        for arg in row.args:
            if arg.name not in passed_names:
                yield _make_argument_item(arg.name, arg.type + (f" = {arg.default}" if arg.default is not None else ""))
    for name, detail in _STATEMENT_ARGUMENTS.get(
        function_name if function_name in _STATEMENT_ARGUMENTS else context.line.split(" ")[0], ()
    ):
        if name not in passed_names and context.line.startswith(tuple(_STATEMENT_ARGUMENTS)):
            yield _make_argument_item(name, detail)


# The arguments of statements with brackets, each with its meaning.
_STATEMENT_ARGUMENTS = {
    row.op: tuple((arg.name, f"attribute, {arg.display_name}" if arg.type.startswith("own ") else arg.type) for arg in row.args)
    for row in EFFECT_BY_OPERATION.values()
    if VERB_BY_WORD[row.op].shape in ("open", "arguments")
}


def _make_argument_item(name: str, detail: str) -> CompletionItem:
    return CompletionItem(f"{name}:", "argument", detail, "", f"{name}: ")


def find_behaviour(request: CompletionRequest, function_name: str) -> nodes.Behaviour | None:
    """Return the behaviour called `function_name`, plain or qualified by a file alias (`alias.name`), or None."""
    alias, dot, name = function_name.partition(".")
    if dot:
        module = request.workspace.find_document(request.names.modules[alias]) if alias in request.names.modules else None
        return module.names.behaviours.get(name) if module is not None else None
    return dict(_list_known_behaviours(request)).get(function_name)


def _list_known_behaviours(request: CompletionRequest) -> Iterator[tuple[str, nodes.Behaviour]]:
    """Yield the behaviours of the libraries that the file uses, then those of the file itself."""
    for path in request.names.libraries.values():
        library = request.workspace.find_document(path.resolve())
        if library is not None:
            yield from library.names.behaviours.items()
    yield from request.names.behaviours.items()


def propose_behaviours(request: CompletionRequest) -> Iterator[CompletionItem]:
    """Propose behaviours, and library files that contain further behaviours."""
    for behaviour in dict(_list_known_behaviours(request)).values():
        yield _make_call_item(behaviour)
    for alias in request.names.modules:
        yield CompletionItem(alias, "file", "another file")


def _make_call_item(node: nodes.Behaviour) -> CompletionItem:
    """Return the proposal that inserts a call of a behaviour, with a placeholder for each required argument."""
    required = [argument for argument in node.arguments if argument.default is None]
    placeholders = ", ".join(f"${{{number}:{argument.name.text}}}" for number, argument in enumerate(required, 1))
    optional = "$0" if not required and node.arguments else ""
    insert = f"{node.name.text}({placeholders or optional})" + ("" if optional else "$0")
    return CompletionItem(node.name.text, "function", format_signature(node), find_help_text(node), insert, True)


def propose_own_names(request: CompletionRequest, only_assignable: bool = False) -> Iterator[CompletionItem]:
    """Propose the params and attributes of the current species. `only_assignable`: propose only those that a statement may
    set."""
    table = request.names.species.get(request.species or "")
    for name, member in (table.own_members if table is not None else {}).items():
        if only_assignable and not isinstance(member, nodes.Declaration):
            continue
        node = find_declaring_node(member)
        kind = MEMBER_WORDS.get(type(member), "attribute")
        value = f" = {' '.join(node.value.span.text.split())}" if isinstance(node, nodes.Declaration) else ""
        yield CompletionItem(name, "variable", f"{kind}{value}", find_help_text(node))


_INSIDE_EXPRESSIONS = (
    "and", "or", "not", "no", "if", "then", "else", "is none", "none of", "held", "take", "after", "chance", "when", "self",
)  # fmt: skip


def propose_values(request: CompletionRequest) -> Iterator[CompletionItem]:
    """Propose everything that is a value or may start one."""
    for name, (description, _) in _find_local_names(request).items():
        yield CompletionItem(name, "variable", description)
    if request.context.find_enclosing_name("top", "behaviour") is None:
        yield from propose_own_names(request)
        table = request.names.species.get(request.species or "")
        for word in (*STATE_WORDS, *(table.machines if table is not None else ())):
            if word != "main":
                yield CompletionItem(word, "variable", "of its states")
    yield from propose_behaviours(request)
    yield from make_thing_proposer()(request)
    yield from propose_fields(request)
    yield from propose_species(request)
    for name, row in vocabulary.get_builtin_attributes(request.edition).items():
        yield CompletionItem(name, "variable", row.type, row.help)
    for name, type in (*vocabulary.RUN_VALUE_TYPES.items(), *vocabulary.SENSE_TYPE_BY_NAME.items()):
        yield CompletionItem(name, "variable", type, VALUE_HELP[name].help if name in VALUE_HELP else "")
    for name, rows in vocabulary.BUILTINS_BY_NAME.items():
        cursor = "$0" if rows[0].args else ""
        yield CompletionItem(name, "function", format_builtin(name, rows[0]), rows[0].help, f"{name}({cursor})", True)
    for name, help in vocabulary.REDUCER_HELP.items():
        yield CompletionItem(
            name, "function", f"{name}(n in SET: …)", help, f"{name}(${{1:n}} in ${{2:neighbours(20 mm)}}: $0)", True
        )
    for word in _INSIDE_EXPRESSIONS:
        yield CompletionItem(word, "keyword")
    is_in_behaviour = request.context.find_enclosing_name("top", "behaviour") is not None
    if request.context.find_enclosing_name("top", "spec") is not None or (request.species is None and not is_in_behaviour):
        for word in ("total", "share", "at_start", "time_of", "motion"):
            yield CompletionItem(word, "keyword", "of the whole crowd")
