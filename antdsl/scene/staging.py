"""A matched scene to a `Setting`: meshes and points are read, everything is turned to millimetres and the scene's axes.

What binding would need in memory is computed first, so that a request for a billion cells is refused before anything is
allocated."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.diagnostics import Label, Report
from antdsl.program.model import Const, Expr, Op, ParamRef, Program
from antdsl.program.vocabulary import LENGTH
from antdsl.scene import setting as stage_of
from antdsl.scene.document import Key
from antdsl.scene.flows import check_densities, stage_flows
from antdsl.scene.load import Scene
from antdsl.scene.matching import const_base
from antdsl.scene.meshes import MeshError, RawMesh, placed, read_mesh, turned_up
from antdsl.scene.model import UNIT_MM, CurveThing, ItemThing, MeshThing, Placement, Point, millimetres
from antdsl.scene.paths import PathRefused
from antdsl.scene.points import POINT_BYTES, PointsError, read_points
from antdsl.scene.quantities import Quantity

DEFAULT_ITEM_RADIUS = 10.0  # mm
_UP = {"y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_WIDEST = 1e6  # body lengths: ants in a whole county
_FAR = 1e7  # mm from the origin; float32 steps are 1 mm there


@dataclass(slots=True)
class Staging:
    """A setting in the making: the report, and a hash of the bytes of each file that was read."""

    scene: Scene
    program: Program
    report: Report = field(default_factory=Report)
    hashes: dict[str, str] = field(default_factory=dict)
    raw: dict[str, RawMesh] = field(default_factory=dict)  # surfaces and obstacles as their files have them

    def read(self, text: str, cap: int, *path: Key) -> bytes | None:
        """A file's bytes, or None and a complaint at the path that names it."""
        try:
            data = self.scene.roots.read(text, cap)
        except PathRefused as refused:
            self.report.error(refused.code, str(refused), self.scene.span(*path), refused.help)
            return None
        self.hashes[text] = hashlib.blake2b(data, digest_size=16).hexdigest()
        return data

    def points(self, text: str, least: int, *path: Key) -> NDArray[np.float64] | None:
        """At least so many points of a JSON file, in the file's own units, or None and a complaint."""
        data = self.read(text, POINT_BYTES, *path)
        if data is None:
            return None
        try:
            return read_points(data, least)
        except PointsError as why:
            self.report.error("bad-points", f"`{text}` {why}", self.scene.span(*path))
            return None


def stage(
    scene: Scene, program: Program, overrides: Mapping[str, Quantity] | None = None
) -> tuple[stage_of.Setting | None, Report, dict[str, str]]:
    """The setting, what there is to complain about, and a hash for each file read. `overrides` are params given by the person."""
    staging = Staging(scene, program)
    model = scene.model
    surfaces = _meshes(staging, "surface")
    obstacles = _meshes(staging, "obstacle")
    solids = _solids(staging)
    if staging.report.ok:
        _check_cells(staging, {**surfaces, **{name: solid.mesh for name, solid in solids.items()}})
        _check_scale(staging, surfaces)
    curves = _curves(staging)
    items = {
        name: tuple(_items(staging, name, value, surfaces)) for name, value in model.world.items() if isinstance(value, dict)
    }
    flows, maps = stage_flows(staging, items, curves)
    places = {item.name: item.position for group in items.values() for item in group} | {
        name: group[0].position for name, group in items.items() if group
    }
    crowds = tuple(
        stage_of.CrowdData(line.species, line.count, _place(staging, places, line.place, "crowd", number, "place"), number)
        for number, line in enumerate(model.crowd)
    )
    check_densities(staging, maps)
    if not staging.report.ok:
        return None, staging.report, staging.hashes
    dt = float(1 / model.fps)
    params = {name: value.base(model.unit_mm, dt) for name, value in {**model.set, **(overrides or {})}.items()}
    made = stage_of.Setting(
        fps=model.fps,
        substeps=model.substeps,
        up=_UP[model.up],
        unit_mm=model.unit_mm,
        seed=model.seed,
        first_frame=model.frames.first - model.preroll,
        surfaces=surfaces,
        obstacles=obstacles,
        items=items,
        curves=curves,
        flows=flows,
        maps=maps,
        crowds=crowds,
        params=params,
        field_start={
            name: stage_of.FieldStart(
                start.start, _point(scene, places, start.around, start.radius), _length(scene, start.radius)
            )
            for name, start in model.fields.items()
        },
        solids=solids,
    )
    return made, staging.report, staging.hashes


def _length(scene: Scene, value: Quantity | None) -> float | None:
    return None if value is None else value.length(scene.model.unit_mm)


