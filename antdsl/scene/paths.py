"""The only interface to the files that a scene or a program names. Files must be below the scene's own folder or a granted root.

A path is checked as text before the disk is accessed. Then it is opened component by component, without following links."""

from __future__ import annotations

import os
import re
import unicodedata
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path

from antdsl.safe_read import FileTooLargeError, NotRegularFileError, open_regular_file, read_handle

_WINDOWS_DEVICE_NAMES = frozenset(
    ["con", "prn", "aux", "nul", "conin$", "conout$", *(f"{name}{i}" for name in ("com", "lpt") for i in "0123456789¹²³")]
)
_VARIABLE_PATTERN = re.compile(r"\$(?:[A-Za-z_][A-Za-z0-9_]*|\{[^}/]*\}?|\([^)/]*\)?)|%[A-Za-z_][A-Za-z0-9_]*%")
_FRAME_COUNTER_PATTERN = re.compile("%0?[0-9]*d")  # programs replace it by the number of a frame, with the format of C
_WILDCARD_CHARACTERS = "*?[]{}`"
_WINDOWS_FORBIDDEN_CHARACTERS = '<>:"|'  # not allowed in names on Windows
_INVISIBLE_CATEGORIES = frozenset(
    ["Cc", "Cs", "Zl", "Zp"]
)  # categories of invisible characters: control characters, surrogates, line separators
GRANTED_PATH_PATTERN = re.compile(r"([A-Za-z][A-Za-z0-9_]{1,31}):(?!//)(.*)", re.DOTALL)
_MAX_PATH_CHARACTERS = 500
RequestedPaths = dict[Path, Path | None]
_requested_paths: ContextVar[RequestedPaths | None] = ContextVar("sought", default=None)
_SEQUENCE_PATTERN = re.compile("([^#]*?)(#{1,9})([^#/]*)")


class PathRefused(Exception):
    """Error for a path that may not be opened. The exception's text is the message of the diagnostic.

    `code`: the code of the diagnostic. `help`: what to write instead."""

    def __init__(self, code: str, message: str, help: str | None = None) -> None:
        super().__init__(message)
        self.code, self.message, self.help = code, message, help


@contextmanager
def record_requested_paths() -> Iterator[RequestedPaths]:
    """Record all files that are requested through this module within the context, in order, whether they exist or not.

    It yields a mapping from each path to the root folder that must contain it, or to None if the user named the file. Links
    below the root are not followed."""
    sought_files: RequestedPaths = {}
    token = _requested_paths.set(sought_files)
    try:
        yield sought_files
    finally:
        _requested_paths.reset(token)
        for path, root in sought_files.items():
            record_request(path, root)  # an outer context also records them


