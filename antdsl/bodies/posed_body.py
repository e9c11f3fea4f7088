"""An agent definition prepared for drawing: one mesh with vertices that follow the poses of many agents.

Agents that are small in a picture get coarser shapes: all points in a grid cell are merged into one point (vertex clustering; J.
Rossignac and P. Borrel, Multi-resolution 3D approximations for rendering complex scenes, 1993).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.affine import Floats
from antdsl.bodies.agents.blending import blend_poses
from antdsl.bodies.agents.boxes import compute_rest_box
from antdsl.bodies.agents.definition import STATE_MATERIAL, Binding, Definition, Layer, SkinShape, SkinWeights
from antdsl.bodies.agents.deformers import deform_binding
from antdsl.bodies.agents.driving import PoseAdjustments, offset_joints, rotate_joints_to_look_directions, set_pose_channels
from antdsl.bodies.agents.leg_ik import BodySpaceFeet, LegIkSolver
from antdsl.bodies.agents.machine_clips import MachineClips, PlayedClip, build_machine_playback
from antdsl.bodies.agents.poses import WorldPoses, build_clip_table, to_local_transforms
from antdsl.bodies.agents.varied_bodies import compute_vertex_colours, scale_groups
from antdsl.bodies.body import compute_vertex_normals
from antdsl.bodies.skinned_mesh import SkinnedMesh, build_skinned_mesh

COARSE_CELLS_PER_BODY_LENGTH = 14  # grid cells of coarse shapes along a body's length
_CELL_GROWTH = 2.0  # maximum factor by which a coarse shape is stretched to its original box
COARSE_CELLS_PER_SHAPE = 3  # minimum number of grid cells along the longest side of a shape


BODY_LAYER_NAME, CLOSE_LAYER_NAME, COLLISION_LAYER_NAME = "body", "close", "collision"  # layers
NO_DRIVEN_POSE = PoseAdjustments()
NEUTRAL_COLOUR = (0.1, 0.1, 0.1)  # linear; of surfaces without a colour
_GOLDEN_RATIO_FRACTION = (5**0.5 - 1) / 2  # its multiples, modulo 1, are spread evenly over 0 to 1


class PosedBody:
    """A body that can be posed for many agents at once. It has length 1 along +x, its heading; +y is up.

    The drawn shapes are those of the base layer and of `layers`; layers that the body lacks are ignored. The base layer is `body`
    if it exists, else the first layer not called `collision`.

    `faces`: int32[m, 3], triangles of vertices.
    `material_colours`: float32[v, 3], linear colours of vertices: the material's colour times the point's colour (`Cd`), which
        includes textures.
    `tint_weights`: float32[v], 1 for vertices that have the agent's colour, 0 for those that have the material's colour. It is 1
        for the material `state` and for vertices without a colour.
    `material_names`: [v], the name of each vertex's material.
    `point_indices`: int[v], the point of each vertex, as an index into the points of all `bindings` in sequence.
    `fine_body`, `coarse_body`, `distant_body`: the same body with more or fewer triangles, for agents that are large, small, or a
        few pixels long in a picture."""

    def __init__(self, definition: Definition, clips: Sequence[tuple[str, str] | PlayedClip], layers: Sequence[str] = ()) -> None:
        self.clips, self.layers, self._full_definition, self.name = tuple(clips), tuple(layers), definition, definition.name
        self._played = (*self.clips, (definition.idle, ""))
        self._table = build_clip_table(definition)
        self._bindings = _select_visible_bindings(definition, layers)
        names = {binding.shape for binding in self._bindings}
        shaded = {
            n: _add_missing_normals(shape) if n in names else shape
            for n, shape in _select_needed_shapes(definition, names).items()
        }
        self._definition = replace(definition, shapes=shaded)
        base = definition.compute_base_matrix()[:3, :3]
        self._base_matrix = base.astype(np.float32)
        self._rotation = (base * definition.length).astype(np.float32)
        parts = [_split_by_material(shaded[binding.shape], definition.materials) for binding in self._bindings]
        starts = np.cumsum([0, *(len(shaded[binding.shape].points) for binding in self._bindings)])
        counts = np.cumsum([0, *(len(part[0]) for part in parts)])
        none = np.zeros(0, np.int64)
        self.point_indices = np.concatenate([none, *(part[0] + s for part, s in zip(parts, starts, strict=False))])
        self.faces = np.concatenate(
            [np.zeros((0, 3), np.int32), *(part[1] + np.int32(s) for part, s in zip(parts, counts, strict=False))]
        )
        self.material_colours = np.concatenate([np.zeros((0, 3), np.float32), *(part[2] for part in parts)])
        self.tint_weights = np.concatenate([np.zeros(0, np.float32), *(part[3] for part in parts)])
        self.material_names = np.concatenate([np.zeros(0, "U1"), *(part[4] for part in parts)])

    def compute_colours(self, driven_pose: PoseAdjustments) -> Floats:
        """Return the linear colours of vertices, which come from their materials. The result is float32[n, v, 3], or [1, v, 3]
        if the colours are equal for all agents.

        The variation of the material `state` is not included; see `compute_natural_colours`."""
        variation = self._definition.variation
        own = replace(variation, materials={n: c for n, c in variation.materials.items() if n != STATE_MATERIAL})
        return compute_vertex_colours(own, driven_pose.variation_draws, self.material_names, self.material_colours)

    def compute_natural_colours(self, driven_pose: PoseAdjustments, count: int) -> Floats:
        """Return the linear colour of the material `state` for `count` agents, float32[count, 3], with their variation.

        For a body without this material, it is a neutral grey."""
        own = np.array([self._full_definition.materials.get(STATE_MATERIAL, NEUTRAL_COLOUR)], np.float32)
        variation = self._full_definition.variation
        colours = compute_vertex_colours(variation, driven_pose.variation_draws, np.array([STATE_MATERIAL]), own)
        return np.broadcast_to(colours[:, 0], (count, 3))

    def list_worn_layers(self) -> list[str]:
        """Return the names of the drawn layers except the base layer."""
        base = find_base_layer(self._full_definition).name
        return [name for name in self.layers if name in self._full_definition.layers and name != base]

    @cached_property
    def reach(self) -> float:
        """Return the distance from the origin to the farthest corner of the rest pose's bounding box, in body lengths."""
        drawn = Layer(
            BODY_LAYER_NAME, tuple(b for b in self._bindings if not b.deformer), tuple(b for b in self._bindings if b.deformer)
        )
        low, high = compute_rest_box(replace(self._definition, layers={BODY_LAYER_NAME: drawn}))
        return float(np.linalg.norm(np.maximum(np.abs(low), np.abs(high)))) / self._full_definition.length

    @cached_property
    def fine_body(self) -> PosedBody:
        """Return the body for agents that are large in a picture. If the body has a layer `close`, this layer is drawn instead
        of the layer `body`."""
        close = self._full_definition.layers.get(CLOSE_LAYER_NAME)
        if close is None:
            return self
        layers = {name: layer for name, layer in self._full_definition.layers.items() if name != CLOSE_LAYER_NAME}
        return PosedBody(
            replace(self._full_definition, layers=layers | {BODY_LAYER_NAME: replace(close, name=BODY_LAYER_NAME)}),
            self.clips,
            self.layers,
        )

    @cached_property
    def coarse_body(self) -> PosedBody:
        """Return a version of the body with fewer triangles, for agents that are small in a picture.

        If the body has a layer `close`, return the body unchanged. Its layer `body` is then already the coarse version."""
        return (
            self
            if CLOSE_LAYER_NAME in self._full_definition.layers
            else PosedBody(coarsen_definition(self._full_definition), self.clips, self.layers)
        )

    @cached_property
    def distant_body(self) -> PosedBody:
        """Return the version of the body with the fewest triangles, for agents that are a few pixels long in a picture."""
        layers = {name: layer for name, layer in self._full_definition.layers.items() if name != CLOSE_LAYER_NAME}
        drawn = _select_needed_shapes(
            self._full_definition, {binding.shape for layer in layers.values() for binding in _list_layer_bindings(layer)}
        )
        return PosedBody(coarsen_definition(replace(self._full_definition, layers=layers, shapes=drawn)), self.clips, self.layers)

    def build_idle_clips(self, ids: NDArray[Any], seconds: float) -> tuple[MachineClips, ...]:
        """Return the idle clip as played by the agents with these ids. Each agent starts at a different time in the clip.

        `seconds`: the time since frame 0. The result is empty if there is no idle clip."""
        clip = self._full_definition.clips.get(self._full_definition.idle)
        if clip is None or clip.duration <= 0:
            return ()
        turns = (np.asarray(ids, np.float64) * _GOLDEN_RATIO_FRACTION + seconds / clip.duration) % 1.0
        ones, none = np.ones(len(turns), np.float32), np.zeros(len(turns), np.float32)
        number = np.full(len(turns), len(self.clips), np.int16)
        return (MachineClips(number, turns.astype(np.float32), ones, np.full(len(turns), -1, np.int16), none, none, none),)

    @cached_property
    def mesh(self) -> SkinnedMesh:
        """Return the mesh of vertices and bones, for skinning by graphics hardware."""
        return build_skinned_mesh(self._definition, self._bindings, self.point_indices)

    @cached_property
    def layer_masks(self) -> NDArray[np.uint64]:
        """Return a bit mask for each vertex, uint64[v]. Bit k means that layer number k of `layers` shows the vertex.

        The mask of vertices that are always visible is 0."""
        own, layers = find_base_layer(self._full_definition), self._full_definition.layers
        vertex_masks = []
        for binding in self._bindings:
            worn = [k for k, name in enumerate(self.layers) if name in layers and binding in _list_layer_bindings(layers[name])]
            mask = 0 if binding in _list_layer_bindings(own) else sum(1 << k for k in worn)
            vertex_masks.append(np.full(len(self._definition.shapes[binding.shape].points), mask, np.uint64))
        taken: NDArray[np.uint64] = np.concatenate([np.zeros(0, np.uint64), *vertex_masks])[self.point_indices]
        return taken

    @cached_property
    def leg_solver(self) -> LegIkSolver | None:
        """Return the solver that places the body's feet; None for a body without legs."""
        return LegIkSolver(self._full_definition) if self._full_definition.legs else None

    @property
    def definition(self) -> Definition:
        """Return the complete agent definition."""
        return self._full_definition

    @property
    def drawn_definition(self) -> Definition:
        """Return the definition with only the drawn shapes, all of them with normals."""
        return self._definition

    @property
    def bindings(self) -> tuple[Binding, ...]:
        """Return the bindings of all drawn layers. Within each layer, static bindings come first."""
        return self._bindings

    def with_clips(self, clips: Sequence[tuple[str, str] | PlayedClip]) -> PosedBody:
        """Return the same body for agents that play other clips."""
        return PosedBody(self._full_definition, clips, self.layers)

    def compute_poses(
        self,
        machines: Sequence[MachineClips],
        count: int,
        feet: BodySpaceFeet | None = None,
        threads: int = 1,
        *,
        driven_pose: PoseAdjustments = NO_DRIVEN_POSE,
        needs_local: bool = False,
    ) -> WorldPoses:
        """Return the transforms and channels of `count` agents, in the definition's space.

        `machines`: the clips that agents play. `feet`: if given, legs bend so that feet are at these positions, and trunks move
        accordingly. `driven_pose`: values that drive poses in addition to clips. `needs_local`: also return local transforms."""
        playing = build_machine_playback(self._table, self._played, machines, count, driven_pose.lean)
        poses = blend_poses(self._table, self._definition.groups, playing, needs_local=needs_local, threads=threads)
        poses = set_pose_channels(self._table, poses, driven_pose.channels)
        poses = rotate_joints_to_look_directions(
            self._table,
            poses,
            driven_pose.look_directions,
            self._definition.groups,
            self._definition.compute_base_matrix()[:3, :3],
        )
        poses = offset_joints(self._table, poses, driven_pose.joint_offsets, self._definition.compute_base_matrix()[:3, :3])
        poses = scale_groups(self._table, poses, self._definition.variation, self._definition.groups, driven_pose.variation_draws)
        if self.leg_solver is not None and feet is not None:
            stands = self.leg_solver.compute_stance_weights(self._played, machines, count)
            poses = self.leg_solver.bend_legs(poses, feet.scale_trunk_motion(stands), stands)
        return (
            replace(poses, local_transforms=to_local_transforms(self._table, poses.world_transforms))
            if needs_local and poses.local_transforms is None
            else poses
        )

    def pose_vertices(
        self,
        machines: Sequence[MachineClips],
        count: int,
        feet: BodySpaceFeet | None = None,
        threads: int = 1,
        *,
        driven_pose: PoseAdjustments = NO_DRIVEN_POSE,
    ) -> tuple[Floats, Floats]:
        """Return the vertices, in body lengths, and the unit normals of `count` agents, both float32[n, v, 3]. The arguments are
        those of `compute_poses`."""
        points, normals = self.compute_shape_points(self.compute_poses(machines, count, feet, threads, driven_pose=driven_pose))
        return points[:, self.point_indices], normals[:, self.point_indices]

    def compute_shape_points(self, poses: WorldPoses) -> tuple[Floats, Floats]:
        """Return the points and unit normals of all bindings in sequence, both float32[n, p, 3]. Points are in body lengths, with
        front +x and up +y."""
        deformed_shapes = [deform_binding(self._definition, binding, poses) for binding in self._bindings]
        none = np.zeros((len(poses.world_transforms), 0, 3), np.float32)
        points = np.concatenate([none, *(each.points for each in deformed_shapes)], axis=1)
        normals = np.concatenate([none, *(each.normals for each in deformed_shapes if each.normals is not None)], axis=1)
        return points @ self._base_matrix.T, normals @ self._rotation.T


