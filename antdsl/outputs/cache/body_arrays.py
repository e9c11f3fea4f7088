"""Agent definitions in a cache. `static.npz` contains each definition once, as arrays `body.N.PART`, so that pictures need no
other files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.definition import BodyError, Definition
from antdsl.bodies.agents.packed import ARRAY_NAMES, hash_definition, pack_definition, unpack_definition
from antdsl.bodies.files.definition_checks import LocatedDefinition, check_definition
from antdsl.diagnostics import Report
from antdsl.outputs.cache.manifest import BodyEntry, Manifest, WornBodyEntry
from antdsl.scene.crowds.body_choice import make_body_key

Arrays = Mapping[str, NDArray[Any]]


@dataclass(frozen=True, slots=True, eq=False)
class StoredBodies:
    """Agent definitions in the form that a cache stores.

    `entries`: a manifest entry for each definition. `index_by_species`: for each species with bodies from files, or with bodies
    that the scene names, the entries of its bodies. `arrays`: the arrays of all definitions for `static.npz`."""

    entries: tuple[BodyEntry, ...]
    index_by_species: Mapping[str, tuple[WornBodyEntry, ...]]
    arrays: Arrays

    @staticmethod
    def from_definitions(
        definitions: Mapping[str, Definition], weights_by_species: Mapping[str, Mapping[str, float]]
    ) -> StoredBodies:
        """Return the stored form of definitions. `definitions`: by body key.

        `weights_by_species`: for each species, the bodies that the scene names (words or files), with their weights."""
        numbers: dict[int, int] = {}
        entries: list[BodyEntry] = []
        arrays: dict[str, NDArray[Any]] = {}
        texts = {make_body_key(of, k, len(ws)): text for of, ws in weights_by_species.items() for k, text in enumerate(ws)}
        for key, body in sorted(definitions.items()):
            number = numbers.setdefault(id(body), len(numbers))
            if number == len(entries):
                entries.append(BodyEntry(name=texts.get(key, body.name)[-500:], digest=hash_definition(body)))
                arrays |= {f"body.{number}.{part}": array for part, array in pack_definition(body).items()}
        index = {key: numbers[id(body)] for key, body in definitions.items()}
        worn = {
            of: tuple(
                WornBodyEntry(body=text[-500:], definition=index.get(make_body_key(of, k, len(weights))), weight=weight)
                for k, (text, weight) in enumerate(weights.items())
            )
            for of, weights in weights_by_species.items()
        }
        return StoredBodies(tuple(entries), worn, arrays)


def load_definition(manifest: Manifest, static: Arrays, number: int) -> Definition:
    """Return definition `number` of the manifest's list.

    Raises BodyError if it is missing or damaged, or is not the definition that was written."""
    arrays = {part: static[name] for part in ARRAY_NAMES if (name := f"body.{number}.{part}") in static}
    if number >= len(manifest.bodies) or len(arrays) != len(ARRAY_NAMES):
        raise BodyError("is missing")
    definition = unpack_checked_definition(arrays)
    if hash_definition(definition) != manifest.bodies[number].digest:
        raise BodyError("has changed since it was written")
    return definition


def unpack_checked_definition(arrays: Mapping[str, NDArray[Any]]) -> Definition:
    """Return the definition that `bodies.agents.packed` stored in these arrays, after checking all of them.

    Raises BodyError for any other arrays."""
    definition, report = unpack_definition(arrays), Report()
    with np.errstate(all="ignore"):
        if check_definition(LocatedDefinition(definition, needs_length=False), report) is None:
            raise BodyError(f"is damaged: in a body, {report.errors[0].message}")
    return definition
