"""Code that loads four adjacent floats for each of eight lanes."""

from __future__ import annotations

from antdsl.machine_code.lanes import LaneBuilder, Lanes
from antdsl.machine_code.number_kinds import F32, I64, LANE_COUNT

_FLOAT4_TYPE = f"<4 x {F32}>"


def emit_quadruple_loads(e: LaneBuilder, base: Lanes, index: Lanes) -> list[Lanes]:
    """Return four values per lane, loaded from an array that has four adjacent floats for each index. `index`: i32."""
    fours = (emit_quadruple_address(e, base, e.extract_lane(index, lane)) for lane in range(LANE_COUNT))
    return e.transpose_rows([e.op("load", F32, each, x=", align 4", lanes=4) for each in fours])


def emit_quadruple_address(e: LaneBuilder, base: Lanes, index: Lanes) -> Lanes:
    """Return the address of the four adjacent floats with a single index."""
    return e.address(base, e.convert(index, I64), _FLOAT4_TYPE)
