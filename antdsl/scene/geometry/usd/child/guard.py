"""Converts USD's own exceptions to refusals, for all functions that answer requests about USD files."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import wraps
from typing import TYPE_CHECKING, Any

import numpy as np

from antdsl.reader.protocol import RefusalError
from antdsl.scene.geometry.mesh_text import MeshError
from antdsl.scene.geometry.usd.errors import format_usd_error, import_pxr_module

if TYPE_CHECKING:
    from antdsl.reader.protocol import ReaderMessage

ReaderAnswer = tuple[dict[str, Any], Mapping[str, Any]]


def wrap_refusals(read: Callable[[ReaderMessage], ReaderAnswer]) -> Callable[[ReaderMessage], ReaderAnswer]:
    """Return a reader that does the same as `read` but raises a RefusalError for every problem of the file.

    The `about` of the RefusalError is `mesh` for unusable meshes, and `exception` for USD's own errors."""

    @wraps(read)
    def answer_request(request: ReaderMessage) -> ReaderAnswer:
        try:
            with np.errstate(all="ignore"):  # values that are not finite are reported by the code that uses them
                return read(request)
        except MeshError as error:
            raise RefusalError("bad-mesh", str(error), error.help, "prim", "mesh") from error
        except import_pxr_module("Tf").ErrorException as error:
            raise RefusalError(
                "bad-usd", format_usd_error(error, str(request.document["folder"])), None, "prim", "exception"
            ) from error
        except UnicodeDecodeError as error:  # USD does not validate names and texts of the file
            raise RefusalError(
                "bad-usd", "it has bytes that are not UTF-8 text", "export it again", "prim", "exception"
            ) from error

    return answer_request
