"""What differs between a world and the fingerprints of another: attribute by attribute, of whom, from what to what."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from antdsl.program.model import Program
from antdsl.runtime.world import World
from antdsl.specs.golden.fingerprints import Column, columns, digest, sampled

_NAMED = 8  # agents named of those that differ


@dataclass(frozen=True, slots=True)
class Difference:
    """`whom`: the agent, item or cell, where it is one and known which, or some of the agents that differ; empty where none is
    known. `now` and `was` in the author's words; empty where they cannot be told."""

    who: str
    what: str
    whom: str
    now: str
    was: str

    def __str__(self) -> str:
        name = f"`{self.who}.{self.what}`" if self.what else f"`{self.who}`"
        name += f" of {self.whom}" if self.whom else ""
        if self.now and self.was and self.now != self.was:
            return f"{name} is {self.now}, was {self.was}"
        return f"{name} differs"


def differences(
    world: World, program: Program, was: Mapping[str, tuple[str, str, str]], agents: Mapping[str, str]
) -> list[Difference]:
    """All attributes that differ, the most telling first. `was`: sums and words by key, `agents`: digests by species."""
    now = columns(world, program)
    some = {name: _some(world, program, name, text) for name, text in agents.items() if name in world.populations}
    found: list[tuple[int, Difference]] = []
    others = {name: len(world.populations[name]) for name in world.populations if _are_others(now, was, name)}
    found += [(0, Difference(name, "", "", f"{count} agents", "others")) for name, count in others.items()]
    for key, column in now.items():
        if column.who in others:
            continue
        if key not in was:
            found.append((0, Difference(column.who, column.what, "", "there", "not there")))
            continue
        first, second, words = was[key]
        sums = (int(first, 16), int(second, 16))
        if column.sums() != sums:
            found.append((column.rank, _difference(world, column, sums, words, some)))
    for key in was.keys() - now.keys():
        who, _, what = key.partition(".")
        found.append((0, Difference(who, what, "", "not there", "there")))
    found.sort(key=lambda pair: pair[0])
    return [difference for _, difference in found]


def _are_others(now: Mapping[str, Column], was: Mapping[str, tuple[str, str, str]], species: str) -> bool:
    """Whether these are not the agents that there were: what one of them has cannot be held against what another had."""
    key = f"{species}.id"
    return key in now and key in was and now[key].sums() != (int(was[key][0], 16), int(was[key][1], 16))


def _difference(world: World, column: Column, sums: tuple[int, int], words: str, some: Mapping[str, str]) -> Difference:
    one = column.one(sums)
    if one is not None and not column.opaque:
        row, before = one
        return Difference(
            column.who, column.what, _name(column, row), column.shown(world, column.values[row]), column.shown(world, before)
        )
    whom = _name(column, one[0]) if one is not None else some.get(column.who, "")
    return Difference(column.who, column.what, whom, column.summary(world), words)


def _name(column: Column, row: int) -> str:
    if column.names:
        return column.names[row]
    if not column.what and len(column.ids) == 1:
        return ""  # a param
    return f"{column.who} {column.ids[row]}" if column.what else f"cell {column.ids[row]}"


def _some(world: World, program: Program, name: str, text: str) -> str:
    """Which of the agents that a digest tells apart differ; nothing where it is not about the same agents."""
    population = world.populations[name]
    rows, now = sampled(len(population)), digest(world, population, program)
    if len(now) != len(text):
        return ""
    ids = population.ids[population.in_id_order()][rows]
    differ = [int(id) for k, id in enumerate(ids) if now[4 * k : 4 * k + 4] != text[4 * k : 4 * k + 4]]
    if not differ:
        return ""
    more = f" and {len(differ) - _NAMED} more" if len(differ) > _NAMED else ""
    named = f"{name} {', '.join(map(str, differ[:_NAMED]))}{more}"
    return named if len(ids) == len(population) else f"{named} of {len(ids)} looked at"
