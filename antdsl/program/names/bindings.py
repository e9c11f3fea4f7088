"""The declaration to which each name of a program refers, mainly for editors.

Each declaration has a key: its kind, then the names of its owners, then its own name, such as ("own", "forager", "load"). Files
that are checked together have the same keys.
The kinds are `thing attribute field species measure own machine state let event behaviour inner alias`. An `own` is a param,
attribute, let, latch or fuzzy value of a species. An `inner` is an argument or line of a behaviour.

Built-in names of items, hits and agents have keys such as ("item-given", "radius"), ("hit-given", …) and ("given", …). Other
words of the language have no binding: a name without a binding has its built-in meaning."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from antdsl.source import Span

NameKey = tuple[str, ...]


class NameUse(NamedTuple):
    """One use of a name, and the declaration to which it refers.

    `declaration`: a key. If a name is visible only in a part of the text, like `n` in `sum(n in …)`, it is the span of the
    declaration. In `take 1 load from meal`, the name `load` has two uses."""

    span: Span
    declaration: NameKey | Span


@dataclass(frozen=True, slots=True)
class NameBindings:
    """All uses of names that the checker resolved, in the order of checking. A use may occur twice."""

    uses: tuple[NameUse, ...] = ()
