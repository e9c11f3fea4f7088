"""Fields of the program at the scene's frame rate: whether cells can follow how fast scent spreads, and whether any is laid."""

from __future__ import annotations

from antdsl.diagnostics import Report
from antdsl.program.model import Ask, Expr, Program
from antdsl.program.tables.effects import feeding
from antdsl.program.traverse import parts
from antdsl.program.types.folding import constant_behind
from antdsl.scene.adjusting import with_fields
from antdsl.scene.load import Scene


def largest_stable_diffusion(cell: float, dt: float) -> float:
    """The most diffusion (mm²/s) at which scent in cells of `cell` mm never swings or goes below 0 in steps of `dt` s."""
    return cell * cell / (4.0 * dt)


def spreading(scene: Scene, program: Program, report: Report) -> None:
    dt = float(1 / scene.model.fps)
    for field in with_fields(program, scene, scene.model.set).fields.values():
        cell, diffuse = _base(scene, field.cell), _base(scene, field.diffuse)
        most = largest_stable_diffusion(cell, dt) if cell else 0.0
        if cell and diffuse and diffuse > most * (1 + 1e-6):
            report.error(
                "unstable-field",
                f"field `{field.name}` spreads faster than its cells of {cell:g} mm can follow at {1 / dt:g} frames a second",
                field.diffuse.span if field.diffuse is not None else field.span,
                f"write `diffuse` {most:g} mm^2/s or less, or a larger `cell`",
            )  # fmt: skip
    laying = feeding("field")
    laid = {part.of for part in parts(tuple(program.species.values())) if isinstance(part, Ask) and part.op in laying}
    for name, field in program.fields.items():
        if name not in laid and name not in scene.model.fields:
            report.warning(
                "unlaid-field", f"no agent lays the field `{name}`, and the scene starts without it", field.span,
                f"write `deposit {name} 1 /s` in a state, or in the scene `fields: {{{name}: {{start: 1}}}}`",
            )  # fmt: skip


def _base(scene: Scene, value: Expr | None) -> float | None:
    """A constant setting in base units; None for none, or for one that follows from params."""
    found = constant_behind(value) if value is not None else None
    if found is None:
        return None
    return float(found.number * scene.model.unit_mm**found.u * float(1 / scene.model.fps) ** found.step)
