"""The manifest of a cache: its inputs, and the meaning of the numbers in its frames. It is a JSON file. Types and bounds are
checked when it is read."""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, TypeAdapter, ValidationError

from antdsl import limits
from antdsl.atomic_write import write_atomically
from antdsl.numerics.periodic_box import PeriodicBox
from antdsl.outputs.cache.manifest_parts import CameraEntry, FollowEntry, LampEntry, ManifestPart, PeriodEntry, Triple, Word
from antdsl.program.tables.things import KIND_BY_WORD, KINDS_WITH_FACES, ThingKindRow
from antdsl.safe_read import FileTooLargeError, read_size_limited
from antdsl.scene.camera_models import DEFAULT_CAMERA_NAME
from antdsl.scene.light_model import DEFAULT_LIGHT, LightSettings
from antdsl.scene.looks import LOOK_WORDS

FORMAT_VERSION = 1
MANIFEST_FILE_NAME = "manifest.json"
CAMERA_PARTS = ("at", "look_at", "up", "focal")
EDIT_ARRAYS_PATTERN = re.compile(r"^edits\.[0-9a-f]{32}\.npz$")  # the name of the file with arrays of edits
MAX_COUNTED_ID = 2**50  # that edits can count on from
_MAX_MANIFEST_BYTES = 16 * limits.MIB

_MAX_LINE = 400  # characters of a note or an edit
ScenePath = Annotated[str, Field(max_length=500, pattern=r"^([^:/\\\x00-\x1f]+/)*[^:/\\\x00-\x1f]+\.ya?ml$")]
Look = Annotated[Word, Field(pattern=f"^({'|'.join(LOOK_WORDS)})$")]
MeshKind = Annotated[Word, Field(pattern=f"^({'|'.join(KINDS_WITH_FACES)})$")]


class StateEntry(ManifestPart):
    """A state's name, label, and colour (sRGB display values from 0 to 1)."""

    name: Word
    label: Word
    colour: Triple


class MachineEntry(ManifestPart):
    """A state machine of a species, with its states."""

    name: Word
    states: tuple[StateEntry, ...]


class FeelersEntry(ManifestPart):
    """Feelers of an agent: rays ahead, spread over up to `spread` radians to each side.

    Each ray is `reach` scene units plus `per_length` body lengths long."""

    count: Annotated[int, Field(ge=1, le=64)]
    spread: float
    reach: float
    per_length: float


class BodyEntry(ManifestPart):
    """An agent definition: the file that it was read from, and a hash of its content.

    `static.npz` contains it as the arrays `body.N.text`, `.f4`, `.f8`, `.i4` and `.i8`. N is the index in the manifest's list."""

    name: Word
    digest: Word


class ClipEntry(ManifestPart):
    """A clip that states play. `add`: whether the clip is added to all other clips.

    `on`: the transform group of the joints that it moves; empty for all joints. `left`, `right`, `up`, `down`: the clips that
    replace it while an agent turns left or right, climbs or descends."""

    name: Word
    on: Word = ""
    add: bool = False
    left: Word = ""
    right: Word = ""
    up: Word = ""
    down: Word = ""


class WornBodyEntry(ManifestPart):
    """One of the bodies of a species.

    `body`: its word or file in the scene; None chooses a body by the name of the species. `definition`: the index of its agent
    definition in the manifest's `bodies`; None for a body of the library. `weight`: its weight among the bodies of the species; 0
    for a body that only edits use."""

    body: Word | None = None
    definition: Annotated[int, Field(ge=0, lt=limits.MAX_BODY_PARTS)] | None = None
    weight: Annotated[float, Field(ge=0, le=limits.MAX_BODY_WEIGHT)] = 1.0


class ReplacedBody(ManifestPart):
    """A range of agents of a species to which an edit gave another body: `count` ids from `first` on.

    `body`: the index of the new body among the bodies of the species. `level`: how many of the species' `copies` existed at the
    time of the edit. Later copies have the bodies of their originals."""

    first: Annotated[int, Field(ge=0)]
    count: Annotated[int, Field(ge=1)]
    body: Annotated[int, Field(ge=0, lt=limits.MAX_SPECIES_BODIES)]
    level: Annotated[int, Field(ge=0)] = 0


