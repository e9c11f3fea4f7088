"""One layer of USD: opened, held against the limits, and what it is composed with."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

from antdsl import limits
from antdsl.scene.geometry.usd.child.guard import Answer, guarded
from antdsl.scene.geometry.usd.errors import UsdError, pxr, words_of

if TYPE_CHECKING:
    from antdsl.reader.protocol import Message

_folder = ""
_layers: dict[str, Any] = {}  # of the folder, so that USD reads each once


@guarded
def read_layer(request: Message) -> Answer:
    """The asset paths `assets` that the layer `path` is composed with, sublayers, references, payloads and those in variants
    included, as they are in the file. `folder` is that of all files of the stage, `text` the layer's name in messages."""
    said = request.document
    path, folder, text = (str(said[key]) for key in ("path", "folder", "text"))
    layer = opened_layer(path, folder, text)
    found: list[Any] = []
    layer.Traverse(pxr("Sdf").Path.absoluteRootPath, found.append)
    if any(place.pathElementCount > limits.USD_LEVELS for place in found):
        words = f"`{text}` cannot be read as USD: it has prims more than {limits.USD_LEVELS} levels deep"
        raise UsdError("bad-usd", words, "flatten its hierarchy", "usd")
    for place in found:
        if place.IsPrimPath() or place.IsPrimVariantSelectionPath():
            spec = layer.GetObjectAtPath(place)
            if spec is not None and spec.HasInfo("clips"):
                # they are opened when a value is read, which nothing could check before
                words = f"`{place}` of `{text}` has value clips, which are not read"
                raise UsdError("bad-usd", words, "flatten the file: `usdcat --flatten`", "usd")
    return {"assets": sorted(filter(None, layer.GetCompositionAssetDependencies()))}, {}  # an empty one names the layer itself


def opened_layer(path: str, folder: str, text: str) -> Any:
    """A layer below a folder; UsdError where USD cannot read it. Those of another folder are closed."""
    global _folder
    if folder != _folder:
        _layers.clear()
        _folder = folder
    if path not in _layers:
        _layers[path] = _opened(path, folder, text)
    return _layers[path]


def _opened(path: str, folder: str, text: str) -> Any:
    why = "it is of no kind that USD knows"
    try:
        layer = pxr("Sdf").Layer.FindOrOpen(path)
        if layer is not None:
            return layer
    except pxr("Tf").ErrorException as problem:
        why = words_of(problem, folder).replace(os.path.relpath(path, folder), text)
    except UnicodeDecodeError:  # USD's own words repeat what is no text
        why = "it has bytes that are no UTF-8 text"
    raise UsdError("bad-usd", f"`{text}` cannot be read as USD: {why}", "export it again", "usd")
