"""Values over time in files of their own, so many frames in each (USD's value clips): the stage stays small, and a program opens
those of the frames that it shows.

`shot.usdc` names `shot.values.0001.usdc`, `shot.values.0025.usdc` … by their first frames, and `shot.values.manifest.usda`, which
says what attributes they have. Each ends with the first sample of the next, so that what lies between the two is known."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any

from antdsl.outputs.usd.values import ROOT, Out
from antdsl.scene.geometry.usd import pxr
from antdsl.whole import whole

_SET = "default"  # the name of a prim's first set of clips


class ValueFiles:
    """The files of values of a stage that is written to `path`."""

    def __init__(self, out: Out, path: Path, frames: list[int], chunk: int) -> None:
        self._out, self._path, self._frames = out, path, frames
        groups = {(frame - frames[0]) // chunk: frame for frame in reversed(frames)} if chunk else {}
        self._starts = sorted(groups.values())
        self._parts = ExitStack()
        self._layer: Any = None
        if self._starts:
            out.manifest = pxr("Sdf").Layer.CreateAnonymous("manifest.usda")

    def begins(self, frame: int) -> bool:
        """Whether values from a frame on belong in another file than those before."""
        return frame in self._starts[1:]

    def begin(self, frame: int) -> None:
        """Write into the file that begins with a frame. Raises OSError."""
        if not self._starts:
            return
        self._save()
        part = self._parts.enter_context(whole(self._named(f"{frame:04d}.usdc"), ".usdc"))
        part.unlink()
        self._layer = pxr("Sdf").Layer.CreateNew(str(part))
        self._out.begin(self._layer)

    def _save(self) -> None:
        if self._layer is not None:
            self._layer.Save()
        self._layer = None

    def __enter__(self) -> ValueFiles:
        return self

    def __exit__(self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None) -> None:
        """Put all files in their places, or, where anything failed, none of them. The stage of an earlier export goes first: it
        would show these values as its own, should its successor not come."""
        self._layer = self._out.clip = None
        if self._starts and kind is None:
            self._path.unlink(missing_ok=True)
        self._parts.__exit__(kind, problem, trace)

    def finish(self) -> None:
        """Name all files in the stage."""
        self._save()
        if not self._starts:
            return
        self._out.clip = None
        manifest = self._named("manifest.usda")
        self._out.manifest.Export(str(self._parts.enter_context(whole(manifest, ".usda"))))
        gf, vt = pxr("Gf"), pxr("Vt")
        clips = pxr("Usd").ClipsAPI(self._out.stage.GetPrimAtPath(ROOT))
        names = [f"./{self._named(f'{frame:04d}.usdc').name}" for frame in self._starts]
        clips.SetClipAssetPaths(pxr("Sdf").AssetPathArray([pxr("Sdf").AssetPath(name) for name in names]), _SET)
        clips.SetClipManifestAssetPath(pxr("Sdf").AssetPath(f"./{manifest.name}"), _SET)
        clips.SetClipPrimPath(ROOT, _SET)
        ends = (self._frames[0] - 1, self._frames[-1] + 2)  # samples of a shutter lie around the frames
        begins = [ends[0], *self._starts[1:]]
        clips.SetClipActive(vt.Vec2dArray([gf.Vec2d(begin, k) for k, begin in enumerate(begins)]), _SET)
        clips.SetClipTimes(vt.Vec2dArray([gf.Vec2d(end, end) for end in ends]), _SET)

    def _named(self, ending: str) -> Path:
        return self._path.with_name(f"{self._path.stem}.values.{ending}")
