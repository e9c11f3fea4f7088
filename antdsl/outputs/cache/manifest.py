"""The manifest of a cache: its inputs and the meaning of its numbers. JSON, with types and bounds checked when it is read."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from antdsl import limits
from antdsl.bounded import TooLarge, read_bounded
from antdsl.program.tables.things import KIND_BY_WORD, WITH_FACES, KindOfThing
from antdsl.whole import write_atomically

FORMAT = 1
MANIFEST = "manifest.json"
_BYTES = 16 * limits.MIB

Word = Annotated[str, Field(max_length=500)]
ScenePath = Annotated[str, Field(max_length=500, pattern=r"^([^:/\\\x00-\x1f]+/)*[^:/\\\x00-\x1f]+\.ya?ml$")]
Triple = tuple[float, float, float]
Look = Literal["metal", "soil", "leaf", "light", "none"]
MeshKind = Annotated[Word, Field(pattern=f"^({'|'.join(WITH_FACES)})$")]


class Part(BaseModel):
    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False, hide_input_in_errors=True)


class StateEntry(Part):
    """A state's name, label, and display (sRGB) colour from 0 to 1."""

    name: Word
    label: Word
    colour: Triple


class MachineEntry(Part):
    name: Word
    states: tuple[StateEntry, ...]


class FeelersEntry(Part):
    """Rays ahead, up to `spread` radians to each side. Their length is `reach` scene units plus `per_length` body lengths."""

    count: Annotated[int, Field(ge=1, le=64)]
    spread: float
    reach: float
    per_length: float


class BodyEntry(Part):
    """An agent definition: the file it was read from, and a hash of its content. `static.npz` has it as the arrays `body.N.text`,
    `.f4`, `.f8`, `.i4` and `.i8`, with its index in the list as N."""

    name: Word
    digest: Word


class ClipEntry(Part):
    """A clip that states play, on the joints of a transform group (empty: all). `add`: it is added to all others. `left`,
    `right`, `up`, `down`: the clips that replace it as an agent turns, climbs or descends."""

    name: Word
    on: Word = ""
    add: bool = False
    left: Word = ""
    right: Word = ""
    up: Word = ""
    down: Word = ""


class SpeciesEntry(Part):
    """A species. `body`: the body in pictures; None chooses by the species' name. `definition`: its index among the manifest's
    bodies. `clips`: the clips of its states, in the order of the indices in frames. `playing`: the machines that play them.

    `wears`: body layers that agents may show in addition to their own; frames have masks with one bit per layer. `channels` and
    `looks`: the body's channels and groups that states set or turn."""

    name: Word
    body: Word | None = None
    definition: Annotated[int, Field(ge=0, lt=limits.MAX_BODY_PARTS)] | None = None
    clips: tuple[ClipEntry, ...] = ()
    playing: tuple[Word, ...] = ()
    wears: Annotated[tuple[Word, ...], Field(max_length=limits.MAX_WORN_LAYERS)] = ()
    channels: tuple[Word, ...] = ()
    looks: tuple[Word, ...] = ()
    feelers: tuple[FeelersEntry, ...] = ()
    machines: tuple[MachineEntry, ...]


Count = Annotated[int, Field(ge=0)]


class ImportEntry(Part):
    """Notes on the import of a mesh's file, as in `antdsl.scene.geometry.import_notes.MeshImport`."""

    file: Word
    form: Word
    vertices: Count
    triangles: Count
    polygons: Count = 0
    concave: Count = 0
    crossing: Count = 0
    dropped: Count = 0
    welded: Count = 0
    border_edges: Count = 0
    skipped: tuple[Word, ...] = ()
    low: Triple
    high: Triple
    left: Count | None = None


class MeshEntry(Part):
    """A mesh. `imported`: notes on the import of its file. `moves`: each frame has its vertices. `look`: its look in pictures;
    None chooses by its name.

    `deviation`: for a height field, the maximum distance (scene units) of its triangles from the bilinear surface through its
    samples."""

    name: Word
    kind: MeshKind
    moves: bool = False
    look: Look | None = None
    deviation: float | None = None
    imported: ImportEntry | None = None

    @property
    def row(self) -> KindOfThing:
        """Return what the program knows about its kind."""
        return KIND_BY_WORD[self.kind]


class FieldEntry(Part):
    """`cell` in scene units."""

    name: Word
    cell: float


