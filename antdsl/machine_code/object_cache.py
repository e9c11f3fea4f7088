"""A cache that stores results between runs: key → bytes, in a folder or in memory. The results are mainly object files from
LLVM. Files in the folder are executed, or read by code that trusts them. So each begins with a signature that only this user's
antdsl can make on this machine (`signing`). A file without a valid signature is never used. It is removed, and the result is
computed again. Without a signing key or a folder, code stays in memory and `messages` reports why. No file system error is
raised."""

from __future__ import annotations

import errno
import os
import re
import sys
import time
from collections import OrderedDict
from contextlib import suppress
from functools import cache
from hashlib import blake2b
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Final, NamedTuple

from antdsl.atomic_write import PART_SUFFIX, write_atomically
from antdsl.diagnostics.model import replace_unprintable
from antdsl.limits import MIB
from antdsl.machine_code import signing
from antdsl.safe_read import NotRegularFileError, open_regular_file, read_handle, read_size_limited
from antdsl.user_folders import cache_folder

if TYPE_CHECKING:
    from antdsl.machine_code.llvm_compiler import Target

CACHE_VARIABLE: Final = "ANTDSL_NATIVE_CACHE"
MAX_CACHE_BYTES: Final = 256 * MIB
_MAX_MEMORY_BYTES: Final = 16 * MIB
_MAX_OBJECT_BYTES: Final = 64 * MIB  # of one object file
_KEY_PATTERN = re.compile("[0-9a-f]{64}")
_TEMPORARY_FILE_PATTERN = re.compile(
    rf"\.[0-9a-f]{{40}}\.[0-9a-f]{{12}}{re.escape(PART_SUFFIX)}"
)  # by a run that ended while it wrote
_ABANDONED_AFTER_SECONDS: Final = 3600.0  # temporary files older than this are removed
IR_VERSION: Final = "3"  # change it if the meaning of texts, or their compilation outside `llvm_compiler.py`, changes
ABI_VERSION: Final = "1"  # change it if the location of arguments or of called functions changes


class StoreKind(NamedTuple):
    """One kind of cache, with its folder and the words of its messages.

    - `folder`: its subfolder of antdsl's cache folder
    - `variable`: the environment variable that overrides the folder
    - `suffix`: the suffix of its file names
    - `name`, `verb`, `usage`, `result_noun`, `recompute_phrase`, `fallback`: words of its messages"""

    folder: str
    variable: str
    suffix: str
    name: str
    verb: str  # verb for the name: is, are
    usage: str  # how signed content is used
    result_noun: str  # noun for the subject of one result
    recompute_phrase: str  # what each run does without a cache
    fallback: str  # what happens if a file is not used


CODE_STORE: Final = StoreKind(
    "native",
    CACHE_VARIABLE,
    ".object",
    "compiled code",
    "is",
    "antdsl runs only code that it has signed with your private key",
    "one program",
    "each run compiles the code again",
    "antdsl compiles the code again",
)


def compute_object_key(text: str, target: Target, *, versions: tuple[str, ...]) -> str:
    """Return the key, 64 hexadecimal digits, of the object file for a target and the LLVM IR `text`.

    `versions` is the result of `list_environment_versions()`. The key need not contain the data layout, which follows from the
    triple and LLVM's version."""
    hashed = blake2b(digest_size=32)
    for part in (text, target.triple, target.cpu, target.features, *versions):
        data = part.encode("utf-8", "surrogatepass")
        hashed.update(len(data).to_bytes(8, "little"))  # so that parts cannot be shifted into each other
        hashed.update(data)
    return hashed.hexdigest()


@cache
def list_code_versions() -> tuple[str, ...]:
    """Return the versions of the LLVM IR, the calls, the passes and LLVM. Object files depend on these and on the target. Imports
    llvmlite."""
    import llvmlite.binding as llvm

    from antdsl.machine_code import llvm_compiler

    try:
        passes = blake2b(read_size_limited(llvm_compiler.__file__, MIB), digest_size=16).hexdigest()
    except OSError:  # an installation without sources
        passes = ""
    return IR_VERSION, ABI_VERSION, passes, ".".join(map(str, llvm.llvm_version_info))


