"""The bodies by name, each made once, and which one suits a species."""

from collections.abc import Callable
from functools import cache

from antdsl.bodies.ant import ant
from antdsl.bodies.body import Body
from antdsl.bodies.figures import arrow, ball, person

BODIES: dict[str, Callable[[bool], Body]] = {"ant": ant, "person": person, "arrow": arrow, "ball": ball}

_WORDS: tuple[tuple[str, str], ...] = (
    ("person", "person"),
    ("people", "person"),
    ("human", "person"),
    ("pedestrian", "person"),
    ("bird", "arrow"),
    ("boid", "arrow"),
    ("fish", "arrow"),
    ("flock", "arrow"),
    ("sheep", "ball"),
    ("rabbit", "ball"),
    ("hunter", "ball"),
    ("prey", "ball"),
)


@cache
def body(name: str, fine: bool = False) -> Body:
    """The body called `name`, for crowds or (`fine`) for close-ups. Raises KeyError for a name that is not in BODIES."""
    return BODIES[name](fine)


def body_of(species: str) -> str:
    """The name of the body that suits a species called so; an ant where nothing else does."""
    return next((name for word, name in _WORDS if word in species.lower()), "ant")
