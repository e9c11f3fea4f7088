"""The first pass over the files: finds the behaviours that each file can call, and the names that all files declare."""

from __future__ import annotations

import posixpath
from collections.abc import Callable, Iterator, Mapping

from antdsl import limits
from antdsl.diagnostics import Fix, Report
from antdsl.diagnostics.suggestion import find_nearest_name
from antdsl.program.names.scope import (
    BehaviourInfo,
    Declarations,
    FileNames,
    MachineNames,
    SpeciesNames,
    report_duplicate,
    suggest_name,
)
from antdsl.program.tables.effects import EFFECT_BY_OPERATION
from antdsl.program.tables.vocabulary import (
    BUILTINS_BY_NAME,
    REDUCER_HELP,
    RESERVED_WORDS,
    RUN_VALUE_TYPES,
    SENSE_TYPE_BY_NAME,
    BuiltinAttribute,
)
from antdsl.source import Span
from antdsl.syntax import nodes

LibraryFinder = Callable[[str], "nodes.File | None"]

_RESERVED_NAMES = frozenset(
    {
        *RUN_VALUE_TYPES,
        *SENSE_TYPE_BY_NAME,
        *RESERVED_WORDS,
        "state",
        "previous",
        "next",
        "time_in_state",
        "self",
        "true",
        "false",
        "none",
        "chance",
        "clip",
    }
)
BUILTIN_EVENTS = ("spawn", "collision")
LIBRARY_NAMES = ("steering",)


def make_module_key(using_file: nodes.File, path: str) -> str:
    """Return the key of a file that another file uses by path. It is the path, resolved from the folder of `using_file`, in the
    form of `Source.path`."""
    return posixpath.normpath(posixpath.join(posixpath.dirname(using_file.source.path.replace("\\", "/")), path))


class FileLoader:
    """Loader of the behaviours that files use. Each library and module is read only once."""

    def __init__(self, report: Report, library: LibraryFinder, modules: Mapping[str, nodes.File] | None) -> None:
        self.report = report
        self.load_library = library
        self.modules = modules or {}
        self.has_reported_missing = modules is not None  # the caller has reported missing files
        self.known: dict[int, FileNames] = {}
        self.libraries: dict[str, FileNames | None] = {}

    def load_file(self, node: nodes.File, using_files: tuple[nodes.File, ...] = ()) -> FileNames:
        """Return the names of a file. `using_files`: the chain of files that lead to this one, outermost first, to detect
        cycles."""
        if id(node) in self.known:
            return self.known[id(node)]
        names = self.known[id(node)] = FileNames(node)
        for item in node.items:
            if isinstance(item, nodes.Behaviour):
                self._add_behaviour(names, item)
        for item in node.items:
            if isinstance(item, nodes.Use):
                self._load_use(names, item, (*using_files, node))
        return names

    def find_library(self, behaviour: str) -> str | None:
        """Return the name of the library that contains a behaviour, or None. The program need not contain a `use` line for the
        library."""
        for name in LIBRARY_NAMES:
            node = self.load_library(name)
            if node is not None and any(isinstance(item, nodes.Behaviour) and item.name.text == behaviour for item in node.items):
                return name
        return None

    def find_library_behaviour(self, library: str, behaviour: str) -> BehaviourInfo | None:
        """Return a behaviour of a library that the language itself calls, or None. The program need not contain a `use` line for
        the library."""
        names = self.libraries.get(library)
        if names is None and (node := self.load_library(library)) is not None:
            names = self.libraries[library] = self.load_file(node)
        return None if names is None else names.own_behaviours.get(behaviour)

    def _add_behaviour(self, names: FileNames, node: nodes.Behaviour) -> None:
        name = node.name.text
        if name in names.own_behaviours:
            report_duplicate(self.report, "behaviour", node.name, names.own_behaviours[name].node.name.span)
        elif name in BUILTINS_BY_NAME or name in REDUCER_HELP or name in RESERVED_WORDS:
            message = f"`{name}` is a word of the language"
            self.report.error("reserved-name", message, node.name.span, f"choose another name, such as `my_{name}`")
        else:
            names.own_behaviours[name] = BehaviourInfo(node, names)

    def _load_use(self, names: FileNames, item: nodes.Use, using_files: tuple[nodes.File, ...]) -> None:
        if item.library is not None:
            self._use_library(names, item.library, using_files)
        elif item.path is not None and item.alias is not None:
            self._use_module(names, item.path, item.alias, using_files)

    def _use_library(self, names: FileNames, name: nodes.Name, using_files: tuple[nodes.File, ...]) -> None:
        if name.text not in self.libraries:
            node = self.load_library(name.text)
            self.libraries[name.text] = None if node is None else self.load_file(node, using_files)
        file_names = self.libraries[name.text]
        if file_names is None:
            names.missing_uses.add(
                find_nearest_name(name.text, LIBRARY_NAMES) or ""
            )  # suppresses errors about names of this library
            self.report.error(
                "unknown-library",
                f"no library `{name.text}`",
                name.span,
                suggest_name(name.text, LIBRARY_NAMES, "antdsl has one library: `steering`"),
            )
            return
        names.libraries.append(name.text)
        for behaviour, info in file_names.own_behaviours.items():
            names.library_behaviours.setdefault(behaviour, info)

    def _use_module(self, names: FileNames, path: nodes.Text, alias: nodes.Name, using_files: tuple[nodes.File, ...]) -> None:
        node = self.modules.get(make_module_key(names.node, path.text)) or self.modules.get(path.text)
        if node is None:
            names.aliases[alias.text] = FileNames(names.node, is_missing=True)
            if not self.has_reported_missing:
                advice = 'write the path from this file\'s folder: `use "./mine.ant" as mine`'
                self.report.error("unknown-module", f"no file `{path.text}` could be read", path.span, advice)
        elif any(node is each for each in using_files):
            circle = " → ".join(
                f"`{each.source.path}`" for each in [*using_files[[id(e) for e in using_files].index(id(node)) :], node]
            )
            message = f"files use each other in a circle: {circle}"
            self.report.error("circle", message, path.span, "move the common parts to a third file")
        elif len(using_files) >= limits.MAX_USE_DEPTH:
            message = f"files are nested more than {limits.MAX_USE_DEPTH} levels deep"
            self.report.error("too-deep", message, path.span, "use the file directly")
        elif alias.text in names.aliases:
            message = f"two files are both named `{alias.text}`"
            self.report.error("duplicate-name", message, alias.span, "give one of them another name")
        else:
            names.aliases[alias.text] = self.load_file(node, using_files)


