"""Selectors: texts and mappings that select agents, such as `guards.17` or `{of: guards, near: leaf, within: 50 mm}`.

Notes of scenes and edits of caches use them. `selection` applies them to arrays.

A word names a crowd line or a species. A number or a range may follow: `guards.17` is agent number 17 of the line `guards`, and
`ant.3` is the agent with the id 3 of the species `ant`. A list is a union. A mapping is the intersection of its conditions."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, NamedTuple

from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from antdsl import limits
from antdsl.diagnostics.suggestion import find_nearest_name
from antdsl.scene.document import PathKey
from antdsl.scene.flow_mistakes import suggest_selector
from antdsl.scene.notes.note_values import ShareRange
from antdsl.scene.values import (
    PointOrName,
    PointValue,
    PositiveLength,
    SceneName,
    ScenePart,
    SceneWord,
    describe_value,
    make_value_error,
    parse_integer_between,
    parse_share,
    require_text,
)

_NAME_PATTERN = re.compile(r"([A-Za-z][A-Za-z0-9_]*)(?:\.([0-9]{1,18})(?:\s*\.\.\s*([0-9]{1,18}))?)?", re.ASCII)
SELECTOR_FORMS = "write a crowd line or a species, `guards`, some of its agents, `guards.17` or `guards.3..9`, or a list, "
SELECTOR_FORMS += "`[guards.17, ant.3]`"
_TARGET_FORMS = "write a point, `[0, 0, 0]`, or a name, such as `leaf` or `guards.17`"


class AgentName(NamedTuple):
    """A name that stands for agents: a crowd line or a species, or a range of its agents. `first`, `last`: the range, as numbers
    in the line or as ids in the species; None for all agents."""

    name: str
    first: int | None = None
    last: int | None = None

    def __str__(self) -> str:
        """Return the name in the notation of a scene."""
        if self.first is None:
            return self.name
        return f"{self.name}.{self.first}" + ("" if self.last == self.first else f"..{self.last}")


def parse_agent_name(value: Any) -> AgentName:
    """Return the agents that a text such as `guards.17` names. Raises an error, which pydantic reports, for an invalid text."""
    text = require_text(value, "agents")
    match = _NAME_PATTERN.fullmatch(text)
    if match is None:
        help = suggest_selector(text) or SELECTOR_FORMS
        raise make_value_error(f"{describe_value(text)} names no agents", help)
    if match[2] is None:
        return AgentName(match[1])
    first, last = int(match[2]), int(match[3] or match[2])
    if last < first:
        raise make_value_error(f"{describe_value(text)} ends before it begins", f"write `{AgentName(match[1], last, first)}`")
    return AgentName(match[1], first, last)


class Box(ScenePart):
    """A box along the axes of the scene. `from`, `to`: two opposite corners."""

    corner: PointValue = Field(alias="from")
    opposite: PointValue = Field(alias="to")


def _suggest_near(name: str) -> str:
    return f"write `near: {name}, within: 50 mm` instead of `in`"


def _reject_agents(value: Any) -> Any:
    """Return a value unchanged. Raises an error, which pydantic reports, for an agent such as `guards.7`."""
    if isinstance(value, str) and "." in value and _NAME_PATTERN.fullmatch(value):
        raise make_value_error(f"`{value}` is an agent, not an item", _suggest_near(value))
    return value


class Ball(ScenePart):
    """All points within the distance `radius` of a point or an item."""

    around: Annotated[PointOrName, BeforeValidator(_reject_agents)]
    radius: PositiveLength


class View(ScenePart):
    """All points within the picture of a camera, including points that something hides.

    `across`, `up`: limit the view to a part of the picture, in percent of its width from the left and of its height from the
    bottom."""

    in_view: SceneName
    across: ShareRange = (0.0, 1.0)
    up: ShareRange = (0.0, 1.0)


def _find_region_tag(value: Any) -> str:
    return "ball-region" if isinstance(value, dict) and {"around", "radius"} & value.keys() else "box-region"


def require_region(value: Any) -> Any:
    """Return a value unchanged. Raises an error, which pydantic reports, for a text, such as the name of an item."""
    if isinstance(value, str):
        example = value.strip()[:40] or "leaf"
        raise make_value_error(f"{describe_value(value)} is not a region", f"write `{{around: {example}, radius: 50 mm}}`")
    return value


Region = Annotated[
    Annotated[Box, Tag("box-region")] | Annotated[Ball, Tag("ball-region")],
    Discriminator(_find_region_tag),
    BeforeValidator(require_region),
]


def _find_part_tag(value: Any) -> str:
    return "view-region" if isinstance(value, dict) and "in_view" in value else _find_region_tag(value)


SelectorRegion = Annotated[
    Annotated[Box, Tag("box-region")] | Annotated[Ball, Tag("ball-region")] | Annotated[View, Tag("view-region")],
    Discriminator(_find_part_tag),
    BeforeValidator(require_region),
]


def _parse_target_name(value: Any) -> AgentName:
    """Return the thing or the agents that a text such as `leaf` names. Raises an error, which pydantic reports, for an invalid
    text."""
    if not isinstance(value, str) or not _NAME_PATTERN.fullmatch(value.strip()):
        raise make_value_error(f"{describe_value(value)} is not a target", _TARGET_FORMS)
    return parse_agent_name(value)


def _require_single_target(value: Any) -> Any:
    """Return a value unchanged. Raises an error, which pydantic reports, for a list of names."""
    if isinstance(value, list) and any(isinstance(each, str) and each[:1].isalpha() for each in value):
        raise make_value_error("this is more than one target", "write a line for each of them")
    return value


def _find_near_tag(value: Any) -> str:
    return "point" if isinstance(value, list) else "agent-or-item"


NearTarget = Annotated[
    Annotated[PointValue, Tag("point")] | Annotated[AgentName, BeforeValidator(_parse_target_name), Tag("agent-or-item")],
    Discriminator(_find_near_tag),
    BeforeValidator(_require_single_target),
]


def _find_selector_tag(value: Any) -> str:
    return "mapping-selector" if isinstance(value, dict) else "list-selector" if isinstance(value, list) else "name-selector"


def _find_single_tag(value: Any) -> str:
    return "mapping-selector" if isinstance(value, dict) else "name-selector"


_ConditionsSelector = Annotated["AgentConditions", Tag("mapping-selector")]
_NameSelector = Annotated[AgentName, BeforeValidator(parse_agent_name), Tag("name-selector")]
_SingleSelector = Annotated[_ConditionsSelector | _NameSelector, Discriminator(_find_single_tag)]
_ListSelector = Annotated[tuple[_SingleSelector, ...], Field(min_length=1), Tag("list-selector")]
Selector = Annotated[_ConditionsSelector | _ListSelector | _NameSelector, Discriminator(_find_selector_tag)]


class SelectorKeys(ScenePart):
    """Conditions that select fewer agents. You can write them as keys of a selector, a note or an edit.

    `state`: agents that are in this state, such as `rest` or `MACHINE.rest`.
    `near`, `within`: agents within this distance of a point, an item, the nearest of several items, a camera, or other
    agents.
    `most`: the number of agents to select; the ones nearest to `near`, of those that meet all other conditions.
    `farthest`: the number of agents to select; the ones farthest from `near`, of those that meet all other conditions.
    `in`: agents in a box, a ball or a view.
    `share`: each agent with this probability. The draw depends on `seed` (default: the scene's seed), the species and the id.
    `in_view`: agents within the picture of this camera.
    `across`, `up`: agents in this part of the picture, in percent of its width from the left and of its height from the
    bottom.
    `without`: all agents except these."""

    state: SceneWord | None = None
    near: NearTarget | None = None
    within: PositiveLength | None = None
    most: Annotated[int, BeforeValidator(parse_integer_between(1, limits.MAX_AGENTS))] | None = None
    farthest: Annotated[int, BeforeValidator(parse_integer_between(1, limits.MAX_AGENTS))] | None = None
    region: SelectorRegion | None = Field(None, alias="in")
    share: Annotated[float, BeforeValidator(parse_share)] | None = None
    seed: Annotated[int, BeforeValidator(parse_integer_between(0, 2**64 - 1))] | None = None
    in_view: SceneName | None = None
    across: ShareRange | None = None
    up: ShareRange | None = None
    without: Selector | None = None

    @model_validator(mode="after")
    def _check_pairs(self) -> SelectorKeys:
        keys = [name for name in ("within", "most", "farthest") if getattr(self, name) is not None]
        if self.near is None and keys:
            raise make_value_error(f"`{keys[0]}` has no effect without `near`", "add `near: [0, 0, 0]`")
        if self.near is not None and not keys:
            raise make_value_error("`near` has no effect without `within` or `most`", "add `within: 50 mm`, or `most: 3`")
        if self.most is not None and self.farthest is not None:
            raise make_value_error("`most` and `farthest` exclude each other", "leave out one of them")
        if self.seed is not None and self.share is None:
            raise make_value_error("`seed` has no effect without `share`", "add `share: 30 %`")
        parts = [name for name in ("across", "up") if getattr(self, name) is not None]
        if self.in_view is None and parts:
            raise make_value_error(
                f"`{parts[0]}` has no effect without `in_view`", "add `in_view: shot`, the camera of the picture"
            )
        return self

    @property
    def views(self) -> tuple[View, ...]:
        """Return the parts of pictures in which selected agents must be."""
        own = View.model_construct(in_view=self.in_view, across=self.across or (0.0, 1.0), up=self.up or (0.0, 1.0))
        return (*((own,) if self.in_view is not None else ()), *((self.region,) if isinstance(self.region, View) else ()))

    @property
    def has_conditions(self) -> bool:
        """Return whether the keys contain a condition."""
        return any(getattr(self, name) is not None for name in SelectorKeys.model_fields)


class AgentConditions(SelectorKeys):
    """Conditions that must all be met. `of`: the agents to which the conditions apply; all by default."""

    of: Selector | None = None


SelectorKeys.model_rebuild()
AgentConditions.model_rebuild()
AnySelector = AgentName | tuple[Any, ...] | AgentConditions


def combine_selector(selector: AnySelector | None, keys: SelectorKeys) -> AnySelector:
    """Return a selector of the agents that `selector` selects and that also meet the conditions in `keys`."""
    if selector is not None and not keys.has_conditions:
        return selector
    values = {name: getattr(keys, name) for name in SelectorKeys.model_fields}
    return AgentConditions.model_construct(of=selector, **values)


def needs_frame(selector: AnySelector | None) -> bool:
    """Return whether a selector depends on positions or states in a frame, rather than only on ids."""
    if selector is None or isinstance(selector, AgentName):
        return False
    if isinstance(selector, tuple):
        return any(map(needs_frame, selector))
    own = (selector.state, selector.near, selector.region, selector.in_view)
    return any(each is not None for each in own) or needs_frame(selector.of) or needs_frame(selector.without)


@dataclass(frozen=True, slots=True)
class SelectorNames:
    """The names that selectors may use.

    `lines`: the number of agents of each named crowd line. `species`, `items`, `cameras`: names. `states`: names as `STATE` and
    `MACHINE.STATE`. `late_cameras`: by name, cameras that are placed only when pictures are drawn, each with the name of the
    agent that it follows or ""."""

    lines: Mapping[str, int] = field(default_factory=dict)
    species: frozenset[str] = frozenset()
    items: frozenset[str] = frozenset()
    states: frozenset[str] = frozenset()
    cameras: frozenset[str] = frozenset()
    late_cameras: Mapping[str, str] = field(default_factory=dict)


class SelectorProblem(NamedTuple):
    """A name in a selector that does not exist. `path`: the keys that lead to the name in the selector."""

    path: tuple[PathKey, ...]
    message: str
    help: str


_NO_AGENTS = "no crowd line or species is named"


def find_selector_problems(
    selector: AnySelector | SelectorKeys,
    names: SelectorNames,
    *path: PathKey,
    others: frozenset[str] = frozenset(),
    what: str = _NO_AGENTS,
) -> Iterator[SelectorProblem]:
    """Yield the unknown names in a selector or in selector keys. `others`, `what`: as in `find_name_problems`. They only apply
    if the selector is a single name."""
    if isinstance(selector, AgentName):
        yield from find_name_problems(selector, names, path, others, what)
    elif isinstance(selector, tuple):
        for number, each in enumerate(selector):
            yield from find_selector_problems(each, names, *path, number)
    else:
        for key in ("of", "without"):
            inner = getattr(selector, key, None)
            if inner is not None:
                yield from find_selector_problems(inner, names, *path, key)
        if isinstance(selector.near, AgentName):
            what = "no crowd line, species, item or camera is named"
            yield from find_name_problems(selector.near, names, (*path, "near"), names.items | names.cameras, what)
        if isinstance(selector.region, Ball) and isinstance(selector.region.around, str):
            around = selector.region.around
            problems = find_unknown_name(around, names.items, "no item is named", (*path, "in", "around"))
            is_other = around in names.cameras or around in names.species or around in names.lines
            yield from (each._replace(help=_suggest_near(around)) if is_other else each for each in problems)
        if selector.state is not None:
            yield from find_unknown_name(selector.state, names.states, "no species has a state", (*path, "state"))
        if selector.in_view is not None:
            yield from find_camera_problems(selector.in_view, names, (*path, "in_view"))
        if isinstance(selector.region, View):
            yield from find_camera_problems(selector.region.in_view, names, (*path, "in", "in_view"))


def find_name_problems(
    name: AgentName, names: SelectorNames, path: tuple[PathKey, ...], others: frozenset[str] = frozenset(), what: str = _NO_AGENTS
) -> Iterator[SelectorProblem]:
    """Yield a problem if a name is neither a name of agents nor in `others`. `others`: further names that are allowed. `what`:
    the start of the message, before the name."""
    if name.first is None and name.name in others:
        return
    count = names.lines.get(name.name)
    if count is None and name.first is None and name.name in names.late_cameras:
        yield from find_camera_problems(name.name, names, path, is_target=True)
    elif count is None:
        yield from find_unknown_name(name.name, names.species | names.lines.keys() | others, what, path)
    elif name.last is not None and name.last >= count:
        numbers = f"write a number from 0 to {count - 1}" if count > 1 else f"write `{name.name}.0`"
        agents = "1 agent" if count == 1 else f"{count:,} agents"
        help = numbers if count else "this line has no agents"
        yield SelectorProblem(path, f"`{name}` does not exist: `{name.name}` has {agents}", help)


def find_camera_problems(
    name: str, names: SelectorNames, path: tuple[PathKey, ...], *, is_target: bool = False
) -> Iterator[SelectorProblem]:
    """Yield a problem if a camera does not exist, or if it is placed too late. `is_target`: whether an agent is also allowed."""
    if name not in names.late_cameras:
        yield from find_unknown_name(name, names.cameras, "no camera is named", path)
        return
    agent = names.late_cameras[name]
    why = f"follows `{agent}`" if agent else "holds the agents of the drawn frames"
    instead = "name a camera with `at` and `look_at`" + (f", or the agent, `{agent}`" if agent and is_target else "")
    yield SelectorProblem(path, f"the camera `{name}` {why}: its place is known only when pictures are drawn", instead)


def find_unknown_name(name: str, known_names: frozenset[str], words: str, path: tuple[PathKey, ...]) -> Iterator[SelectorProblem]:
    """Yield a problem if a name is not in `known_names`. `words`: the start of the message, before the name."""
    if name not in known_names:
        near = find_nearest_name(name, known_names)
        listed = "known: " + ", ".join(f"`{each}`" for each in sorted(known_names)[:12]) if known_names else "none exists here"
        yield SelectorProblem(path, f"{words} `{name}`", f"did you mean `{near}`?" if near else listed)
