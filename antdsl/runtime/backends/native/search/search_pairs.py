"""The inputs of the functions of a search, and the pairs of agents that a search finds."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from antdsl.machine_code.lanes import Lanes
from antdsl.machine_code.number_kinds import I32, I64, LANE_COUNT
from antdsl.plan import ir
from antdsl.runtime.backends.native.address_layout import LANE_TYPE_BY_KIND
from antdsl.runtime.backends.native.block_writer import FunctionWriter
from antdsl.runtime.backends.native.float4 import emit_quadruple_address, emit_quadruple_loads
from antdsl.runtime.world import AXES

POSITION_REGISTERS = tuple(f"position.{axis}" for axis in AXES)
OPERAND_STRIDE_BYTES = 64  # bytes from one operand or result of a search to the next


@dataclass(slots=True, eq=False)
class SearchCodePlan:
    """A search over the neighbours of one species: its reductions `nodes`, and the indices of operands and results.

    `radius_slots`, `view_slots`: by set, the index of the operand with the radius, or the field of view. `operand_slots`: the
    indices of other operands. `overflow_slots`: for each set that reports too many neighbours, the index among the results.
    `extra_registers`: registers of the others in the order of the grid, up to four names per text."""

    name: str
    number: int
    other_species: str
    nodes: list[ir.PlanNode]
    operand_kinds: list[str] = field(default_factory=list)  # kinds of the operands
    radius_slots: dict[ir.PlanNode, int] = field(default_factory=dict)
    view_slots: dict[ir.PlanNode, int] = field(default_factory=dict)
    operand_slots: dict[ir.PlanNode, int] = field(default_factory=dict)
    # sets for which too many neighbours are reported, and their index among the results
    overflow_slots: dict[ir.PlanNode, int] = field(default_factory=dict)
    extra_registers: list[str] = field(
        default_factory=list
    )  # registers of the others in the grid's order; each text names up to four


@dataclass(slots=True, eq=False)
class NeighbourLanes:
    """Eight pairs of a requesting agent and another agent, in lanes.

    `is_present`: the mask of pairs that exist. `rows`: the rows of the others. `dx`, `dy`, `dz`, `distance`: the vector (mm) from
    the requesting agent to the other, and its length. `grid_indices`: the indices of the others in the order of the grid.
    `positions`: x, y, z of the others (mm)."""

    writer: FunctionWriter
    search: SearchCodePlan
    is_present: Lanes
    grid_indices: Lanes
    rows: Lanes
    positions: list[Lanes]
    dx: Lanes
    dy: Lanes
    dz: Lanes
    distance: Lanes

    def emit_ids(self) -> Lanes:
        """Return the ids of the others."""

        def gather_ids() -> Lanes:
            return self.writer.builder.gather(
                self.writer.emit_array_address("other", self.search.other_species, "unsorted ids"),
                self._emit_rows_from_indices(),
                I64,
            )

        found: Lanes = self.writer.builder.get_or_make(("ids", self.rows.name), gather_ids)
        return found

    def emit_value_of_other(self, node: ir.PlanNode) -> Lanes:
        """Return the value of a leaf node that depends on the other agent, for the eight pairs."""
        named = {"pair.x": self.dx, "pair.y": self.dy, "pair.z": self.dz, "pair.distance": self.distance}
        if node.op in named:
            return named[node.op]
        if node.op == "other.id":
            return self.emit_ids()
        if node.attrs[0] in POSITION_REGISTERS:
            return self.positions[POSITION_REGISTERS.index(node.attrs[0])]
        for names in self.search.extra_registers:
            if node.attrs[0] in names.split():
                return self._emit_register_group_load(names)[names.split().index(node.attrs[0])]
        return self.writer.builder.gather(
            self.writer.emit_array_address("other", self.search.other_species, node.attrs[0]),
            self._emit_rows_from_indices(),
            LANE_TYPE_BY_KIND[node.kind],
        )

    def _emit_register_group_load(self, names: str) -> list[Lanes]:
        e, base = self.writer.builder, self.writer.emit_array_address("grid", self.search.number, names)
        registers: list[Lanes] = e.get_or_make((names, self.rows.name), lambda: emit_quadruple_loads(e, base, self.grid_indices))
        return registers

    def _emit_rows_from_indices(self) -> Lanes:
        """Return the rows of the others, loaded one by one.

        Each row is used as a separate address. Extracting these from a SIMD register would be slower."""
        e, positions = self.writer.builder, self.writer.emit_array_address("grid", self.search.number, "places")

        def extract_lanes() -> Lanes:
            fours = (emit_quadruple_address(e, positions, e.extract_lane(self.grid_indices, lane)) for lane in range(LANE_COUNT))
            return e.combine_lanes(e.load(e.emit_offset_address(four, 12), I32) for four in fours)

        row_lanes: Lanes = e.get_or_make(("rows", self.rows.name), extract_lanes)
        return row_lanes


def emit_pair_measurements(
    w: FunctionWriter, search_code: SearchCodePlan, grid_indices: Lanes, place: list[Lanes], is_present: Lanes
) -> NeighbourLanes:
    """Return the pairs of requesting agents at positions `place` and others with indices `grid_indices`."""
    e = w.builder
    *others, rows = emit_quadruple_loads(e, w.emit_array_address("grid", search_code.number, "places"), grid_indices)
    dx, dy, dz = (other - own for other, own in zip(others, place, strict=True))
    return NeighbourLanes(
        w,
        search_code,
        is_present,
        grid_indices,
        e.reinterpret_bits(rows, I32),
        others,
        dx,
        dy,
        dz,
        np.sqrt((dx * dx + dy * dy) + dz * dz),
    )
