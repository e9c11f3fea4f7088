"""Reads numbers and vectors that are painted on a mesh: attributes of .ply files, or arrays of .npz files."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.scene.geometry.arrays import ArrayFileError, convert_to_float64, read_arrays
from antdsl.scene.geometry.ply import HeaderError, PlyElement, PlyHeader, read_header
from antdsl.scene.geometry.ply_body import read_columns

Floats = NDArray[np.float64]

_COMPONENT_NAME_PATTERNS = (("{}_x", "{}_y", "{}_z"), ("{}.x", "{}.y", "{}.z"), ("{}x", "{}y", "{}z"), ("{}_0", "{}_1", "{}_2"))


class PaintError(Exception):
    """Error for a file without the requested data. The message is a reason that fits after the file's name. `help`: what to
    write."""

    def __init__(self, message: str, help: str | None = None) -> None:
        super().__init__(message)
        self.help = help


def read_painted_values(data: bytes, name: str, attribute: str | tuple[str, ...], width: int) -> Floats:
    """Return the values of an attribute (n, width), one row per vertex or face. Raises PaintError if the file has no such
    values.

    `attribute`: the name of the attribute, or the names of the three components of a vector.
    `width`: 1 or 3. One-byte numbers are scaled so that 255 becomes 1. Values that are not finite are an error."""
    kind = name.rsplit(".", 1)[-1].lower() if "." in name else ""
    if kind not in _READER_BY_SUFFIX:
        raise PaintError("is neither a .ply nor an .npz file", "paint on the vertices of a .ply file, or write an .npz file")
    rows = _READER_BY_SUFFIX[kind](data, attribute, width)
    wrong = np.flatnonzero(~np.isfinite(rows).all(axis=1))
    if len(wrong):
        raise PaintError(f"has a value (number {wrong[0]}) that is not finite")
    wrong = np.flatnonzero((np.abs(rows) > limits.MAX_NUMBER).any(axis=1))
    if len(wrong):
        raise PaintError(f"has a value (number {wrong[0]}) that is too large to store", "paint numbers below 3e38")
    return rows


def _format_names(names: Sequence[str]) -> str:
    return ", ".join(f"`{name[:40]}`" for name in list(names)[:12]) or "nothing"


# --- .ply ------------------------------------------------------------------------------------------------------------


def _read_ply_attribute(data: bytes, attribute: str | tuple[str, ...], width: int) -> Floats:
    try:
        header = read_header(data)
        for element in header.elements:
            columns = _find_columns(element, attribute, width)
            if element.name in ("vertex", "face") and columns is not None:
                return _read_scaled_columns(data, header, element, columns, width)
    except HeaderError as error:
        raise PaintError(str(error)) from None
    painted = [p.name for e in header.elements if e.name in ("vertex", "face") for p in e.properties if not p.length_type]
    words = " ".join(attribute) if isinstance(attribute, tuple) else attribute
    sample = "attribute: [nx, ny, nz]" if width == 3 else "attribute: NAME"
    what = "three attributes" if width == 3 else "attribute"
    raise PaintError(f"has no {what} `{words}`", f"write `{sample}`; the file has {_format_names(painted)}")


def _find_columns(element: PlyElement, attribute: str | tuple[str, ...], width: int) -> tuple[str, ...] | None:
    """Return the names of an element's properties that form the attribute, or None if the element does not have them."""
    have = {p.name for p in element.properties if not p.length_type}
    if isinstance(attribute, tuple):
        return attribute if len(attribute) == width and have.issuperset(attribute) else None
    if width == 1:
        return (attribute,) if attribute in have else None
    for parts in _COMPONENT_NAME_PATTERNS:
        names = tuple(part.format(attribute) for part in parts)
        if have.issuperset(names):
            return names
    return None


def _read_scaled_columns(data: bytes, header: PlyHeader, element: PlyElement, columns: tuple[str, ...], width: int) -> Floats:
    values = read_columns(data, header, element, columns)
    kinds = {p.name: p.value_type for p in element.properties}
    if any(kinds[name] == "u1" for name in columns):
        if width == 3:
            raise PaintError("has a vector of unsigned bytes, which cannot be negative", "write it as floating-point numbers")
        values = values / 255.0
    return values


# --- .npz ------------------------------------------------------------------------------------------------------------


def _read_npz_array(data: bytes, attribute: str | tuple[str, ...], width: int) -> Floats:
    try:
        arrays = read_arrays(data)
    except ArrayFileError as error:
        raise PaintError(str(error), "write it with `numpy.savez`, uncompressed") from None
    names = attribute if isinstance(attribute, tuple) else (attribute,)
    missing = [name for name in names if name not in arrays]
    if missing:
        raise PaintError(f"has no array `{missing[0]}`", f"write `attribute: NAME`; the file has {_format_names(list(arrays))}")
    parts = [convert_to_float64(arrays[name]) / (255.0 if arrays[name].dtype == np.uint8 else 1.0) for name in names]
    rows = parts[0] if len(parts) == 1 else np.stack(parts, axis=-1) if len({p.shape for p in parts}) == 1 else np.empty(0)
    rows = rows[:, None] if rows.ndim == 1 and width == 1 else rows
    if rows.ndim != 2 or rows.shape[1] != width:
        shape = "(n,)" if width == 1 else "(n, 3)"
        raise PaintError(f"has an array `{names[0]}` of shape {parts[0].shape}, but needs {shape}")
    return rows


_READER_BY_SUFFIX: dict[str, Callable[[bytes, str | tuple[str, ...], int], Floats]] = {
    "ply": _read_ply_attribute,
    "npz": _read_npz_array,
}