class SpeciesEntry(ManifestPart):
    """A species.

    `body`: the body in pictures; None chooses one by the species' name. `definition`: the index of its agent definition in the
    manifest's `bodies`. `bodies`: the bodies, if the species has several; `body_choice` decides which agent has which body. Empty
    for a single body. `clips`: the clips of its states; frames contain indices into this list. `playing`: the machines that play
    clips. `wears`: body layers that agents may show in addition to the body's own; frames have masks with one bit per layer.
    `channels`: the channels of the body that states set. `looks`: the transform groups of the body that states turn towards a
    direction. `copies`: for each edit that added copies, in order, a number N. The agent with the id i + k N is copy k of agent
    i. `merged`: the indices of those N in `copies` that stand for another cache: the agent with the id i + N is agent i of that
    cache. `drawn_as`: the name with which bodies are drawn, if an edit gave the species another name. `joints`: the joints of the
    body that edits shift and rotate. `replaced`: the agents to which edits gave another body than the one chosen at random."""

    name: Word
    body: Word | None = None
    definition: Annotated[int, Field(ge=0, lt=limits.MAX_BODY_PARTS)] | None = None
    bodies: Annotated[tuple[WornBodyEntry, ...], Field(max_length=limits.MAX_SPECIES_BODIES)] = ()
    clips: tuple[ClipEntry, ...] = ()
    playing: tuple[Word, ...] = ()
    wears: Annotated[tuple[Word, ...], Field(max_length=limits.MAX_WORN_LAYERS)] = ()
    channels: tuple[Word, ...] = ()
    looks: tuple[Word, ...] = ()
    feelers: tuple[FeelersEntry, ...] = ()
    machines: tuple[MachineEntry, ...]
    copies: tuple[Annotated[int, Field(ge=1)], ...] = ()
    merged: tuple[Annotated[int, Field(ge=0)], ...] = ()
    drawn_as: Word = ""
    joints: tuple[Word, ...] = ()
    replaced: tuple[ReplacedBody, ...] = ()


Count = Annotated[int, Field(ge=0)]


class ImportEntry(ManifestPart):
    """The import report of a mesh's file. The fields are those of `antdsl.scene.geometry.import_notes.MeshImport`."""

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


class MeshEntry(ManifestPart):
    """A mesh. `imported`: the import report of its file.

    `moves`: whether each frame has the mesh's vertices. `look`: its look in pictures; None chooses one by its name. `deviation`:
    for a height field only, the greatest distance of its triangles from the bilinear surface (scene units)."""

    name: Word
    kind: MeshKind
    moves: bool = False
    look: Look | None = None
    deviation: float | None = None
    imported: ImportEntry | None = None

    @property
    def row(self) -> ThingKindRow:
        """Return the row of the program's table for this kind of mesh."""
        return KIND_BY_WORD[self.kind]


class FieldEntry(ManifestPart):
    """A field. `cell`: the edge length of a cell in scene units."""

    name: Word
    cell: float


class ItemsEntry(ManifestPart):
    """All items of one name: the names of the single items, and the attributes for which frames contain arrays.

    `position`, `radius`: in scene units, at the first simulated frame. `moves`: whether frames contain positions of the items.
    `looks`: the look of each item in pictures; empty if the scene sets none."""

    name: Word
    names: tuple[Word, ...]
    position: tuple[Triple, ...]
    radius: tuple[float, ...]
    attributes: tuple[Word, ...]
    moves: bool = False
    looks: tuple[Look | None, ...] = ()
    lamp: LampEntry | None = None


class LineEntry(ManifestPart):
    """A crowd line that has a name in the scene.

    `ranges`: the ids of its agents in the order of creation, as ranges (first id, number of ids). Agent k of the line has the
    k-th of these ids, counted from 0."""

    name: Word
    species: Word
    ranges: tuple[tuple[Count, Annotated[int, Field(ge=1)]], ...]


class EditsEntry(ManifestPart):
    """The edits of the cache that readers apply to its frames.

    `name`: the file from which they were read. `text`: its content. `arrays`: the file next to the manifest that contains the
    meshes and bodies named in the edits; None if there are none. `caches`: for each other cache named in the text, its path
    relative to this cache's folder. `next_ids`: for each species, the first id that no agent has in the first `counted_frames`
    frames."""

    name: Word
    text: Annotated[str, Field(max_length=limits.MAX_EDITS_BYTES)]
    arrays: Annotated[str, Field(pattern=EDIT_ARRAYS_PATTERN.pattern)] | None = None
    caches: dict[Word, Word] = Field({})
    next_ids: dict[Word, Annotated[int, Field(ge=0, le=MAX_COUNTED_ID)]] = Field({})
    counted_frames: int = 0


AnyCameraEntry = CameraEntry | FollowEntry | Literal["fit"]  # `fit`: one that holds the crowd in the frames that are drawn


def make_camera_array_name(camera: str, part: str) -> str:
    """Return the name of the array that contains one part of a moving camera."""
    return f"camera.{part}" if camera == DEFAULT_CAMERA_NAME else f"camera.{camera}.{part}"


