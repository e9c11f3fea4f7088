"""Creates the fields of a plan on the surfaces of a setting: their cells, start amounts, and rates per step."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from antdsl.diagnostics import Report
from antdsl.fields.cells import FieldTooFineError, SurfaceCells
from antdsl.fields.growing import GrowingCells
from antdsl.fields.periodic_cells import CellsDoNotFit, PeriodicCells
from antdsl.fields.pheromone import PheromoneField
from antdsl.fields.vector_field import VectorField
from antdsl.ground.protocol import Floats, Index
from antdsl.plan import ir
from antdsl.plan.field_components import name_field_components
from antdsl.runtime.binding.binding_cache import BindingCache
from antdsl.runtime.binding.field_starts import find_start_values
from antdsl.scene.field_settings import compute_max_diffusion
from antdsl.scene.setting import MeshData

if TYPE_CHECKING:
    from antdsl.runtime.world import World


def bind_fields(
    world: World,
    meshes: dict[str, MeshData],
    value: Callable[[World, ir.PlanNode], float],
    report: Report,
    binding_cache: BindingCache,
) -> None:
    """Create all fields of the plan in the world. Add errors to the report."""
    cells: dict[tuple[tuple[str, ...], float], SurfaceCells] = {}
    start_values: dict[str, list[tuple[Index, Floats]]] = {}  # of the program's fields; the components of a vector share them
    for plan in world.plan.fields.values():
        size = value(world, plan.cell)
        keep = 1.0 if plan.retained_share is None else value(world, plan.retained_share)
        diffuse = 0.0 if plan.diffuse is None else value(world, plan.diffuse)
        limit = np.inf if plan.limit is None else value(world, plan.limit)
        if not _check_field_settings(plan, size, keep, diffuse, limit, world.dt, report):
            continue
        key = (plan.surfaces, size)
        if key not in cells:
            surfaces = [(m.vertices, m.faces) for name in plan.surfaces if (m := meshes.get(name)) is not None]
            try:
                kind: type[SurfaceCells] = GrowingCells if any(name in world.solids for name in plan.surfaces) else SurfaceCells
                inputs: tuple[Any, ...] = (surfaces, size)
                if world.periodic is not None:
                    kind, inputs = PeriodicCells, (surfaces, size, world.periodic.box)
                make_cells = partial(kind, *inputs)
                keep_all = binding_cache.get_or_compute_deep_copy if kind is GrowingCells else binding_cache.get_or_compute
                cells[key] = keep_all(kind.__name__, inputs, make_cells)
            except CellsDoNotFit as error:
                words = f"the world is {error.width:g} mm wide, which is not a multiple of the cell size of {size:g} mm"
                advice = f"write `cell {error.fitting_cell:g} mm`, or make the world at least three cells wide"
                report.error("field-setting", f"field `{plan.name}` does not fit the world: {words}", plan.span, advice)
                continue
            except FieldTooFineError as error:
                row = " in a row" if error.is_axis_limit else ""
                words = f"about {error.needed:,} cells of {size:g} mm{row}; at most {error.cap:,} are allowed"
                report.error("field-too-fine", f"field `{plan.name}` needs {words}", plan.span, "write a larger `cell`")
                continue
        field = PheromoneField(
            cells[key],
            "max" if plan.combine == "max" else "add",
            np.inf if plan.vector_field else limit,
            plan.stencil,
            deposits_first=plan.deposits == "first",
            has_signed_amounts=bool(plan.vector_field),
        )
        program_name = plan.vector_field or plan.name
        if program_name not in start_values:
            own_meshes = {name: mesh for name in plan.surfaces if (mesh := meshes.get(name)) is not None}
            starts = world.setting.field_start.get(program_name, ())
            start_values[program_name] = [find_start_values(world, field.cells, start, own_meshes) for start in starts]
            for number, (cell_rows, _) in enumerate(start_values[program_name]):
                if not len(cell_rows) and len(field.cells):
                    world.unreached_field_starts.append((program_name, number))
        part = name_field_components(program_name).index(plan.name) if plan.vector_field else None
        for cell_rows, values in start_values[program_name]:
            field.amounts[cell_rows] = values if part is None else values[:, part]
        world.fields[plan.name] = field
        world.field_rates[plan.name] = (np.float32(keep), diffuse)
        components = name_field_components(plan.vector_field)
        if plan.name == components[-1] and world.fields.keys() >= set(components):
            x, y, z = (world.fields[name] for name in components)
            world.vector_fields[plan.vector_field] = VectorField((x, y, z), limit)


def _check_field_settings(
    plan: ir.FieldPlan, size: float, retained_share: float, diffuse: float, limit: float, dt: float, report: Report
) -> bool:
    """Return whether the settings of a field are valid. Add errors to the report."""
    if not (np.isfinite(size) and size > 0):
        report.error("field-setting", f"field `{plan.name}` has no cell size", plan.span, "write `cell 4 mm`")
        return False
    if not 0 <= retained_share <= 1:
        report.error(
            "field-setting",
            f"field `{plan.name}` keeps {retained_share * 100:g} % per step",
            plan.span,
            "write a share from 0 to 100 %",
        )
        return False
    if not diffuse >= 0 or not limit >= 0:
        report.error(
            "field-setting", f"`diffuse` and `limit` of field `{plan.name}` cannot be below 0", plan.span, "write 0 or more"
        )
        return False
    most = compute_max_diffusion(size, dt)
    if diffuse > most * (1 + 1e-6):
        report.error(
            "unstable-field",
            f"field `{plan.name}` spreads faster than its cells of {size:g} mm can follow at this frame rate",
            plan.span,
            f"write `diffuse` {most:g} mm^2/s or less, or a larger `cell`",
        )
        return False
    return True
