"""Reads the polygons of Houdini's geometry files: single polygons, runs of polygons, polygon soups, and packed geometry.

Houdini orders the corners of a polygon clockwise as seen from outside, so the order is reversed here."""

from __future__ import annotations

from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.diagnostics.model import replace_unprintable
from antdsl.scene.geometry.houdini_document import HoudiniDocument
from antdsl.scene.geometry.import_notes import ImportNotes
from antdsl.scene.geometry.mesh_text import MeshError, check_count
from antdsl.scene.geometry.polygons import PolygonMesh

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
_MAX_PACKED_DEPTH = 8
_PACKED_KINDS = ("PackedGeometry", "PackedFragment")
_LONG_KIND_NAMES = {"p_r": "Polygon_run"}  # since version 16
_SKIN_ATTRIBUTE = "boneCapture"
_CONVERT_HELP = "convert it to polygons in Houdini, and unpack files on disk"


def read_houdini(data: bytes, notes: ImportNotes, group: str | None = None) -> PolygonMesh:
    """Return the polygons of a file, including those of packed primitives. Raises MeshError with the reason.

    `group`: read only primitives with this value of the attribute `name`; None for all. `notes`: receives the omitted primitives
    with their byte offsets."""
    notes.form = ".bgeo" if data[:1] == b"\x7f" else ".geo"
    document = HoudiniDocument(data)
    detail = _HoudiniGeometry(document, document.root, notes)
    if group is not None and group not in detail.list_names():
        known = ", ".join(f"`{name}`" for name in detail.list_names()[:5]) or "no primitive has the attribute `name`"
        raise MeshError(f"has no primitives with the name `{group}`", f"names: {known}")
    polygons = detail.read_polygons(None if group is None else ("name", group))
    if not len(polygons.corner_counts) and notes.skipped_elements:
        raise MeshError(f"has no polygons: {'; '.join(notes.describe_skipped())} is not read", _CONVERT_HELP)
    return polygons.reverse_corners()


def read_houdini_by_name(data: bytes, notes: ImportNotes) -> dict[str, PolygonMesh]:
    """Return the meshes of a file, one for each value of the primitive attribute `name`.

    Values without polygons are omitted. For `notes` and errors, see `read_houdini`."""
    document = HoudiniDocument(data)
    detail = _HoudiniGeometry(document, document.root, notes)
    names = detail.list_names()
    check_count(len(names), limits.MAX_BODY_PARTS, "names of primitives")
    parts = {name: detail.read_polygons(("name", name)) for name in names}
    return {name: each.reverse_corners() for name, each in parts.items() if len(each.corner_counts)}


class _HoudiniPolygons(NamedTuple):
    """Polygons: `points` float64[n, 3], `corner_counts` int64[p], `point_indices` int64[corner_counts.sum()]."""

    points: Floats
    corner_counts: Integers
    point_indices: Integers

    def transform(self, matrix: Floats) -> _HoudiniPolygons:
        """Return the polygons transformed by a matrix (4, 4) for row vectors."""
        return self._replace(points=_transform_row_vectors(self.points, matrix) + matrix[3, :3])

    @staticmethod
    def join(parts: list[_HoudiniPolygons]) -> _HoudiniPolygons:
        """Return all parts joined into one. Raises MeshError if the limits are exceeded."""
        check_count(sum(len(each.points) for each in parts), 3 * limits.MAX_MESH_FACES, "points")
        check_count(sum(len(each.point_indices) for each in parts), 3 * limits.MAX_MESH_FACES, "corners of faces")
        starts = np.cumsum([0, *(len(each.points) for each in parts)])
        none = np.zeros(0, np.int64)
        return _HoudiniPolygons(
            np.concatenate([np.zeros((0, 3)), *(each.points for each in parts)]),
            np.concatenate([none, *(each.corner_counts for each in parts)]),
            np.concatenate([none, *(each.point_indices + start for each, start in zip(parts, starts, strict=False))]),
        )

    def reverse_corners(self) -> PolygonMesh:
        """Return this mesh with the corners of each polygon in reverse order."""
        ends = np.cumsum(self.corner_counts)
        order = np.repeat(2 * ends - self.corner_counts - 1, self.corner_counts) - np.arange(len(self.point_indices))
        return PolygonMesh(self.points, self.corner_counts, self.point_indices[order])


