"""Which files a USD file is made of, each judged before USD opens it: below the scene's folder or a granted root, no link, no
address, no larger than a mesh may be."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from hashlib import blake2b
from pathlib import Path
from typing import Any

from antdsl import limits
from antdsl.scene.geometry.usd.errors import UsdError, pxr, words_of
from antdsl.scene.geometry.usd.sandbox import what_is_wrong
from antdsl.scene.paths import PathRefused, Roots

KINDS = (".usd", ".usda", ".usdc", ".usdz")
_ADDRESS = re.compile("[A-Za-z][A-Za-z0-9+.-]+:")
_LAYERS = 10_000


class Layers:
    """Files that may be opened, with their layers and a hash of each by the name a scene would give it."""

    def __init__(self, roots: Roots, text: str) -> None:
        self.hashes: dict[str, str] = {}
        self.layers: dict[str, Any] = {}  # by full path; kept, so that USD reads each once
        self._roots = roots
        self._bytes = 0
        self.first = self._open(text, None)
        self._top = os.path.abspath(roots.path(text))
        waiting = [self.first]
        while waiting:
            layer = waiting.pop()
            for asset in _assets(layer):
                path = self._path(layer, asset)
                if path not in self.layers:
                    waiting.append(self._open(self._name(path, layer, asset), layer))

    def wrong(self, prim: str) -> str:
        """Why the files together are not to be opened for a prim, empty where nothing is wrong."""
        digest = blake2b(repr(sorted(self.hashes.items())).encode(), digest_size=16).hexdigest()
        return what_is_wrong(digest, "stage", self._top, prim)

    def knows(self, layer: Any) -> bool:
        """Whether a layer that a stage uses is one of these, or lies in memory alone."""
        return bool(layer.anonymous) or _outer(layer.identifier)[0] in self.layers

    def _open(self, text: str, by: Any) -> Any:
        """A layer by the name that a scene would give its file, after its bytes were read through the one door to files."""
        if not text.lower().endswith(KINDS):
            raise UsdError("bad-usd", f"`{text}` is not one of {', '.join(KINDS)}", None, "usd")
        try:
            data = self._roots.read(text, limits.MESH_BYTES)
        except PathRefused as refused:
            raise UsdError(refused.code, f"{refused}{_named_by(by)}", refused.help, "usd") from None
        self._bytes += len(data)
        if len(self.layers) >= _LAYERS or self._bytes > 4 * limits.MESH_BYTES:
            raise UsdError("too-large", f"`{text}` and the files it is made of are more than are read", None, "usd")
        self.hashes[text] = blake2b(data, digest_size=16).hexdigest()
        path = os.path.abspath(self._roots.path(text))
        wrong = what_is_wrong(self.hashes[text], "layer", path)
        if wrong:
            raise UsdError("bad-usd", f"`{text}` cannot be read as USD: {wrong}", "export it anew", "usd")
        layer = _layer(path, text)
        self.layers[path] = layer
        return layer

    def _path(self, layer: Any, asset: str) -> str:
        """The full path of a file that a layer names; UsdError for an address or anything that is worked out when opened."""
        inside = f"`{_shown(asset)}`{_named_by(layer)}"
        if "`" in asset or ":SDF_FORMAT_ARGS:" in asset:
            raise UsdError("bad-path", f"{inside} is an expression, not a file", "write the path out", "usd")
        if _ADDRESS.match(asset):
            raise UsdError("bad-path", f"{inside} is an address, not a file", "copy the file beside the others", "usd")
        outer = _outer(layer.identifier)[0]
        if outer.lower().endswith(".usdz"):
            return outer  # a package names parts of itself
        beside, own = (os.path.normpath(os.path.join(os.path.dirname(f), _outer(asset)[0])) for f in (outer, self._top))
        # USD looks beside the file that names it, then beside the first
        return own if not asset.startswith(".") and not os.path.lexists(beside) and os.path.lexists(own) else beside

    def _name(self, path: str, layer: Any, asset: str) -> str:
        for name, folder in (("", self._roots.folder), *self._roots.granted.items()):
            root = os.path.abspath(folder)
            if path.startswith(root + os.sep):
                below = Path(path).relative_to(root).as_posix()
                return f"{name}:{below}" if name else below
        message = f"`{_shown(asset)}`{_named_by(layer)} lies outside the scene's folder and of every granted root"
        raise UsdError("bad-path", message, "grant its folder with `--root NAME=FOLDER`, or copy the file", "usd")


def _layer(path: str, text: str) -> Any:
    why = "it is of no kind that USD knows"
    with quiet():
        try:
            layer = pxr("Sdf").Layer.FindOrOpen(path)
            if layer is not None:
                layer.Reload()  # one that was read before and has changed since
                return layer
        except pxr("Tf").ErrorException as problem:
            why = words_of(problem).replace(path, text)
        except UnicodeDecodeError:  # USD's own words repeat what is no text
            why = "it has bytes that are no UTF-8 text"
    raise UsdError("bad-usd", f"`{text}` cannot be read as USD: {why}", None, "usd")


def _assets(layer: Any) -> Iterator[str]:
    """What a layer is composed with. Value clips are opened as they are asked for, which no one could judge before."""
    found: list[Any] = []
    layer.Traverse(pxr("Sdf").Path.absoluteRootPath, found.append)
    for path in found:
        if path.IsPrimPath() or path.IsPrimVariantSelectionPath():
            spec = layer.GetObjectAtPath(path)
            if spec is not None and spec.HasInfo("clips"):
                words = f"`{path}`{_named_by(layer)} has value clips, which are not read"
                raise UsdError("bad-usd", words, "flatten the file: `usdcat --flatten`", "usd")
    yield from sorted(filter(None, layer.GetCompositionAssetDependencies()))  # what is empty names the layer itself


def _outer(identifier: str) -> tuple[str, str]:
    """A path and what it names inside of that file, for packages: `set.usdz[set.usdc]`."""
    outer, mark, inner = identifier.partition("[")
    return outer, inner.removesuffix("]") if mark else ""


def _named_by(layer: Any) -> str:
    return "" if layer is None else f", named by `{os.path.basename(layer.identifier)[:80]}`,"


def _shown(text: str) -> str:
    return text if len(text) <= 80 else text[:77] + "…"


class quiet:
    """USD's own warnings are kept from the screen while a file is opened: what matters is told in the scene's words."""

    def __enter__(self) -> None:
        self._caught = pxr("UsdUtils").CoalescingDiagnosticDelegate()

    def __exit__(self, *_: object) -> None:
        self._caught.TakeUncoalescedDiagnostics()
        del self._caught
