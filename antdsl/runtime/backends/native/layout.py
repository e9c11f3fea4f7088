"""Where a block's machine code finds its arrays and numbers: by a place in a table. So the code contains no address and no value,
and all worlds and numbers of a program share it."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field

from antdsl.machine_code.kinds import BOOL, F32, I32, I64
from antdsl.plan import ir

LANE_TYPE_BY_KIND = {ir.ValueKind.F32: F32, ir.ValueKind.BOOL: BOOL, ir.ValueKind.I32: I32, ir.ValueKind.I64: I64}
AddressKey = tuple[Hashable, ...]


@dataclass(slots=True, eq=False)
class AddressLayout:
    """`pointers`: places in the table of addresses; the first is that of the numbers. `numbers`: places among the numbers, eight
    bytes each. `arrays`: kinds of values stored between stages or for calls, by slot and part."""

    pointers: dict[AddressKey, int] = field(default_factory=lambda: {("numbers",): 0})
    numbers: dict[AddressKey, int] = field(default_factory=dict)
    arrays: dict[tuple[int, int], str] = field(default_factory=dict)

    def pointer(self, *key: Hashable) -> int:
        return self.pointers.setdefault(key, len(self.pointers))

    def number(self, *key: Hashable) -> int:
        return self.numbers.setdefault(key, len(self.numbers))

    def array(self, slot: int, part: int, kind: str) -> int:
        self.arrays[slot, part] = kind
        return self.pointer("array", slot, part)
