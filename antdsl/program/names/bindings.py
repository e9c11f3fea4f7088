"""The resolved meaning of each name of a program, mainly for editors.

Each declaration has a key: its kind and the names that lead to it, such as ("own", "forager", "load"). The key is equal in all
files that are checked together.
The kinds are `thing attribute field species measure own machine state let event behaviour inner alias`. An `own` is a param,
attribute, let, latch or fuzzy value of a species. An `inner` is an argument or line of a behaviour.

Items, hits and agents have built-in names with keys such as ("item-given", "radius"), ("hit-given", …) and ("given", …). Other
words of the language have no binding: a name without a binding has its built-in meaning."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from antdsl.source import Span

NameKey = tuple[str, ...]


class NameUse(NamedTuple):
    """One use of a name, and its declaration.

    The declaration is a key. It is a span if the name is visible in part of the text only, such as `n` in `sum(n in …)`. In `take
    1 load from meal`, the name `load` has two uses."""

    span: Span
    declaration: NameKey | Span


@dataclass(frozen=True, slots=True)
class NameBindings:
    """All uses of names that were resolved, in the order of checking. A use may occur twice."""

    uses: tuple[NameUse, ...] = ()
