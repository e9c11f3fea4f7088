"""Collects all files of which a USD file consists, and copies them into a private folder.

The reader process may only open files in this folder.

`Roots` reads each file, so the same rules apply as to any file that a scene names. Files must be below the scene's folder or a
granted root. Links and URLs are not followed, and a file may be no larger than a mesh. The reader opens each copy and lists the
files that it names. Copies have the same relative paths as the original files, so that USD finds them. No message reveals
whether a file outside the roots exists.

A .usdz package is unpacked here, never by USD. It is then rebuilt as USD expects it: layers only, uncompressed, with plain and
unique names. Otherwise, two readers of the same zip file could see different members."""

from __future__ import annotations

import io
import os
import posixpath
import re
import shutil
import struct
import weakref
import zipfile
from collections.abc import Iterator
from hashlib import blake2b
from pathlib import Path
from typing import NoReturn

from antdsl import limits
from antdsl.reader import client
from antdsl.reader.protocol import ProtocolError, RefusalError, clean_for_display
from antdsl.scene.geometry.usd.errors import UsdError
from antdsl.scene.paths import PathRefused, Roots

LAYER_SUFFIXES = (".usd", ".usda", ".usdc")
_MEMBER_ALIGNMENT_BYTES = 64  # alignment of the data of each member (USDZ specification)
_PADDING_FIELD_ID = 0x1986  # the extra field that USD uses for padding
_END_RECORD_STRUCT = struct.Struct("<4s4H2LH")
_MEMBER_NAME_PATTERN = re.compile(r"[^\x00-\x1f\x7f\\:\[\]<>|*?\"@`]{1,255}")


PACKAGE_SUFFIX = ".usdz"
USD_SUFFIXES = (*LAYER_SUFFIXES, PACKAGE_SUFFIX)
_URL_PATTERN = re.compile("[A-Za-z][A-Za-z0-9+.-]+:")
_ABSOLUTE_PATH_PATTERN = re.compile(r"[/\\]|[A-Za-z]:")
_DISPLAY_WIDTH = 80

LayerLocation = tuple[str, str]  # the full path of a file, and for a package the layer in it, else ""


