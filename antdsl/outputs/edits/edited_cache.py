"""Opens caches together with their edits. Each edit is a view of the cache below it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import Any

from numpy.typing import NDArray

from antdsl import limits
from antdsl.bodies.agents.definition import BodyError
from antdsl.diagnostics import Report
from antdsl.outputs.cache.cache_reader import Cache, CacheError, open_cache
from antdsl.outputs.cache.frame_agents import IDENTITY_ARRAYS, get_agent_ids, get_species_numbers
from antdsl.outputs.cache.manifest import MANIFEST_FILE_NAME, EditsEntry, Manifest, ManifestError, shorten_line
from antdsl.outputs.cache.npz import ArrayFileError, read_npz
from antdsl.outputs.edits.edit_files import encode_edit_arrays, find_cache_path, find_missing_file, read_edit_files
from antdsl.outputs.edits.edit_layer import EditInputs, NotEditable, StoredFrames
from antdsl.outputs.edits.edit_lines import EditList, read_edits
from antdsl.outputs.edits.settled_layer import SettledFrames, SettledLayer
from antdsl.outputs.edits.verb_table import VERB_BY_WORD
from antdsl.outputs.edits.verbs.terrain import Ground
from antdsl.scene.paths import PathRefused, read_user_file

INPUT_PREFIX = "edit "  # of the names of edits among the inputs in a manifest
SETTLED_INPUT = "settled"
_STORED_FRAMES = 3  # of the result: exports read a frame and its neighbours several times


@dataclass(frozen=True, eq=False)
class EditedCache(StoredFrames):
    """A cache with edits, which are applied when a frame is read. `original`: the cache without edits."""

    original: Cache


def open_edited_cache(folder: Path) -> Cache:
    """Return the cache in a folder with its edits applied.

    Raises ManifestError with the reason if the folder contains no cache, or if its edits cannot be applied."""
    cache = open_cache(folder)
    entry = cache.manifest.edits
    if entry is None:
        return cache
    edits, report = read_edits(entry.text.encode(), entry.name, cache.manifest)
    try:
        if edits is not None:
            return apply_edits(cache, edits, read_inputs(cache, entry, edits))
        reason = report.errors[0].message
    except (NotEditable, BodyError) as why:
        reason = str(why)
    raise ManifestError(f"the edits in `{folder}` cannot be applied: {reason}")


def read_inputs(cache: Cache, entry: EditsEntry, edits: EditList) -> EditInputs:
    """Return the inputs that the edits of a cache need, other than the cache itself.

    Raises CacheError if a file or the entry is damaged, and ManifestError if another cache is missing."""
    arrays: Mapping[str, NDArray[Any]] = {}
    if entry.arrays is not None:
        try:
            arrays = read_npz(cache.folder / entry.arrays)
        except (OSError, ArrayFileError) as why:
            raise CacheError(f"`{cache.folder / entry.arrays}`, which its edits need, cannot be read: {why}") from None
    is_counted = entry.counted_frames == len(cache.frames())
    missing_species = (each.name for each in cache.manifest.species if is_counted and each.name not in entry.next_ids)
    damage = next((f"their ids of `{name}` are missing" for name in missing_species), None)
    for text, path in entry.caches.items():
        if PurePosixPath(path).is_absolute() or PureWindowsPath(path).anchor:
            damage = f"the path of `{text}` does not begin at the cache"
    if missing := find_missing_file(edits, cache.manifest, arrays, entry.caches):
        damage = f"`{missing}`, which they need, is missing"
    if damage:
        raise CacheError(f"the edits in `{cache.folder / MANIFEST_FILE_NAME}` are damaged: {damage}")
    caches = {text: open_cache(cache.folder / path) for text, path in entry.caches.items()}
    return EditInputs(Ground(cache), arrays, caches, entry.next_ids if is_counted else find_next_ids(cache))


def find_next_ids(cache: Cache) -> dict[str, int]:
    """Return, for each species, the first id that no agent of a cache has. Raises CacheError if a frame is damaged."""
    next_ids = {species.name: 0 for species in cache.manifest.species}
    for line in cache.manifest.lines:
        next_ids[line.species] = max([next_ids.get(line.species, 0), *(first + count for first, count in line.ranges)])
    for frame in cache.frames():
        arrays = cache.frame(frame, IDENTITY_ARRAYS)
        ids, numbers = get_agent_ids(arrays), get_species_numbers(arrays)
        for number, species in enumerate(cache.manifest.species):
            next_ids[species.name] = int(ids[numbers == number].max(initial=next_ids[species.name] - 1)) + 1
    return next_ids


@dataclass(frozen=True, slots=True, eq=False)
class LoadedEdits:
    """The edits of a file for a cache.

    `view`: the cache with the edits. `entry`: the edits as the manifest stores them. `inputs`: the inputs of the edits. Their
    arrays are those of meshes and bodies from files, and of agents that were simulated again."""

    edits: EditList
    view: EditedCache
    entry: EditsEntry
    inputs: EditInputs

    def add_settled(self, settled_frames: SettledFrames) -> LoadedEdits:
        """Return these edits together with agents that were simulated again."""
        inputs = replace(self.inputs, arrays={**self.inputs.arrays, **settled_frames.pack()})
        entry = self.entry.model_copy(update={"arrays": encode_edit_arrays(dict(inputs.arrays))[0]})
        return LoadedEdits(self.edits, apply_edits(self.view.original, self.edits, inputs), entry, inputs)


def load_edits(cache: Cache, path: Path) -> tuple[LoadedEdits | None, Report]:
    """Return the edits that a file contains for a cache, and a report. The edits are None if there are errors.

    Raises NotEditable if the frames of the cache lack an array."""
    try:
        data = read_user_file(path, limits.MAX_EDITS_BYTES)
    except PathRefused as refused:
        report = Report()
        report.error(refused.code, str(refused), None, refused.help)
        return None, report
    edits, report = read_edits(data, str(path), cache.manifest)
    if edits is None:
        return None, report
    arrays, caches, report = read_edit_files(edits, cache.manifest, path.resolve().parent)
    if not report.ok:
        return None, report
    entry = EditsEntry(
        name=path.name,
        text=edits.source.text,
        arrays=encode_edit_arrays(arrays)[0] if arrays else None,
        caches={text: find_cache_path(other, cache.folder) for text, other in caches.items()},
        next_ids=find_next_ids(cache),
        counted_frames=len(cache.frames()),
    )
    inputs = EditInputs(Ground(cache), arrays, caches, entry.next_ids)
    return LoadedEdits(edits, apply_edits(cache, edits, inputs), entry, inputs), report


def smooth_cache(cache: Cache, width: int) -> Cache:
    """Return a view of a cache in which orientations are averaged over `width` frames."""
    edits, report = read_edits(f"edits: [{{smooth: {{}}, orient: {width}}}]".encode(), "--smooth", cache.manifest)
    assert edits is not None, report
    return apply_edits(cache, edits, EditInputs(Ground(cache)))


def apply_edits(cache: Cache, edits: EditList, inputs: EditInputs) -> EditedCache:
    """Return a view of a cache with edits. Each edit reads the view of the previous edit.

    The order is that of the text. Then follow edits that read the result of all others, and then agents that were simulated
    again. Raises CacheError if the arrays of these agents are damaged."""
    listed, settled = _list_inputs(cache.manifest, edits), SettledFrames.unpack(inputs.arrays)
    layers = sorted(edits.edits, key=lambda edit: VERB_BY_WORD[edit.line.verb].is_last)
    top: Cache = cache
    for edit in layers:
        layer = VERB_BY_WORD[edit.line.verb].layer.of(top, edit.line, inputs)
        top, inputs = layer, layer.pass_inputs()
    if settled is not None:
        top, listed = SettledLayer.of(top, settled), {**listed, SETTLED_INPUT: settled.describe_agents()}
    manifest = top.manifest.model_copy(update={"edits": None, "inputs": {**cache.manifest.inputs, **listed}})
    return EditedCache(cache.folder, manifest, top, _STORED_FRAMES, cache)


def _list_inputs(manifest: Manifest, edits: EditList) -> dict[str, str]:
    """Return the entries that edits add to the inputs in a manifest, by name."""
    first = 1 + sum(name.startswith(INPUT_PREFIX) for name in manifest.inputs)
    return {f"{INPUT_PREFIX}{first + k}": shorten_line(edit.text) for k, edit in enumerate(edits.edits)}