@dataclass(frozen=True, slots=True)
class Roots:
    """The folders from which files may be read: the scene's folder, and folders that the user grants by name (`--root
    assets=PATH`)."""

    folder: Path
    folder_by_name: Mapping[str, Path] = field(default_factory=dict)

    def split_path(self, text: str) -> tuple[Path, tuple[str, ...]]:
        """Return the root of a path, and its components below the root. The disk is not accessed.

        Raises PathRefused unless the text is a path below one of the roots."""
        named = GRANTED_PATH_PATTERN.fullmatch(text)
        if named and len(named[1]) > 1:
            name, rest = named[1], named[2]
            if name in ("http", "https", "file", "ftp", "data"):
                raise _make_refusal(text, "is an address, not a file", "copy the file next to the scene")
            if name not in self.folder_by_name:
                known = ", ".join(f"`{n}:`" for n in sorted(self.folder_by_name)) or "none"
                raise PathRefused(
                    "root-not-granted", f"no root `{name}:` is granted (granted: {known})", f"run with `--root {name}=FOLDER`"
                )
            return self.folder_by_name[name], _split_path(text, rest)
        return self.folder, _split_path(text, text)

    def resolve_path(self, text: str) -> Path:
        """Return the full path of a file. Only the text is checked; the disk is not accessed."""
        root, parts = self.split_path(text)
        return root.joinpath(*parts)

    def read_file(self, text: str, max_bytes: int) -> bytes:
        """Return the bytes of a regular file of at most `max_bytes` bytes. Raises PathRefused with the reason."""
        return _read_all(self.open_file(text), text, max_bytes)

    def open_file(self, text: str) -> int:
        """Return a file descriptor of a regular file, which the caller must close. Raises PathRefused with the reason."""
        root, parts = self.split_path(text)
        record_request(root.joinpath(*parts), root)
        return _open_below(root, parts, text)

    def find_folder(self, text: str) -> Path:
        """Return the full path of a folder. No component may be a link. Raises PathRefused with the reason."""
        root, parts = self.split_path(text)
        _list_names_below(root, parts, text)
        return root.joinpath(*parts)

    def measure_file_size(self, text: str) -> int:
        """Return the size of a regular file in bytes, without reading it. Raises PathRefused with the reason."""
        handle = self.open_file(text)
        try:
            return os.fstat(handle).st_size
        finally:
            os.close(handle)

    def is_sequence(self, text: str) -> bool:
        """Return whether the `#` signs in a path stand for a frame number. They do not if a file has exactly this name."""
        if "#" not in text:
            return False
        try:
            self.measure_file_size(text)
        except PathRefused as error:
            return error.code == "no-such-file"
        return False

    def find_sequence(self, text: str) -> dict[int, str]:
        """Return, by frame, the files of a path such as `walls.####.ply`. The `#` signs stand for the frame number, padded with
        zeros.

        Raises PathRefused if there is no such file, or if the path is not allowed."""
        named = _SEQUENCE_PATTERN.fullmatch(text)
        if named is None:
            raise _make_refusal(text, "has `#` outside its file name, or in two places", "write `walls.####.ply`")
        root, parts = self.split_path(f"{named[1]}{0:0{len(named[2])}d}{named[3]}")
        start = parts[-1][: len(parts[-1]) - len(named[2]) - len(named[3])]
        files_by_frame = {}
        for name in _list_names_below(root, parts[:-1], text):
            digits = name[len(start) : len(name) - len(named[3])]
            fits = name.startswith(start) and name.endswith(named[3]) and re.fullmatch("-?[0-9]{1,9}", digits, re.ASCII)
            if fits and digits == f"{int(digits):0{len(named[2]) + (digits[0] == '-')}d}":
                files_by_frame[int(digits)] = f"{named[1]}{digits}{named[3]}"
        if not files_by_frame:
            raise PathRefused("no-such-file", f"there is no file `{text}`, and none with a number for `{named[2]}`", None)
        return dict(sorted(files_by_frame.items()))


def read_user_file(path: Path, max_bytes: int) -> bytes:
    """Return the bytes of a file that the user named on the command line, which may have at most `max_bytes` bytes. Links are
    followed.

    Anything but a regular file is an error."""
    display_path = str(path)
    record_request(path, None)
    try:
        handle = open_regular_file(path)
    except FileNotFoundError:
        raise PathRefused("no-such-file", f"there is no file `{display_path}`") from None
    except OSError as problem:
        raise _make_read_refusal(problem, display_path) from None
    return _read_all(handle, display_path, max_bytes)


def reopen_file(path: Path, root: Path | None) -> int:
    """Open a regular file again to check whether it has changed since the first request. Return the file descriptor, which the
    caller must close."""
    if root is None:
        return open_regular_file(path)
    try:
        return _open_below(root, path.relative_to(root).parts, path.name)
    except PathRefused as error:
        raise OSError(str(error)) from None


def record_request(path: Path, root: Path | None) -> None:
    """Record a request for a file while `record_requested_paths` is active. A caller that uses a cached result instead of the
    file must call this, too."""
    sought_files = _requested_paths.get()
    if sought_files is not None:
        sought_files[path] = root


def _read_all(handle: int, display_path: str, max_bytes: int) -> bytes:
    """Return all bytes of an open regular file, and close it. `handle`: the file descriptor.

    More than `max_bytes` bytes are an error, even if the file grows while it is being read."""
    try:
        return read_handle(handle, max_bytes)
    except OSError as problem:
        raise _make_read_refusal(problem, display_path) from None


