"""A hash of antdsl's own files. It identifies the code on which results and stored files depend."""

from __future__ import annotations

import os
from functools import cache
from hashlib import blake2b
from pathlib import Path

import antdsl
from antdsl.limits import MIB
from antdsl.resources import behaviours_folder, grammar_folder
from antdsl.safe_read import read_size_limited

_HASHED_SUFFIXES = (".py", ".ll", ".ant", ".json", ".lark")  # what a result may depend on
_SKIPPED_FOLDERS = frozenset(["_data", "page", "web", "__pycache__"])


def has_module_sources() -> bool:
    """Return whether the installation contains the sources of its modules. Otherwise `hash_sources` cannot depend on the code."""
    return antdsl.__file__.endswith(".py")


@cache
def hash_sources() -> str:
    """Return a hash of the names and contents of the package's files, the behaviour library and the grammar. The hash has 24
    hexadecimal digits."""
    hashed = blake2b(digest_size=12)
    for start in (Path(antdsl.__file__).parent, behaviours_folder(), grammar_folder()):
        for folder, inner, files in os.walk(start):
            inner[:] = sorted(name for name in inner if name not in _SKIPPED_FOLDERS)
            for name in sorted(name for name in files if name.endswith(_HASHED_SUFFIXES)):
                path = os.path.join(folder, name)
                for part in (Path(path).relative_to(start).as_posix().encode(), read_size_limited(path, 16 * MIB)):
                    hashed.update(len(part).to_bytes(8, "little"))
                    hashed.update(part)
    return hashed.hexdigest()
