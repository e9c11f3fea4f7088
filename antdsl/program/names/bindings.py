"""The resolved meaning of each name of a program, above all for editors.

A declaration has a key: its kind and the names that lead to it, equal in all files that are checked together, such as ("own",
"forager", "load"). The kinds are `thing attribute field species own machine state let event behaviour inner alias`. An `own` is a
param, attribute, let, latch or fuzzy of a species. An `inner` is an argument or line of a behaviour.

A name that the language gives to items, hits and agents is ("item-given", "radius"), ("hit-given", …) or ("given", …). Other
words of the language are not listed: a name without a binding that is such a word has its built-in meaning."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from antdsl.source import Span

NameKey = tuple[str, ...]


class NameUse(NamedTuple):
    """A place where a name is used, and the declaration that it stands for: its key, or its place where only a part of the text
    sees it, as the `n` of `sum(n in …)`. In `take 1 load from meal` one name has two uses."""

    span: Span
    declared: NameKey | Span


@dataclass(frozen=True, slots=True)
class NameBindings:
    """Every use of a name that could be resolved, in the order of checking; one may be listed again."""

    uses: tuple[NameUse, ...] = ()