class _HoudiniGeometry:
    """A geometry: its points, attributes and primitives."""

    def __init__(self, document: HoudiniDocument, value: Any, notes: ImportNotes, depth: int = 0) -> None:
        self._document, self._notes, self._depth = document, notes, depth
        if depth > _MAX_PACKED_DEPTH:
            raise MeshError(f"has packed geometry in more than {_MAX_PACKED_DEPTH} levels", "unpack it in Houdini")
        self._parts = _to_map(value, "the geometry")
        if "pointcount" not in self._parts:
            raise MeshError("has no `pointcount`, so it is not a geometry of Houdini", _CONVERT_HELP)
        self._point_count, self._primitive_count = (
            _to_count(self._parts.get(f"{each}count", 0)) for each in ("point", "primitive")
        )
        if max(self._point_count, self._primitive_count) > document.byte_count:
            raise MeshError(
                f"declares {self._point_count:,} points and {self._primitive_count:,} primitives, more than fit in its bytes"
            )
        self._attributes = _to_map(self._parts.get("attributes", []), "`attributes`")
        topology = _to_map(self._parts.get("topology", []), "`topology`")
        indices = _to_map(topology.get("pointref", []), "`pointref`").get("indices", [])
        self._vertex_points = _to_integers(indices, "`pointref`")
        self._embedded = self._find_embedded_geometry()
        self._detail_by_key = dict[str, _HoudiniGeometry]()
        self._polygons_by_selection = dict[tuple[str, str] | None, _HoudiniPolygons]()

    def _find_embedded_geometry(self) -> dict[str, Any]:
        """Return the values of embedded (packed) geometries, by their keys."""
        shared = self._parts.get("sharedprimitivedata", [])
        values_by_key: dict[str, Any] = {}
        for entry in shared[1::2] if isinstance(shared, list) else []:
            rows = entry if isinstance(entry, list) else []
            for kind, key, value in zip(rows[::3], rows[1::3], rows[2::3], strict=False):
                if kind == "gu:embeddedgeo" and isinstance(key, str):
                    values_by_key[key] = value
        return values_by_key

    def _find_attribute(self, owner: str, name: str) -> dict[str, Any] | None:
        """Return the data of an attribute, or None if there is none. `owner`: `point` or `primitive`, the elements that have the
        attribute."""
        for entry in _to_list(self._attributes.get(f"{owner}attributes", []), "attributes"):
            if isinstance(entry, list) and len(entry) == 2 and _to_map(entry[0], "an attribute").get("name") == name:
                return _to_map(entry[1], f"the attribute `{name}`")
        return None

    @cached_property
    def _points(self) -> Floats:
        """Return the positions of all points, float64[n, 3]."""
        attribute = self._find_attribute("point", "P")
        if attribute is None:
            return np.zeros((self._point_count, 3))
        if self._find_attribute("point", _SKIN_ATTRIBUTE) is not None:
            self._notes.count_skipped(
                f"skin weights `{_SKIN_ATTRIBUTE}` from byte {self._document.find_offset(_SKIN_ATTRIBUTE):,} on"
            )
        values = _read_tuples(_to_map(attribute.get("values", []), "`P`"), self._point_count, "`P`")
        if values.shape[1] < 3:
            raise MeshError("has points of fewer than three coordinates", _CONVERT_HELP)
        return values[:, :3]

    def read_texts(self, name: str) -> list[str]:
        """Return the value of a text attribute for each primitive. The list is empty if there is no such attribute."""
        attribute = self._find_attribute("primitive", name)
        if attribute is None or "strings" not in attribute:
            return []
        texts = [str(each) for each in _to_list(attribute["strings"], f"`{_to_printable(name)}`")]
        what = f"`{_to_printable(name)}`"
        numbers = _read_tuples(_to_map(attribute.get("indices", []), what), self._primitive_count, what)[:, 0].astype(np.int64)
        return [texts[k] if 0 <= k < len(texts) else "" for k in numbers.tolist()]

    def list_names(self) -> list[str]:
        """Return the distinct values of the primitive attribute `name`, without values that cannot be printed."""
        return list(dict.fromkeys(name for name in self.read_texts("name") if name and name.isprintable()))

    def read_polygons(self, selection: tuple[str, str] | None) -> _HoudiniPolygons:
        """Return the polygons, including those of packed geometries.

        `selection`: the name of a text attribute of primitives, and the value that selected primitives have; None for all."""
        if selection not in self._polygons_by_selection:
            self._polygons_by_selection[selection] = self._read_polygons(selection)
        return self._polygons_by_selection[selection]

    def _read_polygons(self, selection: tuple[str, str] | None) -> _HoudiniPolygons:
        points, first = self._points, 0
        selected = None if selection is None else np.array(self.read_texts(selection[0]), np.object_) == selection[1]
        none = np.zeros(0, np.int64)
        counts, vertices, packed = [none], [none], list[_HoudiniPolygons]()
        for kind, fields, number in self._primitives:
            is_chosen = np.ones(number, np.bool_) if selected is None else np.resize(selected[first : first + number], number)
            first += number
            if kind in _PACKED_KINDS:
                packed += self._read_packed(kind, fields, points) if is_chosen[0] else []
            else:
                own_counts, own_vertices = _list_corners(kind, fields, number, len(self._vertex_points))
                keep = np.resize(is_chosen, len(own_counts))
                counts.append(own_counts[keep])
                vertices.append(own_vertices[np.repeat(keep, own_counts)])
        corners = np.concatenate(vertices)
        if ((corners < 0) | (corners >= len(self._vertex_points))).any():
            raise MeshError("has a polygon that names a missing vertex", _CONVERT_HELP)
        own = _HoudiniPolygons(points if len(corners) else points[:0], np.concatenate(counts), self._vertex_points[corners])
        if ((own.point_indices < 0) | (own.point_indices >= len(points))).any():
            raise MeshError("has a vertex that names a missing point", _CONVERT_HELP)
        return _HoudiniPolygons.join([own, *packed])

    @cached_property
    def _primitives(self) -> list[tuple[str, dict[str, Any], int]]:
        """Return the readable primitives, each as its kind, its fields and a count. A run of primitives has one entry for all of
        them, with their number as the count.

        Unreadable primitives are counted in the notes."""
        primitives: list[tuple[str, dict[str, Any], int]] = []
        for entry in _to_list(self._parts.get("primitives", []), "`primitives`"):
            if not isinstance(entry, list) or len(entry) != 2:
                raise MeshError("has a primitive without a type", _CONVERT_HELP)
            head = _to_map(entry[0], "a type of primitives")
            kind = _to_printable(head.get("type"))
            kind = _LONG_KIND_NAMES.get(kind, kind)
            if kind == "run":
                kind = _to_printable(head.get("runtype"))
                names, uniform = _to_list(head.get("varyingfields", []), "a run"), _to_map(head.get("uniformfields", {}), "a run")
                values = [_to_list(row, "a run") for row in _to_list(entry[1], "a run")]
                rows = [(uniform | dict(zip(map(str, names), row, strict=False)), 1) for row in values]
            else:
                fields = _to_map(entry[1], f"`{kind}`")
                rows = [(fields, _to_count(_get_long_or_short_key(fields, "nprimitives", "n_p", 1)))]
            check_count(sum(number for _, number in rows), 3 * limits.MAX_MESH_FACES, "primitives")
            if kind in ("Poly", "Polygon_run", "PolySoup", *_PACKED_KINDS):
                primitives += [(kind, fields, number) for fields, number in rows]
            else:
                offset = self._document.find_offset(kind)
                self._notes.count_skipped(f"`{kind}` from byte {offset:,} on", sum(number for _, number in rows))
                primitives += [("", {}, number) for _, number in rows]
        return primitives

    def _read_packed(self, kind: str, fields: dict[str, Any], points: Floats) -> list[_HoudiniPolygons]:
        """Return the polygons of a packed geometry, moved to its point. If a fragment of the geometry is packed, return only its
        polygons.

        The list is empty if the geometry is not embedded in the file."""
        parameters = _to_map(fields.get("parameters", {}), f"`{kind}`")
        key, vertex = str(parameters.get("embedded")), _to_count(fields.get("vertex", 0))
        if key not in self._embedded or vertex >= len(self._vertex_points) or not 0 <= self._vertex_points[vertex] < len(points):
            self._notes.count_skipped(f"`{kind}` without its geometry, from byte {self._document.find_offset(kind):,} on")
            return []
        if key not in self._detail_by_key:
            self._detail_by_key[key] = _HoudiniGeometry(self._document, self._embedded[key], self._notes, self._depth + 1)
        matrix, turn = np.eye(4), _to_floats(fields.get("transform", np.eye(3)), "`transform`")
        pivot = _to_floats(fields.get("pivot", np.zeros(3)), "`pivot`")
        if len(turn) != 9 or len(pivot) != 3:
            raise MeshError("has a packed geometry with a transform of an unknown form", _CONVERT_HELP)
        matrix[:3, :3] = turn.reshape(3, 3)
        matrix[3, :3] = points[self._vertex_points[vertex]] - _transform_row_vectors(pivot[None], matrix)[0]
        selection = (str(parameters.get("attribute")), str(parameters.get("name"))) if kind == "PackedFragment" else None
        return [self._detail_by_key[key].read_polygons(selection).transform(matrix)]


