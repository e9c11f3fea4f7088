"""The bodies that come with antdsl: their names and sizes, and the species that each body fits.

They are stored as data: `NAME.json` and `NAME.glb` in `antdsl/bodies/data`, with a row for each body in `bodies.json`."""

from __future__ import annotations

import json
from dataclasses import dataclass

from antdsl import resources


@dataclass(frozen=True, slots=True)
class TrunkCapsule:
    """The capsule around a trunk, without legs and feelers, in body lengths.

    `length`, `width`: the size along and across the heading.
    `height`: the height of its centre above the feet.
    `forward_offset`: how far its centre is ahead of the feet."""

    length: float
    width: float
    height: float
    forward_offset: float = 0.0


_BODY_ROWS = json.loads(resources.body_file("bodies.json").read_text("utf-8"))
CAPSULE_BY_BODY = {name: TrunkCapsule(**row["capsule"]) for name, row in _BODY_ROWS.items()}
# Capsules of bodies with head and abdomen, where these are larger than the trunk of most bodies
COMPLETE_CAPSULE_BY_BODY = {name: TrunkCapsule(**row.get("whole", row["capsule"])) for name, row in _BODY_ROWS.items()}
LOAD_FRONT_BY_BODY: dict[str, float] = {  # body lengths from the feet to the front of a carried load
    name: row["load"] for name, row in _BODY_ROWS.items() if "load" in row
}
BODY_WORDS = tuple(CAPSULE_BY_BODY)  # words that `body:` accepts, in addition to files
_BODY_BY_SPECIES = [(word, name) for name, row in _BODY_ROWS.items() for word in row["species"]]


def find_body_for_species(species: str) -> str:
    """Return the name of the body that fits a species with the name `species`. The default is an ant."""
    return next((name for word, name in _BODY_BY_SPECIES if word in species.lower()), "ant")
