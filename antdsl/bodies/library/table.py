"""The library of bodies by the words that a scene's `body:` takes, and which of them suits a species."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

from antdsl.bodies.agents.definition import Definition
from antdsl.bodies.library.ant import ant, queen, soldier
from antdsl.bodies.library.rigid import arrow, ball, person

BODIES: dict[str, Callable[[], Definition]] = {
    "ant": ant, "ant_queen": queen, "ant_soldier": soldier, "person": person, "arrow": arrow, "ball": ball,
}  # fmt: skip


@cache
def library_body(word: str) -> Definition:
    """The body called `word`, made once. Raises KeyError for a word that is not in BODIES."""
    return BODIES[word]()
