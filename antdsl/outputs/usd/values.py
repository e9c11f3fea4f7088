"""Values over time, arrays and names in the form that USD requires. USD's messages about disk failures become an OSError."""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.posed_body import PosedBody
from antdsl.outputs.cache.manifest import SpeciesEntry
from antdsl.scene.geometry.usd import import_pxr_module

_DISK_ERRORS = (
    errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO, errno.EROFS, errno.EACCES, errno.EPERM, errno.EMFILE, errno.ENOENT,
    errno.ESTALE, errno.EINTR,
)  # fmt: skip
ROOT_PATH = "/World"
MATERIALS_PATH = "/World/looks"
BODIES_PATH = "/bodies"  # class prims, which are drawn only where a prim refers to them
Array = NDArray[Any]


def add_root(stage: Any, origin: NDArray[np.float64]) -> Any:
    """Return the root prim of a stage. It is moved in double precision by `origin` (scene units), to which positions are
    relative."""
    world = import_pxr_module("UsdGeom").Xform.Define(stage, ROOT_PATH)
    if origin.any():
        world.AddTranslateOp(import_pxr_module("UsdGeom").XformOp.PrecisionDouble, "origin").Set(
            import_pxr_module("Gf").Vec3d(*origin.tolist())
        )
    return world


class ValueSamples:
    """The values of one attribute over time.

    A value that does not change is written at its start and at its end, because USD interpolates linearly. `always`: whether to
    write a value at every time, because some readers use the attribute only at the times of other attributes."""

    def __init__(
        self, stage_output: StageOutput, attribute: Any, convert: Callable[[Array], Any], array_type: Any, always: bool
    ) -> None:
        self._out, self._convert, self._array_type, self._writes_always = stage_output, convert, array_type, always
        self._attribute = attribute.GetAttr() if hasattr(attribute, "GetAttr") else attribute
        self._path = self._attribute.GetPath()
        self._value: Array | None = None
        self._written_time = self._last_time = 0.0
        self._file_number = -1

    def set(self, time: float, values: Any) -> None:
        """Set the value that applies from this time on. Times must ascend."""
        value = np.ascontiguousarray(values, self._array_type)
        new = self._file_number != self._out.file_number
        if new or self._writes_always or self._value is None or not np.array_equal(self._value, value):
            if not new and not self._writes_always and self._value is not None and self._last_time > self._written_time:
                self._write_value(self._value, self._last_time)
            self._write_value(value, time)
            self._value, self._written_time, self._file_number = value, time, self._out.file_number
        self._last_time = time

    def _write_value(self, value: Array, time: float) -> None:
        """Write the value at a time into the current layer."""
        layer = self._out.clip
        if layer is None:
            self._attribute.Set(self._convert(value), time)
            return
        for each in (layer, self._out.manifest_layer):
            if each.GetAttributeAtPath(self._path) is None:
                self._declare_attribute(each)
        layer.SetTimeSample(self._path, time, self._convert(value))

    def _declare_attribute(self, layer: Any) -> None:
        """Add the attribute to a layer if the layer does not contain it."""
        kind = self._attribute.GetTypeName()
        import_pxr_module("Sdf").JustCreatePrimAttributeInLayer(
            layer, self._path, kind, import_pxr_module("Sdf").VariabilityVarying
        )
        if layer is self._out.manifest_layer and self._path.name == import_pxr_module("UsdGeom").Tokens.visibility:
            layer.GetAttributeAtPath(self._path).default = "invisible"  # hidden in files without a value for the prim


class StageOutput:
    """The stage, and the layer that receives values over time.

    `shows_states`: whether agents have the colours of their states instead of natural colours. `clip`: the layer to which values
    are written; None for the stage itself. `manifest_layer`: a layer that lists all attributes with values in clips."""

    def __init__(self, stage: Any, shows_states: bool = False) -> None:
        self.stage: Any = stage
        self.shows_states = shows_states
        self.clip: Any = None
        self.manifest_layer: Any = None
        self.file_number = 0
        self._used_names = {"items", "fields", "camera", "lights", "looks", "world"}
        self._name_by_thing: dict[tuple[str, str], str] = {}
        self._body_names = set[str]()

    def name(self, kind: str, name: str) -> str:
        """Return a name for the prim of a thing below the root. A number is added if another thing already has the name."""
        if (kind, name) not in self._name_by_thing:
            self._name_by_thing[kind, name] = make_unique(to_identifier(name), self._used_names)
        return self._name_by_thing[kind, name]

    def name_body(self, species: str, body: PosedBody, key: str) -> str:
        """Return a name for a body of a species that distinguishes it from all others, such as `worker_with_crumb`.

        `key`: the key of the body. If the species has several bodies, the result contains the name of the body."""
        words = [self.name("species", species), *([body.name] if key not in ("", species) else [])]
        words += [part for layer in body.list_worn_layers() for part in ("with", layer)]
        return make_unique(to_identifier("_".join(words)), self._body_names)

    def add_samples(
        self, attribute: Any, convert: Callable[[Array], Any], array_type: Any = np.float64, *, always: bool = False
    ) -> ValueSamples:
        """Return the values over time of an attribute. `convert`: converts arrays of the type `array_type` to USD's type."""
        return ValueSamples(self, attribute, convert, array_type, always)

    def begin(self, layer: Any) -> None:
        """Write values to another layer from now on. Each attribute is written again at its next time."""
        self.clip, self.file_number = layer, self.file_number + 1


