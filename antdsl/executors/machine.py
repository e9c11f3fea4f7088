"""What tells one machine, and one installation, from another: the processor's name, and a hash of antdsl's own files."""

from __future__ import annotations

import hashlib
import platform
from functools import cache
from pathlib import Path

import antdsl
from antdsl.bounded import read_bounded
from antdsl.limits import MIB
from antdsl.resources import behaviours_folder, grammar_folder

_PROCESSORS = Path("/proc/cpuinfo")  # Linux
_PATTERNS = ("*.py", "*.ant", "*.json", "*.lark")  # what a result may depend on


@cache
def processor() -> str:
    """The processor's name as the system tells it."""
    try:
        lines = _PROCESSORS.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or "unknown processor"


@cache
def sources() -> str:
    """A hash of the package's modules, its library of behaviours and its grammar, by name: 24 hexadecimal digits."""
    hashed = hashlib.blake2b(digest_size=12)
    for folder in (Path(antdsl.__file__).parent, behaviours_folder(), grammar_folder()):
        for path in sorted(path for pattern in _PATTERNS for path in folder.rglob(pattern)):
            name = path.relative_to(folder)
            if "_data" not in name.parts[:-1] and "page" not in name.parts and "web" not in name.parts:
                for part in (name.as_posix().encode(), read_bounded(path, 16 * MIB)):
                    hashed.update(len(part).to_bytes(8, "little"))
                    hashed.update(part)
    return hashed.hexdigest()
