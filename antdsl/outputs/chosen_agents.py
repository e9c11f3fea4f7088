"""Agents that users name on the command line: by ids (`17`, `3..9`), or as in selectors (`guards.17`, `guards`, `ant.3..9`)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from pydantic_core import PydanticCustomError

from antdsl.outputs.cache.manifest import Manifest
from antdsl.outputs.edits.cache_selection import list_selector_names
from antdsl.outputs.edits.frame_rows import SPECIES_PER_KEY
from antdsl.scene.crowds.line_ids import CrowdLineIds
from antdsl.scene.notes.selectors import AgentName, find_selector_problems, parse_agent_name
from antdsl.scene.quantities import QuantityError, parse_integer_range

_MAX_IDS = 1_000_001  # of one range
_MAX_ID = (1 << 62) // SPECIES_PER_KEY


class ChosenAgent(NamedTuple):
    """An agent given by its id. `species`: None for the agents of all species that have this id."""

    species: str | None
    id: int


class UnknownAgent(Exception):
    """Error for a text that names no agents of a cache. The message is a complete explanation. `help`: how to name agents."""

    def __init__(self, message: str, help: str) -> None:
        super().__init__(message)
        self.help = help


def find_agents(text: str, manifest: Manifest) -> list[ChosenAgent]:
    """Return the agents that a list such as `17, guards.3..9` names, in the same order. Raises UnknownAgent."""
    return [agent for word in text.split(",") for agent in _find_agents_of_word(word.strip(), manifest)]


def find_agent(text: str, manifest: Manifest) -> ChosenAgent:
    """Return the single agent that a text such as `17` or `guards.17` names. Raises UnknownAgent."""
    agents = find_agents(text, manifest)
    if len(agents) != 1:
        name, _, ids = text.split(",")[0].strip().partition(".")
        example = f"{name}.{ids.partition('.')[0] or 0}" if name[:1].isalpha() else name
        raise UnknownAgent(f"`{text}` names {len(agents):,} agents", f"write a single agent, such as `{example}`")
    return agents[0]


def find_keys(text: str | None, manifest: Manifest) -> list[int]:
    """Return the keys (`make_agent_keys`) of the agents that a list names, in the same order. Raises UnknownAgent."""
    number_by_species = {entry.name: number for number, entry in enumerate(manifest.species)}
    return [
        agent.id * SPECIES_PER_KEY + number
        for agent in (find_agents(text, manifest) if text is not None else ())
        for number in ((number_by_species[agent.species],) if agent.species else number_by_species.values())
    ]


def _find_agents_of_word(word: str, manifest: Manifest) -> Iterator[ChosenAgent]:
    if not word[:1].isalpha():
        yield from (ChosenAgent(None, number) for number in _parse_ids(word))
        return
    try:
        name = parse_agent_name(word)
    except PydanticCustomError as why:
        raise UnknownAgent(
            str((why.context or {})["words"]), ("write an id, such as `17`, or a name, such as `guards.17`")
        ) from None
    for problem in find_selector_problems(name, list_selector_names(manifest)):
        raise UnknownAgent(problem.message, problem.help)
    line = next((each for each in manifest.lines if each.name == name.name), None)
    if line is not None:
        for agent in CrowdLineIds(line.species, line.ranges).list_ids_between(name.first or 0, name.last).tolist():
            yield ChosenAgent(line.species, agent)
    elif name.first is None:
        raise UnknownAgent(f"`{word}` is a species", f"write the ids of its agents, such as `{word}.0..9`")
    else:
        yield from (ChosenAgent(name.name, number) for number in _require_range(name))


def _parse_ids(word: str) -> range:
    try:
        low, high = parse_integer_range(word)
    except QuantityError:
        low, high = 1, 0
    if not 0 <= low <= high < low + _MAX_IDS or high > _MAX_ID:
        raise UnknownAgent(f"`{word}` names no agents", "write ids, such as `3,8..12`, or names, such as `guards.17`")
    return range(low, high + 1)


def _require_range(name: AgentName) -> range:
    first, last = name.first or 0, name.last or 0
    if last > _MAX_ID:
        raise UnknownAgent(f"`{name}` has an id above {_MAX_ID:,}", "write the id of an agent, such as `guards.17`")
    if last - first >= _MAX_IDS:
        raise UnknownAgent(f"`{name}` has more than a million ids", "name fewer agents")
    return range(first, last + 1)
