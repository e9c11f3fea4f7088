"""Opens a USD stage for one prim: its layers, units, axes and time, and the visible prims below the prim.

The size of each layer is compared with the limits."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.scene.geometry.matrices import compose_transforms
from antdsl.scene.geometry.usd.child.guard import ReaderAnswer, wrap_refusals
from antdsl.scene.geometry.usd.errors import UsdError, clean_usd_text, format_usd_error, import_pxr_module

if TYPE_CHECKING:
    from antdsl.reader.protocol import ReaderMessage

_current_folder = ""
_open_layers: dict[str, Any] = {}  # cached by folder, so that USD reads each layer once
Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class OpenStage:
    """A stage that is open for one prim.

    `prim`: the requested prim.
    `to_scene` (3, 4): the transform from positions in the stage to mm and the scene's axes.
    `times`: the time codes of the requested frames. Geometry at the first one is the rest position."""

    prim: Any
    to_scene: Floats
    times: tuple[float, ...]
    purpose: str
    stage: Any

    @property
    def first_time(self) -> Any:
        """Return USD's time code of the first requested frame."""
        return import_pxr_module("Usd").TimeCode(self.times[0])

    def is_visible(self, prim: Any) -> bool:
        """Return whether a prim has the requested purpose and is visible at the first frame."""
        image = import_pxr_module("UsdGeom").Imageable(prim)
        if not image:
            return True
        return image.ComputePurpose() in ("default", self.purpose) and image.ComputeVisibility(self.first_time) != "invisible"

    def find_visible_prims(self, prim: Any) -> Iterator[Any]:
        """Yield a prim and its visible descendants. Instances are included, but prototypes of point instancers are not."""
        usd, geom = import_pxr_module("Usd"), import_pxr_module("UsdGeom")
        walk = iter(usd.PrimRange(prim, usd.TraverseInstanceProxies()))
        for descendant in walk:
            if not self.is_visible(descendant):
                if geom.Imageable(descendant).ComputeVisibility(self.first_time) == "invisible":
                    walk.PruneChildren()
                continue
            if descendant.IsA(geom.PointInstancer):
                walk.PruneChildren()
            yield descendant

    def compute_scene_transforms(self, prim: Any, all_frames: bool) -> Floats:
        """Return the transforms (frames, 3, 4) from a prim's own space to the scene.

        `all_frames`: whether to return all frames or only the first."""
        cache = import_pxr_module("UsdGeom").XformCache()
        found = []
        for time in self.times if all_frames else self.times[:1]:
            cache.SetTime(import_pxr_module("Usd").TimeCode(time))
            found.append(to_column_matrix(cache.GetLocalToWorldTransform(prim)))
        return compose_transforms(self.to_scene, np.array(found))

    def is_moving(self, prim: Any) -> bool:
        """Return whether the transform of a prim may change over time."""
        geom = import_pxr_module("UsdGeom")
        while prim and not prim.IsPseudoRoot():
            moved = geom.Xformable(prim)
            if moved:
                if moved.TransformMightBeTimeVarying():
                    return len(self.times) > 1
                if moved.GetResetXformStack():
                    return False
            prim = prim.GetParent()
        return False


def to_column_matrix(matrix: Any) -> Floats:
    """Return USD's matrix, which is for row vectors, as a matrix (3, 4) for column vectors."""
    rows = np.array(matrix, np.float64)
    return np.ascontiguousarray(rows[:, :3].T)


_last_stage: tuple[tuple[object, ...], OpenStage] | None = None  # successive requests are often about the same prim


def open_stage(request: ReaderMessage) -> OpenStage:
    """Return a stage that is open for the contents at and below a prim. The request has these fields:

    `path`: the top file; `folder`: the folder with all files of the stage.
    `prim`: the path of the prim; `text`: the file's name in messages.

    Frame f is USD's time code f · timeCodesPerSecond / fps. The two are equal if the rates are equal. Raises UsdError if the
    stage uses a file outside the folder, exceeds the limits, or has no such prim."""
    global _last_stage
    said, frames = request.document, request.require_array("frames", "<i8", None)
    path, folder, text, prim, up, purpose = (str(said[key]) for key in ("path", "folder", "text", "prim", "up", "purpose"))
    fps = Fraction(int(said["fps"][0]), int(said["fps"][1]))
    key = (path, folder, prim, up, purpose, fps, frames.tobytes())
    if _last_stage is None or _last_stage[0] != key:
        _last_stage = None
        _last_stage = (key, _open_prim_stage(path, folder, text, prim, up, purpose, fps, frames.tolist()))
    return _last_stage[1]


