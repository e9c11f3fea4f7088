"""Computes colours of points from a glTF file: vertex colours, times the base colour texture at each point. Khronos Group, glTF
2.0 Specification, 2021, sections 3.7.2 and 3.8.

Images are decoded by the confined reader, after a check of their sizes against a limit."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.reader.image_request import ImageError, read_image_file
from antdsl.scene.geometry.gltf_file import GltfDocument, GltfError

Floats = NDArray[np.float64]
COLOUR_ATTRIBUTE = "Cd"  # the attribute of points with linear colours
_IMAGE_SIGNATURES = ((b"\x89PNG", "PNG"), (b"\xff\xd8\xff", "JPEG"))
_CLAMP_WRAP_MODE, _MIRROR_WRAP_MODE = 33071, 33648


class TextureError(Exception):
    """Error for a texture that cannot be read. The message is the reason."""


@dataclass(slots=True)
class Textures:
    """The images of a file, decoded when they are first needed. `_images`: uint8[rows, columns, 3] by number.
    `_remaining_pixels`: how many more pixels may be decoded."""

    file: GltfDocument
    _images: dict[int, NDArray[np.uint8]] = field(default_factory=dict)
    _remaining_pixels: int = field(default_factory=lambda: limits.MAX_TEXTURE_PIXELS)

    def sample_colours(self, info: dict[str, Any], uvs: Floats) -> Floats:
        """Return the linear colours [P, 3] of a texture at the texture coordinates [P, 2], interpolated between texels.

        `info`: the reference to the texture in a material. Raises TextureError if the texture cannot be read."""
        file = self.file
        if info.get("texCoord", 0) != 0:
            raise TextureError("the texture does not use the first set of texture coordinates")
        textures = file.get_top_list("textures")
        texture = textures[file.check_index(info.get("index"), "texture", len(textures))]
        image = self._read_image(file.get_index(texture, "source", len(file.get_top_list("images"))))
        sampler = file.get_index(texture, "sampler", len(file.get_top_list("samplers")))
        wrap = {} if sampler is None else file.get_top_list("samplers")[sampler]
        uv = _transform_uvs(file, info, uvs)
        size = np.array([image.shape[1], image.shape[0]])
        at = (
            np.stack([_wrap_coordinates(uv[:, k], wrap.get(name, 0)) for k, name in enumerate(("wrapS", "wrapT"))], axis=1) * size
            - 0.5
        )
        first = np.floor(at)
        share = at - first
        low, high = (np.clip(first + step, 0, size - 1).astype(np.intp) for step in (0, 1))
        linear = _LINEAR_BY_SRGB_BYTE[image]
        above = linear[low[:, 1], low[:, 0]] * (1 - share[:, :1]) + linear[low[:, 1], high[:, 0]] * share[:, :1]
        below = linear[high[:, 1], low[:, 0]] * (1 - share[:, :1]) + linear[high[:, 1], high[:, 0]] * share[:, :1]
        return np.asarray(above * (1 - share[:, 1:]) + below * share[:, 1:])

    def _read_image(self, number: int | None) -> NDArray[np.uint8]:
        """Return the decoded image with this number. Raises TextureError if it cannot be read."""
        if number is None:
            raise TextureError("the texture has no PNG or JPEG image")
        if number not in self._images:
            try:
                data = self.file.read_image_bytes(number)
            except GltfError as error:
                raise TextureError(f"the file {error}") from None
            format = next((name for magic, name in _IMAGE_SIGNATURES if data.startswith(magic)), "")
            if not format:
                raise TextureError("the image is neither PNG nor JPEG")
            try:
                image = read_image_file(data, format, ("RGB",), self._remaining_pixels, convert="RGB")
            except ImageError as error:
                raise TextureError(f"its image {error}") from None
            if image.samples is None:
                raise TextureError(f"the image has {image.rows * image.columns:,} pixels, which is too many")
            self._remaining_pixels -= image.rows * image.columns
            self._images[number] = image.samples
        return self._images[number]


def _transform_uvs(file: GltfDocument, info: dict[str, Any], uvs: Floats) -> Floats:
    """Return the texture coordinates after the transform of the extension KHR_texture_transform, if `info` has one."""
    change = file.get_object(file.get_object(info, "extensions"), "KHR_texture_transform")
    if not change:
        return uvs
    offset, scale = file.get_floats(change, "offset", (0.0, 0.0)), file.get_floats(change, "scale", (1.0, 1.0))
    angle = change.get("rotation", 0.0)
    angle = float(angle) if isinstance(angle, int | float) and np.isfinite(angle) else 0.0
    sine, cosine = np.sin(angle), np.cos(angle)
    moved = uvs * scale
    return np.stack([cosine * moved[:, 0] + sine * moved[:, 1], cosine * moved[:, 1] - sine * moved[:, 0]], axis=1) + offset


def _wrap_coordinates(values: Floats, mode: Any) -> Floats:
    """Return texture coordinates wrapped into the range 0 to 1 by a sampler's wrap mode. The default mode repeats the texture."""
    if mode == _CLAMP_WRAP_MODE:
        return np.clip(values, 0.0, 1.0)
    if mode == _MIRROR_WRAP_MODE:
        return np.asarray(1.0 - np.abs(values % 2.0 - 1.0))
    return np.asarray(values - np.floor(values))


def _build_linear_table() -> NDArray[np.float32]:
    """Return a table of the linear value of each 8-bit sRGB value, float32[256]."""
    value = np.arange(256) / 255.0
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4).astype(np.float32)


_LINEAR_BY_SRGB_BYTE = _build_linear_table()