def find_base_layer(definition: Definition) -> Layer:
    """Return the layer that is always drawn. It is the layer `body` or, if there is none, the first layer that is not for
    collisions. For a body without layers, return an empty layer."""
    layers = definition.layers
    worn = [layer for name, layer in layers.items() if name != COLLISION_LAYER_NAME]
    return layers.get(BODY_LAYER_NAME) or next(iter(worn), Layer(BODY_LAYER_NAME))


def _select_needed_shapes(definition: Definition, names: Iterable[str]) -> dict[str, SkinShape]:
    """Return, by name, the shapes called `names` and all shapes that these blend towards."""
    shapes: dict[str, SkinShape] = {}
    left = list(names)
    while left:
        name = left.pop()
        if name not in shapes and name in definition.shapes:
            shapes[name] = shape = definition.shapes[name]
            left += [*(shape.blend.shapes if shape.blend else ()), *(shape.in_betweens.shapes if shape.in_betweens else ())]
    return shapes


def _select_visible_bindings(definition: Definition, layers: Sequence[str]) -> tuple[Binding, ...]:
    """Return the bindings of the base layer and of `layers`, each once, in the order of the definition's layers."""
    own = find_base_layer(definition)
    worn = (own, *(layer for name, layer in definition.layers.items() if name in layers and layer is not own))
    return tuple(dict.fromkeys(binding for layer in worn for binding in _list_layer_bindings(layer)))


