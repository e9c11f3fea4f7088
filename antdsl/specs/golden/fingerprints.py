"""A compact fingerprint of a state: for each attribute a sum and a weighted sum of its bits, and its mean.

Two sums over all agents suffice to find the one agent that differs and its former value. With bits b and ids k, the sums of b and
(k + 1) b change by d and (k + 1) d. These are the checksums of J. Fletcher, IEEE Trans. Comm. 30, 1982, modulo 2^64. If several
agents differ, the sums show that they do, and a digest of a few agents identifies some of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.program.model import Program, TypeKind, ValueType
from antdsl.program.names.scope import type_from_words
from antdsl.program.tables.units import default_unit
from antdsl.program.tables.vocabulary import BUILTIN_ATTRIBUTE_BY_NAME
from antdsl.runtime.world import Population, World
from antdsl.specs.aggregates import exact_total
from antdsl.specs.value_text import format_value

_MAX_NAMED_AGENTS = 8  # agents named of those that differ
MAX_SAMPLED_AGENTS = 64  # agents of a species that a digest tells apart
_MAX_LISTED_VALUES = 8  # values that are reported one by one
_PLAIN_NUMBER_TYPE = ValueType(TypeKind.NUMBER)
_MOTION_VECTORS = ("velocity", "heading", "up", "position")
_MIX_MULTIPLIER = np.uint64(0x9E3779B97F4A7C15)


@dataclass(frozen=True, slots=True, eq=False)
class FingerprintColumn:
    """One attribute of all agents of a species, all items of a name or all cells of a field. Agents are sorted by id.

    `rank`: the order in reports. `opaque`: the values mean nothing to a reader. `names`: of items, by number."""

    who: str
    what: str
    rank: int
    ids: NDArray[np.int64]
    values: NDArray[Any]
    type: ValueType = _PLAIN_NUMBER_TYPE
    unit: str = ""
    opaque: bool = False
    names: tuple[str, ...] = ()

    @property
    def key(self) -> str:
        """Return the unique name of the column, such as `forager.load`."""
        return f"{self.who}.{self.what}" if self.what else self.who

    def bits(self) -> NDArray[np.uint64]:
        """Return the bits of the values, 64 for each value."""
        if self.values.dtype.itemsize == 8:
            return self.values.view(np.uint64)
        if self.values.dtype.itemsize == 4:
            return self.values.view(np.uint32).astype(np.uint64)
        return self.values.astype(np.uint64)

    def sums(self) -> tuple[int, int]:
        """Return the sum and the weighted sum of the bits, modulo 2^64."""
        bits = self.bits()
        return int(bits.sum(dtype=np.uint64)), int(((self.ids + 1).astype(np.uint64) * bits).sum(dtype=np.uint64))

    def one(self, was: tuple[int, int]) -> tuple[int, Any] | None:
        """Return the row and the old value of the only value that changed since the sums were `was`; None if several changed."""
        now = self.sums()
        changed, weighted = ((b - a) % 2**64 for a, b in zip(was, now, strict=True))
        matching_rows = np.flatnonzero((self.ids + 1).astype(np.uint64) * np.uint64(changed) == np.uint64(weighted))
        if not changed or len(matching_rows) != 1:
            return None
        row = int(matching_rows[0])
        previous_bits = (int(self.bits()[row]) - changed) % 2**64
        size = self.values.dtype.itemsize
        if previous_bits >= 2 ** (8 * size):
            return None
        return row, np.frombuffer(previous_bits.to_bytes(size, "little"), self.values.dtype.newbyteorder("<"))[0]

    def format_value(self, world: World, value: Any) -> str:
        """Return a value of the column in the author's spelling."""
        return format_value(world, value, self.type, self.unit)

    def summary(self, world: World) -> str:
        """Return the values if there are few of them; else how many agents are in each state, for how many a truth holds, or the
        mean."""
        if self.opaque or not len(self.values):
            return ""
        if len(self.values) <= _MAX_LISTED_VALUES:
            return ", ".join(self.format_value(world, value) for value in self.values)
        if self.type.kind is TypeKind.STATE:
            numbers, counts = np.unique(self.values, return_counts=True)
            return ", ".join(f"{self.format_value(world, n)} {count}" for n, count in zip(numbers, counts, strict=True))
        if self.values.dtype == np.bool_:
            return f"{np.count_nonzero(self.values)} of {len(self.values)}"
        if self.type.kind is not TypeKind.NUMBER or self.values.dtype.kind != "f":
            return ""
        return f"{self.format_value(world, np.float64(exact_total(self.values) / len(self.values)))} on average"


