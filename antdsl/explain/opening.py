"""From a cache back to the shot that it was made from: its scene is found, with the texts of then, or it is refused."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from antdsl.diagnostics import Report
from antdsl.outputs.cache.cache_reader import Cache
from antdsl.outputs.starting import StartError, start_hash
from antdsl.pipeline import Choices, Shot, open_scene
from antdsl.runtime.hashing import STATE_HASH
from antdsl.scene.values import FrameRange

_SET = "--set "
_SPEC_SET = "set "


class ExplainError(Exception):
    """Why nothing can be explained, in words that stand alone. `usage`: what was asked for is wrong; `report`: the complaints
    about the scene's files, where they are the reason."""

    def __init__(self, message: str, help: str = "", *, usage: bool = False, report: Report | None = None) -> None:
        super().__init__(message)
        self.help, self.usage, self.report = help, usage, report


def open_shot(cache: Cache, scene: Path | None = None, grants: Mapping[str, Path] | None = None) -> Shot:
    """The shot of a cache. ExplainError when its scene is not found, does not check, or is not what the cache was made from."""
    manifest = cache.manifest
    path = scene or _scene_of(cache)
    spec = [name for name in manifest.inputs if name.startswith(_SPEC_SET)]
    if spec:
        words = f"the cache was made by a spec that sets `{spec[0].removeprefix(_SPEC_SET)}`"
        raise ExplainError(words, "only caches of `antdsl run` can be explained")
    if manifest.state_hash != STATE_HASH:
        words = f"`{cache.folder}` was written by an antdsl that hashes states in another way"
        raise ExplainError(words, "run the scene again: then a step that is done again can be held against the cache")
    params = {name.removeprefix(_SET): text for name, text in manifest.inputs.items() if name.startswith(_SET)}
    choices = Choices(grants or {}, FrameRange(manifest.first, manifest.last), manifest.seed, params)
    shot, report = open_scene(path, choices)
    if shot is None or not report.ok:
        other = "" if scene is not None else f"if `{path}` is not its scene, say which: `--scene FILE`"
        raise ExplainError(f"`{path}` does not check", other, report=report)
    try:
        now = {**shot.inputs, **start_hash(shot)}
    except StartError as why:
        raise ExplainError(str(why), report=why.report) from None
    then = manifest.inputs
    different = sorted(name for name in {**then, **now} if then.get(name) != now.get(name))
    if different:
        names = ", ".join(f"`{name}`" for name in different[:5])
        other = "" if scene is not None else f"; if `{path}` is not its scene, say which: `--scene FILE`"
        raise ExplainError(
            f"the cache was made from other inputs: {names}",
            f"an explanation needs the texts that the run was made with: put them back, or run the scene again{other}",
        )
    return shot


def _scene_of(cache: Cache) -> Path:
    """The scene's file: where it was, seen from the cache; else beside the folder `out` where runs put caches, in a folder above,
    or where one is."""
    name = Path(cache.manifest.scene).name
    folder = cache.folder.resolve()
    then = Path(os.path.normpath(folder / cache.manifest.scene_path)) if cache.manifest.scene_path else None
    near = (place / name for place in (*list(folder.parents)[:4], Path.cwd()))
    for path in (*([then] if then is not None else []), *near):
        if path.is_file():
            return path
    was = f", nor where it was from there: `{cache.manifest.scene_path}`" if then is not None else ""
    words = f"the scene `{name}` of `{cache.folder}` is not near it{was}"
    raise ExplainError(words, "say where it is: `--scene FILE`", usage=True)
