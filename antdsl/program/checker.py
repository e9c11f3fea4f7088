"""Checks the files of one program and returns a Program. It checks names first, then types, then the complete program."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial

from antdsl.diagnostics import Label, Report
from antdsl.program import model
from antdsl.program.cascading_errors import add_all_locations, drop_cascading_errors
from antdsl.program.checks import CHECKS, ERROR_FREE_CHECKS, PER_SPECIES_CHECKS, PER_STATE_CHECKS, Check, CheckContext
from antdsl.program.declarations.behaviours import check_behaviour
from antdsl.program.declarations.fields import check_field, declare_fields
from antdsl.program.declarations.measures import check_measures, declare_measures
from antdsl.program.declarations.species import begin_species, complete_species
from antdsl.program.declarations.specs import check_spec
from antdsl.program.declarations.world import check_world_species, declare_world
from antdsl.program.memo import CheckResultCache, get_or_compute_part, update_outside_number
from antdsl.program.names.bindings import NameBindings
from antdsl.program.names.collect import FileLoader, LibraryFinder, declare_names
from antdsl.program.names.scope import Declarations, FileNames, SpeciesNames
from antdsl.program.types.descriptions import quote_source
from antdsl.program.types.rules import TYPING_RULES
from antdsl.source import Span
from antdsl.syntax import nodes
from antdsl.syntax.incremental_parser import move_diagnostic


def check(
    files: nodes.File | Sequence[nodes.File],
    library: LibraryFinder,
    modules: Mapping[str, nodes.File] | None = None,
    *,
    strict: bool = False,
    memo: CheckResultCache | None = None,
) -> tuple[model.Program, Report]:
    """Check everything in the files of a program that can be decided without a run, such as names, types, units and rates.

    - `library`: returns the file behind `use NAME`, or None.
    - `modules`: the files behind `use "PATH" as NAME`, by `Source.path` or by the path in the text.
    - `strict`: whether to warn about legal code that depends on the number of frames per second.
    - `memo`: supplies the results of an earlier check for unchanged parts.

    If the report has errors, the program can be inspected but not lowered."""
    files = [files] if isinstance(files, nodes.File) else list(files)
    report = Report()
    declared = Declarations(TYPING_RULES, report, strict, memo=memo)
    loader = FileLoader(report, library, modules)
    declared.find_library, declared.find_library_behaviour = loader.find_library, loader.find_library_behaviour
    names = [loader.load_file(file) for file in files]
    for each in names:
        declare_names(declared, each)
    for each in names:
        declare_world(declared, each)
    fields = [(each, field) for each in names for field in declare_fields(declared, each)]
    file_by_measure = declare_measures(declared, names)
    outside = update_outside_number(declared, _make_key_of_outside_declarations(declared, loader))
    program = _assemble_program(declared, names, fields, file_by_measure)
    declared.outside_number = outside
    _check_behaviours(declared, [*names, *_find_used_modules(names)])
    checked = CheckContext(program, declared, names)
    for look in CHECKS:
        _run_check(checked, look, report)
    recovered = [span for each in loader.known.values() for span in each.node.skipped_spans]
    sound = report.ok and not any(each.node.has_errors for each in loader.known.values())
    for look in ERROR_FREE_CHECKS if sound else ():
        _run_check(checked, look, report)
    if memo is not None:
        memo.mark_results_used(() if sound else (*ERROR_FREE_CHECKS, "named"))
        memo.drop_unused_results()
        if any(each.missing_uses for each in loader.known.values()):
            memo.known.clear()  # cached parts lack the findings that the missing `use` suppressed
    repeated_spans = {first: tuple(dict.fromkeys(others)) for first, *others in declared.unknown_names.values() if others}
    program = replace(program, bindings=NameBindings(tuple(declared.name_uses)))
    return program, drop_cascading_errors(*_convert_to_file_spans(loader, add_all_locations(report, repeated_spans), recovered))


def _run_check(context: CheckContext, check_function: Check, report: Report) -> None:
    """Run one check of the complete program.

    If there is a memo, checks in PER_SPECIES_CHECKS and PER_STATE_CHECKS run only for changed species or states."""
    program = context.program
    if context.declarations.memo is None or check_function not in PER_SPECIES_CHECKS:
        check_function(context, report)
        return
    params = tuple(program.params.values())

    def check_species(species: model.Species) -> None:
        check_function(replace(context, program=replace(program, species={species.name: species})), report)

    def check_state(species: model.Species, machine: model.Machine, state: model.State) -> None:
        check_species(_restrict_to_state(species, machine, state))

    for species in program.species.values():
        if check_function not in PER_STATE_CHECKS:
            get_or_compute_part(context.declarations, (check_function, species, params), partial(check_species, species))
            continue
        without = replace(species, machines=())
        get_or_compute_part(context.declarations, (check_function, species.layers, params), partial(check_species, without))
        for machine in species.machines:
            for state in machine.states:
                get_or_compute_part(
                    context.declarations, (check_function, state, params), partial(check_state, species, machine, state)
                )


def _restrict_to_state(species: model.Species, machine: model.Machine, state: model.State) -> model.Species:
    """Return the species reduced to one machine with one state, and without layers. It is used to check this state alone."""
    return replace(species, machines=(replace(machine, states=(state,)),), layers=replace(species.layers, layers=()))


def _convert_to_file_spans(loader: FileLoader, report: Report, skipped_spans: Sequence[Span]) -> tuple[Report, list[Span]]:
    """Return the report and the skipped spans with locations in complete files. Some parts of a file were parsed separately, so
    their locations are converted."""
    files = {part: file.node for file in loader.known.values() for part in file.node.parts}
    if not files:
        return report, list(skipped_spans)

    def map_span(span: Span) -> Span:
        return files[span.source].file_span(span) if span.source in files else span

    return Report([move_diagnostic(each, map_span) for each in report.diagnostics]), [map_span(span) for span in skipped_spans]


def _make_key_of_outside_declarations(declarations: Declarations, loader: FileLoader) -> Hashable:
    """Return a key for the declarations in other parts of the program that the check of one part uses.

    If the keys of two checks are equal, these declarations are equal too, except for the types of attributes."""
    things = [(t.name, t.kind, tuple((a.name, a.type) for a in t.attributes)) for t in declarations.things.values()]
    machines = [
        (s.name, s.edition, s.node is None, tuple((m.name, *m.states) for m in s.machines.values()))
        for s in declarations.species.values()
    ]
    called = [
        item for each in loader.known.values() for item in each.node.items if isinstance(item, (nodes.Behaviour, nodes.Use))
    ]
    fields = list(declarations.fields.values())
    parts: tuple[Iterable[Hashable], ...] = (things, machines, called, fields, declarations.events, declarations.unclear_things)
    return declarations.strict, *(tuple(part) for part in parts)


def _make_type_key(species: SpeciesNames) -> Hashable:
    """Return a key with the name of a species and the known types of its attributes and params."""
    return (species.name, *species.attributes.items(), *species.pair_value_species.items(), *species.params.items())


def _assemble_program(
    declarations: Declarations,
    names: Sequence[FileNames],
    fields: Iterable[tuple[FileNames, nodes.FieldDecl]],
    file_by_measure: Mapping[str, FileNames],
) -> model.Program:
    made_fields = {node.name.text: field for file, node in fields if (field := check_field(declarations, file, node)) is not None}
    drafts = []
    for file in names:
        for item in file.node.items:
            if isinstance(item, nodes.Species) and declarations.species[item.name.text].node is item:
                drafts.append(begin_species(declarations, file, item))
                update_outside_number(declarations, (declarations.outside_number, _make_type_key(drafts[-1].names)))
    check_world_species(declarations)
    update_outside_number(declarations, (declarations.outside_number, *map(_make_type_key, declarations.species.values())))
    species = {work.names.name: complete_species(work) for work in drafts}
    params = {param.name: param for each in species.values() for param in each.params}
    written = [(file, item) for file in names for item in file.node.items if isinstance(item, nodes.Spec)]
    measures = check_measures(declarations, file_by_measure)
    bindings = (b for each in species.values() for b in (*each.lets, *each.latches))
    known = (*params.values(), *bindings, *declarations.measures.values())
    for file in names:
        _check_spec_names(declarations, file)
    specs = tuple(
        get_or_compute_part(
            declarations, ("spec", item, known), partial(check_spec, declarations, file, item, params, made_fields)
        )
        for file, item in written
    )
    return model.Program(
        species, dict(declarations.things), made_fields, params, tuple(declarations.events), specs,
        tuple(file.node for file in names), measures=measures,
    )  # fmt: skip


def _check_spec_names(declarations: Declarations, file: FileNames) -> None:
    """Report specs in one file that have the same name, because reports and stored results identify specs by name."""
    first: dict[str, Span] = {}
    for spec in (item for item in file.node.items if isinstance(item, nodes.Spec)):
        if spec.name.text in first:
            declarations.report.error(
                "duplicate-name", f"two specs are called {quote_source(spec.name.span)}", spec.name.span, "rename one of them",
                labels=(Label(first[spec.name.text], "first here"),),
            )  # fmt: skip
        first.setdefault(spec.name.text, spec.name.span)


def _find_used_modules(names: Sequence[FileNames]) -> list[FileNames]:
    """Return the files that other files use by path, each once."""
    modules: dict[int, FileNames] = {}
    stack = list(names)
    while stack:
        for module in stack.pop().aliases.values():
            if id(module) not in modules:
                modules[id(module)] = module
                stack.append(module)
    return list(modules.values())


def _check_behaviours(declarations: Declarations, names: Sequence[FileNames]) -> None:
    """Check the behaviours in the program's own files, including behaviours that nothing calls. Library behaviours are checked
    when they are called."""
    for file in names:
        for info in file.own_behaviours.values():
            check_behaviour(declarations, info)