def _make_refusal(text: str, reason: str, help: str | None) -> PathRefused:
    display_text = text if len(text) <= 80 else text[:77] + "…"
    return PathRefused("bad-path", f"the path `{display_text}` {reason}", help)


def _split_path(text: str, relative_text: str) -> tuple[str, ...]:
    inside = "write a path below the scene's folder, such as `meshes/ground.ply`"
    granted = "put the file below the scene's folder, or grant its folder: `--root assets=FOLDER` and `assets:…`"
    if not relative_text or len(relative_text) > _MAX_PATH_CHARACTERS:
        raise _make_refusal(text, "is empty" if not relative_text else "is too long", inside)
    if "\\" in relative_text:
        raise _make_refusal(text, "has a backslash", "write `/` between folders")
    if relative_text.startswith("/") or re.match("[A-Za-z]:", relative_text):
        raise _make_refusal(text, "is absolute", granted)
    _check_characters(text, relative_text)
    parts = tuple(p for p in relative_text.split("/") if p != ".")
    for part in parts:
        if part == "..":
            raise _make_refusal(text, "leaves its folder", granted)
        if not part:
            raise _make_refusal(text, "has a `/` with no name before or after it", inside)
        if part[-1] in ". " or part[0] == " ":
            where = "begins with a space" if part[0] == " " else f"ends with a {'dot' if part[-1] == '.' else 'blank'}"
            raise _make_refusal(text, f"has a name that {where}, which Windows drops", f"rename `{part}`")
        if part.split(".")[0].rstrip(" ").lower() in _WINDOWS_DEVICE_NAMES:
            raise _make_refusal(text, "names a device", f"rename `{part}`: Windows has a device of that name")
    if not parts:
        raise _make_refusal(text, "names no file", inside)
    return parts


def _check_characters(text: str, relative_text: str) -> None:
    """Raise PathRefused if a path has characters that are invalid in file names on some system, or that a shell would expand."""
    if relative_text.startswith("~"):
        raise _make_refusal(
            text, "begins with `~`, which is not expanded here", "write a path below the scene's folder, or `./~…`"
        )
    if match := _FRAME_COUNTER_PATTERN.search(relative_text):
        raise _make_refusal(text, f"has `{match[0]}`, which is not expanded here", "write `####` for the number of a frame")
    if match := _VARIABLE_PATTERN.search(relative_text):
        help = "write the path below the scene's folder, or rename the file without this sign"
        raise _make_refusal(text, f"has `{match[0]}`, but variables are not expanded here", help)
    for sign in relative_text:
        display_sign = "a backtick" if sign == "`" else f"`{sign}`"
        if sign in _WINDOWS_FORBIDDEN_CHARACTERS:
            raise _make_refusal(
                text, f"has {display_sign}, which no name on Windows can have", f"rename the file without {display_sign}"
            )
        if sign in _WILDCARD_CHARACTERS:
            help = f"name one file; rename a file that has {display_sign} in its name"
            raise _make_refusal(text, f"has {display_sign}, but patterns are not expanded here", help)
        if unicodedata.category(sign) in _INVISIBLE_CATEGORIES:
            raise _make_refusal(text, f"has an invisible character, U+{ord(sign):04X}", "rename the file without it")


def _make_read_refusal(problem: OSError, display_path: str) -> PathRefused:
    """Return the error for an existing file that cannot be read."""
    if isinstance(problem, NotRegularFileError):
        return PathRefused("not-a-file", f"`{display_path}` is {problem.kind}", "name a file")
    if isinstance(problem, FileTooLargeError):
        return PathRefused(
            "too-large", f"`{display_path}` has {problem.size:,} bytes, and more than {problem.cap:,} are not read"
        )
    return PathRefused("no-such-file", f"cannot open `{display_path}`: {(problem.strerror or 'access denied').lower()}")