def columns(world: World, program: Program) -> dict[str, FingerprintColumn]:
    """Return all columns of a state by key."""
    column_list: list[FingerprintColumn] = []
    for name in sorted(world.populations):
        column_list += _agent_columns(world, program, world.populations[name])
    for name, items in sorted(world.items.items()):
        ids = np.arange(len(items))
        column_list += [
            FingerprintColumn(name, key, 2, ids, amounts, names=items.names) for key, amounts in sorted(items.amounts.items())
        ]
    for name, field in sorted(world.fields.items()):
        values = np.asarray(field.values, np.float64)
        column_list.append(FingerprintColumn(name, "", 3, np.arange(len(values)), values))
    for name, parts in sorted(_part_digests(world).items()):
        column_list.append(
            FingerprintColumn(name, "", 3, np.zeros(1, np.int64), np.frombuffer(parts[:8], np.uint64), opaque=True)
        )
    for name, value in sorted(world.params.items()):
        column_list.append(FingerprintColumn(name, "", 0, np.zeros(1, np.int64), np.array([value], np.float32)))
    return {column.key: column for column in column_list}


def _part_digests(world: World) -> dict[str, bytes]:
    from hashlib import sha256

    digests = {name: volume.digest() for name, volume in world.solids.items()}
    for name, flow in world.flows.items():
        state = b"".join(key.encode() + array.tobytes() for key, array in sorted(flow.state().items()))
        if state:
            digests[name] = sha256(state).digest()
    return digests


def _agent_columns(world: World, program: Program, population: Population) -> list[FingerprintColumn]:
    """Return one column for each value that the author names. Memories and footings are combined in one column."""
    rows = population.in_id_order()
    ids, name = population.ids[rows], population.name
    species = program.species[name]
    mine = {a.name: a.type for a in species.attributes}
    agent_columns = [FingerprintColumn(name, "id", 0, ids, ids, opaque=True)]
    rest = np.zeros(len(ids), np.uint64)
    for key, register in sorted(population.plan.registers.items()):
        if register.role == "temp":
            continue
        column = _make_column(name, key, mine, ids, population.now[key][rows])
        if column is None:
            rest = rest * _MIX_MULTIPLIER + FingerprintColumn(name, key, 9, ids, population.now[key][rows]).bits()
        else:
            agent_columns.append(column)
    stored_arrays = [population.born, population.quarantined, *population.position.T]
    stored_arrays += population.footing.columns.values()
    stored_arrays += [flags for _, flags in sorted(population.events.items())]
    for array in stored_arrays:
        for part in array.T if array.ndim == 2 else (array,):
            rest = rest * _MIX_MULTIPLIER + FingerprintColumn(name, "", 9, ids, np.ascontiguousarray(part)[rows]).bits()
    return [*agent_columns, FingerprintColumn(name, "memory", 9, ids, rest, opaque=True)]


def _make_column(
    who: str, key: str, mine: dict[str, ValueType], ids: NDArray[np.int64], values: NDArray[Any]
) -> FingerprintColumn | None:
    machine, _, word = key.rpartition(".")
    if word == "state" and machine:
        what = "state" if machine == "main" else key
        return FingerprintColumn(who, what, 1, ids, values, ValueType(TypeKind.STATE, of=f"{who}.{machine}"))
    base, axis = (machine, f".{word}") if word in ("x", "y", "z") else (key, "")
    if base in mine or base in BUILTIN_ATTRIBUTE_BY_NAME:
        type = mine.get(base) or type_from_words(BUILTIN_ATTRIBUTE_BY_NAME[base].type) or _PLAIN_NUMBER_TYPE
        rank = 4 + _MOTION_VECTORS.index(base) if base in _MOTION_VECTORS else 1
        if type.kind is TypeKind.VECTOR:
            type = ValueType(TypeKind.NUMBER, type.dim)
        return FingerprintColumn(
            who, base + axis, rank, ids, values, type, default_unit(type.dim) if type.kind is TypeKind.NUMBER else ""
        )
    return None


def agents_digest(world: World, population: Population, program: Program) -> str:
    """Return four hexadecimal digits for each of the agents that `sample_places` names."""
    mixed = np.zeros(len(population), np.uint64)
    for column in _agent_columns(world, program, population):
        mixed = (mixed ^ column.bits()) * _MIX_MULTIPLIER
    picked = sample_places(len(population))
    return (mixed >> np.uint64(48)).astype(">u2")[picked].tobytes().hex()


