"""Tables that `antdsl check` prints about programs and scenes: `--params`, `--cost` and `--imports`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from antdsl.diagnostics.text_positions import escape_text
from antdsl.program.cost import StateCost, estimate_costs
from antdsl.program.kinds import TypeKind
from antdsl.program.model import Constant, Param, Program, Species
from antdsl.program.tables.editions import STANDING_SIZE_SETTING, find_setting_defaults
from antdsl.program.tables.units import find_unit_measure
from antdsl.source import Span
from antdsl.syntax import nodes

if TYPE_CHECKING:
    from antdsl.diagnostics import Report
    from antdsl.pipeline import RunChoices, Shot

CheckedPrograms = Sequence[tuple[Path, Program]]


def _align_rows(rows: Sequence[Sequence[str]]) -> Iterator[str]:
    """Yield the rows as lines with aligned columns. The last column is not padded."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]) - 1)]
    for row in rows:
        cells = [cell.ljust(width) for cell, width in zip(row, widths, strict=False)]
        yield "  " + "  ".join([*cells, row[-1]]).rstrip()


# --- params ----------------------------------------------------------------------------------------------------------


def format_params_table(programs: CheckedPrograms) -> Iterator[str]:
    """Yield the lines of a table of all params. A param is listed only under the first file that contains it."""
    listed_spans: set[Span] = set()
    for file, program in programs:
        new = [param for param in program.params.values() if param.span not in listed_spans]
        listed_spans.update(param.span for param in new)
        if new:
            yield f"{file}:"
            yield from _align_rows([("param", "default", "unit", "range", "help"), *(_make_param_row(param) for param in new)])
    if not listed_spans:
        yield "no program here has a param"


def format_settings_table(programs: CheckedPrograms) -> Iterator[str]:
    """Yield the lines of a table of all species settings of which the default depends on the edition, with value and source."""
    listed_spans: set[Span] = set()
    for file, program in programs:
        rows = [row for source in program.sources for row in _make_setting_rows(source, program, listed_spans)]
        if rows:
            yield f"{file}:"
            yield from _align_rows([("setting", "value", "from"), *rows])


def _make_setting_rows(source: nodes.File, program: Program, listed_spans: set[Span]) -> Iterator[tuple[str, str, str]]:
    """Yield the table rows of the species in one file. Skip species at a location in `listed_spans`; add the locations of all
    others to it."""
    edition = source.edition_number
    for species in source.items:
        if not isinstance(species, nodes.Species) or species.span in listed_spans or species.name.text not in program.species:
            continue
        listed_spans.add(species.span)
        lines = {each.name.text: each for each in species.members if isinstance(each, nodes.AnimalProperty)}
        for name, default in find_setting_defaults(edition, STANDING_SIZE_SETTING in lines).items():
            line = lines.get(name)
            value = default if line is None else " ".join(line.value.span.text.split())
            origin = f"edition {edition}" if line is None else f"line {source.source.find_line_column(line.span.start)[0]}"
            yield f"{species.name.text}.{name}", value, origin


def _make_param_row(param: Param) -> tuple[str, ...]:
    """Return the cells of a param's row: name, default, unit, range and help. Numbers are in the unit that the author used.
    Other values are shown as in the source."""
    measure = find_unit_measure(param.unit) if param.unit else None

    def format_cell(value: Constant | None) -> str:
        if value is None:
            return "…"
        if param.type.kind is TypeKind.BOOL:
            return "true" if value.number else "false"
        if measure is None or (measure.unit_power, measure.step) != (value.unit_power, value.step):
            return " ".join(value.span.text.split()) if param.unit else f"{value.number:.6g}"
        return f"{value.number / measure.factor:.6g}"

    bounded = param.low is not None or param.high is not None
    range = f"{format_cell(param.low)} .. {format_cell(param.high)}" if bounded else "any"
    return param.name, format_cell(param.default), param.unit or "-", range, escape_text(param.help)


# --- cost ------------------------------------------------------------------------------------------------------------


def format_cost_table(programs: CheckedPrograms) -> Iterator[str]:
    """Yield the lines of a table of the queries of each state and the memory per agent. A species is listed only under the first
    file that contains it."""
    listed_spans: set[Span] = set()
    for file, program in programs:
        new = [species for species in program.species.values() if species.span not in listed_spans]
        listed_spans.update(species.span for species in new)
        sizes = _describe_memory(program) if new else {}
        for species in new:
            yield f"{file}: {species.name}{sizes.get(species.name, '')}"
            yield from _align_rows([("state", "cost", "sums", "senses, fields and draws"), *_make_state_rows(program, species)])
    if not listed_spans:
        yield "no program without errors here has a species"


