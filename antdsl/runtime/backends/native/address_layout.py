"""The layout of the tables of addresses and numbers that machine code reads. Code contains indices into these tables, but no
addresses or numbers. So all worlds and all param values of a program use the same code."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field

from antdsl.machine_code.number_kinds import BOOL, F32, I32, I64
from antdsl.plan import ir

LANE_TYPE_BY_KIND = {ir.ValueKind.F32: F32, ir.ValueKind.BOOL: BOOL, ir.ValueKind.I32: I32, ir.ValueKind.I64: I64}
AddressKey = tuple[Hashable, ...]


@dataclass(slots=True, eq=False)
class AddressLayout:
    """The inputs of a block's machine code: keys, numbered in a table of addresses and a table of numbers.

    `pointer_indices`: for each key, its index in the table of addresses. Entry 0 is the address of the table of numbers.
    `number_indices`: for each key, its index in the table of numbers, eight bytes each. `array_kind_by_slot`: by (slot, part),
    the kind of each value that is stored for later stages or for calls."""

    pointer_indices: dict[AddressKey, int] = field(default_factory=lambda: {("numbers",): 0})
    number_indices: dict[AddressKey, int] = field(default_factory=dict)
    array_kind_by_slot: dict[tuple[int, int], str] = field(default_factory=dict)

    def find_pointer_index(self, *key: Hashable) -> int:
        """Return the index in the table of addresses for a key. Add the key if it is new."""
        return self.pointer_indices.setdefault(key, len(self.pointer_indices))

    def find_number_index(self, *key: Hashable) -> int:
        """Return the index in the table of numbers for a key. Add the key if it is new."""
        return self.number_indices.setdefault(key, len(self.number_indices))

    def find_array_index(self, slot: int, part: int, kind: str) -> int:
        """Return the index in the table of addresses for the stored part `part` of a slot's value. `kind`: the kind of this
        part."""
        self.array_kind_by_slot[slot, part] = kind
        return self.find_pointer_index("array", slot, part)