# --- names of all files together -------------------------------------------------------------------------------------


def declare_names(declarations: Declarations, names: FileNames) -> None:
    """Add the fields, species, machines, states and events of a file to the declarations. `world.py` adds the things of the
    world."""
    report = declarations.report
    for item in names.node.items:
        if isinstance(item, nodes.Species):
            known = declarations.species.get(item.name.text)
            if known is not None and known.node is not None:
                report_duplicate(report, "species", item.name, known.node.name.span)
                continue
            check_free_name(report, item.name)
            species_names = SpeciesNames(item.name.text, item, edition=names.node.edition_number)
            declarations.species[item.name.text] = species_names
            _declare_machines(report, species_names, item)
    for item in names.node.items:
        if isinstance(item, nodes.Species):
            for event, span in _iterate_events(item):
                declarations.events.setdefault(event, span)


def check_free_name(report: Report, name: nodes.Name) -> bool:
    """Return whether a name may be declared. Report an error if it is a word of the language."""
    if name.text in _RESERVED_NAMES:
        message = f"`{name.text}` is a word of the language"
        report.error("reserved-name", message, name.span, f"choose another name, such as `my_{name.text}`")
        return False
    return True


def check_free_member_name(report: Report, name: nodes.Name, value: Span, builtins: Mapping[str, BuiltinAttribute]) -> bool:
    """Return whether a name is free for a member of a species. Report an error for words of the language, as `check_free_name`
    does, and for names of `builtins`.

    `value`: the span of the declared value."""
    builtin = builtins.get(name.text)
    if builtin is None:
        return check_free_name(report, name)
    if builtin.is_settable:
        text = " ".join(value.text.split())
        words = f"`{name.text}` is built in and is set without `=`"
        advice = f"write `{name.text} {text}`"
        report.error("reserved-name", words, name.span, advice, fix=Fix(name.span.to(value), f"{name.text} {text}"))
    else:
        message = f"every agent has a `{name.text}` already: {builtin.help}"
        report.error("reserved-name", message, name.span, f"choose another name, such as `my_{name.text}`")
    return False


def _declare_machines(report: Report, species: SpeciesNames, node: nodes.Species) -> None:
    """Add the machines of a species with their states. States directly in the species belong to the machine `main`."""
    loose = tuple(m for m in node.members if isinstance(m, nodes.State))
    if loose:
        _declare_machine(report, species, "main", loose)
    for member in node.members:
        if isinstance(member, nodes.Machine):
            if member.name.text in species.machines:
                report_duplicate(report, "machine", member.name, member.name.span)
                continue
            check_free_member_name(report, member.name, member.name.span, species.builtins)
            _declare_machine(report, species, member.name.text, tuple(m for m in member.members if isinstance(m, nodes.State)))


def _declare_machine(report: Report, species: SpeciesNames, name: str, states: tuple[nodes.State, ...]) -> None:
    machine_names = MachineNames(name, f"{species.name}.{name}", {})
    spans: dict[str, Span] = {}
    for state in states:
        if state.name.text in machine_names.states:
            report_duplicate(report, "state", state.name, spans[state.name.text])
            continue
        check_free_name(report, state.name)
        machine_names.states[state.name.text] = len(machine_names.states)
        spans[state.name.text] = state.name.span
    if len(machine_names.states) > limits.MAX_MACHINE_STATES:
        message = f"machine `{name}` has more than {limits.MAX_MACHINE_STATES} states"
        report.error("too-many", message, states[limits.MAX_MACHINE_STATES].name.span, "split it into several machines")
    species.machines[name] = machine_names


def _iterate_events(species: nodes.Species) -> Iterator[tuple[str, Span]]:
    """Yield the name and span of each event that a species emits or handles."""
    for actions in iterate_action_blocks(species):
        for action in actions:
            if (event := find_emitted_event(action)) is not None:
                yield event.text, event.span
    for member in species.members:
        if isinstance(member, nodes.On) and member.event.text not in BUILTIN_EVENTS:
            yield member.event.text, member.event.span


def find_emitted_event(part: object) -> nodes.Name | None:
    """Return the name of the event that a line emits, or None."""
    row = EFFECT_BY_OPERATION.get(part.verb) if isinstance(part, nodes.VerbLine) else None
    return part.name if isinstance(part, nodes.VerbLine) and row is not None and row.target == "event" else None


def iterate_action_blocks(species: nodes.Species) -> Iterator[tuple[object, ...]]:
    """Yield every list of statements in a species."""
    members: list[object] = list(species.members)
    for machine in species.members:
        if isinstance(machine, nodes.Machine):
            members += machine.members
    for member in members:
        if isinstance(member, (nodes.On, nodes.Change)):
            yield member.actions
        elif isinstance(member, nodes.State):
            yield member.body
            yield member.enter
            yield member.exit
            for line in member.body:
                if isinstance(line, nodes.Change):
                    yield line.actions
