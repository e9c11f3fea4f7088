"""A USD file opened for one prim: its units and axes, its time, and which of the prims below are seen."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.scene.geometry.matrices import after
from antdsl.scene.geometry.usd.errors import UsdError, pxr
from antdsl.scene.geometry.usd.layers import Layers, quiet
from antdsl.scene.paths import Roots

Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class UsdStage:
    """`prim` is the one asked for. `to_scene` (3, 4) takes the stage's places to mm and the scene's axes. `times` are the time
    codes of the frames asked for, the first being the one at which everything stands at rest; `hashes` of all files by name."""

    prim: Any
    to_scene: Floats
    times: tuple[float, ...]
    hashes: dict[str, str]
    purpose: str
    stage: Any

    @property
    def first(self) -> Any:
        return pxr("Usd").TimeCode(self.times[0])

    def shown(self, prim: Any) -> bool:
        """Whether a prim is of the purpose asked for and visible at the first frame."""
        image = pxr("UsdGeom").Imageable(prim)
        if not image:
            return True
        return image.ComputePurpose() in ("default", self.purpose) and image.ComputeVisibility(self.first) != "invisible"

    def below(self, prim: Any) -> Iterator[Any]:
        """The prim and those below it that are seen, instances looked into, the prototypes of point instancers left out."""
        usd, geom = pxr("Usd"), pxr("UsdGeom")
        walk = iter(usd.PrimRange(prim, usd.TraverseInstanceProxies()))
        for found in walk:
            if not self.shown(found):
                if geom.Imageable(found).ComputeVisibility(self.first) == "invisible":
                    walk.PruneChildren()
                continue
            if found.IsA(geom.PointInstancer):
                walk.PruneChildren()
            yield found

    def matrices(self, prim: Any, every: bool) -> Floats:
        """The way from a prim's own space to the scene (frames, 3, 4), at all frames, or only the first when `every` is False."""
        cache = pxr("UsdGeom").XformCache()
        found = []
        for time in self.times if every else self.times[:1]:
            cache.SetTime(pxr("Usd").TimeCode(time))
            found.append(column_matrix(cache.GetLocalToWorldTransform(prim)))
        return after(self.to_scene, np.array(found))

    def travels(self, prim: Any) -> bool:
        """Whether a prim's place may change over time."""
        geom = pxr("UsdGeom")
        while prim and not prim.IsPseudoRoot():
            moved = geom.Xformable(prim)
            if moved:
                if moved.TransformMightBeTimeVarying():
                    return len(self.times) > 1
                if moved.GetResetXformStack():
                    return False
            prim = prim.GetParent()
        return False


def column_matrix(matrix: Any) -> Floats:
    """USD's matrix for rows of coordinates as (3, 4) for columns."""
    rows = np.array(matrix, np.float64)
    return np.ascontiguousarray(rows[:, :3].T)


def open_stage(
    roots: Roots,
    text: str,
    prim: str,
    *,
    up: str,
    frames: Sequence[int],
    fps: Fraction,
    purpose: str = "render",
    layers: dict[str, Layers] | None = None,
) -> UsdStage:
    """A file opened for what lies at and below a prim path. `layers` keeps files that were judged already, by name.

    Frame f is USD's time code f · timeCodesPerSecond / fps: equal where the rates are. UsdError when the file or anything it is
    made of may not be opened, or there is no such prim."""
    usd, geom, sdf = pxr("Usd"), pxr("UsdGeom"), pxr("Sdf")
    kept = {} if layers is None else layers
    if text not in kept:
        kept[text] = Layers(roots, text)
    judged = kept[text]
    if not prim.startswith("/") or not sdf.Path.IsValidPathString(prim)[0] or not sdf.Path(prim).IsAbsoluteRootOrPrimPath():
        raise UsdError("no-such-prim", f"`{prim}` is not the path of a prim", "write it from the root: `/set/stones`")
    path = sdf.Path(prim)
    wrong = judged.wrong(prim)
    if wrong:
        raise UsdError("bad-usd", f"`{text}` cannot be opened for `{prim}`: {wrong}", "name a smaller part of it")
    with quiet():
        stage = usd.Stage.OpenMasked(judged.first, usd.StagePopulationMask([path]))
        stage.ExpandPopulationMask()
    for layer in stage.GetUsedLayers():
        if not judged.knows(layer):
            raise UsdError(
                "bad-path", f"`{text}` uses `{layer.identifier[-80:]}`, which is outside of the granted roots", None, "usd"
            )
    found = stage.GetPrimAtPath(path)
    if not found or not found.IsActive():
        raise _no_such_prim(judged.first, text, path, bool(found))
    problems = stage.GetCompositionErrors()
    if problems:
        raise UsdError("bad-usd", f"`{text}` does not hold together: {_first_words(str(problems[0]))}", None, "usd")
    rate = float(stage.GetTimeCodesPerSecond())
    factor = float(geom.GetStageMetersPerUnit(stage)) * 1000.0
    for name, value in (("timeCodesPerSecond", rate), ("metersPerUnit", factor / 1000.0)):
        if not 1e-12 < value < 1e12:
            words = f"`{text}` says `{name} = {value:g}`, which cannot be"
            raise UsdError("bad-usd", words, f"give it a `{name}` above 0", "usd")
    times = tuple(float(Fraction(frame) / fps) * rate for frame in frames)
    return UsdStage(found, _to_scene(factor, str(geom.GetStageUpAxis(stage)).lower(), up), times, judged.hashes, purpose, stage)


def _to_scene(factor: float, own: str, up: str) -> Floats:
    matrix = np.zeros((3, 4))
    if own == up:
        rows = [(0, 1.0), (1, 1.0), (2, 1.0)]
    elif own == "z":
        rows = [(0, 1.0), (2, 1.0), (1, -1.0)]  # as `meshes.turned_up`
    else:
        rows = [(0, 1.0), (2, -1.0), (1, 1.0)]
    for row, (column, sign) in enumerate(rows):
        matrix[row, column] = sign * factor
    return matrix


def _first_words(text: str) -> str:
    line = "".join(c if c.isprintable() else "\ufffd" for c in " ".join(text.split()))
    return line if len(line) <= 160 else line[:157] + "…"


def _no_such_prim(layer: Any, text: str, path: Any, inactive: bool) -> UsdError:
    """With what is there instead: the children of the longest part of the path that exists."""
    from antdsl.diagnostics.suggestion import nearest_name

    if inactive:
        return UsdError("no-such-prim", f"the prim `{path}` of `{text}` is switched off", "make it active, or name another")
    usd = pxr("Usd")
    above = path.GetParentPath()
    while True:
        with quiet():
            stage = usd.Stage.OpenMasked(layer, usd.StagePopulationMask([above]), usd.Stage.LoadNone)
        parent = stage.GetPrimAtPath(above)
        if parent or above.isEmpty or above.IsAbsoluteRootPath():
            break
        above = above.GetParentPath()
    names = [child.GetName() for child in parent.GetFilteredChildren(usd.PrimAllPrimsPredicate)][:200] if parent else []
    wanted = str(path).removeprefix(str(above)).strip("/").split("/")[0]
    near = nearest_name(wanted, names)
    if near:
        help: str | None = f"did you mean `{above.AppendChild(near)}`?"
    else:
        help = f"below `{above}` are: " + ", ".join(f"`{name}`" for name in names[:12]) if names else None
    return UsdError("no-such-prim", f"there is no prim `{path}` in `{text}`", help)