def _make_state_rows(program: Program, species: Species) -> Iterator[tuple[str, ...]]:
    """Yield a row for each state of a species, with its queries of senses, fields and random draws."""
    for part in estimate_costs(program, species):
        words = "; ".join(_list_counted_operations(part))
        yield part.name, f"{part.weight:,.0f}", f"{part.operation_count:,}", words or "-"


def _list_counted_operations(part: StateCost) -> Iterator[str]:
    """Yield one text per kind of query that a state makes. The text lists these queries."""
    for kind in ("senses", "fields", "draws"):
        words = [use.description for use in part.cost_entries if use.kind == kind]
        if words:
            yield f"{kind}: {', '.join(words)}"


_ROLE_PHRASES = {"attribute": "attributes", "pair": "values per pair", "memory": "memory"}


def _describe_memory(program: Program) -> dict[str, str]:
    """Return a text about the memory per agent of each species, by name; {} if the program cannot be compiled yet."""
    from antdsl import passes, plan
    from antdsl.plan.registers import count_bytes_by_purpose

    lowered, report = plan.lower(program)
    if not report.ok:
        return {}
    memory_words = {}
    for name, species in passes.optimise_plan(lowered).species.items():
        size = count_bytes_by_purpose(species)
        role_sizes = [f"{size[role]} {words}" for role, words in _ROLE_PHRASES.items() if size[role] or role != "pair"]
        of_all = sum(size[role] for role in _ROLE_PHRASES)
        memory_words[name] = f", {of_all} bytes per agent ({', '.join(role_sizes)}), {size['temp']} more in a step"
    return memory_words


# --- imports ---------------------------------------------------------------------------------------------------------


def format_import_table(files: Sequence[Path], reports: Mapping[Path, Report], choices: RunChoices) -> Iterator[str]:
    """Yield lines about each mesh of the scenes in `files`: its contents, and what the import changed. Scenes with errors are
    included."""
    from antdsl.pipeline import read_mesh_imports
    from antdsl.scene.geometry.import_notes import format_import_report

    count = 0
    for file in files:
        if file.suffix == ".ant":
            continue
        imports, units = read_mesh_imports(file, choices)
        for name, mesh_import in imports.items():
            first, *rest = format_import_report(mesh_import, units)
            yield f"{file}: {name}: {first}"
            yield from (f"  {line}" for line in rest)
        if not imports and not reports[file].ok:
            yield explain_missing_table("import report", file, reports[file])
        count += bool(imports) or not reports[file].ok
    if not count:
        yield "no scene here has a mesh"


def explain_missing_table(table_kind: str, file: Path, report: Report) -> str:
    """Return the reason why a file has no table. `table_kind`: the kind of table, for the message."""
    errors = sum(each.severity == "error" for each in report.diagnostics)
    return f"no {table_kind} for `{file}`: it has {errors} error{'' if errors == 1 else 's'} (above)"


# --- work of a scene -------------------------------------------------------------------------------------------------


def format_agent_counts(files: Sequence[Path], choices: RunChoices) -> Iterator[str]:
    """For each scene that creates agents during the run, yield a line with the largest number of agents that it may have."""
    from antdsl.scene.crowds.crowd_checks import count_agents
    from antdsl.scene.load import load_scene

    for file in files:
        scene = load_scene(file, choices.grants)[0] if file.suffix != ".ant" else None
        if scene is None or all(line.frames is None and line.seconds is None for line in scene.model.crowd):
            continue
        counts = list(zip(scene.model.crowd, count_agents(scene), strict=True))
        later_count = sum(count for line, count in counts if line.frames is not None or line.seconds is not None)
        total = sum(count for _, count in counts)
        yield f"{file}: at most {total:,} agents of the crowd, {later_count:,} of them created in given frames"


def format_work_table(file: Path, shot: Shot) -> Iterator[str]:
    """Yield lines about the allocations for the world and crowd of a scene, in counts and bytes. They are estimated before
    anything is allocated."""
    from antdsl.cli.memory_demand import estimate_shot_work, format_bytes

    works = estimate_shot_work(shot)
    yield f"{file}: at least {format_bytes(sum(work.bytes for work in works))} for the world and its crowd"
    rows = [(work.subject, f"{work.part_count:,} {work.unit_name}", format_bytes(work.bytes)) for work in works]
    yield from _align_rows([("thing", "work", "memory"), *rows])
