"""The layout of the tables of addresses and numbers that machine code reads. Code contains only indices into these tables, no
addresses or values. So all worlds and param values of a program share the same code."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field

from antdsl.machine_code.number_kinds import BOOL, F32, I32, I64
from antdsl.plan import ir

LANE_TYPE_BY_KIND = {ir.ValueKind.F32: F32, ir.ValueKind.BOOL: BOOL, ir.ValueKind.I32: I32, ir.ValueKind.I64: I64}
AddressKey = tuple[Hashable, ...]


@dataclass(slots=True, eq=False)
class AddressLayout:
    """The inputs of a block's machine code, numbered in a table of addresses and a table of numbers.

    `pointer_indices`: for each key, the index in the table of addresses. Entry 0 is the address of the table of numbers.
    `number_indices`: for each key, the index in the table of numbers, eight bytes each.
    `array_kinds`: the kind of each value that is stored between stages or for calls, by slot and part."""

    pointer_indices: dict[AddressKey, int] = field(default_factory=lambda: {("numbers",): 0})
    number_indices: dict[AddressKey, int] = field(default_factory=dict)
    array_kinds: dict[tuple[int, int], str] = field(default_factory=dict)

    def find_pointer_index(self, *key: Hashable) -> int:
        """Return the table index of the address with this key. A new key gets a new index."""
        return self.pointer_indices.setdefault(key, len(self.pointer_indices))

    def find_number_index(self, *key: Hashable) -> int:
        """Return the table index of the number with this key. A new key gets a new index."""
        return self.number_indices.setdefault(key, len(self.number_indices))

    def find_array_index(self, slot: int, part: int, kind: str) -> int:
        """Return the index of the address at which a part of a slot is stored. `kind`: its kind."""
        self.array_kinds[slot, part] = kind
        return self.find_pointer_index("array", slot, part)
