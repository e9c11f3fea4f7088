"""What the checker resolved each name of a program to, for those who ask where a name leads: an editor above all.

A declaration is known by its kind and the names that lead to it, the same in all files that are checked together:
("own", "forager", "load"). The kinds are `thing attribute field species own machine state let event behaviour inner alias`; an
`own` is a param, attribute, let, latch or fuzzy of a species, an `inner` an argument or line of a behaviour. A name that the
language gives to items, hits and agents is ("item-given", "radius"), ("hit-given", …) or ("given", …). Other words of the
language are not listed: where a name has no binding and is such a word, it stands for that."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from antdsl.source import Span

Key = tuple[str, ...]


class Use(NamedTuple):
    """A place where a name is used, and the declaration that it stands for: its key, or its place where only a part of the text
    sees it, as the `n` of `sum(n in …)`. In `take 1 load from meal` one name has two uses."""

    span: Span
    declared: Key | Span


@dataclass(frozen=True, slots=True)
class Bindings:
    """Every use of a name that could be resolved, in the order of checking; one may be listed again."""

    uses: tuple[Use, ...] = ()