@cache
def list_environment_versions() -> tuple[str, ...]:
    """Return the versions of `list_code_versions`, and those of antdsl, llvmlite, Python and NumPy. These may also change the
    LLVM IR or its compilation."""
    import llvmlite
    import numpy as np

    import antdsl

    python = ".".join(map(str, sys.version_info[:2]))
    return antdsl.__version__, *list_code_versions(), str(llvmlite.__version__), python, np.__version__


class ObjectCache:
    """Object files in a folder, by key. Several threads may use one cache; several processes and users may share a folder.
    Files are written atomically. A user cannot derive another user's file names.

    - `folder`: the cache folder. None means the folder that the environment variable of `kind` names, or no folder if the
      variable is empty. Without the variable, it is a subfolder of the user's cache folder.
    - `max_bytes`: the maximum size of all files together, in bytes; the least recently used are removed first
    - `max_result_bytes`: the maximum size of one result, in bytes
    - `messages`: sentences that tell the user why a result was not stored or not used; none is repeated"""

    def __init__(
        self,
        folder: Path | None = None,
        *,
        kind: StoreKind = CODE_STORE,
        max_bytes: int = MAX_CACHE_BYTES,
        max_result_bytes: int | None = None,
    ) -> None:
        self.messages: list[str] = []
        self._kind = kind
        self._max_result_bytes = _MAX_OBJECT_BYTES if max_result_bytes is None else max_result_bytes
        self._max_bytes = max_bytes
        self._memory: OrderedDict[str, bytes] = OrderedDict()
        self._lock = Lock()
        self._signer: signing.Signer | None = None
        self._folder = folder
        if folder is None and (named := os.environ.get(kind.variable)) is not None:
            self._folder = Path(named) if named else None
        elif folder is None:
            try:
                self._folder = cache_folder() / "antdsl" / kind.folder
            except OSError as problem:
                self._report_once(f"{kind.name} {kind.verb} not stored: {_describe_problem(problem)}; {kind.recompute_phrase}")
        if self._folder is not None and not self._folder.is_absolute():
            self._report_not_stored(
                self._folder, "the path does not begin at the root", f"write an absolute path in {kind.variable}"
            )
            self._folder = None

    def get(self, key: str) -> bytes | None:
        """Return the object file stored under `key`, or None. Raises ValueError if `key` does not have the form of a key."""
        _require_key(key)
        with self._lock:
            if key in self._memory:
                self._memory.move_to_end(key)
                return self._memory[key]
        signer = self._get_signer(create=False)
        return None if self._folder is None or signer is None else self._read(self._folder, signer, key)

    def store_bytes(self, key: str, code: bytes) -> None:
        """Store an object file in the folder, or in memory if there is no folder. Raises ValueError if `key` does not have the
        form of a key."""
        _require_key(key)
        signer = self._get_signer(create=True)
        if self._folder is None or signer is None or not self._write(self._folder, signer, key, code):
            with self._lock:
                self._memory[key] = code
                self._memory.move_to_end(key)
                while sum(map(len, self._memory.values())) > _MAX_MEMORY_BYTES:
                    self._memory.popitem(last=False)

    def prepare_folder(self) -> None:
        """Create the user's signing key and the folder now, so that `messages` reports errors early."""
        if self._get_signer(create=True) is not None and self._folder is not None:
            self._make_folder(self._folder)

    def _get_signer(self, *, create: bool) -> signing.Signer | None:
        """Return the user's signer, or None if there is no key. The key is read once. `create`: create a missing key. If an
        error occurs, it is reported, and the folder is not used any longer."""
        folder = self._folder
        if self._signer is None and folder is not None:
            try:
                self._signer = signing.get_signer(create=create)
            except OSError as problem:
                what = f"{self._kind.usage}, and no such key exists ({_describe_problem(problem)})"
                self._report_not_stored(folder, what, self._kind.recompute_phrase)
                self._folder = None
        return self._signer

    def _read(self, folder: Path, signer: signing.Signer, key: str) -> bytes | None:
        """Return the code stored in the file of `key`, or None if there is no file. Also return None if the file cannot be
        trusted; this is reported."""
        path = folder / (signer.make_file_name(key) + self._kind.suffix)
        try:
            handle = open_regular_file(path, follows_links=False)
            with suppress(OSError):  # a read-only disk
                os.utime(handle if os.utime in os.supports_fd else path)
            data = read_handle(handle, signing.SIGNATURE_BYTES + self._max_result_bytes)
        except FileNotFoundError:
            return None
        except OSError as problem:
            if os.path.lexists(path):  # an unreadable folder is reported by `put`
                self._reject_file(path, _describe_problem(problem))
            return None
        signature, code = data[: signing.SIGNATURE_BYTES], data[signing.SIGNATURE_BYTES :]
        if not signer.is_signed(key, code, signature):
            self._reject_file(path, "a file is damaged, or was not written by this user on this machine")
            return None
        return code

    def _write(self, folder: Path, signer: signing.Signer, key: str, code: bytes) -> bool:
        """Store code in the folder, and return whether this succeeded. A failure is reported."""
        data = signer.sign(key, code) + code
        if len(code) > self._max_result_bytes or len(data) > self._max_bytes:
            self._report_not_stored(
                folder, f"{len(code):,} bytes of {self._kind.result_noun} are too many", self._kind.recompute_phrase
            )
            return False
        name = signer.make_file_name(key) + self._kind.suffix
        if not self._make_folder(folder):
            return False
        try:
            write_atomically(folder / name, data, sync=False)
            _remove_oldest(folder, self._max_bytes, name)
        except (OSError, ValueError) as problem:
            self._report_not_stored(folder, _describe_problem(problem), self._folder_advice(problem))
            return False
        return True

    def _make_folder(self, folder: Path) -> bool:
        """Create the folder if necessary, and return whether it exists now. A failure is reported."""
        try:
            os.makedirs(folder, 0o700, exist_ok=True)
        except (OSError, ValueError) as problem:
            self._report_not_stored(folder, _describe_problem(problem), self._folder_advice(problem))
            return False
        return True

    def _folder_advice(self, problem: OSError | ValueError) -> str:
        full = isinstance(problem, OSError) and problem.errno == errno.ENOSPC
        return f"{'free some disk space, or ' if full else ''}name another folder in {self._kind.variable}"

    def _reject_file(self, path: Path, reason: str) -> None:
        """Report that a file is not used, and remove it. If it is a link, the link is removed, not its target."""
        with suppress(OSError, ValueError):
            os.unlink(path)
        kind = self._kind
        self._report_once(f"{kind.name} in {_quote_path(path.parent)} {kind.verb} not used: {reason}; {kind.fallback}")

    def _report_not_stored(self, folder: Path, reason: str, advice: str) -> None:
        self._report_once(f"{self._kind.name} {self._kind.verb} not stored in {_quote_path(folder)}: {reason}; {advice}")

    def _report_once(self, sentence: str) -> None:
        with self._lock:
            if sentence not in self.messages:
                self.messages.append(sentence)


