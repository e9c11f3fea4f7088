"""Files of one program to a checked Program: names first, then types, then the checks that look at the whole."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from antdsl.diagnostics import Report
from antdsl.program import model
from antdsl.program.behaviours import check_behaviour
from antdsl.program.checks import CHECKS, OF_SOUND, Checked
from antdsl.program.collect import Library, Loader, declare
from antdsl.program.consequences import without_consequences
from antdsl.program.memo import Memo
from antdsl.program.rules import RULES
from antdsl.program.scope import Declared, FileNames
from antdsl.program.species import complete, draft
from antdsl.program.specs import check_spec
from antdsl.program.world import check_brought, check_field, declare_fields, declare_world
from antdsl.syntax import nodes


def check(
    files: nodes.File | Sequence[nodes.File],
    library: Library,
    modules: Mapping[str, nodes.File] | None = None,
    *,
    strict: bool = False,
    memo: Memo | None = None,
) -> tuple[model.Program, Report]:
    """Names, types, units and rates of one or more files, and everything else that can be known without running them.

    `library` gives the file behind `use NAME`, or None; `modules` the files behind `use "PATH" as NAME`, by `Source.path` or by
    the path as written. `strict` adds warnings about what is legal and depends on the frames per second. `memo` brings what an
    earlier check found about parts that are still the same. A program that comes with errors in the report is for looking at,
    not for lowering.
    """
    files = [files] if isinstance(files, nodes.File) else list(files)
    report = Report()
    declared = Declared(RULES, report, strict, memo=memo)
    loader = Loader(report, library, modules)
    declared.home = loader.home
    names = [loader.file(file) for file in files]
    for each in names:
        declare(declared, each)
    for each in names:
        declare_world(declared, each)
    fields = [(each, field) for each in names for field in declare_fields(declared, each)]
    program = _program(declared, names, fields)
    _behaviours(declared, [*names, *_modules(names)])
    checked = Checked(program, declared, names)
    for look in CHECKS:
        look(checked, report)
    doubtful = [span for each in loader.known.values() for span in each.node.doubtful]
    for look in OF_SOUND if report.ok and not doubtful else ():
        look(checked, report)
    return program, without_consequences(report, doubtful)


def _program(
    declared: Declared, names: Sequence[FileNames], fields: Iterable[tuple[FileNames, nodes.FieldDecl]]
) -> model.Program:
    made_fields = {node.name.text: field for file, node in fields if (field := check_field(declared, file, node)) is not None}
    drafts = []
    for file in names:
        for item in file.node.items:
            if isinstance(item, nodes.Species) and declared.species[item.name.text].node is item:
                drafts.append(draft(declared, file, item))
    check_brought(declared)
    species = {work.names.name: complete(work) for work in drafts}
    params = {param.name: param for each in species.values() for param in each.params}
    written = [(file, item) for file in names for item in file.node.items if isinstance(item, nodes.Spec)]
    specs = tuple(check_spec(declared, file, item, params, made_fields) for file, item in written)
    return model.Program(
        species, dict(declared.things), made_fields, params, tuple(declared.events), specs, tuple(file.node for file in names)
    )  # fmt: skip


def _modules(names: Sequence[FileNames]) -> list[FileNames]:
    """Every file that is used by path, once."""
    found: list[FileNames] = []
    stack = list(names)
    while stack:
        for module in stack.pop().aliases.values():
            if module not in found:
                found.append(module)
                stack.append(module)
    return found


def _behaviours(declared: Declared, names: Sequence[FileNames]) -> None:
    """Behaviours of the program's own files are checked even if nobody calls them; those of the library when they are called."""
    for file in names:
        for info in file.own.values():
            check_behaviour(declared, info)
