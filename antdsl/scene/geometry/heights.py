"""Makes triangle surfaces from heights in rows and columns. Heights are read from 16-bit grey images and from arrays.

Sizes are compared with the limits before anything is decompressed."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.scene.geometry.arrays import ArrayFileError, convert_to_float64, read_npz_archive
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
    kind = name.rsplit(".", 1)[-1].lower() if "." in name else ""
    if kind == "npz":
        samples = _read_height_array(data, array, layer)
    elif kind in IMAGE_FORMATS:
        for key, value in (("array", array), ("layer", layer)):
            if value is not None:
                raise MeshError("is an image, which has one layer of samples", f"leave `{key}` out")
        samples = _read_height_image(data, IMAGE_FORMATS[kind])
    else:
        raise MeshError("is not one of " + ", ".join(f".{word}" for word in (*IMAGE_FORMATS, "npz")))
    if not np.isfinite(samples).all():
        raise MeshError("has a height that is not a finite number")
    return samples


def _read_height_image(data: bytes, form: str) -> Floats:
    from antdsl.reader.image_request import ImageError, read_image_file

    try:
        image = read_image_file(data, form, _PIXEL_MODES, 2 * limits.MAX_MESH_FACES)
    except ImageError as error:
        raise MeshError(str(error), *([error.help] if error.help else [])) from None
    _check_sample_count(image.rows, image.columns)
    if image.pages != 1:
        raise MeshError("has several pages", "save one of them")
    if image.samples is None:
        raise MeshError(f"has no samples of 16 bits in one channel (its mode is {image.mode})", "save it as grey with 16 bits")
    samples = convert_to_float64(image.samples)
    return samples if image.mode == "F" else samples / _MAX_GREY_SAMPLE


def _read_height_array(data: bytes, array: str | None, layer: int | None) -> Floats:
    try:
        arrays = read_npz_archive(io.BytesIO(data), len(data), None if array is None else {array})
    except ArrayFileError as error:
        raise MeshError(str(error)) from None
    if array is None and len(arrays) != 1:
        names = ", ".join(f"`{each}`" for each in arrays) or "none"
        raise MeshError(f"has {len(arrays)} arrays, {names}", "name one: `array: …`")
    samples: NDArray[Any] | None = next(iter(arrays.values()), None) if array is None else arrays.get(array)
    if samples is None:
        raise MeshError(f"has no array `{array}`")
    if samples.dtype.kind not in "fiu":
        raise MeshError("has an array that is not numeric")
    if samples.ndim == 3:
        if layer is None:
            raise MeshError(f"has {samples.shape[0]} layers of samples", "choose one: `layer: 0`")
        if layer >= samples.shape[0]:
            raise MeshError(f"has no layer {layer}", f"write one from 0 to {samples.shape[0] - 1}")
        samples = samples[layer]
    elif layer is not None:
        raise MeshError("has one layer of samples", "leave `layer` out")
    if samples.ndim != 2:
        raise MeshError(f"has an array with {samples.ndim} dimensions", "save one with rows and columns")
    _check_sample_count(*samples.shape)
    return convert_to_float64(samples)


def _check_sample_count(rows: int, columns: int) -> None:
    if rows < 2 or columns < 2:
        raise MeshError(f"has {rows} rows and {columns} columns of samples, but needs two of each")
    if 2 * (rows - 1) * (columns - 1) > limits.MAX_MESH_FACES:
        words = f"has {rows:,} rows and {columns:,} columns of samples, which make more than {limits.MAX_MESH_FACES:,} faces"
        raise MeshError(words, "use a smaller one")


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