def _list_layer_bindings(layer: Layer) -> tuple[Binding, ...]:
    """Return all bindings of a layer, the static ones first."""
    return (*layer.static, *layer.deforming)


def _add_missing_normals(shape: SkinShape) -> SkinShape:
    """Return a shape with normals; missing ones are computed from its faces."""
    if shape.normals is not None:
        return shape
    return replace(shape, normals=compute_vertex_normals(shape.points.astype(np.float64), shape.faces))


def _split_by_material(
    shape: SkinShape, colours: Mapping[str, tuple[float, float, float]]
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.float32], NDArray[np.float32], NDArray[np.str_]]:
    """Split the points of a shape into vertices. A point with several materials becomes several vertices.

    Return the point of each vertex and the triangles of vertices. Also return the linear colour, the tint weight (0 or 1) and the
    material name of each vertex."""
    material = np.zeros(len(shape.faces), np.int64) if shape.material is None else shape.material.astype(np.int64)
    names = shape.materials or ("",)
    pairs = shape.faces.astype(np.int64) * len(names) + material[:, None]
    kinds, faces = np.unique(pairs, return_inverse=True)
    point, of = kinds // len(names), kinds % len(names)
    own = np.array([colours.get(name, NEUTRAL_COLOUR) for name in names], np.float32)[of]
    tint = np.array([name == STATE_MATERIAL or name not in colours for name in names], np.float32)[of]
    colour = shape.attributes.get("Cd")
    if colour is not None and colour.shape == (len(shape.points), 3):  # from a texture or from vertex colours
        bare = np.array([name == "" for name in names])[of]
        own = np.where(bare[:, None], np.float32(1), own) * np.asarray(colour[point], np.float32)
        tint = np.where(bare, np.float32(0), tint)
    return point, faces.reshape(-1, 3).astype(np.int32), own, tint, np.array(names)[of]