def _transform_row_vectors(vectors: Floats, matrix: Floats) -> Floats:
    """Return vectors (n, 3) multiplied by the first three rows of a matrix (4, 4). Every processor computes the same bits."""
    return vectors[:, :1] * matrix[0, :3] + vectors[:, 1:2] * matrix[1, :3] + vectors[:, 2:3] * matrix[2, :3]


def _list_corners(kind: str, fields: dict[str, Any], number: int, vertex_count: int) -> tuple[Integers, Integers]:
    """Return the number of corners of each polygon of a primitive, and the vertex of each corner.

    `number`: how many polygons the primitive has if it is a run. `vertex_count`: how many vertices the geometry has. Raises
    MeshError if the counts do not fit."""
    none = np.zeros(0, np.int64)
    if kind == "Poly":
        vertices = _to_integers(fields.get("vertex", []), "`vertex`")
        return (np.array([len(vertices)]), vertices) if fields.get("closed", True) else (none, none)
    if kind == "Polygon_run":
        runs = _get_long_or_short_key(fields, "nvertices_rle", "r_v", None)
        if runs is None:
            counts = _to_integers(_get_long_or_short_key(fields, "nvertices", "n_v", []), "`nvertices`")
        else:
            counts = _expand_runs(_to_integers(runs, "`nvertices_rle`"), vertex_count)
        if len(counts) != number or (counts < 0).any() or counts.sum() > vertex_count:
            raise MeshError(f"has a run of {number:,} polygons with the corners of {len(counts):,}", _CONVERT_HELP)
        start = _to_count(_get_long_or_short_key(fields, "startvertex", "s_v", 0))
        return counts, np.arange(start, start + int(counts.sum()))
    if kind == "PolySoup":
        info = fields.get("polyinfo", [])
        if not isinstance(info, list) or len(info) != 3:
            raise MeshError("has a polygon soup without `polyinfo`", _CONVERT_HELP)
        sizes, amounts, corners = (_to_integers(each, "`polyinfo`") for each in info)
        if len(sizes) != len(amounts):
            raise MeshError("has a polygon soup with sizes that have no count", _CONVERT_HELP)
        counts = _expand_runs(np.stack([sizes, amounts], axis=1).reshape(-1), len(corners))
        if counts.sum() != len(corners):
            raise MeshError("has a polygon soup with too few or too many corners", _CONVERT_HELP)
        return counts, corners
    return none, none


