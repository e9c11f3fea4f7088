"""Why something of a USD file cannot be used, and the one place that imports usd-core: in the reader's process to read, in any to
write."""

from __future__ import annotations

import os
import re
from functools import cache
from typing import Any

from antdsl.diagnostics.model import printable
from antdsl.reader.protocol import Refusal

_NO_MEMORY = ("failed to map segment", "annot allocate memory")  # what loaders of libraries say without memory
_SESSION = re.compile(r",@anon:0x[0-9a-fA-F]+:[^@]*-session\.\w+@")  # a layer that USD adds to each stage
_ADDRESS = re.compile(r"(?:\banon:0x[0-9a-fA-F]+:?)|(?: ?<0x[0-9a-fA-F]+>)")


class UsdError(Refusal):
    """A refusal that is about a key of the scene: `prim`, `usd` or `kind`."""

    def __init__(self, code: str, message: str, help: str | None = None, key: str = "prim") -> None:
        super().__init__(code, message, help, key)


def words_of(problem: Exception, folder: str) -> str:
    """What USD's own exception says, less where in its sources it says so; `folder` as for `plain_words`."""
    found = re.findall(r"in file \S+ : '(.*?)'\s*(?:\n|$)", str(problem), re.DOTALL)
    return plain_words(found[-1] if found else type(problem).__name__, folder)


def plain_words(text: str, folder: str) -> str:
    """Words of USD on one line of a message, the same in each run: layers have the names of the files, not of their copies in
    `folder`, and no address in memory."""
    line = " ".join(text.replace(folder.rstrip(os.sep) + os.sep, "").split())
    line = _SESSION.sub("", line)
    line = _ADDRESS.sub("", line)
    line = re.sub(r"\bpxrInternal\w*::(?:\w+::)*", "", line)  # names inside of USD's own code
    line = printable(line)
    return line if len(line) <= 200 else line[:197] + "…"


@cache
def pxr(module: str) -> Any:
    """A module of usd-core, such as `UsdGeom`; UsdError when it is not installed."""
    from importlib import import_module

    try:
        return import_module(f"pxr.{module}")
    except ImportError as problem:
        if any(words in str(problem) for words in _NO_MEMORY):
            raise MemoryError(str(problem)) from None
        why = "" if getattr(problem, "name", "") in ("pxr", f"pxr.{module}") else f", which cannot be loaded ({problem})"
        raise missing_extra(why) from None


def missing_extra(why: str = "") -> UsdError:
    """The error where usd-core is not installed; `why` it cannot be loaded where it is."""
    return UsdError("missing-extra", f"USD files need the package usd-core{why}", 'install it: pip install "antdsl[usd]"', "usd")
