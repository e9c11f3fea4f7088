"""The bodies that agents and items are shown with: each once."""

from __future__ import annotations

import numpy as np

from antdsl.bodies.agents.definition import Definition
from antdsl.bodies.library import library_body
from antdsl.bodies.placed import placed, shape_of
from antdsl.pipeline import Shot
from antdsl.preview.binary_packets import pack
from antdsl.preview.viewing.seen import Packets, Seen
from antdsl.scene.library_bodies import BODY_WORDS, body_of


def body_of_species(shot: Shot, species: str) -> Definition:
    """The body of a species: its own file's, else the one of the library that the scene asks for, or that suits the name."""
    own = shot.bodies.get(species)
    if own is not None:
        return own
    asked = next((line.body for line in shot.scene.model.crowd if line.species == species), None)
    return library_body(asked if asked in BODY_WORDS else body_of(species))


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
