"""How finely a flow is worked out: the pieces that its faces are cut into."""

from __future__ import annotations

from antdsl import limits
from antdsl.fields.face_points import Floats, Index, LatticeTooFine, cuts_for, slots_of
from antdsl.scene.setting import BorderFlow, SolvedFlow, SpreadFlow

_PIECES = 8  # of a radius or border, where no cell is given
_ACROSS = 64  # pieces of the ground's extent, where there is no radius either
_ACROSS_CROWD = 48  # the same, where it is worked out again and again
_OWN_POINTS = 200_000  # at most, where the cell is not given
_LEAST = 1e-12  # of the extent


def cell_of(flow: SpreadFlow | BorderFlow | SolvedFlow, extent: float) -> float:
    """The edge (mm) of the cells of a flow: its own `cell`, or what fits a ground of such an extent (mm)."""
    if flow.cell is not None:
        return flow.cell
    if isinstance(flow, BorderFlow):
        return flow.within / _PIECES
    if isinstance(flow, SpreadFlow):
        return extent / _ACROSS if flow.radius is None else flow.radius / _PIECES
    across = extent / (_ACROSS_CROWD if flow.crowding else _ACROSS)
    return min(across, flow.room / 2) if flow.room else across


def flow_cuts(flow: SpreadFlow | BorderFlow | SolvedFlow, longest: Floats, extent: float) -> Index:
    """How many pieces the edges of each face have. `longest` (n): the longest edge (mm) of each, 0 where the flow is not asked
    for. A default cell is made larger where there would be too many points. LatticeTooFine where the scene's is too small."""
    cell = cell_of(flow, extent)
    while True:
        cuts = cuts_for(longest, cell)
        points = slots_of(cuts)
        if flow.cell is not None and points > limits.FLOW_POINTS:
            raise LatticeTooFine(points)
        if flow.cell is not None or points <= max(_OWN_POINTS, 3 * len(longest)):
            return cuts
        cell = max(1.3 * cell, extent * _LEAST)  # a radius next to 0 has cells of 0
