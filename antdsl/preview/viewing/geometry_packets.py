"""Packets of geometry.

Ground and obstacles are sent once as meshes. Moving meshes are sent in each frame. A mesh that was removed is sent once without
faces. Curves are sent as points, and flows as arrows on the ground. Solids are sent in pieces of a few bricks, and a piece is
sent again after agents dig in it."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from antdsl.ground.solid import Volume
from antdsl.outputs.cache.solid_pieces import Piece, join_pieces
from antdsl.outputs.edits.edited_cache import EditedCache
from antdsl.outputs.flow_arrows import make_flow_arrows
from antdsl.preview.binary_packets import pack_arrays
from antdsl.preview.viewing.edited_packets import collect_added_meshes
from antdsl.preview.viewing.view_state import SlotPackets, ViewState
from antdsl.runtime import World
from antdsl.runtime.moving.moving_geometry import compute_vertices
from antdsl.scene.setting import MeshData, SolvedFlowData

_BRICKS_PER_PIECE = 2  # bricks per edge of a piece
_UPDATE_INTERVAL_SECONDS = 0.1  # seconds between two showings while it plays
_SOLVED_FLOW_INTERVAL_SECONDS = 1.0  # seconds after which flows that are solved while it runs are shown again


class MeshPackets:
    """A maker of the packets for the slots `mesh:NAME`: the meshes of the scene, and those that edits add. Unchanged meshes are
    not sent again."""

    def __init__(self) -> None:
        self._world: World | None = None
        self._view: EditedCache | None = None
        self._frame = 0
        self._sent_meshes: dict[str, tuple[MeshData, bytes] | None] = {}  # None: it moves

    def make_packets(self, view_state: ViewState) -> SlotPackets:
        """Yield the packets of meshes that are new, changed, moving or removed."""
        world, moves, view = view_state.world, view_state.world.setting.motion.meshes, view_state.edited.find_view()
        is_fresh = world is not self._world or view is not self._view
        if not is_fresh and (not moves or world.frame == self._frame):
            return
        self._world, self._view, self._frame = world, view, world.frame
        ground = {**world.setting.surfaces, **(collect_added_meshes(view) if view is not None and is_fresh else {})}
        if is_fresh:
            for name in sorted(self._sent_meshes.keys() - ground.keys() - world.setting.obstacles.keys()):
                del self._sent_meshes[name]
                nothing = {"position": np.empty(0, np.float32), "face": np.empty(0, np.uint32)}
                yield f"mesh:{name}", pack_arrays(f"mesh:{name}", nothing, role="", moves=False)
        for role, meshes in (("ground", ground), ("obstacle", world.setting.obstacles)):
            for name, mesh in meshes.items():
                if name in moves:
                    self._sent_meshes[name] = None
                elif not is_fresh or self._is_sent(name, mesh, world):
                    continue
                vertices = compute_vertices(world, name, world.frame) if name in moves else mesh.vertices - world.origin
                slot = f"mesh:{name}"
                yield (
                    slot,
                    pack_arrays(
                        slot,
                        {"position": vertices.astype(np.float32), "face": mesh.faces.astype(np.uint32)},
                        role=role,
                        moves=name in moves,
                    ),
                )

    def _is_sent(self, name: str, mesh: MeshData, world: World) -> bool:
        previous, origin = self._sent_meshes.get(name) or (None, b"")
        same = (
            previous is not None
            and origin == world.origin.tobytes()
            and (
                previous is mesh
                or (np.array_equal(previous.vertices, mesh.vertices) and np.array_equal(previous.faces, mesh.faces))
            )
        )
        self._sent_meshes[name] = mesh, world.origin.tobytes()
        return same


class CurvePackets:
    """A maker of the packets for the slots `curve:NAME`. Moving curves are sent in each frame."""

    def __init__(self) -> None:
        self._world: World | None = None
        self._frame = 0

    def make_packets(self, view_state: ViewState) -> SlotPackets:
        """Yield the packets of curves that are new or that move."""
        world = view_state.world
        moves = world.setting.motion
        if world is self._world and (not moves.curves or world.frame == self._frame):
            return
        fresh, self._world, self._frame = world is not self._world, world, world.frame
        for name, points in world.setting.curves.items():
            if not fresh and name not in moves.curves:
                continue
            if name in moves.curves:
                points = moves.find_positions(moves.curves[name], world.frame)
            closed = len(points) > 2 and bool(np.array_equal(points[0], points[-1]))
            slot = f"curve:{name}"
            yield slot, pack_arrays(slot, {"point": (points - world.origin).astype(np.float32)}, closed=closed)


class FlowPackets:
    """A maker of the packets for the slots `flow:NAME`, for the flows that a page displays."""

    def __init__(self) -> None:
        self._world: World | None = None
        self._sent_flows: set[str] = set()
        self._last_solved_time = 0.0

    def make_packets(self, view_state: ViewState) -> SlotPackets:
        """Yield the packets of displayed flows that are new or have been recomputed."""
        world = view_state.world
        if world is not self._world:
            self._world, self._sent_flows = world, set()
        solved = {name for name in view_state.interest.flows if isinstance(world.setting.flows.get(name), SolvedFlowData)}
        if solved and view_state.time - self._last_solved_time >= _SOLVED_FLOW_INTERVAL_SECONDS:
            self._sent_flows -= solved
            self._last_solved_time = view_state.time
        flow_names = (view_state.interest.flows & world.flows.keys()) - self._sent_flows
        if not flow_names:
            return
        self._sent_flows |= flow_names
        arrow_arrays = make_flow_arrows(world, 1.0)
        for name in sorted(flow_names):
            if f"flow.{name}.P" in arrow_arrays:
                slot = f"flow:{name}"
                yield slot, pack_arrays(slot, {"from": arrow_arrays[f"flow.{name}.P"], "way": arrow_arrays[f"flow.{name}.V"]})


class SolidPackets:
    """A maker of the packets for the slots `solid:NAME:N`, for piece N of a solid. A packet without faces removes the piece."""

    def __init__(self) -> None:
        self._volumes: dict[str, Volume] = {}
        self._bricks_by_piece: dict[str, dict[int, dict[int, Piece]]] = {}  # by solid, piece and brick
        self._displayed_pieces: set[tuple[str, int]] = set()  # pieces that pages have faces of
        self._last_sent_time = -1.0

    def make_packets(self, view_state: ViewState) -> SlotPackets:
        """Yield packets with the pieces of solids in which agents have dug. While the session advances, their rate is limited."""
        if not view_state.interest.shows_solids or (
            view_state.is_advancing and view_state.time - self._last_sent_time < _UPDATE_INTERVAL_SECONDS
        ):
            return
        self._last_sent_time = view_state.time
        for name in self._volumes.keys() - view_state.world.solids.keys():
            for piece in sorted(self._bricks_by_piece.pop(name)):
                yield from self._make_piece_packets(name, piece, [], self._volumes[name])
            del self._volumes[name]
        for name, volume in view_state.world.solids.items():
            yield from self._make_solid_packets(name, volume)

    def _make_solid_packets(self, name: str, volume: Volume) -> SlotPackets:
        bricks_by_piece = self._bricks_by_piece.setdefault(name, {})
        previous_pieces = set(bricks_by_piece)
        is_new_volume = self._volumes.get(name) is not volume  # after a seek or an edit: another one, as it was then
        if is_new_volume:
            self._volumes[name] = volume
            bricks_by_piece.clear()
        touched = set()
        for brick, vertices, faces in volume.iterate_brick_meshes(changed_only=not is_new_volume):
            piece = _find_piece(brick, volume.bricks.shape)
            bricks_by_piece.setdefault(piece, {})[brick] = vertices, faces
            touched.add(piece)
        for piece in sorted(touched):
            yield from self._make_piece_packets(name, piece, bricks_by_piece[piece].values(), volume)
        if is_new_volume:
            for piece in sorted(previous_pieces - set(bricks_by_piece)):
                yield from self._make_piece_packets(name, piece, [], volume)

    def _make_piece_packets(self, name: str, piece: int, bricks: Iterable[Piece], volume: Volume) -> SlotPackets:
        """Return the packet of a piece. A piece that has no faces and is not displayed gets no packet."""
        vertices, faces = join_pieces(list(bricks))
        if not len(faces) and (name, piece) not in self._displayed_pieces:
            return
        (self._displayed_pieces.add if len(faces) else self._displayed_pieces.discard)((name, piece))
        slope = np.asarray(volume.sample_gradients(vertices), np.float64) if len(vertices) else np.empty((0, 3))
        normal = slope / np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-12)
        slot = f"solid:{name}:{piece}"
        arrays = {"position": vertices.astype(np.float32), "normal": normal.astype(np.float32), "face": faces.astype(np.uint32)}
        yield slot, pack_arrays(slot, arrays, solid=name)


def _find_piece(brick: int, shape: tuple[int, int, int]) -> int:
    """Return the number of the piece that contains a brick."""
    at = np.unravel_index(brick, shape)
    a, b, c = (-(-side // _BRICKS_PER_PIECE) for side in shape)
    return int(np.ravel_multi_index([int(k) // _BRICKS_PER_PIECE for k in at], (a, b, c)))
