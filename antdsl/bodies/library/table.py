"""The library of bodies by the words that a scene's `body:` takes, and which of them suits a species."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

from antdsl.bodies.agents.definition import Definition
from antdsl.bodies.library.ant import ant, queen, soldier
from antdsl.bodies.library.hunter import hunter
from antdsl.bodies.library.person import person
from antdsl.bodies.library.rabbit import rabbit
from antdsl.bodies.library.rigid import arrow, ball
from antdsl.bodies.library.roach import roach
from antdsl.bodies.library.spider import spider

BODIES: dict[str, Callable[[], Definition]] = {
    "ant": ant,
    "ant_queen": queen,
    "ant_soldier": soldier,
    "person": person,
    "hunter": hunter,
    "rabbit": rabbit,
    "roach": roach,
    "spider": spider,
    "arrow": arrow,
    "ball": ball,
}


@cache
def library_body(word: str) -> Definition:
    """The body called `word`, made once. Raises KeyError for a word that is not in BODIES."""
    return BODIES[word]()
