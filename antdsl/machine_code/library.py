"""Lists all machine code of the package: its kernels (`@kernel`) and its LLVM IR texts (`@make_library_text`).

`build_objects` compiles them in advance, during installation. Each kernel and text registers itself when its module is
imported. `load_entries` imports all modules with kernels or texts, so no list of them has to be maintained."""

from __future__ import annotations

import re
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any, Final, Protocol
from weakref import WeakSet

import antdsl
from antdsl.limits import MIB
from antdsl.machine_code import code_cache, llvm_compiler
from antdsl.safe_read import read_size_limited

_DECORATOR_PATTERN: Final = re.compile(rb"^@(kernel|make_library_text)\b", re.MULTILINE)


class LibraryEntry(Protocol):
    """A kernel or an LLVM IR text of the package.

    `make_text_key` returns the LLVM IR, or a key that identifies it. Both may depend on the target. The LLVM IR is empty for
    processors that cannot run it."""

    __module__: str
    __name__: str

    def make_text_key(self, target: llvm_compiler.Target) -> str: ...

    def text(self, target: llvm_compiler.Target) -> str: ...


_library_entries: WeakSet[Any] = WeakSet()


def register_entry(entry: LibraryEntry) -> None:
    """Register a kernel or an LLVM IR text. It stays registered as long as the object exists."""
    _library_entries.add(entry)


def list_modules() -> list[str]:
    """Return the names of all modules of the package that define a kernel or an LLVM IR text, in sorted order."""
    package = Path(antdsl.__file__).parent
    paths = [path for path in package.rglob("*.py") if _DECORATOR_PATTERN.search(read_size_limited(path, MIB))]
    return sorted(".".join(path.relative_to(package.parent).with_suffix("").parts) for path in paths)


def load_entries() -> list[LibraryEntry]:
    """Import all modules that have kernels or LLVM IR texts. Return these entries, sorted by module and name."""
    names = list_modules()
    for name in names:
        import_module(name)
    own = [each for each in list(_library_entries) if each.__module__.startswith(f"{antdsl.__name__}.")]
    entries = {(each.__module__, each.__name__): each for each in own}
    if len(entries) < len(own):
        raise ValueError("two kernels of a module have the same name")
    return [entries[place] for place in sorted(entries)]


def read_llvm_file(name: str) -> str:
    """Return the content of an LLVM IR file of the package. The caller replaces the placeholders `$NAME$` in it."""
    return (Path(__file__).parent / name).read_text(encoding="utf-8")


class LibraryText:
    """An LLVM IR text of the package, defined by a function that writes it for a target."""

    def __init__(self, write: Callable[[llvm_compiler.Target], str]) -> None:
        self._write_text = write
        self.__doc__, self.__name__, self.__module__ = write.__doc__, write.__name__, write.__module__

    def __call__(self, target: llvm_compiler.Target) -> str:
        return self._write_text(target)

    text = make_text_key = __call__

    def code(self) -> llvm_compiler.LoadedCode:
        """Return the functions of the text, ready to run on this processor."""
        return code_cache.load_code(self(llvm_compiler.find_host_target()))


def make_library_text(write: Callable[[llvm_compiler.Target], str]) -> LibraryText:
    """Register and return the LLVM IR text that the function `write` writes for a target. Used as a decorator."""
    entry = LibraryText(write)
    register_entry(entry)
    return entry
