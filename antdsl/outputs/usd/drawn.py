"""The mesh of a posed body with what materials need: which of them each triangle has, normals and texture coordinates."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.machine_clips import MachineClips
from antdsl.bodies.posed_body import PosedBody

Floats = NDArray[np.float32]
_SAMPLES = 8  # of each clip, which an extent is measured by
_ROOM = 1.25  # of an extent, for what lies between samples and for blends


class DrawnBody:
    """`faces` int32[m, 3]; `material` int64[m] counts `names` of materials; `uvs` float32[v, 2], or None where no shape has
    some."""

    def __init__(self, body: PosedBody) -> None:
        self.body = body
        shapes = [body.shaded.shapes[binding.shape] for binding in body.bindings]
        starts = np.cumsum([0, *(len(shape.points) for shape in shapes)])
        none = np.zeros((0, 3), np.int32)
        self.faces = np.concatenate([none, *(s.faces + np.int32(a) for s, a in zip(shapes, starts, strict=False))])
        self.names = tuple(dict.fromkeys(name for shape in shapes for name in (*(shape.materials or ("",)),))) or ("",)
        material = [np.zeros(0, np.int64)]
        for shape in shapes:
            own = np.array([self.names.index(name) for name in shape.materials or ("",)])
            material.append(np.full(len(shape.faces), own[0]) if shape.material is None else own[shape.material])
        self.material = np.concatenate(material)
        mapped = [np.zeros((len(s.points), 2), np.float32) if s.uvs is None else s.uvs for s in shapes]
        self.uvs = np.concatenate(mapped) if any(shape.uvs is not None for shape in shapes) else None

    def extent(self) -> NDArray[np.float64]:
        """The box (2, 3) that the body stays in as it plays each of its clips, with some room, in body lengths."""
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for machines in self._playing():
            points = self.body.shaped(self.body.poses(machines, len(machines[0].clip) if machines else 1))[0].reshape(-1, 3)
            if len(points):
                low, high = np.minimum(low, points.min(axis=0)), np.maximum(high, points.max(axis=0))
        if not np.isfinite(low).all():
            return np.zeros((2, 3))
        middle, half = (low + high) / 2, (high - low) / 2 * _ROOM
        return np.stack([middle - half, middle + half])

    def _playing(self) -> Iterator[tuple[MachineClips, ...]]:
        yield ()
        for number in range(len(self.body.clips)):
            yield (alone(np.full(_SAMPLES, number), np.arange(_SAMPLES) / _SAMPLES),)


def alone(clip: NDArray[np.integer], turns: NDArray[np.floating]) -> MachineClips:
    """Agents that play a clip each, -1 for none, whole and unmixed."""
    chosen = np.asarray(clip, np.int16)
    none, one = np.zeros(len(clip), np.float32), np.ones(len(clip), np.float32)
    return MachineClips(chosen, np.asarray(turns, np.float32), one, np.full(len(clip), -1, np.int16), none, none, none)