def _open_prim_stage(
    path: str, folder: str, text: str, prim: str, up: str, purpose: str, fps: Fraction, frames: list[int]
) -> OpenStage:
    """Return a stage with the layer at `path` as its root, open for one prim. Raises UsdError for the reasons that `open_stage`
    lists."""
    usd, geom, sdf = import_pxr_module("Usd"), import_pxr_module("UsdGeom"), import_pxr_module("Sdf")
    if not prim.startswith("/") or not sdf.Path.IsValidPathString(prim)[0] or not sdf.Path(prim).IsAbsoluteRootOrPrimPath():
        raise UsdError("no-such-prim", f"`{prim}` is not the path of a prim", "write it from the root: `/set/stones`")
    place, top = sdf.Path(prim), open_layer(path, folder, text)
    stage = usd.Stage.OpenMasked(top, usd.StagePopulationMask([place]))
    stage.ExpandPopulationMask()
    for layer in stage.GetUsedLayers():
        own = os.path.realpath(str(layer.identifier).partition("[")[0])
        if not layer.anonymous and not own.startswith(folder + os.sep):
            raise UsdError("bad-path", f"`{text}` uses a file that is outside the granted roots", None, "usd")
    stage_prim = stage.GetPrimAtPath(place)
    if not stage_prim or not stage_prim.IsActive():
        raise _make_missing_prim_error(top, text, place, bool(stage_prim))
    problems = stage.GetCompositionErrors()
    if problems:
        raise UsdError("bad-usd", f"`{text}` is inconsistent: {clean_usd_text(str(problems[0]), folder)}", None, "usd")
    _check_prim_count(stage, text, prim)
    rate = float(stage.GetTimeCodesPerSecond())
    factor = float(geom.GetStageMetersPerUnit(stage)) * 1000.0
    for name, value in (("timeCodesPerSecond", rate), ("metersPerUnit", factor / 1000.0)):
        if not 1e-12 < value < 1e12:
            words = f"`{text}` has `{name} = {value:g}`, which is not valid"
            raise UsdError("bad-usd", words, f"give it a `{name}` above 0", "usd")
    times = tuple(float(Fraction(frame) / fps) * rate for frame in frames)
    return OpenStage(
        stage_prim, _make_scene_transform(factor, str(geom.GetStageUpAxis(stage)).lower(), up), times, purpose, stage
    )


def _check_prim_count(stage: Any, text: str, prim: str) -> None:
    usd = import_pxr_module("Usd")
    for number, descendant in enumerate(usd.PrimRange(stage.GetPseudoRoot(), usd.TraverseInstanceProxies())):
        if number >= limits.MAX_USD_PRIMS:
            words = f"`{text}` has more than {limits.MAX_USD_PRIMS:,} prims for `{prim}`"
            raise UsdError("too-large", words, "name a smaller part of it")
        if descendant.GetPath().pathElementCount > limits.MAX_USD_PRIM_DEPTH:
            words = f"`{text}` has prims more than {limits.MAX_USD_PRIM_DEPTH} levels deep for `{prim}`"
            raise UsdError("bad-usd", words, "name a smaller part of it")


def _make_scene_transform(factor: float, own_up: str, up: str) -> Floats:
    """Return the transform (3, 4) from a stage to the scene. `factor`: mm per unit of the stage. `own_up`: the stage's up
    axis."""
    matrix = np.zeros((3, 4))
    if own_up == up:
        rows = [(0, 1.0), (1, 1.0), (2, 1.0)]
    elif own_up == "z":
        rows = [(0, 1.0), (2, 1.0), (1, -1.0)]  # the same as `meshes.rotate_up_axis`
    else:
        rows = [(0, 1.0), (2, -1.0), (1, 1.0)]
    for row, (column, sign) in enumerate(rows):
        matrix[row, column] = sign * factor
    return matrix


