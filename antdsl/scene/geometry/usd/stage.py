"""A USD file as requested from the reader: for one prim, at frames, in the scene's axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from hashlib import blake2b
from importlib.util import find_spec
from typing import Any

import numpy as np

from antdsl.reader import client, confinement
from antdsl.reader.protocol import ProtocolError, ReaderMessage, ReadRefusal
from antdsl.scene.geometry.mesh_text import MeshError
from antdsl.scene.geometry.usd.closure import Closure
from antdsl.scene.geometry.usd.errors import UsdError, missing_extra_error
from antdsl.scene.paths import Roots

_FRAMES_PER_EXTRA_SECOND = 8  # that a request may take in addition


@dataclass(frozen=True, slots=True, eq=False)
class UsdStage:
    """What is at and below a prim of a file. `frames`: at the first, everything is at rest."""

    closure: Closure
    prim: str
    up: str
    frames: Sequence[int]
    fps: Fraction
    purpose: str

    @property
    def hashes(self) -> dict[str, str]:
        """Hashes of all files by name."""
        return self.closure.hashes

    def ask(self, kind: str, document: Mapping[str, Any] | None = None) -> ReaderMessage:
        """Return the reader's answer about this stage, which is not trusted. Raises UsdError, MeshError for an invalid mesh, or a
        Refusal that is `key_fields` something known to the caller."""
        said = {
            "path": self.closure.path,
            "folder": self.closure.folder,
            "text": self.closure.text,
            "prim": self.prim,
            "up": self.up,
            "purpose": self.purpose,
            "fps": [self.fps.numerator, self.fps.denominator],
            **(document or {}),
        }
        key_fields = {name: value for name, value in said.items() if name not in ("path", "folder")}
        digest = blake2b(repr((kind, self.closure.digest, sorted(key_fields.items()), self.frames)).encode(), digest_size=16)
        try:
            return client.ask(
                kind,
                said,
                {"frames": np.array(self.frames, np.int64)},
                size=self.closure.size,
                seconds=len(self.frames) // _FRAMES_PER_EXTRA_SECOND,
                digest=digest.hexdigest(),
                files=self.closure.digest,
            )
        except client.ReaderFailure as why:
            raise self.make_error(str(why), why.help) from None
        except ReadRefusal as why:
            if why.about == "mesh":
                raise MeshError(str(why), why.help) from None
            if why.about == "exception":
                raise self.make_error(f"cannot be read: {why}", why.help) from None
            if why.about:
                raise
            raise UsdError(why.code, str(why), why.help, why.key) from None

    def make_error(self, words: str, help: str | None = None) -> UsdError:
        """An error about the prim, in words that fit after its name."""
        return UsdError("bad-usd", f"`{self.prim}` of `{self.closure.text}` {words}", help)

    def make_answer_error(self, why: ProtocolError) -> UsdError:
        """An error for an answer that is not what was requested."""
        return self.make_error(f"cannot be read: the reader sent an invalid answer ({why})", "export it again")


def open_stage(
    roots: Roots,
    text: str,
    prim: str,
    *,
    up: str,
    frames: Sequence[int],
    fps: Fraction,
    purpose: str = "render",
    closures: dict[str, Closure | UsdError] | None = None,
) -> UsdStage:
    """Open a file for what is at and below a prim path. `closures` stores collected files by name, or why they cannot be
    collected.

    Frame f is USD's time code f · timeCodesPerSecond / fps: equal if the rates are equal. Raises UsdError if the file or a file
    it consists of may not be opened, or if there is no such prim. Also raises it if the system has no sandbox and the user does
    not trust USD files."""
    _check_sandbox(text)
    stored = {} if closures is None else closures
    if text not in stored:
        try:
            stored[text] = Closure(roots, text)
        except UsdError as why:
            stored[text] = why
    closure = stored[text]
    if isinstance(closure, UsdError):
        raise UsdError(closure.code, str(closure), closure.help, closure.key)
    stage = UsdStage(closure, prim, up, frames, fps, purpose)
    stage.ask("usd-stage")
    return stage


def _check_sandbox(text: str) -> None:
    """Raise UsdError without usd-core. Also raise it if nothing confines the process that would read USD, unless the user has
    said that USD files are trusted."""
    if find_spec("pxr") is None:
        raise missing_extra_error()
    try:
        is_confined = bool(client.active_layers()["seccomp"])
    except client.ReaderFailure as why:
        raise UsdError("bad-usd", f"`{text}` cannot be read: {why}", "run `antdsl doctor`", "usd") from None
    if not is_confined and not confinement.is_usd_trusted():
        words = f"`{text}` is not opened: this system has no sandbox for the library that reads USD"
        raise UsdError("bad-usd", words, "if you trust all USD files of the scene, run `antdsl --trust-usd …`", "usd")
