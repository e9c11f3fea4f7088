"""Which body suits a species by its name, and the room that bodies of the library take."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Capsule:
    """The room that a trunk takes, legs and feelers left out, in body lengths: a capsule `length` long and `width` wide along the
    heading, whose middle is `height` above the feet and `ahead` of them."""

    length: float
    width: float
    height: float
    ahead: float = 0.0


# Of an ant as long and wide as from gaster to head; of who stands, shoulder to shoulder all round; hunters and rabbits keep each
# other as far off as the documents' balls do.
_ANT, _BALL = Capsule(0.92, 0.23, 0.165, -0.04), Capsule(1.0, 1.0, 0.5)
CAPSULES: dict[str, Capsule] = {
    "ant": _ANT,
    "ant_queen": _ANT,
    "ant_soldier": _ANT,
    "roach": _ANT,
    "spider": _ANT,
    "hunter": _BALL,
    "rabbit": _BALL,
    "person": Capsule(0.84, 0.84, 1.1),
    "arrow": Capsule(1.0, 0.6, 0.15),
    "ball": _BALL,
}

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
    ("rabbit", "rabbit"),
    ("prey", "rabbit"),
    ("hunter", "hunter"),
    ("roach", "roach"),
    ("spider", "spider"),
    ("queen", "ant_queen"),
    ("soldier", "ant_soldier"),
)


def body_of(species: str) -> str:
    """The name of the body that suits a species called so; an ant where nothing else does."""
    return next((name for word, name in _WORDS if word in species.lower()), "ant")