class UsdFileClosure:
    """The copies of all files of which the USD file `text` consists. Raises UsdError if a file cannot be read.

    `path`: the copy of the USD file in the private `folder`.
    `hashes`: the hashes of all files, by their names in a scene.
    `size`: the total size of all files in bytes.
    The copies are deleted together with this object."""

    def __init__(self, roots: Roots, text: str) -> None:
        self.text, self.size = text, 0
        self.hashes: dict[str, str] = {}
        self._roots = roots
        self._folders = {name: os.path.abspath(folder) for name, folder in (("", roots.folder), *roots.folder_by_name.items())}
        self._files: dict[str, str] = {}  # the name of each file, by its full path
        self._packages: dict[str, dict[str, bytes]] = {}
        try:
            self.folder = os.path.realpath(client.create_reader_folder())
        except OSError as problem:
            words = f"`{text}` cannot be read: there is no folder for temporary files ({(problem.strerror or '').lower()})"
            raise UsdError("bad-usd", words, "set TMPDIR to a folder with room", "usd") from None
        weakref.finalize(self, shutil.rmtree, self.folder, True)
        self._top_path = self._make_full_path(text, None)
        self.path = self._collect_files(text)

    @property
    def closure_digest(self) -> str:
        """Return a hash of the names and contents of all files."""
        return blake2b(repr(sorted(self.hashes.items())).encode(), digest_size=16).hexdigest()

    def _collect_files(self, text: str) -> str:
        """Copy the file and all files that it refers to. Return the path of the file's copy."""
        waiting = [self._copy_file(text, None)]
        known_places = set(waiting)
        while waiting:
            place = waiting.pop()
            for layer_place in self._find_named_files(place):
                if layer_place not in known_places:
                    known_places.add(layer_place)
                    waiting.append(layer_place)
                    if len(known_places) > limits.MAX_USD_LAYERS:
                        raise self._make_size_error(text)
        return self._make_copy_path(self._top_path)

    def _make_copy_path(self, path: str) -> str:
        """Return the path of a file's copy. The copy need not exist."""
        try:
            below = os.path.relpath(path, os.path.commonpath([*self._folders.values()]))
        except ValueError:  # the files may be on several drives
            drive, rest = os.path.splitdrive(path)
            below = os.path.join(re.sub("[^A-Za-z0-9]", "_", drive), rest.lstrip("/\\"))
        return os.path.join(self.folder, below)

    def _make_full_path(self, text: str, naming_layer: LayerLocation | None) -> str:
        """Return the full path of a file with the name `text` in a scene. Only the text is checked. `naming_layer`: the layer
        that names the file; None for the scene."""
        if not text.lower().endswith(USD_SUFFIXES):
            raise UsdError(
                "bad-usd",
                f"`{_shorten_text(text)}`{_describe_naming_layer(naming_layer)} is not one of {', '.join(USD_SUFFIXES)}",
                None,
                "usd",
            )
        try:
            return os.path.abspath(self._roots.resolve_path(text))
        except PathRefused as error:
            raise _make_refusal_error(error, naming_layer) from None

    def _copy_file(self, text: str, naming_layer: LayerLocation | None) -> LayerLocation:
        """Copy a file and return the location of the copy. `text`: its name in a scene. `naming_layer`: the layer that names the
        file; None for the scene."""
        path = self._make_full_path(text, naming_layer)
        if path not in self._files:
            try:
                data = self._roots.read_file(text, limits.MAX_MESH_BYTES)
            except PathRefused as error:
                raise _make_refusal_error(error, naming_layer) from None
            self.size += len(data)
            if len(self._files) >= limits.MAX_USD_LAYERS or self.size > 4 * limits.MAX_MESH_BYTES:
                raise self._make_size_error(text)
            self._files[path] = text
            self.hashes[text] = blake2b(data, digest_size=16).hexdigest()
            if text.lower().endswith(PACKAGE_SUFFIX):
                data = self._unpack_package(path, text, data)
            self._write_copy(Path(self._make_copy_path(path)), data)
        return path, next(iter(self._packages.get(path, [""])))

    def _unpack_package(self, path: str, text: str, data: bytes) -> bytes:
        try:
            self._packages[path] = read_layers(data)
        except PackageError as error:
            raise UsdError("bad-usd", f"the package `{text}` {error}", "export it again", "usd") from None
        return make_package(self._packages[path])

    def _write_copy(self, path: Path, data: bytes) -> None:
        try:
            path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            with open(path, "xb") as file:
                file.write(data)
        except OSError as problem:
            words = f"`{self.text}` cannot be copied to be read: {(problem.strerror or 'it cannot be written').lower()}"
            raise UsdError("bad-usd", words, "set TMPDIR to a folder with room", "usd") from None

    def _find_named_files(self, layer: LayerLocation) -> Iterator[LayerLocation]:
        """Yield the files, or the layers in the same package, that a layer names."""
        path, inside = layer
        copy, name = self._make_copy_path(path), f"{self._files[path]}{f'[{inside}]' if inside else ''}"
        document = {"path": f"{copy}[{inside}]" if inside else copy, "folder": self.folder, "text": name}
        digest = blake2b(f"{self.hashes[self._files[path]]} {inside}".encode(), digest_size=16).hexdigest()
        for asset in self._read_assets(document, name, digest):
            yield self._find_package_layer(layer, asset) if inside else self._find_file(layer, asset)

    def _read_assets(self, document: dict[str, str], name: str, digest: str) -> list[str]:
        try:
            return client.send_request("usd-layer", document, file_bytes=self.size, request_digest=digest).require_texts("assets")
        except RefusalError as error:
            if error.subject == "exception":
                raise UsdError("bad-usd", f"`{name}` cannot be read as USD: {error}", error.help, "usd") from None
            raise UsdError(error.code, str(error), error.help, "usd") from None
        except client.ReaderFailureError as error:
            raise UsdError("bad-usd", f"`{name}` {error}", error.help, "usd") from None
        except ProtocolError as error:
            raise UsdError("bad-usd", f"`{name}` cannot be read: {error}", "export it again", "usd") from None

    def _find_package_layer(self, layer: LayerLocation, asset: str) -> LayerLocation:
        """Return the layer to which another layer of the same package refers."""
        path, inside = layer
        target = posixpath.normpath(posixpath.join(posixpath.dirname(inside), asset))
        parts = self._packages[path]
        if target not in parts and not asset.startswith("."):
            target = posixpath.normpath(asset)  # USD searches next to the layer, then at the package's top
        if target not in parts or _ABSOLUTE_PATH_PATTERN.match(asset):
            words = f"`{_shorten_text(asset)}`{_describe_naming_layer(layer)} is not a layer of that package"
            raise UsdError("bad-path", words, "package all files together, for example with `usdzip`", "usd")
        return path, target

    def _find_file(self, layer: LayerLocation, asset: str) -> LayerLocation:
        """Copy a file that a layer refers to, and return the location of the copy.

        Raises UsdError for a URL, and for a text that USD would evaluate when it opens the file."""
        named = f"`{_shorten_text(asset)}`{_describe_naming_layer(layer)}"
        if "`" in asset or ":SDF_FORMAT_ARGS:" in asset:
            raise UsdError("bad-path", f"{named} is an expression, not a file", "write the path in full", "usd")
        if _URL_PATTERN.match(asset):
            raise UsdError("bad-path", f"{named} is an address, not a file", "copy the file next to the others", "usd")
        outer, mark, inner = asset.partition("[")
        if _ABSOLUTE_PATH_PATTERN.match(asset):
            self._reject_path_outside_roots(named)
        file_place = self._copy_file(self._resolve_name(layer[0], outer, named), layer)
        if not mark:
            return file_place
        if file_place[0] not in self._packages or inner.removesuffix("]") not in self._packages[file_place[0]]:
            raise UsdError("bad-path", f"{named} is not a layer of a package", "name the package alone", "usd")
        return file_place[0], inner.removesuffix("]")

    def _resolve_name(self, path: str, asset: str, asset_path: str) -> str:
        """Return the name of the file that USD would find for an asset path. USD searches relative to the layer first, then
        relative to the top layer."""
        folders = [os.path.dirname(path)] + ([] if asset.startswith(".") else [os.path.dirname(self._top_path)])
        names = [self._find_scene_name(os.path.normpath(os.path.join(folder, asset))) for folder in folders]
        inside = [name for name in names if name is not None]
        if not inside:
            self._reject_path_outside_roots(asset_path)
        return next((name for name in inside if self._has_file(name)), inside[0])

    def _has_file(self, name: str) -> bool:
        """Return whether a file with this name exists below a root. The result is also True if it cannot be read; the reader
        reports the reason later."""
        try:
            return self._roots.measure_file_size(name) >= 0
        except PathRefused as error:
            return error.code != "no-such-file"

    def _reject_path_outside_roots(self, asset_path: str) -> NoReturn:
        message = f"{asset_path} lies outside the scene's folder and of every granted root, or is absolute"
        help = "write a path relative to the file, and grant its folder with `--root NAME=FOLDER`, or copy the file"
        raise UsdError("bad-path", message, help, "usd")

    def _find_scene_name(self, path: str) -> str | None:
        """Return the name by which a scene would refer to a file, or None for a file outside all roots. The result depends only
        on the path. The disk is not accessed."""
        for name, folder in self._folders.items():
            if path.startswith(folder.rstrip(os.sep) + os.sep):
                below = Path(path).relative_to(folder).as_posix()
                return f"{name}:{below}" if name else below
        return None

    def _make_size_error(self, text: str) -> UsdError:
        return UsdError("too-large", f"`{text}` and the files that it uses are larger than the limit", None, "usd")