def _make_missing_prim_error(layer: Any, text: str, path: Any, inactive: bool) -> UsdError:
    """Return an error for a prim that does not exist. It lists the children of the longest part of the path that exists."""
    from antdsl.diagnostics.suggestion import find_nearest_name

    if inactive:
        return UsdError("no-such-prim", f"the prim `{path}` of `{text}` is inactive", "make it active, or name another")
    usd = import_pxr_module("Usd")
    above = path.GetParentPath()
    while True:
        stage = usd.Stage.OpenMasked(layer, usd.StagePopulationMask([above]), usd.Stage.LoadNone)
        parent = stage.GetPrimAtPath(above)
        if parent or above.isEmpty or above.IsAbsoluteRootPath():
            break
        above = above.GetParentPath()
    names = [child.GetName() for child in parent.GetFilteredChildren(usd.PrimAllPrimsPredicate)][:200] if parent else []
    missing_name = str(path).removeprefix(str(above)).strip("/").split("/")[0]
    near = find_nearest_name(missing_name, names)
    if near:
        help: str | None = f"did you mean `{above.AppendChild(near)}`?"
    else:
        help = f"available below `{above}`: " + ", ".join(f"`{name}`" for name in names[:12]) if names else None
    return UsdError("no-such-prim", f"there is no prim `{path}` in `{text}`", help)


@wrap_refusals
def read_layer(request: ReaderMessage) -> ReaderAnswer:
    """Return an answer with `assets`: the asset paths in a layer, as in the file.

    They include sublayers, references, payloads and paths in variants. The request has these fields:
    `path`: the layer; `folder`: the folder with all files of the stage; `text`: the layer's name in messages."""
    said = request.document
    path, folder, text = (str(said[key]) for key in ("path", "folder", "text"))
    layer = open_layer(path, folder, text)
    spec_paths: list[Any] = []
    layer.Traverse(import_pxr_module("Sdf").Path.absoluteRootPath, spec_paths.append)
    if any(place.pathElementCount > limits.MAX_USD_PRIM_DEPTH for place in spec_paths):
        words = f"`{text}` cannot be read as USD: it has prims more than {limits.MAX_USD_PRIM_DEPTH} levels deep"
        raise UsdError("bad-usd", words, "flatten its hierarchy", "usd")
    for place in spec_paths:
        if place.IsPrimPath() or place.IsPrimVariantSelectionPath():
            spec = layer.GetObjectAtPath(place)
            if spec is not None and spec.HasInfo("clips"):
                # USD opens them when it reads a value, so they cannot be checked in advance
                words = f"`{place}` of `{text}` has value clips, which are not supported"
                raise UsdError("bad-usd", words, "flatten the file: `usdcat --flatten`", "usd")
    # an empty path refers to the layer itself
    return {"assets": sorted(filter(None, layer.GetCompositionAssetDependencies()))}, {}


def open_layer(path: str, folder: str, text: str) -> Any:
    """Return the open layer at `path`. Layers from other folders are closed before. Raises UsdError if USD cannot read the
    layer."""
    global _current_folder
    if folder != _current_folder:
        _open_layers.clear()
        _current_folder = folder
    if path not in _open_layers:
        _open_layers[path] = _open_checked_layer(path, folder, text)
    return _open_layers[path]


def _open_checked_layer(path: str, folder: str, text: str) -> Any:
    why = "it is not a format that USD knows"
    try:
        layer = import_pxr_module("Sdf").Layer.FindOrOpen(path)
        if layer is not None:
            return layer
    except import_pxr_module("Tf").ErrorException as problem:
        why = format_usd_error(problem, folder).replace(os.path.relpath(path, folder), text)
    except UnicodeDecodeError:  # USD's message would repeat the invalid bytes
        why = "it has bytes that are not UTF-8 text"
    raise UsdError("bad-usd", f"`{text}` cannot be read as USD: {why}", "export it again", "usd")