def sample_places(count: int) -> NDArray[np.int64]:
    """Return which of `count` agents a digest distinguishes, by index in the order of ids."""
    return np.unique(np.arange(MAX_SAMPLED_AGENTS) * count // MAX_SAMPLED_AGENTS) if count else np.zeros(0, np.int64)


@dataclass(frozen=True, slots=True)
class StateDifference:
    """`member`: the agent, item or cell, if it is a single known one, or some of the agents that differ; empty if none is known.
    `now` and `was`: values in the author's terms; empty if they are unknown."""

    who: str
    what: str
    member: str
    now: str
    was: str

    def __str__(self) -> str:
        name = f"`{self.who}.{self.what}`" if self.what else f"`{self.who}`"
        name += f" of {self.member}" if self.member else ""
        if self.now and self.was and self.now != self.was:
            return f"{name} is {self.now}, was {self.was}"
        return f"{name} differs"


def find_differences(
    world: World, program: Program, was: Mapping[str, tuple[str, str, str]], agents: Mapping[str, str]
) -> list[StateDifference]:
    """Return all attributes that differ, the most informative first. `was`: sums and words by key; `agents`: digests by
    species."""
    now = columns(world, program)
    differing_agents = {
        name: _name_differing(world, program, name, text) for name, text in agents.items() if name in world.populations
    }
    ranked_differences: list[tuple[int, StateDifference]] = []
    others = {name: len(world.populations[name]) for name in world.populations if _has_other_agents(now, was, name)}
    ranked_differences += [(0, StateDifference(name, "", "", f"{count} agents", "others")) for name, count in others.items()]
    for key, column in now.items():
        if column.who in others:
            continue
        if key not in was:
            ranked_differences.append((0, StateDifference(column.who, column.what, "", "there", "not there")))
            continue
        first, second, words = was[key]
        sums = (int(first, 16), int(second, 16))
        if column.sums() != sums:
            ranked_differences.append((column.rank, _describe_difference(world, column, sums, words, differing_agents)))
    for key in was.keys() - now.keys():
        who, _, what = key.partition(".")
        ranked_differences.append((0, StateDifference(who, what, "", "not there", "there")))
    ranked_differences.sort(key=lambda pair: pair[0])
    return [difference for _, difference in ranked_differences]


def _has_other_agents(now: Mapping[str, FingerprintColumn], was: Mapping[str, tuple[str, str, str]], species: str) -> bool:
    """Return whether the agents differ from the recorded ones; their values cannot be compared then."""
    key = f"{species}.id"
    return key in now and key in was and now[key].sums() != (int(was[key][0], 16), int(was[key][1], 16))


def _describe_difference(
    world: World, column: FingerprintColumn, sums: tuple[int, int], words: str, differing_agents: Mapping[str, str]
) -> StateDifference:
    one = column.one(sums)
    if one is not None and not column.opaque:
        row, previous_value = one
        return StateDifference(
            column.who,
            column.what,
            _member_name(column, row),
            column.format_value(world, column.values[row]),
            column.format_value(world, previous_value),
        )
    member = _member_name(column, one[0]) if one is not None else differing_agents.get(column.who, "")
    return StateDifference(column.who, column.what, member, column.summary(world), words)


def _member_name(column: FingerprintColumn, row: int) -> str:
    if column.names:
        return column.names[row]
    if not column.what and len(column.ids) == 1:
        return ""  # a param
    return f"{column.who} {column.ids[row]}" if column.what else f"cell {column.ids[row]}"


def _name_differing(world: World, program: Program, name: str, text: str) -> str:
    """Return which of the agents in a digest differ; empty if the digest is not about the same agents."""
    population = world.populations[name]
    rows, now = sample_places(len(population)), agents_digest(world, population, program)
    if len(now) != len(text):
        return ""
    ids = population.ids[population.in_id_order()][rows]
    differ = [int(id) for k, id in enumerate(ids) if now[4 * k : 4 * k + 4] != text[4 * k : 4 * k + 4]]
    if not differ:
        return ""
    remainder = f" and {len(differ) - _MAX_NAMED_AGENTS} more" if len(differ) > _MAX_NAMED_AGENTS else ""
    named = f"{name} {', '.join(map(str, differ[:_MAX_NAMED_AGENTS]))}{remainder}"
    return named if len(ids) == len(population) else f"{named} of {len(ids)} looked at"