def coarsen_definition(definition: Definition) -> Definition:
    """Return the definition with fewer points. Shapes still follow joints by the same deformers, but are not blended."""
    cell = definition.length / COARSE_CELLS_PER_BODY_LENGTH
    shapes = {name: coarsen_shape(shape, cell) for name, shape in definition.shapes.items()}
    layers = {
        name: Layer(name, layer.static, tuple(_remove_blending(each) for each in layer.deforming))
        for name, layer in definition.layers.items()
    }
    return replace(definition, shapes=shapes, layers=layers)


def coarsen_shape(shape: SkinShape, cell: float) -> SkinShape:
    """Return a coarser shape. In each cell of a regular grid, the points are replaced by one point, their mean. `cell`: the edge
    length of cells.

    The new point follows the joints of the first point in the cell. Triangles with two corners in one cell are omitted. Finally,
    the shape is enlarged a little, so that its bounding box does not shrink."""
    if not len(shape.points):
        return shape
    size = min(cell, float(np.ptp(shape.points, axis=0).max()) / COARSE_CELLS_PER_SHAPE) or cell
    cells = np.floor(shape.points.astype(np.float64) / size).astype(np.int64)
    _, first, of, counts = np.unique(cells, axis=0, return_index=True, return_inverse=True, return_counts=True)
    of = of.reshape(-1)

    def average_groups(values: np.ndarray) -> np.ndarray:
        sums = [np.bincount(of, values[:, axis], len(first)) for axis in range(3)]
        return np.stack(sums, 1) / counts[:, None]

    points, original_points = average_groups(shape.points), shape.points.astype(np.float64)
    low, high, width = original_points.min(axis=0), original_points.max(axis=0), np.ptp(points, axis=0)
    wider = np.where(width > 0, (high - low) / np.where(width > 0, width, 1), 1)
    points = low + (points - points.min(axis=0)) * np.minimum(wider, _CELL_GROWTH)
    normals = None
    if shape.normals is not None:
        turned = average_groups(shape.normals)
        length = np.linalg.norm(turned, axis=1, keepdims=True)
        normals = np.where(length > 1e-6, turned / np.maximum(length, 1e-6), shape.normals[first]).astype(np.float32)
    faces = of[shape.faces].astype(np.int32)
    has_area = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])
    follows = shape.capture
    capture = (
        None
        if follows is None
        else SkinWeights(follows.names, follows.joints[first], follows.weights[first], follows.inverse_matrices)
    )
    return SkinShape(
        shape.name, points.astype(np.float32), faces[has_area], normals, None, shape.materials,
        None if shape.material is None else shape.material[has_area],
        {name: values[first] for name, values in shape.attributes.items()}, capture,
        dual_quaternion_blend=shape.dual_quaternion_blend,
    )  # fmt: skip


def _remove_blending(binding: Binding) -> Binding:
    """Return a binding without the blend-shape deformer."""
    steps = [step for step in binding.deformer.split("+") if step != "blendshape"]
    return replace(binding, deformer="+".join(steps))