def _remove_oldest(folder: Path, max_bytes: int, retained_name: str) -> None:
    """Remove the least recently used files until at most `max_bytes` bytes are left.

    Also remove temporary files of killed runs. The file `retained_name` and files with other suffixes are not removed. Files
    that another run removes meanwhile, or that belong to another user of a shared folder, are skipped."""
    stored_name = re.compile(f"[0-9a-f]{{64}}{re.escape(Path(retained_name).suffix)}")
    stored_files: list[tuple[int, str, int]] = []
    with os.scandir(folder) as entries:
        for entry in entries:
            stored = stored_name.fullmatch(entry.name)
            if not (stored or _TEMPORARY_FILE_PATTERN.fullmatch(entry.name)):
                continue
            with suppress(OSError):
                file_stat = entry.stat(follow_symlinks=False)
                if stored:
                    stored_files.append((file_stat.st_mtime_ns, entry.name, file_stat.st_size))
                elif time.time() - file_stat.st_mtime > _ABANDONED_AFTER_SECONDS:
                    os.unlink(entry.path)
    above = sum(size for _, _, size in stored_files) - max_bytes
    for _, name, size in sorted(stored_files):
        if above <= 0:
            break
        if name != retained_name:
            with suppress(OSError):
                os.unlink(folder / name)
            above -= size


def _require_key(key: str) -> None:
    if not _KEY_PATTERN.fullmatch(key):
        raise ValueError(f"{key!r} is not 64 hexadecimal digits")


def _describe_problem(problem: OSError | ValueError) -> str:
    if isinstance(problem, NotRegularFileError):
        return f"it is {problem.kind}"
    if isinstance(problem, OSError):
        return problem.strerror or "the system denies access"
    return "no folder can have this name"  # a path with a zero character


def _quote_path(path: Path) -> str:
    return "`" + replace_unprintable(str(path)) + "`"