def _expand_runs(runs: Integers, max_count: int) -> Integers:
    """Return the numbers that a run-length encoding stands for. `runs`: pairs of a number and how often it occurs.

    Raises MeshError if there are more than `max_count` numbers, or if the sum of the numbers is larger."""
    if len(runs) % 2 or (runs < 0).any():
        raise MeshError("has runs of polygons that are not pairs of counts", _CONVERT_HELP)
    sizes, counts = runs[::2].astype(np.float64), runs[1::2].astype(np.float64)
    if max(counts.sum(), (sizes * counts).sum()) > max_count:
        raise MeshError("has a polygon that names a missing vertex", _CONVERT_HELP)
    return np.repeat(runs[::2], runs[1::2])


def _read_tuples(values: dict[str, Any], count: int, subject: str) -> Floats:
    """Return the numbers of an attribute, float64[count, size]. They are stored as tuples, as one array per component, or in
    pages."""
    size = _to_count(values.get("size", 1))
    if "tuples" in values:
        table = _to_floats(values["tuples"], subject).reshape(-1)
    elif "arrays" in values:
        table = _to_floats(values["arrays"], subject).reshape(size, -1).T.reshape(-1)
    else:
        table = _unpack_pages(values, count, size, subject)
    if size < 1 or len(table) != count * size:
        raise MeshError(f"has {len(table):,} numbers in {subject}, not {count * size:,}", _CONVERT_HELP)
    return table.reshape(count, size)


