"""The edit `replace`, which gives agents another body, colour or layers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, model_validator

from antdsl import limits
from antdsl.bodies.agents.packed import ARRAY_NAMES, hash_definition
from antdsl.diagnostics.suggestion import find_nearest_name
from antdsl.outputs.cache.body_arrays import unpack_checked_definition
from antdsl.outputs.cache.cache_reader import Arrays, Cache
from antdsl.outputs.cache.frame_agents import make_agent_keys
from antdsl.outputs.cache.manifest import BodyEntry, Manifest, ReplacedBody, WornBodyEntry
from antdsl.outputs.cache_bodies import CacheBodies
from antdsl.outputs.edits.edit_layer import AgentsLine, EditFile, EditLayer, NotEditable
from antdsl.outputs.edits.frame_rows import SPECIES_PER_KEY, FrameRows
from antdsl.program.tables.colours import COLOUR_BY_NAME
from antdsl.scene.crowds.crowd_model import BodyText
from antdsl.scene.library_bodies import BODY_WORDS
from antdsl.scene.notes.selectors import Selector
from antdsl.scene.values import SceneName, make_value_error, parse_number_between, parse_one_of

_Part = Annotated[float, BeforeValidator(parse_number_between(0.0, 1.0))]
_MAX_IDS = 50_000_000  # of a species, that are examined for a body


def _parse_colour(value: Any) -> Any:
    """Return the components of a colour as texts: display values from 0 to 1. A word names a colour of the language."""
    if not isinstance(value, str):
        return value
    return [str(part / 255) for part in COLOUR_BY_NAME[parse_one_of(*COLOUR_BY_NAME)(value)]]


class ReplaceLine(AgentsLine):
    """Gives agents another appearance.

    `body`: a word or the file of an agent definition. `colour`: the agents' colour. `wear`: the layers that they wear."""

    verb = "replace"
    agents: Selector = Field(alias="replace")
    body: BodyText | None = None
    colour: Annotated[tuple[_Part, _Part, _Part], BeforeValidator(_parse_colour)] | None = None
    wear: Annotated[tuple[SceneName, ...], Field(max_length=limits.MAX_WORN_LAYERS)] | None = None

    @model_validator(mode="after")
    def _check_keys(self) -> ReplaceLine:
        if self.body is None and self.colour is None and self.wear is None:
            raise make_value_error("`replace` needs `body`, `colour` or `wear`", "write `colour: red`")
        if self.body is not None and self.frames is not None:
            raise make_value_error("agents have one body in all frames", "leave `frames` out")
        return self

    def list_files(self, manifest: Manifest) -> tuple[EditFile, ...]:
        """Return the file of the body, if the line names one."""
        return () if self.body is None or self.body in BODY_WORDS else (EditFile("body", self.body, "body"),)


@dataclass(frozen=True, eq=False)
class ReplaceLayer(EditLayer):
    """A view of a cache in which some agents have another appearance."""

    line: ReplaceLine
    required_arrays = ("id",)

    @classmethod
    def of(cls, source: Cache, *values: Any) -> Self:
        """Return the view of a cache. `values`: the line of the edit, and its inputs."""
        view = super().of(source, *values)
        manifest = _add_layers(view) if view.line.wear else view.manifest
        return replace(view, manifest=_add_body(view, manifest) if view.line.body else manifest)

    def read_static(self) -> Arrays:
        """Return the arrays that apply to all frames, including the body from the file."""
        arrays, number = self.source.read_static(), len(self.source.manifest.bodies)
        if len(self.manifest.bodies) == number:
            return arrays
        return {**arrays, **{f"body.{number}.{part}": self.inputs.arrays[f"{self.line.body}.{part}"] for part in ARRAY_NAMES}}

    def change_frame(self, number: int, arrays: Arrays) -> Arrays:
        """Return a frame in which the selected agents have another appearance."""
        changed, rows = dict(arrays), np.flatnonzero(self.selection.find(make_agent_keys(arrays)))
        if self.line.colour is not None and "Cd" in arrays:
            changed["Cd"] = arrays["Cd"].copy()
            changed["Cd"][rows] = self.line.colour
        if self.line.wear is not None:
            self._replace_layers(changed, rows)
        if self.line.body is not None:
            self._regroup_feet(changed)
        return changed

    def _replace_layers(self, arrays: dict[str, NDArray[Any]], rows: NDArray[np.intp]) -> None:
        """Replace the layers of the agents in `rows`."""
        table = FrameRows(arrays, self.manifest)
        for species in self.manifest.species:
            own = table.find_body_rows(species.name)
            chosen = np.isin(own, rows)
            name = f"wears.{species.name}"
            if species.wears and chosen.any():
                masks = arrays[name].copy() if name in arrays else np.zeros(len(own), np.uint64)
                masks[chosen] = sum(1 << species.wears.index(layer) for layer in set(self.line.wear or ()))
                arrays[name] = masks

    def _regroup_feet(self, arrays: dict[str, NDArray[Any]]) -> None:
        """Move the feet of agents to the arrays of their new bodies. Agents get no feet if the new body has another number of
        legs."""
        old, new = FrameRows(arrays, self.source.manifest), FrameRows(arrays, self.manifest)
        for number, species in enumerate(self.manifest.species):
            keys = CacheBodies(self.source.manifest, {}).keys(number)
            stored = {key: {f: n for n in arrays if (f := n.removeprefix(f"feet.{key}.")) != n} for key in keys}
            taken = {name: arrays.pop(name) for names in stored.values() for name in names.values()}
            for which, key in enumerate(CacheBodies(self.manifest, {}).keys(number) if taken else ()):
                rows, legs = new.find_body_rows(key), len(self._bodies.definition(number, which).legs)
                for field in next(names for names in stored.values() if names):
                    parts = [(old.find_body_rows(each), taken[names[field]]) for each, names in stored.items() if field in names]
                    width = {array.shape[1] for _, array in parts if field in ("P", "down", "normal")} or {legs}
                    known = np.concatenate([each for each, _ in parts])
                    if width == {legs} and np.isin(rows, known).all() and legs:
                        order = np.argsort(known)
                        values = np.concatenate([array for _, array in parts])[order]
                        arrays[f"feet.{key}.{field}"] = values[np.searchsorted(known[order], rows)]
            _drop_incomplete_feet(arrays, species.name)

    @cached_property
    def _bodies(self) -> CacheBodies:
        return CacheBodies(self.manifest, self.read_static())


