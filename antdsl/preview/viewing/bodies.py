"""The bodies that agents and items are shown with: each once."""

from __future__ import annotations

import numpy as np

from antdsl.bodies.catalogue import BODIES, body, body_of
from antdsl.bodies.placed import placed, shape_of
from antdsl.pipeline import Shot
from antdsl.preview.binary_packets import pack
from antdsl.preview.viewing.seen import Packets, Seen


def body_name(shot: Shot, species: str) -> str:
    """The body that the scene asks for, else one that suits the name."""
    asked = next((line.body for line in shot.scene.model.crowd if line.species == species), None)
    return asked if asked in BODIES else body_of(species)


class Bodies:
    """The slots `body:NAME`, for crowds, and `body:NAME:fine`, for close-ups."""

    def __init__(self) -> None:
        self._given: set[str] = set()

    def packets(self, seen: Seen) -> Packets:
        for name in sorted({body_name(seen.shot, species) for species in seen.world.populations} - self._given):
            self._given.add(name)
            for slot, fine in ((f"body:{name}", False), (f"body:{name}:fine", True)):
                made = body(name, fine)
                arrays = {
                    "poses": made.poses.astype(np.float32),
                    "normal": made.normals.astype(np.float32),
                    "face": made.faces.astype(np.uint32),
                    "tint": made.tint.astype(np.float32),
                }
                yield slot, pack(slot, arrays, stride=float(made.stride), poses=len(made.poses))


class ItemBodies:
    """The slots `item:ITEMS:NAME`. Items that are places and no things have no body."""

    def __init__(self) -> None:
        self._given: set[tuple[str, str, int]] = set()

    def packets(self, seen: Seen) -> Packets:
        for kind, items in seen.world.items.items():
            for index, name in enumerate(items.names):
                if (kind, name, index) in self._given:
                    continue
                self._given.add((kind, name, index))
                shape = shape_of(kind, name)
                if shape == "none":
                    continue
                vertices, faces, colour = placed(shape)
                slot = f"item:{kind}:{name}"
                arrays = {
                    "position": vertices.astype(np.float32),
                    "face": faces.astype(np.uint32),
                    "colour": colour.astype(np.float32),
                }
                yield slot, pack(slot, arrays, items=kind, index=index, shape=shape)