class Visibility:
    """The visibility of a prim over time. A prim that first appears later than the first time sample is hidden until then."""

    def __init__(self, stage_output: StageOutput, prim: Any, first: float, time: float) -> None:
        self._samples = stage_output.add_samples(
            prim.CreateVisibilityAttr(), lambda v: "inherited" if v[0] else "invisible", np.bool_
        )
        if time > first:
            self._samples.set(first, [False])

    def set(self, time: float, is_visible: bool) -> None:
        """Set whether the prim is visible from this time on."""
        self._samples.set(time, [is_visible])


def to_vector_array(values: Array) -> Any:
    """Return rows (n, 3) as USD's array of vectors."""
    return import_pxr_module("Vt").Vec3fArray.FromNumpy(np.ascontiguousarray(values, np.float32))


def to_integer_array(values: Array) -> Any:
    """Return numbers (n,) as USD's array of integers."""
    return import_pxr_module("Vt").IntArray.FromNumpy(np.ascontiguousarray(values, np.int32))


def to_usd_matrix(columns: Array) -> Any:
    """Return a matrix (4, 4) for column vectors as a USD matrix, which is for row vectors."""
    return import_pxr_module("Gf").Matrix4d(*np.asarray(columns, np.float64).T.ravel().tolist())


def to_usd_matrices(columns: Array) -> Any:
    """Return matrices (n, 4, 4) for column vectors as USD's array of matrices, which are for row vectors."""
    turned = np.ascontiguousarray(np.asarray(columns, np.float64).transpose(0, 2, 1))
    return import_pxr_module("Vt").Matrix4dArray.FromNumpy(turned)


def compute_box(points: Array) -> Array:
    """Return the lowest and the highest corner (2, 3) of the bounding box of all points."""
    return np.stack([points.min(axis=0), points.max(axis=0)]) if len(points) else np.zeros((2, 3))


def add_mesh(stage: Any, path: str, points: Array, faces: Array, normals: Array | None = None, uvs: Array | None = None) -> Any:
    """Add a static mesh of triangles. Return the mesh. `normals` (n, 3) and `uvs` (n, 2): one per point."""
    usd_mesh = import_pxr_module("UsdGeom").Mesh.Define(stage, path)
    usd_mesh.CreatePointsAttr(to_vector_array(points))
    usd_mesh.CreateFaceVertexCountsAttr(to_integer_array(np.full(len(faces), 3)))
    usd_mesh.CreateFaceVertexIndicesAttr(to_integer_array(np.ravel(faces)))
    usd_mesh.CreateSubdivisionSchemeAttr("none")
    usd_mesh.CreateExtentAttr(to_vector_array(compute_box(points)))
    if normals is not None:
        usd_mesh.CreateNormalsAttr(to_vector_array(normals))
        usd_mesh.SetNormalsInterpolation("vertex")
    if uvs is not None:
        kind = import_pxr_module("Sdf").ValueTypeNames.TexCoord2fArray
        made_uvs = import_pxr_module("UsdGeom").PrimvarsAPI(usd_mesh).CreatePrimvar("st", kind, "vertex")
        made_uvs.Set(import_pxr_module("Vt").Vec2fArray.FromNumpy(np.ascontiguousarray(uvs, np.float32)))
    return usd_mesh


def write_state_names(prim: Any, species: SpeciesEntry) -> None:
    """Write the names of states, by state number, to the custom data of a prim."""
    for machine in species.machines:
        name = "states" if machine is species.machines[0] else f"{machine.name}.states"
        prim.SetCustomDataByKey(
            to_identifier(name), import_pxr_module("Vt").StringArray([state.name for state in machine.states])
        )


def make_unique(name: str, used_names: set[str]) -> str:
    """Return `name`, with a number added if it is in `used_names`. The result is added to `used_names`."""
    unique_name, number = name, 1
    while unique_name in used_names:
        number += 1
        unique_name = f"{name}_{number}"
    used_names.add(unique_name)
    return unique_name


def to_identifier(name: str) -> str:
    """Return a valid USD identifier for a name."""
    word = re.sub("[^A-Za-z0-9_]", "_", name)
    return word if re.match("[A-Za-z_]", word) else f"_{word}"


@contextmanager
def raise_disk_errors(path: Path) -> Iterator[None]:
    """Raise an OSError that names `path` if the disk fails while USD writes. All other errors propagate unchanged.

    USD includes the system's message only in its own errors."""
    try:
        yield
    except import_pxr_module("Tf").ErrorException as problem:
        said = str(problem)
        number = next((each for each in _DISK_ERRORS if os.strerror(each) in said), None)
        if number is None:
            raise
        raise OSError(number, os.strerror(number), str(path)) from None
