"""Errors about USD files. This is the only module that imports usd-core.

usd-core is imported in the reader process to read, and in any process to write."""

from __future__ import annotations

import os
import re
from functools import cache
from typing import Any

from antdsl.diagnostics.model import replace_unprintable
from antdsl.reader.protocol import RefusalError

_OUT_OF_MEMORY_PHRASES = ("failed to map segment", "annot allocate memory")  # messages of library loaders that run out of memory
_SESSION_LAYER_PATTERN = re.compile(r",@anon:0x[0-9a-fA-F]+:[^@]*-session\.\w+@")  # a layer that USD adds to each stage
_MEMORY_ADDRESS_PATTERN = re.compile(r"(?:\banon:0x[0-9a-fA-F]+:?)|(?: ?<0x[0-9a-fA-F]+>)")


class UsdError(RefusalError):
    """An error about one of the scene's keys `prim`, `usd` or `kind`."""

    def __init__(self, code: str, message: str, help: str | None = None, key: str = "prim") -> None:
        super().__init__(code, message, help, key)


def format_usd_error(problem: Exception, folder: str) -> str:
    """Return the message of a USD exception without the location in USD's source code. `folder`: as in `clean_usd_text`."""
    messages = re.findall(r"in file \S+ : '(.*?)'\s*(?:\n|$)", str(problem), re.DOTALL)
    return clean_usd_text(messages[-1] if messages else type(problem).__name__, folder)


def clean_usd_text(text: str, folder: str) -> str:
    """Return a text from USD as one line for a message. The line does not change from one run to the next."""
    line = " ".join(text.replace(folder.rstrip(os.sep) + os.sep, "").split())
    line = _SESSION_LAYER_PATTERN.sub("", line)
    line = _MEMORY_ADDRESS_PATTERN.sub("", line)
    line = re.sub(r"\bpxrInternal\w*::(?:\w+::)*", "", line)  # names in USD's own code
    line = replace_unprintable(line)
    return line if len(line) <= 200 else line[:197] + "…"


@cache
def import_pxr_module(module: str) -> Any:
    """Return a module of usd-core, such as `UsdGeom`. Raises UsdError if it is not installed."""
    from importlib import import_module

    try:
        return import_module(f"pxr.{module}")
    except ImportError as problem:
        if any(words in str(problem) for words in _OUT_OF_MEMORY_PHRASES):
            raise MemoryError(str(problem)) from None
        why = "" if getattr(problem, "name", "") in ("pxr", f"pxr.{module}") else f", which cannot be loaded ({problem})"
        raise make_missing_extra_error(why) from None


def make_missing_extra_error(reason: str = "") -> UsdError:
    """Return the error for a missing usd-core. `reason`: why it cannot be loaded, if it is installed."""
    return UsdError(
        "missing-extra", f"USD files need the package usd-core{reason}", 'install it: pip install "antdsl[usd]"', "usd"
    )