Places = Mapping[str, stage_of.Point]


def _point(scene: Scene, places: Places, around: Point | str | None, radius: Quantity | None) -> stage_of.Point | None:
    """Where something lies about: a point, an item's place, the origin where only a radius is given."""
    if around is None:
        return None if radius is None else (0.0, 0.0, 0.0)
    return places.get(around) if isinstance(around, str) else millimetres(around, scene.model.unit_mm)


def _meshes(staging: Staging, kind: str) -> dict[str, stage_of.MeshData]:
    found = {}
    for name, thing in staging.program.world.items():
        value = staging.scene.model.world.get(name)
        if thing.kind == kind and isinstance(value, MeshThing):
            mesh = _mesh(staging, name, value)
            if mesh is not None:
                found[name] = mesh
    return found


def _mesh(staging: Staging, name: str, value: MeshThing) -> stage_of.MeshData | None:
    scene, report = staging.scene, staging.report
    data = staging.read(value.mesh, limits.MESH_BYTES, "world", name, "mesh")
    if data is None:
        return None
    span = scene.span("world", name, "mesh")
    unit_mm = scene.model.unit_mm
    try:
        raw = read_mesh(data, value.mesh)
        mesh = placed(
            raw,
            factor=UNIT_MM[value.units or scene.model.units] * value.scale,
            own_up=value.up or scene.model.up,
            up=scene.model.up,
            angles=tuple(angle.number for angle in value.rotate) if value.rotate else (0.0, 0.0, 0.0),  # type: ignore[arg-type]
            at=millimetres(value.at, unit_mm) if value.at else (0.0, 0.0, 0.0),
        )
    except MeshError as why:
        report.error("bad-mesh", f"the mesh `{value.mesh}` {why}", span)
        return None
    staging.raw[name] = raw
    if raw.dropped:
        faces = "face" if raw.dropped == 1 else "faces"
        report.warning(
            "degenerate-faces", f"{raw.dropped:,} {faces} of `{value.mesh}` without area or given twice left out", span
        )
    if np.abs(mesh.vertices).max() > _FAR:
        report.warning(
            "far-away",
            f"the mesh `{value.mesh}` lies more than 10 km from the origin",
            span,
            "move it with `at`, or check its `units`",
        )
    return mesh


def _solids(staging: Staging) -> dict[str, stage_of.SolidData]:
    """The solids; a request for more voxels than can be is refused before one is made."""
    scene, found = staging.scene, {}
    for name, mesh in _meshes(staging, "solid").items():
        value = scene.model.world[name]
        if not isinstance(value, MeshThing) or value.voxel is None:  # complained about when the scene was matched
            continue
        edge = value.voxel.length(scene.model.unit_mm)
        across = [float(side) / edge + 1 for side in np.ptp(mesh.vertices, axis=0)]
        _refuse_if_many(
            staging, across[0] * across[1] * across[2], limits.VOXELS, f"`{name}`", "voxels", edge, "world", name, "voxel"
        )
        found[name] = stage_of.SolidData(mesh, edge)
    return found


def _check_cells(staging: Staging, surfaces: Mapping[str, stage_of.MeshData]) -> None:
    for name, declared in staging.program.fields.items():
        if not isinstance(declared.cell, Const):
            continue
        edge = const_base(declared.cell, staging.scene)
        if edge <= 0:
            continue
        area = sum(_area(surfaces[s]) for s in declared.surfaces if s in surfaces)
        place = declared.surfaces[0] if declared.surfaces else ""
        # a plane that lies aslant touches up to 1.7 times the voxels of its area; one each for the area is the least
        labels = (Label(declared.cell.span, "the cell's size"),)
        _refuse_if_many(
            staging, area / (edge * edge), limits.FIELD_CELLS, f"the field `{name}`", "cells", edge, "world", place, labels=labels
        )


def _check_scale(staging: Staging, surfaces: Mapping[str, stage_of.MeshData]) -> None:
    """Warn of a surface hardly larger than who walks on it, or so large that its units are likely wrong."""
    for line in staging.scene.model.crowd:
        species = staging.program.species.get(line.species)
        size = next((a.default for a in species.attributes if a.name == "size"), None) if species else None
        length = _some_length(size, staging) if size is not None else None
        if length is None:
            continue
        for name, mesh in surfaces.items():
            width = float(np.ptp(mesh.vertices, axis=0).max())
            if not 3 * length <= width <= _WIDEST * length:
                words = f"`{name}` is {width:.3g} mm wide, and a `{line.species}` about {length:.3g} mm long"
                staging.report.warning(
                    "odd-scale", words, staging.scene.span("world", name), "say the mesh's `units`, such as `units: m`"
                )