class ItemsEntry(Part):
    """Items of one name: their own names, and the attributes for which each frame has an array.

    Positions and radii are in scene units, at the first simulated frame; `moves`: each frame has its own. `looks`: the look of
    each in pictures, empty where no scene gives one."""

    name: Word
    names: tuple[Word, ...]
    position: tuple[Triple, ...]
    radius: tuple[float, ...]
    attributes: tuple[Word, ...]
    moves: bool = False
    looks: tuple[Look | None, ...] = ()


class CameraEntry(Part):
    """Points in scene units, focal length in mm for a sensor 36 mm wide. `moves`: `static.npz` has it for each frame."""

    at: Triple
    look_at: Triple
    focal: float | None
    up: Triple | None = None
    moves: bool = False


class Provenance(Part):
    """The environment in which a cache was made. `sources` is a hash of antdsl's own files, `command` makes the same frames.
    Versions are empty for missing packages. Readers do not depend on any of it."""

    sources: Word
    python: Word
    numpy: Word
    llvm: Word
    open3d: Word
    platform: Word
    command: Annotated[str, Field(max_length=2000)]


class Manifest(Part):
    """The description of a cache. `inputs` has a hash for every input of the frames. `fps` is a fraction, `24/1`. `first` and
    `last` are the requested frames; `events` are the names that frames count. `static` is the hash of `static.npz`, None if none
    was stored. `state_hash` is the method of state hashes, a `STATE_HASH`. `scene_path` leads from the cache's folder to the
    scene's file, if `relative_path` knows a path. All positions are relative to `origin` (scene units); in caches without it, to
    the zero point."""

    format: Literal[1] = 1
    antdsl: Word
    made_with: Provenance | None = None
    scene: Word
    scene_path: ScenePath | None = None
    inputs: dict[Word, Word]
    static: Word | None = None
    state_hash: int = 1
    units: Literal["mm", "cm", "m"]
    up: Literal["y", "z"]
    origin: Triple = (0.0, 0.0, 0.0)
    fps: Annotated[str, Field(pattern=r"^[0-9]{1,9}/[0-9]{1,9}$")]
    first: int
    last: int
    preroll: int
    substeps: int
    seed: int
    checkpoint: Annotated[int, Field(ge=1)]
    attributes: tuple[Word, ...]
    species: tuple[SpeciesEntry, ...]
    bodies: tuple[BodyEntry, ...] = ()
    meshes: tuple[MeshEntry, ...]
    fields: tuple[FieldEntry, ...]
    items: tuple[ItemsEntry, ...]
    events: tuple[Word, ...] = ()
    camera: CameraEntry | Literal["fit"] | None = None  # `fit`: one that holds the crowd in the frames that are drawn


class ManifestError(Exception):
    """Reason why a folder is not a cache; the message is complete without context."""


def relative_path(file: Path, folder: Path) -> str | None:
    """Return the path from a folder to a file, with `/` and `..`; None where it is too long for a manifest.

    Also None where it would pass the root of the file system and so name the machine's own folders."""
    start = folder.resolve()
    for end in (Path(os.path.abspath(file)), file.resolve()):  # the way through links first: it stays below what both share
        if end.anchor == start.anchor and os.path.commonpath((start, end)) != start.anchor:
            path = Path(os.path.relpath(end, start)).as_posix()
            try:
                return TypeAdapter(ScenePath).validate_python(path)
            except ValidationError:
                continue
    return None


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Put the manifest into a cache's folder, durably."""
    text = json.dumps(manifest.model_dump(mode="json"), indent=1, ensure_ascii=False) + "\n"
    write_atomically(folder / MANIFEST, text.encode())


def read_manifest(folder: Path) -> Manifest:
    """The manifest of a cache's folder; ManifestError says why there is none."""
    path = folder / MANIFEST
    try:
        text = read_bounded(path, _BYTES, follow=False).decode()
    except TooLarge:
        raise ManifestError(f"`{path}` is too large for a manifest") from None
    except (OSError, UnicodeDecodeError):
        raise ManifestError(f"`{folder}` is not a cache: it has no readable `{MANIFEST}`") from None
    newer = re.search(r'"format"\s*:\s*([0-9]{1,6})', text[:200])
    if newer and int(newer[1]) > FORMAT:
        raise ManifestError(f"`{folder}` was written by a newer antdsl (format {newer[1]}, this one reads {FORMAT})")
    try:
        return Manifest.model_validate_json(text)
    except (ValidationError, RecursionError):
        raise ManifestError(f"`{path}` is damaged") from None