class Provenance(ManifestPart):
    """The environment in which a cache was made. Readers do not depend on it.

    `sources`: a hash of antdsl's own files. `command`: the command that makes the same frames again. The version of a package
    that is not installed is empty."""

    sources: Word
    python: Word
    numpy: Word
    llvm: Word
    open3d: Word
    platform: Word
    command: Annotated[str, Field(max_length=2000)]


class Manifest(ManifestPart):
    """The description of a cache.

    `inputs`: a hash of every input that affects the frames. `fps`: a fraction such as `24/1`. `first`, `last`: the first and the
    last requested frame. `events`: the names of events; frames contain indices into this list. `static`: the hash of
    `static.npz`; None if none was stored. `state_hash`: the method of state hashes, a `STATE_HASH_VERSION`. `scene_path`: the
    path of the scene file relative to the cache's folder; None if `find_relative_path` returned None. `origin`: the point, in
    scene units, to which all positions are relative; (0, 0, 0) in caches without it. `notes`: those lines of the scene's notes
    that were not off. `light`: the light of pictures. `period`: the box of a periodic world, relative to the origin. `camera`:
    the default camera if it does not depend on agents. `cameras`: all cameras of the scene, by name."""

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
    lines: tuple[LineEntry, ...] = ()
    events: tuple[Word, ...] = ()
    notes: tuple[Word, ...] = ()
    edits: EditsEntry | None = None
    camera: CameraEntry | Literal["fit"] | None = None
    cameras: dict[Word, AnyCameraEntry] = Field({})
    light: LightSettings = DEFAULT_LIGHT
    period: PeriodEntry | None = None

    @property
    def periodic_box(self) -> PeriodicBox | None:
        """Return the box of a periodic world in scene units, relative to the origin. None for other worlds."""
        return None if self.period is None else PeriodicBox(self.period.low, self.period.widths)

    @property
    def named_cameras(self) -> Mapping[str, AnyCameraEntry]:
        """Return all cameras by name. In a manifest without `cameras`, this is only the default camera."""
        return self.cameras or ({} if self.camera is None else {DEFAULT_CAMERA_NAME: self.camera})


def join_line(text: str) -> str:
    """Return a line of notes or edits on one line, without the braces around it."""
    return " ".join(text.split()).removeprefix("{").removesuffix("}").strip()


def shorten_line(text: str) -> str:
    """Return the text, shortened if it is too long for a manifest. Then a hash replaces the end of the text."""
    if len(text) <= _MAX_LINE:
        return text
    return f"{text[:_MAX_LINE]}… {hashlib.blake2b(text.encode(), digest_size=8).hexdigest()}"


class ManifestError(Exception):
    """Error for a folder that is not a cache. The message is a complete explanation."""


def find_relative_path(file: Path, folder: Path) -> str | None:
    """Return the path of a file relative to a folder, with `/` and `..`. None if it is too long for a manifest.

    Also None if the path would pass through the root of the file system, because it would then reveal folders of this machine."""
    start = folder.resolve()
    # first the path through links, because it stays below the common folder
    for end in (Path(os.path.abspath(file)), file.resolve()):
        if end.anchor == start.anchor and os.path.commonpath((start, end)) != start.anchor:
            path = Path(os.path.relpath(end, start)).as_posix()
            try:
                return TypeAdapter(ScenePath).validate_python(path)
            except ValidationError:
                continue
    return None


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Write the manifest to a cache's folder, and flush it to disk."""
    text = json.dumps(manifest.model_dump(mode="json"), indent=1, ensure_ascii=False) + "\n"
    write_atomically(folder / MANIFEST_FILE_NAME, text.encode())


def read_manifest(folder: Path) -> Manifest:
    """Return the manifest in a cache's folder. Raises ManifestError with the reason if the folder is not a cache."""
    path = folder / MANIFEST_FILE_NAME
    try:
        text = read_size_limited(path, _MAX_MANIFEST_BYTES, follows_links=False).decode()
    except FileTooLargeError:
        raise ManifestError(f"`{path}` is too large for a manifest") from None
    except (OSError, UnicodeDecodeError):
        raise ManifestError(f"`{folder}` is not a cache: it has no readable `{MANIFEST_FILE_NAME}`") from None
    newer = re.search(r'"format"\s*:\s*([0-9]{1,6})', text[:200])
    if newer and int(newer[1]) > FORMAT_VERSION:
        raise ManifestError(f"`{folder}` was written by a newer antdsl (format {newer[1]}, this one reads {FORMAT_VERSION})")
    try:
        return Manifest.model_validate_json(text)
    except (ValidationError, RecursionError):
        raise ManifestError(f"`{path}` is damaged") from None
