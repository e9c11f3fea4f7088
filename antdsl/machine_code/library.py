"""All machine code of the package itself: its kernels (`@kernel`) and its texts (`@make_library_text`).

`build_objects` compiles it in advance, on installation. Each kernel and text adds itself when its module is imported.
`load_entries` imports all modules that have one, so there is no list to maintain."""

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
    """A kernel or a text of the package.

    `text_key` returns the text, or a key that identifies it. Both may depend on the target. The text is empty for a processor
    that cannot run it."""

    __module__: str
    __name__: str

    def text_key(self, target: llvm_compiler.Target) -> str: ...

    def text(self, target: llvm_compiler.Target) -> str: ...


_library_entries: WeakSet[Any] = WeakSet()


def register_entry(entry: LibraryEntry) -> None:
    """Register a kernel or a text, for as long as the object exists."""
    _library_entries.add(entry)


def list_modules() -> list[str]:
    """Return the names of all modules of the package that have a kernel or a text, in order."""
    package = Path(antdsl.__file__).parent
    paths = [path for path in package.rglob("*.py") if _DECORATOR_PATTERN.search(read_size_limited(path, MIB))]
    return sorted(".".join(path.relative_to(package.parent).with_suffix("").parts) for path in paths)


def load_entries() -> list[LibraryEntry]:
    """Import all modules that have kernels or texts. Return these kernels and texts, in the order of their modules and names."""
    names = list_modules()
    for name in names:
        import_module(name)
    own = [each for each in list(_library_entries) if each.__module__.startswith(f"{antdsl.__name__}.")]
    entries = {(each.__module__, each.__name__): each for each in own}
    if len(entries) < len(own):
        raise ValueError("two kernels of a module have the same name")
    return [entries[place] for place in sorted(entries)]


def read_llvm_file(name: str) -> str:
    """Return the text of a file of the package in LLVM's language. The caller replaces its placeholders `$NAME$`."""
    return (Path(__file__).parent / name).read_text(encoding="utf-8")


class LibraryText:
    """A text of the package in LLVM's language: the function that writes it for a target."""

    def __init__(self, write: Callable[[llvm_compiler.Target], str]) -> None:
        self._write_text = write
        self.__doc__, self.__name__, self.__module__ = write.__doc__, write.__name__, write.__module__

    def __call__(self, target: llvm_compiler.Target) -> str:
        return self._write_text(target)

    text = text_key = __call__

    def code(self) -> llvm_compiler.LoadedCode:
        """Return the functions of the text, ready to run on this processor."""
        return code_cache.load_code(self(llvm_compiler.find_host_target()))


def make_library_text(write: Callable[[llvm_compiler.Target], str]) -> LibraryText:
    """Return and register the text that a function writes for a target."""
    entry = LibraryText(write)
    register_entry(entry)
    return entry
