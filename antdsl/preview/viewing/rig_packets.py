"""Packets of the bodies of species: those of the scene, and those that edits add. Each is sent once."""

from __future__ import annotations

from collections.abc import Mapping

from antdsl.outputs.cache.pose_arrays import list_playing_machines
from antdsl.preview.viewing.body_packets import BodyOutfit, collect_outfits, make_rig_packet
from antdsl.preview.viewing.edited_packets import find_edited_outfits, list_added_species
from antdsl.preview.viewing.view_state import SlotPackets, ViewState


class RigPackets:
    """A maker of the packets for the slots `rig:KEY`, one for each body of a species. A slot is sent again if the body or the
    clips that it plays change."""

    def __init__(self) -> None:
        self._sent_rigs: dict[str, tuple[BodyOutfit, tuple[str, ...]]] = {}

    def make_packets(self, view_state: ViewState) -> SlotPackets:
        """Yield the packets of bodies that are new or have new clips."""
        world, shot, view = view_state.world, view_state.shot, view_state.edited.find_view()
        outfits: Mapping[str, Mapping[str, BodyOutfit]]
        if view is None:
            outfits = {name: collect_outfits(world, shot, population) for name, population in world.populations.items()}
        else:
            outfits = find_edited_outfits(view, world, shot)
        playing = {name: tuple(list_playing_machines(population)) for name, population in world.populations.items()}
        playing |= {entry.name: tuple(entry.playing) for entry in list_added_species(view)}
        for name, bodies in outfits.items():
            for key, worn in bodies.items():
                rig_key = worn, playing[name]
                if self._sent_rigs.get(key) != rig_key:
                    self._sent_rigs[key] = rig_key
                    yield f"rig:{key}", make_rig_packet(key, *rig_key)