def _some_length(expression: Expr, staging: Staging) -> float | None:
    """The first length in an expression such as `uniform(3 mm, 5 mm)`, in millimetres."""
    stack: list[Expr | None] = [expression]
    while stack:
        part = stack.pop()
        if isinstance(part, Const) and part.type.dim == LENGTH and part.number > 0:
            return const_base(part, staging.scene)
        if isinstance(part, ParamRef):
            stack.append(staging.program.params[part.name].default)
        elif isinstance(part, Op):
            stack.extend(reversed(part.args))
    return None


def _area(mesh: stage_of.MeshData) -> float:
    a, b, c = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def _refuse_if_many(
    staging: Staging, count: float, cap: int, what: str, parts: str, edge: float, *path: Key, labels: tuple[Label, ...] = ()
) -> None:
    if count > cap:
        size = f"{count * 8 / limits.GIB:,.0f} GiB" if count * 8 > limits.GIB else f"{count * 8 / limits.MIB:,.0f} MiB"
        message = f"{what} would need at least {count:,.0f} {parts} of {edge:g} mm (about {size}), more than {cap:,}"
        larger = edge * (count / cap) ** (1 / 3 if parts == "voxels" else 1 / 2)
        help = f"write {parts[:-1]}s of {larger * 1.05:.3g} mm or more, or check the `units` of the mesh"
        staging.report.error("too-large", message, staging.scene.span(*path), help, labels=labels)


def _curves(staging: Staging) -> dict[str, NDArray[np.float64]]:
    found = {}
    model = staging.scene.model
    for name, value in model.world.items():
        if isinstance(value, CurveThing):
            points = staging.points(value.curve, 2, "world", name, "curve")
            if points is not None:
                moved = turned_up(points * UNIT_MM[value.units or model.units], value.up or model.up, model.up)
                found[name] = moved + np.array(millimetres(value.at, model.unit_mm) if value.at else (0.0, 0.0, 0.0))
    return found


def _items(
    staging: Staging, name: str, value: Mapping[str, ItemThing], surfaces: Mapping[str, stage_of.MeshData]
) -> Iterator[stage_of.ItemData]:
    model = staging.scene.model
    dt = float(1 / model.fps)
    for item, thing in value.items():
        position = millimetres(thing.at, model.unit_mm)
        if thing.on is not None and thing.on in surfaces:
            height = height_over(surfaces[thing.on], position, model.up)
            if height is None:
                span = staging.scene.span("world", name, item, "at")
                staging.report.error(
                    "off-surface", f"`{item}` is neither over nor under `{thing.on}`", span, "move it, or leave out `on`"
                )
                continue
            position = (position[0], height, position[2]) if model.up == "y" else (position[0], position[1], height)
        radius = _length(staging.scene, thing.radius)
        attributes = {key: quantity.base(model.unit_mm, dt) for key, quantity in (thing.model_extra or {}).items()}
        yield stage_of.ItemData(item, position, DEFAULT_ITEM_RADIUS if radius is None else radius, attributes)


def height_over(mesh: stage_of.MeshData, point: stage_of.Point, up: str) -> float | None:
    """The highest place of a mesh on the line through a point along the scene's up, or None where there is none."""
    flat, tall = ([0, 2], 1) if up == "y" else ([0, 1], 2)
    corners = mesh.vertices[mesh.faces]
    plan = corners[:, :, flat] - np.array(point)[flat]
    # twice the areas of the three triangles that the point makes with the edges, seen from above
    across = [plan[:, i, 0] * plan[:, (i + 1) % 3, 1] - plan[:, i, 1] * plan[:, (i + 1) % 3, 0] for i in range(3)]
    whole = across[0] + across[1] + across[2]
    inside = (np.abs(whole) > 1e-12) & np.all([part * np.sign(whole) >= -1e-12 * np.abs(whole) for part in across], axis=0)
    if not inside.any():
        return None
    heights = corners[inside, :, tall]
    weights = np.stack([across[1][inside], across[2][inside], across[0][inside]], axis=1) / whole[inside, None]
    return float((heights * weights).sum(axis=1).max())


def _place(staging: Staging, places: Places, place: Placement, *path: Key) -> stage_of.PlaceData:
    scene = staging.scene
    points = None
    if place.points is not None:
        points = staging.points(place.points, 1, *path, "points")
        if points is not None:
            points = points * scene.model.unit_mm
    return stage_of.PlaceData(
        on=(place.on,) if place.on is not None else (),
        around=_point(scene, places, place.around, place.radius),
        radius=_length(scene, place.radius),
        points=points,
        density=place.density,
    )
