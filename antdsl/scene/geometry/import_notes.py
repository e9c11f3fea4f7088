"""The import report of a mesh file: what the reader omitted, cut or joined."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field


@dataclass(slots=True)
class SkippedElement:
    """A kind of element that is not read. `count`: how often it occurs. `line`: the line of its first occurrence; None if the
    file has no lines."""

    description: str
    count: int = 0
    line: int | None = None


@dataclass(slots=True)
class ImportNotes:
    """What a reader has noted while it read a mesh file.

    `cut_polygons`: the number of polygons with more than three corners.
    `concave_polygons`: how many of these have a corner that points inward.
    `crossing_polygons`: the number of polygons that cross or cover themselves.
    `crossing_face`: the index of the first polygon that crosses or covers itself."""

    form: str = ""
    vertices: int = 0
    triangles: int = 0
    cut_polygons: int = 0
    concave_polygons: int = 0
    crossing_polygons: int = 0
    crossing_face: int = 0
    skipped_elements: dict[str, SkippedElement] = field(default_factory=dict)

    def count_skipped(self, description: str, count: int = 1, line: int | None = None) -> None:
        """Count elements of one kind that are not read. `description`: the kind of element. `line`: the line of the first one,
        if known."""
        if not count:
            return
        if description not in self.skipped_elements:
            if len(self.skipped_elements) >= 100:
                description = "other content"
            self.skipped_elements.setdefault(description, SkippedElement(description, 0, line))
        self.skipped_elements[description].count += count

    def describe_skipped(self) -> list[str]:
        """Return text about each kind of skipped element, such as `3 × `l` (line 8)`."""
        return [
            (f"{each.count:,} × " if each.count > 1 else "")
            + each.description
            + ("" if each.line is None else f" (line {each.line:,})")
            for each in self.skipped_elements.values()
        ]


FloatTriple = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class MeshImport:
    """The import report of one mesh of a scene. Lengths are in scene units.

    `polygons`: the number of polygons with more than three corners.
    `concave`, `crossing`: the numbers of polygons that `ImportNotes` describes.
    `dropped`: the number of omitted triangles, which have no area or are duplicates.
    `welded`: the number of vertices that were moved onto others.
    `border_edges`: the number of edges with exactly one triangle.
    `low`, `high`: the corners of the mesh's bounding box.
    `left`: the number of triangles in the scene; None if unknown.
    Caches store these field names."""

    file: str
    form: str
    vertices: int
    triangles: int
    polygons: int
    concave: int
    crossing: int
    dropped: int
    welded: int
    border_edges: int
    skipped: tuple[str, ...]
    low: FloatTriple
    high: FloatTriple
    left: int | None = None


def format_import_report(mesh_import: MeshImport, units: str) -> Iterator[str]:
    """Yield the lines of the report as text. `units`: the name of the scene unit."""
    counts = f"{_format_count(mesh_import.vertices, 'vertex', 'vertices')}, {_format_count(mesh_import.triangles, 'triangle')}"
    yield f"{mesh_import.file}, {mesh_import.form}: {counts}"
    size = " × ".join(f"{high - low:.9g}" for low, high in zip(mesh_import.low, mesh_import.high, strict=True))
    low, high = (", ".join(f"{x:.9g}" for x in corner) for corner in (mesh_import.low, mesh_import.high))
    yield f"{size} {units}, from [{low}] to [{high}]"
    changes = [
        f"{_format_count(mesh_import.polygons, 'polygon')} triangulated"
        + (f", {mesh_import.concave:,} of them concave" if mesh_import.concave else "")
        + (f", {mesh_import.crossing:,} crossing themselves" if mesh_import.crossing else "")
        if mesh_import.polygons
        else "",
        f"{_format_count(mesh_import.welded, 'vertex', 'vertices')} welded" if mesh_import.welded else "",
        f"{_format_count(mesh_import.dropped, 'degenerate or doubled triangle')} dropped"
        + (f", {_format_count(mesh_import.left, 'triangle')} left" if mesh_import.left is not None else "")
        if mesh_import.dropped
        else "",
        f"open, {_format_count(mesh_import.border_edges, 'border edge')}"
        if mesh_import.border_edges
        else "closed, no border edges",
    ]
    yield "; ".join(each for each in changes if each)
    if mesh_import.skipped:
        yield f"not read: {', '.join(mesh_import.skipped)}"


def _format_count(number: int, singular: str, plural: str | None = None) -> str:
    return f"{number:,} {singular if number == 1 else plural or singular + 's'}"
