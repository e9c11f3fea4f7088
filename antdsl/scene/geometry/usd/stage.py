"""Requests to the reader process about one prim of a USD file, at given frames and in the scene's axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from hashlib import blake2b
from importlib.util import find_spec
from typing import Any

import numpy as np

from antdsl.reader import client, confinement
from antdsl.reader.protocol import ProtocolError, ReaderMessage, RefusalError
from antdsl.scene.geometry.mesh_text import MeshError
from antdsl.scene.geometry.usd.closure import UsdFileClosure
from antdsl.scene.geometry.usd.errors import UsdError, make_missing_extra_error
from antdsl.scene.paths import Roots

_FRAMES_PER_EXTRA_SECOND = 8  # optional fields of a request


@dataclass(frozen=True, slots=True, eq=False)
class UsdStage:
    """The contents of a USD file at and below one prim. `frames`: the requested frames. Geometry at the first one is the rest
    position."""

    closure: UsdFileClosure
    prim: str
    up: str
    frames: Sequence[int]
    fps: Fraction
    purpose: str

    @property
    def hashes(self) -> dict[str, str]:
        """Return the hashes of all files, by name."""
        return self.closure.hashes

    def send_request(self, kind: str, document: Mapping[str, Any] | None = None) -> ReaderMessage:
        """Return the reader's answer to a request about this stage. The answer is not checked.

        Raises UsdError, or MeshError for an invalid mesh. A RefusalError about anything else is passed on to the caller."""
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
        digest = blake2b(
            repr((kind, self.closure.closure_digest, sorted(key_fields.items()), self.frames)).encode(), digest_size=16
        )
        try:
            return client.send_request(
                kind,
                said,
                {"frames": np.array(self.frames, np.int64)},
                file_bytes=self.closure.size,
                extra_cpu_seconds=len(self.frames) // _FRAMES_PER_EXTRA_SECOND,
                request_digest=digest.hexdigest(),
                files_digest=self.closure.closure_digest,
            )
        except client.ReaderFailureError as error:
            raise self.make_error(str(error), error.help) from None
        except RefusalError as error:
            if error.subject == "mesh":
                raise MeshError(str(error), error.help) from None
            if error.subject == "exception":
                raise self.make_error(f"cannot be read: {error}", error.help) from None
            if error.subject:
                raise
            raise UsdError(error.code, str(error), error.help, error.key) from None

    def make_error(self, message: str, help: str | None = None) -> UsdError:
        """Return an error about the prim. `message`: a text that fits after the name of the prim."""
        return UsdError("bad-usd", f"`{self.prim}` of `{self.closure.text}` {message}", help)

    def make_answer_error(self, error: ProtocolError) -> UsdError:
        """Return an error for an answer that does not fit the request."""
        return self.make_error(f"cannot be read: the reader sent an invalid answer ({error})", "export it again")


def open_stage(
    roots: Roots,
    text: str,
    prim: str,
    *,
    up: str,
    frames: Sequence[int],
    fps: Fraction,
    purpose: str = "render",
    closures: dict[str, UsdFileClosure | UsdError] | None = None,
) -> UsdStage:
    """Return a stage for the contents of a file at and below a prim.

    `closures`: a cache of collected files by name. For files that cannot be collected, it stores the error.

    Frame f is USD's time code f · timeCodesPerSecond / fps. The two are equal if the rates are equal. Raises UsdError if a file
    may not be opened, or if there is no such prim. Also raises it if the system has no sandbox and the user has not allowed USD
    files without one."""
    _check_sandbox(text)
    stored = {} if closures is None else closures
    if text not in stored:
        try:
            stored[text] = UsdFileClosure(roots, text)
        except UsdError as error:
            stored[text] = error
    closure = stored[text]
    if isinstance(closure, UsdError):
        raise UsdError(closure.code, str(closure), closure.help, closure.key)
    stage = UsdStage(closure, prim, up, frames, fps, purpose)
    stage.send_request("usd-stage")
    return stage


def _check_sandbox(text: str) -> None:
    """Raise UsdError if usd-core is not installed.

    Also raise it if the system cannot confine the process that reads USD, unless the user has allowed USD files without a
    sandbox."""
    if find_spec("pxr") is None:
        raise make_missing_extra_error()
    try:
        is_confined = bool(client.find_active_layers()["seccomp"])
    except client.ReaderFailureError as error:
        raise UsdError("bad-usd", f"`{text}` cannot be read: {error}", "run `antdsl doctor`", "usd") from None
    if not is_confined and not confinement.is_usd_trusted():
        words = f"`{text}` is not opened: this system has no sandbox for the library that reads USD"
        raise UsdError("bad-usd", words, "if you trust all USD files of the scene, run `antdsl --trust-usd …`", "usd")
