"""Checks the sizes of meshes, fields and voxels before anything is allocated. They must suit the agents and stay within the
limits."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from antdsl import limits
from antdsl.diagnostics import Label
from antdsl.program.model import Constant, Expr, OperationExpr, ParamRef
from antdsl.program.tables.vocabulary import LENGTH_DIMENSION
from antdsl.scene.checks.entry_checks import convert_constant
from antdsl.scene.document import PathKey
from antdsl.scene.geometry.mesh_files import compute_mesh_area

if TYPE_CHECKING:
    from antdsl.scene.staging.stage_scene import SceneStaging

_MAX_WORLD_BODY_LENGTHS = 1e6  # body lengths; larger surfaces, such as a county for ants, probably have a wrong unit
# body lengths; voxels larger than the first are too coarse, the second is a good size
_MAX_VOXEL_SHARE_OF_BODY, _GOOD_VOXEL_SHARE_OF_BODY = 1 / 3, 1 / 4


def check_sizes(staging: SceneStaging) -> None:
    """Check the sizes of fields, surfaces and solids. All meshes must have been staged without errors."""
    if staging.report.ok:
        _check_cells(staging)
        _check_scale(staging)


def _check_cells(staging: SceneStaging) -> None:
    """Report an error for each field with more cells than the limit."""
    surfaces = {**staging.surfaces, **{name: solid.mesh for name, solid in staging.solids.items()}}
    for name, declared in staging.program.fields.items():
        if not isinstance(declared.cell, Constant):
            continue
        edge = convert_constant(declared.cell, staging.scene)
        if edge <= 0:
            continue
        area = sum(compute_mesh_area(surfaces[s]) for s in declared.surfaces if s in surfaces)
        place = declared.surfaces[0] if declared.surfaces else ""
        # a tilted plane touches up to 1.7 voxels per voxel of its area; one is the lower bound
        labels = (Label(declared.cell.span, "the cell's size"),)
        report_too_many_parts(
            staging,
            area / (edge * edge),
            limits.MAX_FIELD_CELLS,
            f"the field `{name}`",
            "cells",
            edge,
            "world",
            place,
            labels=labels,
        )


def _check_scale(staging: SceneStaging) -> None:
    """Warn about a surface that is hardly larger than its agents, or so large that its unit is probably wrong.

    Also warn about a solid with voxels that are too coarse for the agents that walk on it and dig in it."""
    for line in staging.scene.model.crowd:
        species = staging.program.species.get(line.species)
        size = next((a.default for a in species.attributes if a.name == "size"), None) if species else None
        length = _find_first_length(size, staging) if size is not None else None
        if length is None:
            continue
        for name, mesh in staging.surfaces.items():
            width = float(np.ptp(mesh.vertices, axis=0).max())
            if not 3 * length <= width <= _MAX_WORLD_BODY_LENGTHS * length:
                words = f"`{name}` is {width:.3g} mm wide, and a `{line.species}` about {length:.3g} mm long"
                staging.report.warning(
                    "odd-scale", words, staging.scene.find_span("world", name), "define the mesh's `units`, such as `units: m`"
                )
        for name, solid in staging.solids.items():
            if solid.voxel > _MAX_VOXEL_SHARE_OF_BODY * length:
                words = f"voxels of `{name}` are {solid.voxel:.3g} mm wide, and a `{line.species}` about {length:.3g} mm long"
                place, help = (
                    staging.scene.find_span("world", name, "voxel"),
                    f"write `voxel: {_GOOD_VOXEL_SHARE_OF_BODY * length:.3g} mm` or less",
                )
                staging.report.warning("odd-scale", words, place, help)


def _find_first_length(expression: Expr, staging: SceneStaging) -> float | None:
    """Return the first length in an expression such as `uniform(3 mm, 5 mm)` in millimetres, or None if there is none."""
    stack: list[Expr | None] = [expression]
    while stack:
        part = stack.pop()
        if isinstance(part, Constant) and part.type.dimension == LENGTH_DIMENSION and part.number > 0:
            return convert_constant(part, staging.scene)
        if isinstance(part, ParamRef):
            stack.append(staging.program.params[part.name].default)
        elif isinstance(part, OperationExpr):
            stack.extend(reversed(part.args))
    return None


def report_too_many_parts(
    staging: SceneStaging,
    count: float,
    max_count: int,
    subject: str,
    parts: str,
    edge: float,
    *path: PathKey,
    labels: tuple[Label, ...] = (),
) -> None:
    """Report an error if `count` is above `max_count`. `parts`: what is counted, such as voxels. `edge`: the edge length (mm) of
    a part.

    `path`: the location in the scene."""
    if count > max_count:
        size = f"{count * 8 / limits.GIB:,.0f} GiB" if count * 8 > limits.GIB else f"{count * 8 / limits.MIB:,.0f} MiB"
        message = f"{subject} would need at least {count:,.0f} {parts} of {edge:g} mm (about {size}), more than {max_count:,}"
        larger = edge * (count / max_count) ** (1 / 3 if parts == "voxels" else 1 / 2)
        help = f"write {parts[:-1]}s of {larger * 1.05:.3g} mm or more, or check the `units` of the mesh"
        staging.report.error("too-large", message, staging.scene.find_span(*path), help, labels=labels)
