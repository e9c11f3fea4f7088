"""The import report: elements that the reader of a mesh file left out, cut or joined."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field


@dataclass(slots=True)
class SkippedElement:
    """An element of a file that is not read. `count`: how often it occurs. `line`: the line of the first one, if the file has
    lines."""

    description: str
    count: int = 0
    line: int | None = None


@dataclass(slots=True)
class ImportNotes:
    """Notes on one mesh file.

    `cut_polygons`: polygons with more than three corners.
    `concave_polygons`: polygons in `cut_polygons` with a corner that points inward.
    `crossing_polygons`: polygons that cut or cover themselves.
    `crossing_face`: the index of the first of these."""

    form: str = ""
    vertices: int = 0
    triangles: int = 0
    cut_polygons: int = 0
    concave_polygons: int = 0
    crossing_polygons: int = 0
    crossing_face: int = 0
    skipped_elements: dict[str, SkippedElement] = field(default_factory=dict)

    def count_skipped(self, description: str, count: int = 1, line: int | None = None) -> None:
        """Count elements `description` that are not read."""
        if not count:
            return
        if description not in self.skipped_elements:
            if len(self.skipped_elements) >= 100:
                description = "other content"
            self.skipped_elements.setdefault(description, SkippedElement(description, 0, line))
        self.skipped_elements[description].count += count

    def describe_skipped(self) -> list[str]:
        """Return the skipped elements as phrases, such as `3 × `l` (line 8)`."""
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

    `polygons`: polygons with more than three corners.
    `concave`, `crossing`: numbers of polygons, as in `ImportNotes`.
    `dropped`: triangles that were left out, since they have no area or are duplicates.
    `welded`: vertices moved onto others.
    `border_edges`: edges with exactly one triangle.
    `low`, `high`: the corners of the mesh's box.
    `left`: the number of triangles in the scene; None if unknown. Caches store these names."""

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
    """Yield the lines of the report as text."""
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
