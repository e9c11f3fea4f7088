"""What the writers of USD files share: values over time, meshes that stay as they are, names."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.outputs.cache.manifest import SpeciesEntry
from antdsl.scene.geometry.usd import pxr

ROOT = "/World"


class Samples:
    """Values of one attribute over time. One that stays is written where it begins and where it ends, since USD goes evenly from
    sample to sample."""

    def __init__(self, attribute: Any, convert: Callable[[NDArray[Any]], Any], kind: Any = np.float64) -> None:
        self._attribute, self._convert, self._kind = attribute, convert, kind
        self._value: NDArray[Any] | None = None
        self._written = self._seen = 0

    def set(self, frame: int, values: Any) -> None:
        """The value from a frame on, which comes after all that were set."""
        value = np.ascontiguousarray(values, self._kind)
        if self._value is None or not np.array_equal(self._value, value):
            if self._value is not None and self._seen > self._written:
                self._attribute.Set(self._convert(self._value), self._seen)
            self._attribute.Set(self._convert(value), frame)
            self._value, self._written = value, frame
        self._seen = frame


def still_mesh(stage: Any, path: str, points: NDArray[Any], faces: NDArray[Any]) -> Any:
    """A mesh that stays as it is."""
    made = pxr("UsdGeom").Mesh.Define(stage, path)
    made.CreatePointsAttr(vectors(points))
    made.CreateFaceVertexCountsAttr(pxr("Vt").IntArray.FromNumpy(np.full(len(faces), 3, np.int32)))
    made.CreateFaceVertexIndicesAttr(pxr("Vt").IntArray.FromNumpy(np.ascontiguousarray(faces, np.int32).ravel()))
    made.CreateSubdivisionSchemeAttr("none")
    made.CreateExtentAttr(vectors(box(points)))
    return made


def vectors(values: NDArray[Any]) -> Any:
    """Rows (n, 3) as USD's array of vectors."""
    return pxr("Vt").Vec3fArray.FromNumpy(np.ascontiguousarray(values, np.float32))


def box(points: NDArray[Any]) -> NDArray[Any]:
    """The lowest and the highest corner (2, 3) of what holds all points."""
    return np.stack([points.min(axis=0), points.max(axis=0)]) if len(points) else np.zeros((2, 3))


def name_states(prim: Any, species: SpeciesEntry) -> None:
    """What the numbers of states mean, into a prim's custom data."""
    for machine in species.machines:
        name = "states" if machine is species.machines[0] else f"{machine.name}.states"
        prim.SetCustomDataByKey(identifier(name), pxr("Vt").StringArray([state.name for state in machine.states]))


def identifier(name: str) -> str:
    """A name as USD allows it."""
    word = re.sub("[^A-Za-z0-9_]", "_", name)
    return word if re.match("[A-Za-z_]", word) else f"_{word}"
