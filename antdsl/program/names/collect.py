"""The first pass over the files: finds the behaviours that each file can call, and the names that all files declare."""

from __future__ import annotations

import posixpath
from collections.abc import Callable, Iterator, Mapping

from antdsl import limits
from antdsl.diagnostics import Fix, Report
from antdsl.diagnostics.suggestion import nearest_name
from antdsl.program.names.scope import (
    BehaviourInfo,
    Declarations,
    FileNames,
    MachineNames,
    SpeciesNames,
    did_you_mean,
    report_duplicate,
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


def module_key(using: nodes.File, written: str) -> str:
    """Return the key of a file that is used by path: its path relative to the file that uses it, in the form of `Source.path`."""
    return posixpath.normpath(posixpath.join(posixpath.dirname(using.source.path.replace("\\", "/")), written))


class FileLoader:
    """Finds the behaviours that files use. Each library and module is read once."""

    def __init__(self, report: Report, library: LibraryFinder, modules: Mapping[str, nodes.File] | None) -> None:
        self.report = report
        self.library = library
        self.modules = modules or {}
        self.complained = modules is not None  # the caller has reported missing files
        self.known: dict[int, FileNames] = {}
        self.libraries: dict[str, FileNames | None] = {}

    def file(self, node: nodes.File, above: tuple[nodes.File, ...] = ()) -> FileNames:
        """Return the names of a file. `above`: the files that use it, outermost first, to detect cycles."""
        if id(node) in self.known:
            return self.known[id(node)]
        names = self.known[id(node)] = FileNames(node)
        for item in node.items:
            if isinstance(item, nodes.Behaviour):
                self._behaviour(names, item)
        for item in node.items:
            if isinstance(item, nodes.Use):
                self._load_use(names, item, (*above, node))
        return names

    def library_of(self, behaviour: str) -> str | None:
        """Return the name of the library that has a behaviour of this name, or None. The library need not be in use."""
        for name in LIBRARY_NAMES:
            node = self.library(name)
            if node is not None and any(isinstance(item, nodes.Behaviour) and item.name.text == behaviour for item in node.items):
                return name
        return None

    def library_behaviour(self, library: str, behaviour: str) -> BehaviourInfo | None:
        """Return a library's behaviour that the language itself needs, or None. The library need not be in use."""
        names = self.libraries.get(library)
        if names is None and (node := self.library(library)) is not None:
            names = self.libraries[library] = self.file(node)
        return None if names is None else names.own.get(behaviour)

    def _behaviour(self, names: FileNames, node: nodes.Behaviour) -> None:
        name = node.name.text
        if name in names.own:
            report_duplicate(self.report, "behaviour", node.name, names.own[name].node.name.span)
        elif name in BUILTINS_BY_NAME or name in REDUCER_HELP or name in RESERVED_WORDS:
            message = f"`{name}` is a word of the language"
            self.report.error("reserved-name", message, node.name.span, f"call it otherwise, such as `my_{name}`")
        else:
            names.own[name] = BehaviourInfo(node, names)

    def _load_use(self, names: FileNames, item: nodes.Use, above: tuple[nodes.File, ...]) -> None:
        if item.library is not None:
            self._use_library(names, item.library, above)
        elif item.path is not None and item.alias is not None:
            self._use_module(names, item.path, item.alias, above)

    def _use_library(self, names: FileNames, name: nodes.Name, above: tuple[nodes.File, ...]) -> None:
        if name.text not in self.libraries:
            node = self.library(name.text)
            self.libraries[name.text] = None if node is None else self.file(node, above)
        file_names = self.libraries[name.text]
        if file_names is None:
            names.wanting.add(nearest_name(name.text, LIBRARY_NAMES) or "")  # suppresses errors about names of this library
            self.report.error(
                "unknown-library",
                f"no library `{name.text}`",
                name.span,
                did_you_mean(name.text, LIBRARY_NAMES, "the library that comes with antdsl is `steering`"),
            )
            return
        names.libraries.append(name.text)
        for behaviour, info in file_names.own.items():
            names.library.setdefault(behaviour, info)

    def _use_module(self, names: FileNames, path: nodes.Text, alias: nodes.Name, above: tuple[nodes.File, ...]) -> None:
        node = self.modules.get(module_key(names.node, path.text)) or self.modules.get(path.text)
        if node is None:
            names.aliases[alias.text] = FileNames(names.node, missing=True)
            if not self.complained:
                advice = 'write the path from this file\'s folder: `use "./mine.ant" as mine`'
                self.report.error("unknown-module", f"no file `{path.text}` could be read", path.span, advice)
        elif any(node is each for each in above):
            circle = " → ".join(f"`{each.source.path}`" for each in [*above[[id(e) for e in above].index(id(node)) :], node])
            message = f"files use each other in a circle: {circle}"
            self.report.error("circle", message, path.span, "put what both need into a third file")
        elif len(above) >= limits.MAX_USE_DEPTH:
            message = f"files use files more than {limits.MAX_USE_DEPTH} levels deep"
            self.report.error("too-deep", message, path.span, "use the file directly")
        elif alias.text in names.aliases:
            message = f"two files are both named `{alias.text}`"
            self.report.error("duplicate-name", message, alias.span, "give one of them another name")
        else:
            names.aliases[alias.text] = self.file(node, above)


# --- names of all files together -------------------------------------------------------------------------------------


def declare(declared: Declarations, names: FileNames) -> None:
    """Add the names of a file's fields, species, machines, states and events. `world.py` adds the things of the world."""
    report = declared.report
    for item in names.node.items:
        if isinstance(item, nodes.Species):
            known = declared.species.get(item.name.text)
            if known is not None and known.node is not None:
                report_duplicate(report, "species", item.name, known.node.name.span)
                continue
            check_free(report, item.name)
            species_names = SpeciesNames(item.name.text, item, edition=names.node.edition_number)
            declared.species[item.name.text] = species_names
            _declare_machines(report, species_names, item)
    for item in names.node.items:
        if isinstance(item, nodes.Species):
            for event, span in _events(item):
                declared.events.setdefault(event, span)


def check_free(report: Report, name: nodes.Name) -> bool:
    """Return whether a name may be declared. Report an error if it is a word of the language."""
    if name.text in _RESERVED_NAMES:
        message = f"`{name.text}` is a word of the language"
        report.error("reserved-name", message, name.span, f"call it otherwise, such as `my_{name.text}`")
        return False
    return True


def check_free_in_species(report: Report, name: nodes.Name, value: Span, builtins: Mapping[str, BuiltinAttribute]) -> bool:
    """Like `check_free`, for members of a species, which may not have the names of `builtins` either. `value`: the span of the
    declared value."""
    builtin = builtins.get(name.text)
    if builtin is None:
        return check_free(report, name)
    if builtin.settable:
        text = " ".join(value.text.split())
        words = f"`{name.text}` is built in and is set without `=`"
        advice = f"write `{name.text} {text}`"
        report.error("reserved-name", words, name.span, advice, fix=Fix(name.span.to(value), f"{name.text} {text}"))
    else:
        message = f"every agent has a `{name.text}` already: {builtin.help}"
        report.error("reserved-name", message, name.span, f"call it otherwise, such as `my_{name.text}`")
    return False


def _declare_machines(report: Report, species: SpeciesNames, node: nodes.Species) -> None:
    """Add the machines of a species with their states: each `machine`, and `main` for states directly in the species."""
    loose = tuple(m for m in node.members if isinstance(m, nodes.State))
    if loose:
        _declare_machine(report, species, "main", loose)
    for member in node.members:
        if isinstance(member, nodes.Machine):
            if member.name.text in species.machines:
                report_duplicate(report, "machine", member.name, member.name.span)
                continue
            check_free_in_species(report, member.name, member.name.span, species.builtins)
            _declare_machine(report, species, member.name.text, tuple(m for m in member.members if isinstance(m, nodes.State)))


def _declare_machine(report: Report, species: SpeciesNames, name: str, states: tuple[nodes.State, ...]) -> None:
    machine_names = MachineNames(name, f"{species.name}.{name}", {})
    spans: dict[str, Span] = {}
    for state in states:
        if state.name.text in machine_names.states:
            report_duplicate(report, "state", state.name, spans[state.name.text])
            continue
        check_free(report, state.name)
        machine_names.states[state.name.text] = len(machine_names.states)
        spans[state.name.text] = state.name.span
    if len(machine_names.states) > limits.MAX_MACHINE_STATES:
        message = f"machine `{name}` has more than {limits.MAX_MACHINE_STATES} states"
        report.error("too-many", message, states[limits.MAX_MACHINE_STATES].name.span, "split it into several machines")
    species.machines[name] = machine_names


def _events(species: nodes.Species) -> Iterator[tuple[str, Span]]:
    """Yield the events that a species emits or handles."""
    for actions in action_blocks(species):
        for action in actions:
            if (event := raised_event(action)) is not None:
                yield event.text, event.span
    for member in species.members:
        if isinstance(member, nodes.On) and member.event.text not in BUILTIN_EVENTS:
            yield member.event.text, member.event.span


def raised_event(part: object) -> nodes.Name | None:
    """Return the name of the event that a line emits, or None."""
    row = EFFECT_BY_OPERATION.get(part.verb) if isinstance(part, nodes.Ask) else None
    return part.name if isinstance(part, nodes.Ask) and row is not None and row.target == "event" else None


def action_blocks(species: nodes.Species) -> Iterator[tuple[object, ...]]:
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
