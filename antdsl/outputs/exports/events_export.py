"""Events of a cache in order of time, for effects and sound.

Births, deaths, state changes and footfalls are found by comparing consecutive frames. Emitted events and contacts are stored in
the frames themselves (`output: {events: …}`)."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.atomic_write import atomic_file, write_atomically
from antdsl.bodies.body import rotate_vectors
from antdsl.numerics.records import select_by_prefix, select_record_rows
from antdsl.outputs.cache.cache_reader import Arrays, CacheError
from antdsl.outputs.cache.frame_agents import find_species_rows, get_agent_ids, get_species_numbers, make_agent_keys
from antdsl.outputs.cache.npz import encode_npz
from antdsl.outputs.csv_text import format_csv
from antdsl.outputs.gallery import Gallery, choose_coordinate_format
from antdsl.program.tables.columns import CONTACT_COLUMNS, Column

EVENT_KINDS = ("birth", "death", "state", "footfall", "emit", "contact")
HEADER_LINE = "frame,seconds,kind,species,id,x,y,z,nx,ny,nz,what,other_species,other,depth"
_DEFAULT_UP = np.array([0.0, 1.0, 0.0])
_COLUMNS = (Column("frame", "derived", "i8"), *CONTACT_COLUMNS[:4], Column("what", "derived", "i4"), *CONTACT_COLUMNS[4:])


@dataclass(frozen=True, slots=True, eq=False)
class EventRows:
    """Events of one kind in one frame, one row per event.

    `species`, `id`: the species number and the id of the agent. `P`, `N` (k, 3): the position in scene units, and the normal.
    `what`: the number of the new state, of the leg, or of the emitted event; -1 for none. `other_species`, `other`, `depth`: for
    contacts, the other agent and the penetration depth."""

    kind: str
    species: NDArray[np.int64]
    id: NDArray[np.int64]
    P: NDArray[np.float64]
    N: NDArray[np.float64]
    what: NDArray[np.int64]
    other_species: NDArray[np.int64]
    other: NDArray[np.int64]
    depth: NDArray[np.float64]


def export_csv_events(gallery: Gallery, frames: Iterable[int], path: Path) -> list[str]:
    """Write the events of these frames as a table with one row per event. Return messages about missing events.

    The column `what` contains words. Raises CacheError for a damaged frame, OSError if writing fails."""
    frames = list(frames)
    names, digits = [entry.name for entry in gallery.manifest.species], choose_coordinate_format(gallery)
    with atomic_file(path) as file:
        file.write(f"{HEADER_LINE}\n".encode())
        for frame, events in _iterate_events(gallery, frames):
            rows: list[list[object]] = []
            for k, word in enumerate(_find_event_words(gallery, events)):
                place = [digits % value for value in events.P[k] + gallery.origin]
                numbers = [*place, *(f"{value:.9g}" for value in events.N[k])]
                other: list[object] = [""] * 3
                if events.other[k] >= 0:
                    other = [names[events.other_species[k]], events.other[k], f"{events.depth[k]:.9g}"]
                seconds = f"{(frame - gallery.manifest.first) * gallery.dt:.9g}"
                rows.append([frame, seconds, events.kind, names[events.species[k]], events.id[k], *numbers, word, *other])
            file.write(format_csv(rows).encode())
    return _note_missing_events(gallery, frames)


def export_npz_events(gallery: Gallery, frames: Iterable[int], path: Path) -> list[str]:
    """Write the events of these frames as arrays. Return messages about missing events.

    Each kind has the arrays `KIND.frame`, `.species`, `.id`, `.P`, `.N` and `.what`. Contacts also have `.other_species`,
    `.other` and `.depth`. `KIND.P` is relative to `origin` float64[3]. Raises CacheError for a damaged frame, OSError if writing
    fails."""
    frames = list(frames)
    events_by_kind: dict[str, list[tuple[int, EventRows]]] = {kind: [] for kind in EVENT_KINDS}
    for frame, each in _iterate_events(gallery, frames):
        events_by_kind[each.kind].append((frame, each))
    arrays: dict[str, NDArray[Any]] = {"origin": gallery.origin}
    for kind, parts in events_by_kind.items():
        for column in _COLUMNS if kind == "contact" else _COLUMNS[:-3]:
            is_frame = column.name == "frame"
            values = [np.full(len(each.id), frame) if is_frame else getattr(each, column.field) for frame, each in parts]
            empty = np.zeros((0, *column.compute_dimensions()), column.type)
            arrays[f"{kind}.{column.field}"] = np.concatenate([empty, *values]).astype(column.type)
    write_atomically(path, encode_npz(arrays))
    return _note_missing_events(gallery, frames)


def _note_missing_events(gallery: Gallery, frames: list[int]) -> list[str]:
    """Return messages about the kinds of events that the cache does not have."""
    arrays = gallery.cache.frame(frames[-1])
    lacks = [kind for kind in ("emit", "contact") if f"events.{kind}.id" not in arrays]
    if not lacks:
        return []
    kinds, names = ", ".join(lacks), " or ".join(f"`{kind}`" for kind in lacks)
    return [f"the cache has no events {names}; add `output: {{events: [{kinds}]}}` to the scene"]


def _iterate_events(gallery: Gallery, frames: list[int]) -> Iterator[tuple[int, EventRows]]:
    """Yield (frame number, events of one kind in this frame), frame by frame and kind by kind.

    Events of the first frame are found by comparing it with the frame before it, if that exists."""
    previous: Arrays | None
    try:
        previous = gallery.cache.frame(frames[0] - 1)
    except CacheError:
        previous = None
    known_pairs: set[tuple[int, ...]] = set() if previous is None else set(_list_contact_pairs(previous))
    for frame in frames:
        arrays = gallery.cache.frame(frame)
        if previous is not None:
            yield from ((frame, each) for each in _compare_frames(gallery, previous, arrays) if len(each.id))
        for each in _read_stored_events(arrays, known_pairs):
            if len(each.id):
                yield frame, each
        previous, known_pairs = arrays, set(_list_contact_pairs(arrays))


def _compare_frames(gallery: Gallery, previous_arrays: Arrays, arrays: Arrays) -> Iterator[EventRows]:
    """Yield the events that a comparison of two consecutive frames shows: births, deaths, state changes and footfalls."""
    was, now = make_agent_keys(previous_arrays), make_agent_keys(arrays)
    _, left, right = np.intersect1d(was, now, assume_unique=True, return_indices=True)
    yield _make_events("birth", arrays, np.flatnonzero(~np.isin(now, was)))
    yield _make_events("death", previous_arrays, np.flatnonzero(~np.isin(was, now)))
    if "state" in arrays and "state" in previous_arrays:
        changed = np.sort(right[previous_arrays["state"][left] != arrays["state"][right]])
        yield _make_events("state", arrays, changed, np.asarray(arrays["state"], np.int64)[changed])
    for number in range(len(gallery.manifest.species)):
        for which, key in enumerate(gallery.bodies.keys(number)):
            yield from _find_footfalls(gallery, (number, which, key), previous_arrays, arrays)


def _find_footfalls(gallery: Gallery, body: tuple[int, int, str], previous_arrays: Arrays, arrays: Arrays) -> Iterator[EventRows]:
    """Yield the events of feet that land between two frames, for the agents with one body.

    `body`: the number of the species, the index of the body within the species, and the key of the body."""
    number, which, key = body
    down = [each.get(f"feet.{key}.down") for each in (previous_arrays, arrays)]
    positions = arrays.get(f"feet.{key}.P")
    if down[0] is None or down[1] is None or positions is None:
        return
    rows = []
    for each in (previous_arrays, arrays):
        own = find_species_rows(each, number)
        rows.append(own[gallery.bodies.numbers(number, get_agent_ids(each)[own]) == which])
    was, now = (make_agent_keys(each)[own] for each, own in zip((previous_arrays, arrays), rows, strict=True))
    _, left, right = np.intersect1d(was, now, assume_unique=True, return_indices=True)
    agent, leg = np.nonzero((down[0][left] == 0) & (down[1][right] != 0))
    row = right[agent]
    yield _make_events("footfall", arrays, rows[1][row], leg, np.asarray(positions, np.float64)[row, leg])


def _make_events(
    kind: str,
    arrays: Arrays,
    rows: NDArray[np.intp],
    event_details: NDArray[Any] | None = None,
    positions: NDArray[np.float64] | None = None,
) -> EventRows:
    """Return events of one kind for the agents in `rows` of a frame. `N` is the up direction of the agents.

    `event_details`: the values of `what`. `positions`: the positions of the events; None for those of the agents."""
    none = np.full(len(rows), -1, np.int64)
    up = rotate_vectors(np.asarray(arrays["orient"], np.float64)[rows], np.tile(_DEFAULT_UP, (len(rows), 1)))
    where = np.asarray(arrays["P"], np.float64)[rows] if positions is None else positions
    details = none if event_details is None else np.asarray(event_details, np.int64)
    species, ids = get_species_numbers(arrays)[rows], get_agent_ids(arrays)[rows]
    return EventRows(kind, species, ids, where, up, details, none, none, np.zeros(len(rows)))


def _read_stored_events(arrays: Arrays, known_pairs: set[tuple[int, ...]]) -> Iterator[EventRows]:
    """Yield the events that a frame contains. Contacts in `known_pairs`, which the previous frame already has, are omitted."""
    for kind in ("emit", "contact"):
        of = select_by_prefix(arrays, f"events.{kind}.")
        if "id" not in of:
            continue
        none = np.full(len(of["id"]), -1, np.int64)
        what, species, other = (of[name].astype(np.int64) if name in of else none for name in ("event", "other_species", "other"))
        place, normal, depth = (each.astype(np.float64) for each in (of["P"], of["N"], of.get("depth", np.zeros(len(none)))))
        events = EventRows(kind, of["species"].astype(np.int64), of["id"], place, normal, what, species, other, depth)
        if kind == "contact":
            new = np.array([pair not in known_pairs for pair in _list_contact_pairs(arrays)], np.bool_)
            events = select_record_rows(events, new)
        yield events


def _list_contact_pairs(arrays: Arrays) -> list[tuple[int, ...]]:
    """Return the species and ids of both agents for each contact in a frame."""
    keys = [f"events.contact.{name}" for name in ("species", "id", "other_species", "other")]
    return list(zip(*(arrays[key].tolist() for key in keys), strict=True)) if keys[-1] in arrays else []


def _find_event_words(gallery: Gallery, events: EventRows) -> list[str]:
    """Return the word in `what` for each event: the new state, the leg that lands, or the name of the emitted event."""
    species, manifest = events.species.tolist(), gallery.manifest
    if events.kind == "state":
        return [manifest.species[s].machines[0].states[k].name for s, k in zip(species, events.what.tolist(), strict=True)]
    if events.kind == "emit":
        return [manifest.events[k] for k in events.what.tolist()]
    if events.kind == "footfall":
        bodies = [int(gallery.bodies.numbers(s, events.id[k : k + 1])[0]) for k, s in enumerate(species)]
        worn = list(zip(species, bodies, strict=True))
        legs = {(s, which): [leg.name for leg in gallery.load_body(s, 0, which).definition.legs] for s, which in set(worn)}
        return [legs[each][k] for each, k in zip(worn, events.what.tolist(), strict=True)]
    return [""] * len(species)