def _make_refusal_error(refusal: PathRefused, naming_layer: LayerLocation | None) -> UsdError:
    return UsdError(
        refusal.code,
        f"{refusal} (named by {_format_layer_name(naming_layer)})" if naming_layer else str(refusal),
        refusal.help,
        "usd",
    )


def _describe_naming_layer(layer: LayerLocation | None) -> str:
    """Return words about the layer that names a file. In a message, they follow the file's name and precede the problem."""
    return f", named by {_format_layer_name(layer)}," if layer else ""


def _format_layer_name(layer: LayerLocation) -> str:
    name = posixpath.basename(layer[1]) or os.path.basename(layer[0])
    return f"`{clean_for_display(name[:_DISPLAY_WIDTH])}`"


def _shorten_text(text: str) -> str:
    return clean_for_display(text if len(text) <= _DISPLAY_WIDTH else text[: _DISPLAY_WIDTH - 3] + "…")


class PackageError(Exception):
    """Error for a package that cannot be read. The message is a reason that fits after the package's name."""


def read_layers(data: bytes) -> dict[str, bytes]:
    """Return the layers of a package by name. The first one is the root layer. Other members, such as textures, are omitted.

    Raises PackageError if the data is not a package or contains a forbidden member."""
    _check_end(data)
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return _read_archive_layers(archive, len(data))
    except (zipfile.BadZipFile, EOFError, NotImplementedError, RuntimeError, ValueError, OverflowError, struct.error):
        raise PackageError("is damaged, or not a zip file") from None


