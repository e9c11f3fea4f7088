"""The contents of one line of a scene's crowd: species, count, starting positions, and an optional walk."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from typing import Annotated, Any

from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from antdsl import limits
from antdsl.program.tables.vocabulary import LENGTH_DIMENSION
from antdsl.scene.crowds.casting_model import (
    ClumpFormation,
    FacingValue,
    InitialValues,
    RankFormation,
    ReleaseRate,
    TimeRangeValue,
    convert_rate,
)
from antdsl.scene.library_bodies import BODY_WORDS
from antdsl.scene.notes.selectors import Region
from antdsl.scene.quantities import Quantity
from antdsl.scene.values import (
    FilePath,
    FrameRangeValue,
    PointOrName,
    PositiveLength,
    PositiveSpeed,
    SceneName,
    ScenePart,
    SceneWord,
    make_value_error,
    parse_integer_between,
    parse_number_between,
    parse_one_of,
    parse_positive_quantity,
    parse_word_or_file,
    parse_word_or_quantity,
)

NO_LAYER_WORD = "none"  # stands for no layer of a part
# Of the library of bodies.
BodyText = Annotated[str, BeforeValidator(parse_word_or_file(*BODY_WORDS))]
BodyWeight = Annotated[float, BeforeValidator(parse_number_between(limits.MIN_BODY_WEIGHT, limits.MAX_BODY_WEIGHT))]
SpacingValue = Annotated[
    Quantity | str, BeforeValidator(parse_word_or_quantity("even", parse_positive_quantity(LENGTH_DIMENSION)))
]
DirectionComponent = Annotated[float, BeforeValidator(parse_number_between(-1e6, 1e6))]
PlacementMethod = Annotated[str, BeforeValidator(parse_one_of("above", "area"))]


class UsdPositions(ScenePart):
    """Positions from a USD file: the points or empties below a prim, or all empties of one kind.

    By default, the kind is the name of the species."""

    usd: FilePath
    prim: SceneWord | None = None
    kind: SceneWord | None = None


def _find_points_type_tag(value: Any) -> str:
    return "usd-places" if isinstance(value, dict) else "points-file"


class Placement(ScenePart):
    """Where the agents of a crowd start. By default, they are spread over all surfaces at random.

    `on`: the surface on which they start.
    `radius`, `around`: only within this distance of a point or an item (default: the scene's origin).
    `density`: a painted map; where its value is greater, agents start closer together.
    `points`: positions from a file, one for each agent.
    `inside`: a point or an item in a hollow. Agents start where random rays from there hit a surface first.
    `by`: `above` drops agents onto surfaces from above. `area` spreads them over all sides, including undersides.
    `apart`: the smallest distance between agents, or `even` for the largest distance for which all agents have space.
    `seed`: another seed than that of the scene.
    `along`: a curve on which agents start. `edge`: a surface with open borders on which they start.
    `radius`: with these two, the largest distance from the line.
    `in`: a box or a ball. Agents start at the surface points that are nearest to it.
    `ranks`: agents start in ranks around `around`. `clumps`: agents start in groups.
    `facing`: the direction in which agents look: `out`, `in`, `along`, towards a point or an item, or a direction."""

    on: SceneName | None = None
    inside: PointOrName | None = None
    around: PointOrName | None = None
    radius: PositiveLength | None = None
    points: (
        Annotated[
            Annotated[FilePath, Tag("points-file")] | Annotated[UsdPositions, Tag("usd-places")],
            Discriminator(_find_points_type_tag),
        ]
        | None
    ) = None
    density: SceneName | None = None
    by: PlacementMethod = "above"
    apart: SpacingValue | None = None
    seed: Annotated[int, BeforeValidator(parse_integer_between(0, 2**64 - 1))] | None = None
    along: SceneName | None = None
    edge: SceneName | None = None
    volume: Region | None = Field(default=None, alias="in")
    ranks: RankFormation | None = None
    clumps: ClumpFormation | None = None
    facing: FacingValue | None = None


class ScriptedWalk(ScenePart):
    """A straight walk that replaces the decisions of the agents: a direction along the scene's axes, a speed, and a length.

    At the end of the walk, the agents stand still."""

    direction: tuple[DirectionComponent, DirectionComponent, DirectionComponent]
    speed: PositiveSpeed
    length: PositiveLength


class LayerChoice(ScenePart):
    """A random choice of one layer, or of `none`, for each agent. A layer that you list twice is twice as likely."""

    any: Annotated[tuple[SceneName, ...], Field(min_length=1, max_length=limits.MAX_WORN_LAYERS)]


def _find_layer_type_tag(value: Any) -> str:
    return "any" if isinstance(value, dict) else "layer"


WornLayer = Annotated[
    Annotated[SceneName, Tag("layer")] | Annotated[LayerChoice, Tag("any")], Discriminator(_find_layer_type_tag)
]


def _find_body_type_tag(value: Any) -> str:
    return "body-weights" if isinstance(value, dict) else "one-body"


BodyValue = Annotated[
    Annotated[BodyText, Tag("one-body")]
    | Annotated[dict[BodyText, BodyWeight], Field(min_length=1, max_length=limits.MAX_SPECIES_BODIES), Tag("body-weights")],
    Discriminator(_find_body_type_tag),
]


class CrowdLine(ScenePart):
    """A group of agents of one species.

    `count`: the number of agents.
    `rate`: the number of agents that appear per second, in these `frames`, or in these `seconds` after the first frame.
    `each`: the values of attributes at birth, and the first `state`.
    `name`: a name for these agents, by which notes, selectors and edits can refer to them.
    `body`: what pictures show: the name of a body, or the file of a body. By default, it depends on the name of the species.
    If you list several bodies with weights, each agent gets a random one of them.
    `wear`: the layers of the body that the agents show in addition to the usual ones."""

    name: SceneName | None = None
    species: SceneName
    source: FilePath = Field(alias="from")
    count: Annotated[int, BeforeValidator(parse_integer_between(0, limits.MAX_AGENTS))] | None = None
    rate: ReleaseRate | None = None
    frames: FrameRangeValue | None = None
    seconds: TimeRangeValue | None = None
    each: InitialValues = Field(default_factory=dict)
    place: Placement = Placement()
    walk: ScriptedWalk | None = None
    body: BodyValue | None = None
    wear: Annotated[tuple[WornLayer, ...], Field(max_length=limits.MAX_WORN_LAYERS)] = ()

    @model_validator(mode="after")
    def _check_agent_count(self) -> CrowdLine:
        if self.count is None and self.rate is None:
            raise make_value_error("this line has no `count`", "add `count: 100`", code="missing-key")
        if self.count is not None and self.rate is not None:
            raise make_value_error("`count` and `rate` both say how many agents there are", "leave one of them out")
        if self.frames is not None and self.seconds is not None:
            raise make_value_error("`frames` and `seconds` both say when agents are created", "leave one of them out")
        if self.rate is not None and self.frames is None and self.seconds is None:
            raise make_value_error("`rate` has no effect without frames", "add `frames: 49..96` or `seconds: 2 s .. 4 s`")
        return self

    def find_release(self, first: int, fps: Fraction) -> tuple[Fraction, Fraction, int]:
        """Return the frame in which the first agent is created, the interval between two agents in frames, and the number of
        agents.

        `first`: the scene's first frame, which is the default. The interval is 0 if the line has neither `frames` nor `seconds`.
        """
        begin, duration = Fraction(first), Fraction(0)
        if self.frames is not None:
            begin, duration = Fraction(self.frames.first), Fraction(self.frames.last - self.frames.first + 1)
        elif self.seconds is not None:
            begin, duration = first + self.seconds.begin * fps, (self.seconds.end - self.seconds.begin) * fps
        if self.rate is not None:
            interval = fps / convert_rate(self.rate.text, fps)
            return begin, interval, int(duration / interval + Fraction(1, 2))
        count = self.count or 0
        return begin, duration / count if count and duration > 1 else Fraction(0), count

    def count_agents(self, first: int, fps: Fraction) -> int:
        """Return the total number of agents that the line creates. `first`: the scene's first frame."""
        return self.find_release(first, fps)[2]

    @property
    def body_weights(self) -> dict[str, float]:
        """Return the bodies of this line with their weights. A single body has the weight 1. The result is empty for a line
        without `body`."""
        if isinstance(self.body, dict):
            return self.body
        return {} if self.body is None else {self.body: 1.0}

    def list_worn_layers(self) -> tuple[tuple[str, ...], ...]:
        """Return, for each part of `wear`, the layers from which one is drawn at random for each agent. "" means no layer."""
        chosen = (each.any if isinstance(each, LayerChoice) else (each,) for each in self.wear)
        return tuple(tuple("" if name == NO_LAYER_WORD else name for name in names) for names in chosen)


def collect_body_weights(crowd: Iterable[CrowdLine]) -> dict[str, dict[str, float]]:
    """Return, by species, the bodies with their weights. If several crowd lines of a species name bodies, those of the first
    such line are used."""
    weights: dict[str, dict[str, float]] = {}
    for line in crowd:
        if line.body is not None:
            weights.setdefault(line.species, line.body_weights)
    return weights
