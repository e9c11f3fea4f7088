"""`Model`: parts of a body, each bound to joints and made of materials, put together to one shape of an agent definition."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.rig import Rig
from antdsl.bodies.agents.shape import Capture, Shape
from antdsl.bodies.library.surfaces import Array, Point, Surface, smooth_through

Weights = Sequence[tuple[float, str]]  # places along a part and the joint that it follows there
_MOST = 2  # joints that a point follows


def rig_of(joints: Mapping[str, tuple[str, Point]]) -> Rig:
    """A rig of joints by name: the parent ("" for none) and where the joint is in the rest pose; none is turned there."""
    names = tuple(joints)
    rest = np.tile(np.eye(4), (len(names), 1, 1))
    for number, (parent, at) in enumerate(joints.values()):
        rest[number, :3, 3] = np.subtract(at, joints[parent][1]) if parent else at
    return Rig(names, np.array([names.index(parent) if parent else -1 for parent, _ in joints.values()], np.int32), rest)


@dataclass(slots=True)
class Model:
    """Collects parts. `joints`: where the joints are in the rest pose, as `rig_of` takes them."""

    joints: Mapping[str, tuple[str, Point]]
    _parts: list[tuple[Surface, str, NDArray[np.int32], NDArray[np.float32], Array, NDArray[np.int32]]] = field(
        default_factory=list
    )
    _materials: list[str] = field(default_factory=list)

    def add(
        self, surface: Surface, follows: str | Weights, material: str | Callable[[Array], NDArray[np.str_]], island: str
    ) -> None:
        """A part that `follows` one joint, or joints along it that blend into each other; `material`: one for all of it, or by
        where along it each triangle is. `island`: parts of the same have the same place in the texture."""
        along = surface.along
        if isinstance(follows, str):
            row, share = np.full((len(along), _MOST), self._joint(follows), np.int32), np.zeros((len(along), _MOST), np.float32)
            share[:, 0] = 1
        else:
            row, share = self._blended(along, follows)
        # Both triangles of a quad have the same middle, so that materials meet in a straight line.
        middle = (along[surface.faces].min(axis=1) + along[surface.faces].max(axis=1)) / 2
        names = [material] * len(middle) if isinstance(material, str) else [str(each) for each in material(middle)]
        for name in sorted(set(names) - set(self._materials)):
            self._materials.append(name)
        number = np.array([self._materials.index(name) for name in names], np.int32)
        self._parts.append((surface, island, row, share, normals_of(surface), number))

    def both(
        self, surface: Surface, follows: str | Weights, material: str | Callable[[Array], NDArray[np.str_]], island: str
    ) -> None:
        """A part on the right, whose joints end in `_r` or `_r` and a number, and its image on the left."""
        self.add(surface, follows, material, island)
        other = left(follows) if isinstance(follows, str) else [(place, left(joint)) for place, joint in follows]
        self.add(surface.mirrored(), other, material, island)

    def _joint(self, name: str) -> int:
        return list(self.joints).index(name)

    def _blended(self, along: Array, follows: Weights) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
        places = np.array([place for place, _ in follows])
        numbers = np.array([self._joint(joint) for _, joint in follows], np.int32)
        k = np.clip(np.searchsorted(places, along, side="right") - 1, 0, len(places) - 1)
        after = np.minimum(k + 1, len(places) - 1)
        reach = np.where(after > k, places[after] - places[k], 1.0)
        t = np.clip((along - places[k]) / reach, 0.0, 1.0)
        t = t * t * (3 - 2 * t)
        return np.stack([numbers[k], numbers[after]], 1), np.stack([1 - t, t], 1).astype(np.float32)

    def shape(self, name: str) -> Shape:
        """All parts as one shape, captured by the rig in its rest pose."""
        starts = np.cumsum([0, *(len(each[0].points) for each in self._parts)])
        islands = sorted({each[1] for each in self._parts})
        columns = int(np.ceil(np.sqrt(len(islands))))
        uvs = []
        for surface, island, *_ in self._parts:
            row, column = divmod(islands.index(island), columns)
            uvs.append((np.array([column, row]) + 0.03 + 0.94 * surface.uv) / columns)
        inverse = np.tile(np.eye(4), (len(self.joints), 1, 1))
        inverse[:, :3, 3] = -np.array([at for _, at in self.joints.values()])
        return Shape(
            name,
            np.concatenate([each[0].points for each in self._parts]).astype(np.float32),
            np.concatenate([each[0].faces + np.int32(s) for each, s in zip(self._parts, starts, strict=False)]).astype(np.int32),
            np.concatenate([each[4] for each in self._parts]).astype(np.float32),
            np.concatenate(uvs).astype(np.float32),
            tuple(self._materials),
            np.concatenate([each[5] for each in self._parts]),
            capture=Capture(
                tuple(self.joints), np.concatenate([each[2] for each in self._parts]),
                np.concatenate([each[3] for each in self._parts]), inverse,
            ),
        )  # fmt: skip


def left(joint: str) -> str:
    """The name on the left of a joint on the right: `femur_r2` is `femur_l2` there; of one in the middle its own."""
    head, mark, tail = joint.rpartition("_r")
    return f"{head}_l{tail}" if mark and (not tail or tail.isdigit() or tail.startswith("_")) else joint


def normals_of(surface: Surface) -> Array:
    """Unit normals [n, 3], the mean of the triangles about a place by their areas; both points of a seam have the same one."""
    _, of = np.unique(surface.points.round(9), axis=0, return_inverse=True)
    of = of.reshape(-1)
    corners = surface.points[surface.faces]
    flat = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    at = of[surface.faces].reshape(-1)
    total = np.stack([np.bincount(at, np.repeat(flat[:, axis], 3), of.max() + 1) for axis in range(3)], 1)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.asarray(np.where(length > 1e-20, total / np.maximum(length, 1e-20), np.array([0.0, 1.0, 0.0]))[of])


def bands(names: Sequence[str], edges: Sequence[float]) -> Callable[[Array], NDArray[np.str_]]:
    """Materials along a part: the first up to the first edge, and so on."""
    return lambda along: np.array(names)[np.searchsorted(np.asarray(edges), along)]


def profile(keys: Sequence[tuple[float, ...]], count: int) -> Array:
    """Rows (place, values …) made smooth and sampled `count` times, closer together at both ends."""
    table = np.asarray(keys, np.float64)
    at = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, count))
    at = table[0, 0] + at * (table[-1, 0] - table[0, 0])
    return np.concatenate([at[:, None], smooth_through(table[:, 1:], at, table[:, 0])], 1)
