"""Reads samples in rows and columns from grey images and arrays, and makes triangle surfaces from samples that are heights.

Sizes are compared with the limits before anything is decompressed."""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.scene.geometry.arrays import ArrayFileError, convert_to_float64, parse_npy, read_npz_archive
from antdsl.scene.geometry.mesh_text import MeshError

Floats = NDArray[np.float64]

IMAGE_FORMATS = {"png": "PNG", "tif": "TIFF", "tiff": "TIFF"}
_PIXEL_MODES = ("F", "I;16", "I;16L", "I;16B", "I;16N")  # Pillow's modes: floats, and 16-bit grey in all byte orders
_MAX_GREY_SAMPLE = 65535.0  # the sample of a 16-bit image that represents 1


def read_heights(data: bytes, name: str, array: str | None = None, layer: int | None = None) -> Floats:
    """Return the height samples in a file's bytes, float64[rows, columns]. Raises MeshError with the reason if this fails.

    Samples of a 16-bit image are scaled to 0 to 1. Samples of a float image or an array are unchanged.
    `array`: the name of the array to read, if an .npz file has several.
    `layer`: the index along the first dimension, if the array has three dimensions."""
    return _read_samples(data, name, array, layer, _HEIGHT_GRID)


def read_field_values(
    data: bytes, name: str, array: str | None = None, layer: int | None = None, has_vectors: bool = False
) -> Floats:
    """Return the samples for the cells of a field, like `read_heights`. Images may also have 8 bits.

    The result has the shape (rows, columns), or (rows, columns, 3) if `has_vectors` is true. Images have no vectors."""
    return _read_samples(data, name, array, layer, _VECTOR_GRID if has_vectors else _NUMBER_GRID)


class _GridKind(NamedTuple):
    """What a file of samples must contain. `modes`: of images, in Pillow's words; `bits`: the same, for messages. `width`: the
    number of components of a sample. `check_count`: raises MeshError for a number of rows and columns that is not allowed."""

    modes: tuple[str, ...]
    bits: str
    width: int
    check_count: Callable[[int, int], None]


def _read_samples(data: bytes, name: str, array: str | None, layer: int | None, grid: _GridKind) -> Floats:
    """Return the samples in a file's bytes: float64[rows, columns], or float64[rows, columns, 3] for vectors."""
    kind = name.rsplit(".", 1)[-1].lower() if "." in name else ""
    if kind in ("npz", "npy"):
        samples = _read_sample_array(data, kind, array, layer, grid)
    elif kind in IMAGE_FORMATS:
        for key, value in (("array", array), ("layer", layer)):
            if value is not None:
                raise MeshError("is an image, which has one layer of samples", f"leave `{key}` out")
        if grid.width > 1:
            raise MeshError("is an image, which has no vectors", "write an array of the shape (rows, columns, 3)")
        samples = _read_sample_image(data, IMAGE_FORMATS[kind], grid)
    else:
        raise MeshError("is not one of " + ", ".join(f".{word}" for word in (*IMAGE_FORMATS, "npz", "npy")))
    if not np.isfinite(samples).all():
        raise MeshError("has a sample that is not a finite number")
    return samples


def _read_sample_image(data: bytes, form: str, grid: _GridKind) -> Floats:
    from antdsl.reader.image_request import ImageError, read_image_file

    try:
        image = read_image_file(data, form, grid.modes, 2 * limits.MAX_MESH_FACES)
    except ImageError as error:
        raise MeshError(str(error), *([error.help] if error.help else [])) from None
    grid.check_count(image.rows, image.columns)
    if image.pages != 1:
        raise MeshError("has several pages", "save one of them")
    if image.samples is None:
        words = f"has no samples of {grid.bits} bits in one channel (its mode is {image.mode})"
        raise MeshError(words, f"save it as grey with {grid.bits} bits")
    samples = convert_to_float64(image.samples)
    return samples if image.mode == "F" else samples / (255.0 if image.mode == "L" else _MAX_GREY_SAMPLE)


