"""Names of the registers of values per pair: a slot of an id and a value for each other that an agent keeps one about."""

from __future__ import annotations

from collections.abc import Iterable


def slot_names(name: str, count: int) -> list[tuple[str, str]]:
    """The registers of a value per pair, slot by slot: of the other's id (I64, -1 for a free slot), of the value (F32)."""
    return [(f"{name}|{k}.id", f"{name}|{k}") for k in range(count)]


def pair_values(registers: Iterable[str]) -> dict[str, list[tuple[str, str]]]:
    """The values per pair among the registers of a species, by name, each with its slots as `slot_names` gives them."""
    counts: dict[str, int] = {}
    for register in registers:
        name, slot, number = register.partition("|")
        if slot and number.isdecimal():
            counts[name] = counts.get(name, 0) + 1
    return {name: slot_names(name, count) for name, count in counts.items()}
