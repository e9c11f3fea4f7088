"""All machine code that the package itself has: its kernels (`@kernel`) and its texts (`@library_text`).

`build_objects` compiles it in advance, on installation. Each kernel and text adds itself when its module is imported, and `load`
imports the modules that have one: there is no list to maintain."""

from __future__ import annotations

import re
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any, Final, Protocol
from weakref import WeakSet

import antdsl
from antdsl.bounded import read_bounded
from antdsl.limits import MIB
from antdsl.machine_code import codes, machine

_DECORATOR_PATTERN: Final = re.compile(rb"^@(kernel|library_text)\b", re.MULTILINE)


class LibraryEntry(Protocol):
    """A kernel or a text. `text_key` stands for its text in keys. Both may depend on the target; a text is empty for a processor
    that cannot run it."""

    __module__: str
    __name__: str

    def text_key(self, target: machine.Target) -> str: ...

    def text(self, target: machine.Target) -> str: ...


_library_entries: WeakSet[Any] = WeakSet()


def add(entry: LibraryEntry) -> None:
    """Add a kernel or a text, for as long as it exists."""
    _library_entries.add(entry)


def modules() -> list[str]:
    """The names of all modules of the package that have a kernel or a text, in order."""
    package = Path(antdsl.__file__).parent
    paths = [path for path in package.rglob("*.py") if _DECORATOR_PATTERN.search(read_bounded(path, MIB))]
    return sorted(".".join(path.relative_to(package.parent).with_suffix("").parts) for path in paths)


def load() -> list[LibraryEntry]:
    """All kernels and texts of the package, in the order of their modules and names. Imports their modules."""
    names = modules()
    for name in names:
        import_module(name)
    own = [each for each in list(_library_entries) if each.__module__.startswith(f"{antdsl.__name__}.")]
    entries = {(each.__module__, each.__name__): each for each in own}
    if len(entries) < len(own):
        raise ValueError("two kernels of a module have one name")
    return [entries[place] for place in sorted(entries)]


def read_language(name: str) -> str:
    """Return a file of the package in LLVM's language, with `$NAME$` for what its reader puts there."""
    return (Path(__file__).parent / name).read_text(encoding="utf-8")


class LibraryText:
    """A function that writes a text of the package in LLVM's language for a target."""

    def __init__(self, write: Callable[[machine.Target], str]) -> None:
        self._write = write
        self.__doc__, self.__name__, self.__module__ = write.__doc__, write.__name__, write.__module__

    def __call__(self, target: machine.Target) -> str:
        return self._write(target)

    text = text_key = __call__

    def code(self) -> machine.LoadedCode:
        """Its functions, ready to run on this processor."""
        return codes.code(self(machine.host()))


def library_text(write: Callable[[machine.Target], str]) -> LibraryText:
    """A text of the package, of a function that writes it for a target."""
    entry = LibraryText(write)
    add(entry)
    return entry