def _read_sample_array(data: bytes, kind: str, array: str | None, layer: int | None, grid: _GridKind) -> Floats:
    try:
        if kind == "npy":
            arrays = {"values": parse_npy(data, "values")}
        else:
            arrays = read_npz_archive(io.BytesIO(data), len(data), None if array is None else {array})
    except ArrayFileError as error:
        raise MeshError(str(error), "write it with `numpy.savez` or `numpy.save`, in C order") from None
    if kind == "npy" and array is not None:
        raise MeshError("is a single array", "leave `array` out")
    if array is None and len(arrays) != 1:
        names = ", ".join(f"`{each}`" for each in arrays) or "none"
        raise MeshError(f"has {len(arrays)} arrays, {names}", "name one: `array: …`")
    samples: NDArray[Any] | None = next(iter(arrays.values()), None) if array is None else arrays.get(array)
    if samples is None:
        raise MeshError(f"has no array `{array}`")
    if samples.dtype.kind not in "fiu":
        raise MeshError("has an array that is not numeric")
    dimensions = 2 if grid.width == 1 else 3
    if samples.ndim == dimensions + 1:
        if layer is None:
            raise MeshError(f"has {samples.shape[0]} layers of samples", "choose one: `layer: 0`")
        if layer >= samples.shape[0]:
            raise MeshError(f"has no layer {layer}", f"write one from 0 to {samples.shape[0] - 1}")
        samples = samples[layer]
    elif layer is not None:
        raise MeshError("has one layer of samples", "leave `layer` out")
    if grid.width > 1 and (samples.ndim != dimensions or samples.shape[-1] != grid.width):
        raise MeshError(f"has an array of the shape {samples.shape}", f"save one of the shape (rows, columns, {grid.width})")
    if samples.ndim != dimensions:
        raise MeshError(f"has an array with {samples.ndim} dimensions", "save one with rows and columns")
    grid.check_count(*samples.shape[:2])
    return convert_to_float64(samples)


def _check_height_count(rows: int, columns: int) -> None:
    if rows < 2 or columns < 2:
        raise MeshError(f"has {rows} rows and {columns} columns of samples, but needs two of each")
    if 2 * (rows - 1) * (columns - 1) > limits.MAX_MESH_FACES:
        words = f"has {rows:,} rows and {columns:,} columns of samples, which make more than {limits.MAX_MESH_FACES:,} faces"
        raise MeshError(words, "use a smaller one")


def _check_value_count(rows: int, columns: int) -> None:
    if not rows or not columns:
        raise MeshError("has no samples")
    if rows * columns > limits.MAX_FIELD_CELLS:
        words = f"has {rows:,} rows and {columns:,} columns of samples, more than {limits.MAX_FIELD_CELLS:,} in all"
        raise MeshError(words, "use a smaller one")


_HEIGHT_GRID = _GridKind(_PIXEL_MODES, "16", 1, _check_height_count)
_NUMBER_GRID = _GridKind((*_PIXEL_MODES, "L"), "8 or 16", 1, _check_value_count)
_VECTOR_GRID = _NUMBER_GRID._replace(width=3)


def make_height_surface(heights: Floats, extent: tuple[float, float]) -> tuple[Floats, NDArray[np.int64]]:
    """Return the vertices (n, 3) and faces (m, 3) of a surface with the heights [rows, columns]. It is centred at the origin,
    with y up.

    `extent`: the size along x and along z.
    Faces have their front above. There is one vertex per sample, row by row. Columns go along +x and rows along +z, like a
    picture seen from above."""
    rows, columns = heights.shape
    x = -extent[0] / 2 + np.arange(columns) * (extent[0] / (columns - 1))
    z = -extent[1] / 2 + np.arange(rows) * (extent[1] / (rows - 1))
    vertices = np.empty((rows, columns, 3))
    vertices[..., 0], vertices[..., 1], vertices[..., 2] = x[None, :], heights, z[:, None]
    a = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)[None, :]).ravel()
    right, below, across = a + 1, a + columns, a + columns + 1
    faces = np.stack([np.stack([a, below, across], axis=1), np.stack([a, across, right], axis=1)], axis=1)
    return vertices.reshape(-1, 3), faces.reshape(-1, 3).astype(np.int64)


def compute_sampling_deviation(heights: Floats) -> float:
    """Return the largest distance between the triangles and the bilinear surface through the samples.

    In each cell, the distance is largest in the middle. There it is a quarter of the difference between the height sums of the
    cell's two diagonals."""
    twist = heights[:-1, :-1] - heights[:-1, 1:] - heights[1:, :-1] + heights[1:, 1:]
    return float(np.abs(twist).max()) / 4