def _check_end(data: bytes) -> None:
    """Check the number of members in a package, and the size of its directory, against the limits. This happens before any
    member is read. Raises PackageError if a limit is exceeded."""
    place = data.rfind(b"PK\5\6", max(0, len(data) - _END_RECORD_STRUCT.size - 0xFFFF))
    if place < 0 or place + _END_RECORD_STRUCT.size > len(data):
        raise PackageError("is damaged, or not a zip file")
    _, _, _, _, count, size, _, _ = _END_RECORD_STRUCT.unpack_from(data, place)
    if count > limits.MAX_PACKAGE_FILES or size > 512 * limits.MAX_PACKAGE_FILES:
        raise PackageError(f"has {count:,} members, and more than {limits.MAX_PACKAGE_FILES:,} are not read")


def _read_archive_layers(archive: zipfile.ZipFile, size: int) -> dict[str, bytes]:
    entries = archive.infolist()
    if len(entries) > limits.MAX_PACKAGE_FILES:
        raise PackageError(f"has {len(entries):,} members, and more than {limits.MAX_PACKAGE_FILES:,} are not read")
    if sum(entry.file_size for entry in entries) > size:
        raise PackageError("declares more data than its size")
    known_names: set[str] = set()
    for entry in entries:
        _check_member(entry, known_names)
    layers = [entry for entry in entries if entry.filename.lower().endswith(LAYER_SUFFIXES)]
    if not layers or layers[0] is not entries[0]:
        raise PackageError("does not begin with a layer")
    return {entry.filename: archive.read(entry) for entry in layers}  # reading verifies the checksum


def _check_member(entry: zipfile.ZipInfo, known_names: set[str]) -> None:
    name = entry.orig_filename
    display_name = f"`{clean_for_display(name[:60])}`"
    parts = name.removesuffix("/").split("/")
    if not all(_MEMBER_NAME_PATTERN.fullmatch(part) and part not in (".", "..") for part in parts) or len(name) > 4096:
        raise PackageError(f"has a member {display_name} with a name that is absolute, leaves the package or is not a plain name")
    if posixpath.normcase(name) in known_names:
        raise PackageError(f"has two members {display_name}")
    known_names.add(name)
    if entry.flag_bits & 0x41:
        raise PackageError(f"has an encrypted member {display_name}")
    if entry.compress_type != zipfile.ZIP_STORED or entry.compress_size != entry.file_size:
        raise PackageError(f"has a compressed member {display_name}, but a .usdz must not be compressed")
    kind = entry.external_attr >> 28
    if kind not in (0, 4, 8):  # Unix file types: none given, folder, regular file
        raise PackageError(f"has a member {display_name} that is a link or a device")


def make_package(layers: dict[str, bytes]) -> bytes:
    """Return the bytes of a package with the given layers."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
        for name, data in layers.items():
            entry = zipfile.ZipInfo(name)
            begin = file.tell() + 30 + len(name.encode()) + 4
            padding = -begin % _MEMBER_ALIGNMENT_BYTES
            entry.extra = struct.pack("<HH", _PADDING_FIELD_ID, padding) + bytes(padding)
            archive.writestr(entry, data)
    return file.getvalue()