def _drop_incomplete_feet(arrays: dict[str, NDArray[Any]], species: str) -> None:
    """Remove the feet arrays of bodies for which positions of feet are missing."""
    for name in [each for each in arrays if each.startswith(("feet." + species + ".", "feet." + species + "#"))]:
        if f"{name.rpartition('.')[0]}.P" not in arrays:
            del arrays[name]


def _add_layers(view: ReplaceLayer) -> Manifest:
    """Return the manifest with the layers that the line names. Raises NotEditable if no body of the selected agents has a
    layer."""
    bodies, manifest = CacheBodies(view.manifest, view.source.read_static()), view.manifest
    entries, known = list(manifest.species), set[str]()
    for number, species in enumerate(manifest.species):
        own = {name for which in range(len(bodies.keys(number))) for name in bodies.definition(number, which).layers}
        added = tuple(name for name in view.line.wear or () if name in own and name not in species.wears)
        if not _find_selected_ids(view, number).any():
            continue
        known |= own | set(species.wears)
        entries[number] = species.model_copy(update={"wears": (*species.wears, *added)})
        if len(entries[number].wears) > limits.MAX_WORN_LAYERS:
            raise NotEditable(f"`{species.name}` has more than {limits.MAX_WORN_LAYERS} layers to wear")
    for name in view.line.wear or ():
        if known and name not in known:
            near = find_nearest_name(name, known)
            raise NotEditable(f"no body of these agents has a layer `{name}`" + (f": did you mean `{near}`?" if near else ""))
    return manifest.model_copy(update={"species": tuple(entries)})


def _find_selected_ids(view: ReplaceLayer, number: int) -> NDArray[np.bool_]:
    """Return a mask of the selected ids of species `number`. Raises NotEditable if there are too many ids."""
    count = view.inputs.next_ids[view.manifest.species[number].name]
    if count > _MAX_IDS:
        raise NotEditable(f"`{view.line.verb}` examines at most {_MAX_IDS:,} ids of a species: write it before `duplicate`")
    return view.selection.find(np.arange(count) * SPECIES_PER_KEY + number)


def _add_body(view: ReplaceLayer, manifest: Manifest) -> Manifest:
    """Return the manifest, in which the selected agents have the body that the line names."""
    text, bodies, entries = view.line.body or "", manifest.bodies, list(manifest.species)
    worn = WornBodyEntry(body=text[-500:], weight=0)
    if text not in BODY_WORDS:
        definition = unpack_checked_definition({part: view.inputs.arrays[f"{text}.{part}"] for part in ARRAY_NAMES})
        worn = worn.model_copy(update={"definition": len(bodies)})
        bodies = (*bodies, BodyEntry(name=text[-500:], digest=hash_definition(definition)))
    for number, species in enumerate(manifest.species):
        is_selected = _find_selected_ids(view, number)
        if is_selected.any():
            own = species.bodies or (WornBodyEntry(body=species.body, definition=species.definition),)
            if len(own) == limits.MAX_SPECIES_BODIES:
                raise NotEditable(f"`{species.name}` has more than {limits.MAX_SPECIES_BODIES} bodies")
            level, body = len(species.copies), len(own)
            ranges = tuple(
                ReplacedBody(first=first, count=count, body=body, level=level) for first, count in _find_runs(is_selected)
            )
            change = {"bodies": (*own, worn), "replaced": (*species.replaced, *ranges)}
            entries[number] = species.model_copy(update=change)
    return manifest.model_copy(update={"species": tuple(entries), "bodies": bodies})


def _find_runs(flags: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return (first index, length) of each run of consecutive true values."""
    edges = np.diff(np.concatenate([[0], flags.astype(np.int8), [0]]))
    starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
    return list(zip(starts.tolist(), (ends - starts).tolist(), strict=True))