def _open_below(root: Path, parts: tuple[str, ...], display_path: str) -> int:
    """Return a file descriptor of a file below a root. No component of the path may be a link.

    Without `dir_fd` (Windows), the resolved path is compared with the root instead."""
    if os.open not in os.supports_dir_fd or not hasattr(os, "O_NOFOLLOW"):
        full_path = root.joinpath(*parts)
        if not full_path.resolve().is_relative_to(root.resolve()):
            raise _make_refusal(display_path, "leaves its folder through a link", None)
        try:
            return open_regular_file(full_path)
        except OSError as problem:
            raise _make_open_refusal(problem, os.fspath(full_path.parent), display_path) from None
    folder = _open_folder_below(root, parts[:-1], display_path)
    try:
        _check_exact_name(folder, parts[-1], display_path)
        return open_regular_file(parts[-1], follows_links=False, folder=folder)
    except OSError as problem:
        raise _make_open_refusal(problem, folder, display_path) from None
    finally:
        os.close(folder)


def _open_folder_below(root: Path, parts: tuple[str, ...], display_path: str) -> int:
    """Return a file descriptor of a folder below a root, which is opened component by component."""
    try:
        opened = [os.open(root, os.O_RDONLY | os.O_DIRECTORY)]
    except OSError:
        raise PathRefused("no-such-file", f"there is no folder `{root}`") from None
    try:
        for part in parts:
            _check_exact_name(opened[-1], part, display_path)
            opened.append(os.open(part, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW, dir_fd=opened[-1]))
        return opened.pop()
    except OSError as problem:
        raise _make_open_refusal(problem, opened[-1], display_path) from None
    finally:
        for handle in opened:
            os.close(handle)


def _list_names_below(root: Path, parts: tuple[str, ...], display_path: str) -> list[str]:
    """Return the names in a folder below a root."""
    if os.open not in os.supports_dir_fd or not hasattr(os, "O_NOFOLLOW"):
        full_path = root.joinpath(*parts)
        if not full_path.resolve().is_relative_to(root.resolve()) or not full_path.is_dir():
            raise _make_refusal(display_path, "leaves its folder through a link, or is not a folder", None)
        return os.listdir(full_path)
    folder = _open_folder_below(root, parts, display_path)
    try:
        return os.listdir(folder)
    finally:
        os.close(folder)


def _check_exact_name(folder: int, component: str, display_path: str) -> None:
    """Raise PathRefused for a name that differs in case from the file's real name. A case-insensitive file system would open the
    file, but another system would not."""
    if _is_exact_name(folder, component):
        return
    names = os.listdir(folder)
    if component not in names:
        alike = sorted(name for name in names if name.lower() == component.lower())
        if alike:
            raise PathRefused(
                "no-such-file", f"there is no file `{display_path}`; `{alike[0]}` differs by case only", f"write `{alike[0]}`"
            )


def _is_exact_name(folder: int, component: str) -> bool:
    """Return whether a file certainly has exactly this name. False means that there is no such file, or that the same name in
    another case exists too.

    The folder is not listed, because it may contain thousands of files."""
    other = "".join(c.swapcase() if c.isascii() else c for c in component)
    if other == component:
        return False
    try:
        os.stat(component, dir_fd=folder, follow_symlinks=False)
    except OSError:
        return False
    try:
        os.stat(other, dir_fd=folder, follow_symlinks=False)
    except FileNotFoundError:
        return True
    except OSError:
        return False
    return False


def _make_open_refusal(problem: OSError, folder: int | str, display_path: str) -> PathRefused:
    import errno

    if problem.errno == errno.ENOENT:
        from antdsl.diagnostics.suggestion import find_nearest_name

        near = find_nearest_name(display_path.rsplit("/", 1)[-1], sorted(os.listdir(folder))[:2000])
        return PathRefused("no-such-file", f"there is no file `{display_path}`", f"did you mean `{near}`?" if near else None)
    if problem.errno in (errno.ELOOP, errno.ENOTDIR):
        return PathRefused(
            "bad-path",
            f"a part of `{display_path}` is a link or not a folder; antdsl does not follow links",
            "name the file itself",
        )
    return _make_read_refusal(problem, display_path)