def _unpack_pages(values: dict[str, Any], count: int, size: int, subject: str) -> Floats:
    """Return the numbers of an attribute that is stored in pages, float64[count * size]. A page has the values of several
    elements.

    `packing` splits each value into subvectors and lists their sizes. A page has one block of numbers for each subvector. If a
    block is flagged as constant, it stores the numbers of a single element, which all elements of the page share."""
    raw, page = _to_floats(values.get("rawpagedata", []), subject), _to_count(values.get("pagesize", 0))
    widths = _to_integers(values.get("packing", [size]), "`packing`").tolist()
    if page < 1 or min(widths, default=0) < 1 or sum(widths) != size:
        raise MeshError(f"has pages of an unknown form in {subject}", _CONVERT_HELP)
    flags = [_to_floats(each, subject) != 0 for each in _to_list(values.get("constantpageflags", []), subject)]
    if len(raw) * page < count * size:
        raise MeshError(f"has too few numbers in {subject}", _CONVERT_HELP)
    table, offset = np.zeros((count, size)), 0
    for number, first in enumerate(range(0, count, page)):
        rows, column = min(page, count - first), 0
        for pack, width in enumerate(widths):
            is_constant = pack < len(flags) and number < len(flags[pack]) and bool(flags[pack][number])
            block = raw[offset : offset + width * (1 if is_constant else rows)]
            if len(block) < width * (1 if is_constant else rows):
                raise MeshError(f"has too few numbers in {subject}", _CONVERT_HELP)
            table[first : first + rows, column : column + width] = block.reshape(-1, width)
            offset, column = offset + len(block), column + width
    return table.reshape(-1)


def _get_long_or_short_key(fields: dict[str, Any], name: str, short_name: str, default: Any) -> Any:
    """Return the field `name`. Newer files store the same field under its short name. Return `default` if both are absent."""
    return fields.get(name, fields.get(short_name, default))


def _to_map(value: Any, subject: str) -> dict[str, Any]:
    """Return a value as a map. It may be stored as a list in which keys and values alternate."""
    if isinstance(value, dict):
        return value
    if isinstance(value, list) and len(value) % 2 == 0 and all(isinstance(key, str) for key in value[::2]):
        return dict(zip(value[::2], value[1::2], strict=True))
    raise MeshError(f"has no names in {subject}", _CONVERT_HELP)


def _to_list(value: Any, subject: str) -> list[Any]:
    """Return the value if it is a list. Raises MeshError if not."""
    if not isinstance(value, list):
        raise MeshError(f"has no list in {subject}", _CONVERT_HELP)
    return value


def _to_printable(value: Any) -> str:
    """Return the beginning of a value as text for a message. Characters that cannot be printed are removed."""
    return replace_unprintable(str(value)[:40])


def _to_count(value: Any) -> int:
    """Return a value as an integer that is at least 0. Raises MeshError if it is not."""
    if isinstance(value, bool) or not isinstance(value, int) or value < 0:
        raise MeshError(f"has `{_to_printable(value)}` in the place of a number", _CONVERT_HELP)
    return value


def _to_floats(value: Any, subject: str) -> Floats:
    """Return a value as an array of numbers (n,). Raises MeshError if it is not."""
    try:
        return np.asarray(value, np.float64).reshape(-1)
    except (TypeError, ValueError):
        raise MeshError(f"has something that is not a number in {subject}", _CONVERT_HELP) from None


def _to_integers(value: Any, subject: str) -> Integers:
    """Return a value as an array of integers (n,). Raises MeshError if it is not."""
    numbers = _to_floats(value, subject)
    if not (np.abs(numbers) < 2**53).all() or (numbers != np.rint(numbers)).any():
        raise MeshError(f"has something that is not a whole number in {subject}", _CONVERT_HELP)
    return numbers.astype(np.int64)
