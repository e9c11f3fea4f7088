"""Compact fingerprints of a state. For each attribute, they store a sum and a weighted sum of the values' bits, and a summary
such as the mean.

If only one agent differs, the two sums identify the agent and its former value. With bits b and ids k, the sums of b and (k + 1)
b change by d and (k + 1) d. These are the checksums of J. Fletcher, IEEE Trans. Comm. 30, 1982, modulo 2^64. If several agents
differ, the sums show only that they do. A digest of a few agents then identifies some of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.measures.aggregates import sum_exactly
from antdsl.program.model import Program, TypeKind, ValueType
from antdsl.program.names.scope import parse_type_words
from antdsl.program.tables.units import choose_default_unit
from antdsl.program.tables.vocabulary import BUILTIN_ATTRIBUTE_BY_NAME
from antdsl.runtime.world import Population, World
from antdsl.specs.value_text import format_value

_MAX_NAMED_AGENTS = 8  # maximum number of named agents that differ
MAX_SAMPLED_AGENTS = 64  # agents of a species that a digest distinguishes
_MAX_LISTED_VALUES = 8  # maximum number of values that are reported individually
_PLAIN_NUMBER_TYPE = ValueType(TypeKind.NUMBER)
_MOTION_VECTORS = ("velocity", "heading", "up", "position")
_HASH_MULTIPLIER = np.uint64(0x9E3779B97F4A7C15)


@dataclass(frozen=True, slots=True, eq=False)
class FingerprintColumn:
    """One attribute of all agents of a species, all items of a group, or all cells of a field, with its values.

    Agents are sorted by id. `report_rank`: the position in reports. `is_opaque`: whether the values mean nothing to a reader.
    `item_names`: the names of items by number."""

    owner: str
    attribute: str
    report_rank: int
    ids: NDArray[np.int64]
    values: NDArray[Any]
    type: ValueType = _PLAIN_NUMBER_TYPE
    unit: str = ""
    is_opaque: bool = False
    item_names: tuple[str, ...] = ()

    @property
    def key(self) -> str:
        """Return the unique name of the column, such as `forager.load`."""
        return f"{self.owner}.{self.attribute}" if self.attribute else self.owner

    def convert_to_bits(self) -> NDArray[np.uint64]:
        """Return the bits of each value as one unsigned integer, uint64[n]."""
        if self.values.dtype.itemsize == 8:
            return self.values.view(np.uint64)
        if self.values.dtype.itemsize == 4:
            return self.values.view(np.uint32).astype(np.uint64)
        return self.values.astype(np.uint64)

    def compute_sums(self) -> tuple[int, int]:
        """Return the sum and the weighted sum of the bits, modulo 2^64."""
        bits = self.convert_to_bits()
        return int(bits.sum(dtype=np.uint64)), int(((self.ids + 1).astype(np.uint64) * bits).sum(dtype=np.uint64))

    def find_only_change(self, old_sums: tuple[int, int]) -> tuple[int, Any] | None:
        """Return the row and the recorded value of a single changed value. Return None if more than one value differs.

        `old_sums`: the sum and the weighted sum of the recorded values."""
        new_sums = self.compute_sums()
        changed, weighted = ((b - a) % 2**64 for a, b in zip(old_sums, new_sums, strict=True))
        matching_rows = np.flatnonzero((self.ids + 1).astype(np.uint64) * np.uint64(changed) == np.uint64(weighted))
        if not changed or len(matching_rows) != 1:
            return None
        row = int(matching_rows[0])
        previous_bits = (int(self.convert_to_bits()[row]) - changed) % 2**64
        size = self.values.dtype.itemsize
        if previous_bits >= 2 ** (8 * size):
            return None
        return row, np.frombuffer(previous_bits.to_bytes(size, "little"), self.values.dtype.newbyteorder("<"))[0]

    def format_value(self, world: World, value: Any) -> str:
        """Return a value of the column as text, in the form that authors write."""
        return format_value(world, value, self.type, self.unit)

    def summarise_values(self, world: World) -> str:
        """Return a summary of the values as text. If there are few values, it lists them. Otherwise, it is the number of agents
        in each state, the number for which a condition holds, or the mean."""
        if self.is_opaque or not len(self.values):
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
        return f"{self.format_value(world, np.float64(sum_exactly(self.values) / len(self.values)))} on average"


def build_columns(world: World, program: Program) -> dict[str, FingerprintColumn]:
    """Return all fingerprint columns of a state, by key."""
    column_list: list[FingerprintColumn] = []
    for name in sorted(world.populations):
        column_list += _make_agent_columns(world, program, world.populations[name])
    for name, items in sorted(world.items.items()):
        ids = np.arange(len(items))
        column_list += [
            FingerprintColumn(name, key, 2, ids, amounts, item_names=items.names)
            for key, amounts in sorted(items.amounts.items())
        ]
    for name, field in sorted(world.fields.items()):
        values = np.asarray(field.amounts, np.float64)
        column_list.append(FingerprintColumn(name, "", 3, np.arange(len(values)), values))
    for name, parts in sorted(_compute_part_digests(world).items()):
        column_list.append(
            FingerprintColumn(name, "", 3, np.zeros(1, np.int64), np.frombuffer(parts[:8], np.uint64), is_opaque=True)
        )
    for name, value in sorted(world.params.items()):
        column_list.append(FingerprintColumn(name, "", 0, np.zeros(1, np.int64), np.array([value], np.float32)))
    return {column.key: column for column in column_list}


def _compute_part_digests(world: World) -> dict[str, bytes]:
    from hashlib import sha256

    digests = {name: volume.compute_digest() for name, volume in world.solids.items()}
    for name, flow in world.flows.items():
        state = b"".join(key.encode() + array.tobytes() for key, array in sorted(flow.get_state().items()))
        if state:
            digests[name] = sha256(state).digest()
    return digests


def _make_agent_columns(world: World, program: Program, population: Population) -> list[FingerprintColumn]:
    """Return one column for each value with a name in the program, and one column for all memories and footings together."""
    rows = population.get_rows_by_id()
    ids, name = population.ids[rows], population.name
    species = program.species[name]
    type_by_attribute = {a.name: a.type for a in species.attributes}
    agent_columns = [FingerprintColumn(name, "id", 0, ids, ids, is_opaque=True)]
    rest = np.zeros(len(ids), np.uint64)
    for key, register in sorted(population.plan.registers.items()):
        if register.role == "temp":
            continue
        column = _make_column(name, key, type_by_attribute, ids, population.now[key][rows])
        if column is None:
            rest = rest * _HASH_MULTIPLIER + FingerprintColumn(name, key, 9, ids, population.now[key][rows]).convert_to_bits()
        else:
            agent_columns.append(column)
    stored_arrays = [population.born, population.quarantined, *population.position.T]
    stored_arrays += population.footing.columns.values()
    stored_arrays += [flags for _, flags in sorted(population.events.items())]
    for array in stored_arrays:
        for part in array.T if array.ndim == 2 else (array,):
            rest = (
                rest * _HASH_MULTIPLIER + FingerprintColumn(name, "", 9, ids, np.ascontiguousarray(part)[rows]).convert_to_bits()
            )
    return [*agent_columns, FingerprintColumn(name, "memory", 9, ids, rest, is_opaque=True)]


def _make_column(
    owner: str, key: str, type_by_attribute: dict[str, ValueType], ids: NDArray[np.int64], values: NDArray[Any]
) -> FingerprintColumn | None:
    machine, _, word = key.rpartition(".")
    if word == "state" and machine:
        value_name = "state" if machine == "main" else key
        return FingerprintColumn(owner, value_name, 1, ids, values, ValueType(TypeKind.STATE, referent=f"{owner}.{machine}"))
    base, axis = (machine, f".{word}") if word in ("x", "y", "z") else (key, "")
    if base in type_by_attribute or base in BUILTIN_ATTRIBUTE_BY_NAME:
        type = type_by_attribute.get(base) or parse_type_words(BUILTIN_ATTRIBUTE_BY_NAME[base].type) or _PLAIN_NUMBER_TYPE
        rank = 4 + _MOTION_VECTORS.index(base) if base in _MOTION_VECTORS else 1
        if type.kind is TypeKind.VECTOR:
            type = ValueType(TypeKind.NUMBER, type.dimension)
        return FingerprintColumn(
            owner,
            base + axis,
            rank,
            ids,
            values,
            type,
            choose_default_unit(type.dimension) if type.kind is TypeKind.NUMBER else "",
        )
    return None


def digest_agents(world: World, population: Population, program: Program) -> str:
    """Return a digest of agents as text, with four hexadecimal digits for each of the agents that `choose_sample_indices`
    selects."""
    mixed = np.zeros(len(population), np.uint64)
    for column in _make_agent_columns(world, program, population):
        mixed = (mixed ^ column.convert_to_bits()) * _HASH_MULTIPLIER
    sample = choose_sample_indices(len(population))
    return (mixed >> np.uint64(48)).astype(">u2")[sample].tobytes().hex()


def choose_sample_indices(count: int) -> NDArray[np.int64]:
    """Return the indices of the agents that a digest covers. They are indices into the agents sorted by id. `count`: the number
    of all agents."""
    return np.unique(np.arange(MAX_SAMPLED_AGENTS) * count // MAX_SAMPLED_AGENTS) if count else np.zeros(0, np.int64)


@dataclass(frozen=True, slots=True)
class StateDifference:
    """An attribute of which values differ from those of the golden run.

    `member`: the name of the agent, item or cell that differs. It may also list some of several agents that differ. It is "" if
    unknown. `current_value`, `old_value`: the value in this run and in the golden run, in the form that authors write; "" if
    unknown."""

    owner: str
    attribute: str
    member: str
    current_value: str
    old_value: str

    def __str__(self) -> str:
        name = f"`{self.owner}.{self.attribute}`" if self.attribute else f"`{self.owner}`"
        name += f" of {self.member}" if self.member else ""
        if self.current_value and self.old_value and self.current_value != self.old_value:
            return f"{name} is {self.current_value}, was {self.old_value}"
        return f"{name} differs"


def find_differences(
    world: World, program: Program, recorded_sums: Mapping[str, tuple[str, str, str]], recorded_digests: Mapping[str, str]
) -> list[StateDifference]:
    """Return all attributes that differ from a recording, the most informative first.

    `recorded_sums`: for each column key, the recorded sum, weighted sum and summary. `recorded_digests`: the recorded digests of
    agents, by species."""
    columns = build_columns(world, program)
    differing_agents = {
        name: _find_differing_agents(world, program, name, text)
        for name, text in recorded_digests.items()
        if name in world.populations
    }
    ranked_differences: list[tuple[int, StateDifference]] = []
    others = {name: len(world.populations[name]) for name in world.populations if _has_other_agents(columns, recorded_sums, name)}
    ranked_differences += [(0, StateDifference(name, "", "", f"{count} agents", "others")) for name, count in others.items()]
    for key, column in columns.items():
        if column.owner in others:
            continue
        if key not in recorded_sums:
            ranked_differences.append((0, StateDifference(column.owner, column.attribute, "", "there", "not there")))
            continue
        first, second, words = recorded_sums[key]
        sums = (int(first, 16), int(second, 16))
        if column.compute_sums() != sums:
            ranked_differences.append((column.report_rank, _describe_difference(world, column, sums, words, differing_agents)))
    for key in recorded_sums.keys() - columns.keys():
        owner, _, value_name = key.partition(".")
        ranked_differences.append((0, StateDifference(owner, value_name, "", "not there", "there")))
    ranked_differences.sort(key=lambda pair: pair[0])
    return [difference for _, difference in ranked_differences]


def _has_other_agents(
    current_columns: Mapping[str, FingerprintColumn], recorded_sums: Mapping[str, tuple[str, str, str]], species: str
) -> bool:
    """Return whether the agents of a species are different agents from those in the recording, so that their values cannot be
    compared."""
    key = f"{species}.id"
    return (
        key in current_columns
        and key in recorded_sums
        and current_columns[key].compute_sums() != (int(recorded_sums[key][0], 16), int(recorded_sums[key][1], 16))
    )


def _describe_difference(
    world: World,
    column: FingerprintColumn,
    recorded_sums: tuple[int, int],
    recorded_summary: str,
    differing_agents: Mapping[str, str],
) -> StateDifference:
    one = column.find_only_change(recorded_sums)
    if one is not None and not column.is_opaque:
        row, previous_value = one
        return StateDifference(
            column.owner,
            column.attribute,
            _find_member_name(column, row),
            column.format_value(world, column.values[row]),
            column.format_value(world, previous_value),
        )
    member = _find_member_name(column, one[0]) if one is not None else differing_agents.get(column.owner, "")
    return StateDifference(column.owner, column.attribute, member, column.summarise_values(world), recorded_summary)


def _find_member_name(column: FingerprintColumn, row: int) -> str:
    if column.item_names:
        return column.item_names[row]
    if not column.attribute and len(column.ids) == 1:
        return ""  # a param
    return f"{column.owner} {column.ids[row]}" if column.attribute else f"cell {column.ids[row]}"


def _find_differing_agents(world: World, program: Program, name: str, recorded_digest: str) -> str:
    """Return the names of the agents that differ according to the digest, or "" if the recorded digest is for other agents."""
    population = world.populations[name]
    rows, digest = choose_sample_indices(len(population)), digest_agents(world, population, program)
    if len(digest) != len(recorded_digest):
        return ""
    ids = population.ids[population.get_rows_by_id()][rows]
    differ = [int(id) for k, id in enumerate(ids) if digest[4 * k : 4 * k + 4] != recorded_digest[4 * k : 4 * k + 4]]
    if not differ:
        return ""
    remainder = f" and {len(differ) - _MAX_NAMED_AGENTS} more" if len(differ) > _MAX_NAMED_AGENTS else ""
    names = f"{name} {', '.join(map(str, differ[:_MAX_NAMED_AGENTS]))}{remainder}"
    return names if len(ids) == len(population) else f"{names} of {len(ids)} looked at"
