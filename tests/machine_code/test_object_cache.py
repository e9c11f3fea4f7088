"""Machine code stored from run to run: what was put comes back, nothing is loaded that this user's antdsl did not write on this
machine, and no trouble with files ends a run."""

from __future__ import annotations

import errno
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from children import child_environment
from compilers import need_llvmlite

from antdsl import user_folders
from antdsl.machine_code import object_cache, signing
from antdsl.machine_code.llvm_compiler import Target, compile_object, find_host_target, load_object
from antdsl.machine_code.object_cache import CACHE_VARIABLE, ObjectCache, compute_object_key, list_environment_versions

TARGET = Target("x86_64-unknown-linux-gnu", "znver1", "+avx2,-fma")
KEY, OTHER = (compute_object_key(text, TARGET, versions=("1",)) for text in ("one", "other"))
CODE = bytes(range(256)) * 8
rights = pytest.mark.skipif(not hasattr(os, "geteuid"), reason="this system says in other ways who may write")


@pytest.fixture(autouse=True)
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A home folder of the password database, next to a working directory that HOME and XDG_CACHE_HOME name."""
    for name in ("project", "home"):
        (tmp_path / name).mkdir(mode=0o700)
    monkeypatch.chdir(tmp_path / "project")
    monkeypatch.delenv(CACHE_VARIABLE, raising=False)
    for name in ("HOME", "USERPROFILE", "LOCALAPPDATA", "XDG_CACHE_HOME", "XDG_STATE_HOME"):
        monkeypatch.setenv(name, str(tmp_path / "project"))
    monkeypatch.setattr(user_folders, "home_folder", lambda: tmp_path / "home")
    monkeypatch.setattr(user_folders, "_find_local_app_data", lambda: tmp_path / "home")
    return tmp_path / "home"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "stored"


@pytest.fixture
def place(folder: Path) -> Path:
    """The file that has CODE under KEY."""
    cache = ObjectCache(folder)
    cache.store_bytes(KEY, CODE)
    assert ObjectCache(folder).get(KEY) == CODE
    assert cache.messages == []
    return file_of(folder, KEY)


def file_of(folder: Path, key: str) -> Path:
    """Where a key's object file is stored."""
    signer = signing.get_signer(create=True)
    assert signer is not None
    return folder / f"{signer.make_file_name(key)}.object"


def refused(folder: Path, why: str) -> ObjectCache:
    """A cache that gives nothing for KEY and says why once."""
    cache = ObjectCache(folder)
    assert cache.get(KEY) is None
    assert len(cache.messages) == 1 and why in cache.messages[0], cache.messages
    cache.get(KEY)
    return cache


def in_memory(cache: ObjectCache, why: str) -> None:
    """What is put into the cache is there for this run alone, and one message says so."""
    for _ in range(2):
        cache.store_bytes(KEY, CODE)
        assert cache.get(KEY) == CODE
    assert len(cache.messages) == 1 and why in cache.messages[0], cache.messages


def test_what_is_put_is_there_for_other_runs(folder: Path, home: Path) -> None:
    first = ObjectCache(folder / "deep")
    assert first.get(KEY) is None
    assert not folder.exists() and not list(home.iterdir()), "nothing is created by a look"
    first.store_bytes(KEY, CODE)
    first.store_bytes(OTHER, b"")
    second = ObjectCache(folder / "deep")
    assert (second.get(KEY), second.get(OTHER)) == (CODE, b"")
    assert first.messages == second.messages == []
    assert len(list((folder / "deep").iterdir())) == 2
    if hasattr(os, "geteuid"):
        assert (folder / "deep").stat().st_mode & 0o777 == 0o700
        assert signing.find_key_path().stat().st_mode & 0o777 == 0o600


def test_a_stored_object_file_runs(folder: Path) -> None:
    need_llvmlite()
    import ctypes

    text = """define void @twice(ptr %table, i64 %first, i64 %last) {
  %numbers = load ptr, ptr %table
  %at = getelementptr double, ptr %numbers, i64 %first
  %x = load double, ptr %at
  %y = fadd double %x, %x
  store double %y, ptr %at
  ret void
}"""
    name = compute_object_key(text, find_host_target(), versions=list_environment_versions())
    ObjectCache(folder).store_bytes(name, compile_object(text, find_host_target()))
    stored_code = ObjectCache(folder).get(name)
    assert stored_code is not None
    numbers = (ctypes.c_double * 2)(1.5, 2.5)
    code = load_object(stored_code)  # its functions exist as long as it does
    code.function("twice")((ctypes.c_void_p * 1)(ctypes.addressof(numbers)), 1, 2)
    assert list(numbers) == [1.5, 5.0]


def test_a_key_is_of_all_that_code_depends_on() -> None:
    need_llvmlite()

    def of(text: str, triple: str, cpu: str, features: str, *versions: str) -> str:
        return compute_object_key(text, Target(triple, cpu, features), versions=versions)

    parts = ("text", "x86_64-unknown-linux-gnu", "znver1", "+avx2", "0.1.0", "22.1.0")
    others = [(*parts[:place], parts[place] + "0", *parts[place + 1 :]) for place in range(len(parts))]
    moved = [(*parts[:place], parts[place][:-1], parts[place][-1] + parts[place + 1], *parts[place + 2 :]) for place in range(5)]
    keys = [of(*each) for each in (parts, *others, *moved, parts[:-1])]
    assert len(set(keys)) == len(keys) == 13
    assert of(*parts) == keys[0] and len(keys[0]) == 64
    assert all(list_environment_versions()) and list_environment_versions() == list_environment_versions()
    for wrong in ("", "../" + "0" * 61, "A" * 64, KEY + "\n"):
        with pytest.raises(ValueError):
            ObjectCache().get(wrong)
        with pytest.raises(ValueError):
            ObjectCache().store_bytes(wrong, b"")


def _flipped(data: bytes, at: int) -> bytes:
    return data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :]


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: _flipped(data, -1),
        lambda data: _flipped(data, 0),
        lambda data: data[:-1],
        lambda data: data + b"\0",
        lambda data: data[:20],
        lambda data: b"",
        lambda data: CODE,
        lambda data: bytes(32) + data[32:],
    ],
    ids=["code", "signature", "short", "long", "header", "empty", "bare", "zeros"],
)
def test_damaged_files_are_not_loaded_and_removed(place: Path, damage: Callable[[bytes], bytes]) -> None:
    data = place.read_bytes()
    damaged = damage(data)
    assert damaged != data
    place.write_bytes(damaged)
    cache = refused(place.parent, "damaged, or was not written by this user on this machine")
    assert not place.exists() and str(place.parent) in cache.messages[0]
    cache.store_bytes(KEY, CODE)
    assert ObjectCache(place.parent).get(KEY) == CODE


def test_the_code_of_another_program_is_not_loaded(place: Path) -> None:
    other = file_of(place.parent, OTHER)
    place.rename(other)
    cache = ObjectCache(place.parent)
    assert cache.get(OTHER) is None and "not written" in cache.messages[0] and not other.exists()


@pytest.mark.parametrize("changed", ["key", "machine", "user"])
def test_code_of_another_user_or_machine_is_not_loaded(place: Path, monkeypatch: pytest.MonkeyPatch, changed: str) -> None:
    """With a folder in common both store theirs: neither finds what the other has written, under whatever name."""
    data = place.read_bytes()
    if changed == "key":
        signing.find_key_path().write_bytes(bytes(32))
    elif changed == "machine":
        monkeypatch.setattr(signing, "find_machine_id", lambda: "another")
    elif hasattr(os, "geteuid"):
        other = os.geteuid() + 1
        monkeypatch.setattr(os, "geteuid", lambda: other)
        monkeypatch.setattr(signing, "read_private", lambda path, cap: path.read_bytes())
    cache = ObjectCache(place.parent)
    assert cache.get(KEY) is None and cache.messages == [] and place.read_bytes() == data
    file_of(place.parent, KEY).write_bytes(data)
    refused(place.parent, "not written by this user on this machine")
    cache.store_bytes(KEY, b"theirs")
    assert cache.get(KEY) == b"theirs" and place.read_bytes() == data


def test_many_bad_files_are_one_message(folder: Path) -> None:
    cache = ObjectCache(folder)
    names = [compute_object_key(str(n), TARGET, versions=()) for n in range(5)]
    for name in names:
        cache.store_bytes(name, CODE)
        file_of(folder, name).write_bytes(CODE)
    assert [cache.get(name) for name in names] == [None] * 5
    assert len(cache.messages) == 1 and not list(folder.iterdir())


def test_a_file_that_is_too_large_is_not_read(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(object_cache, "_MAX_OBJECT_BYTES", len(CODE) - 1)
    refused(place.parent, "the limit is")
    assert not place.exists()
    cache = ObjectCache(place.parent)
    in_memory(cache, "too many")
    assert not list(place.parent.iterdir())


@pytest.mark.parametrize("kind", ["link", "dangling link", "loop", "folder", "pipe"])
@rights
def test_what_is_no_regular_file_is_not_loaded(place: Path, tmp_path: Path, kind: str) -> None:
    elsewhere = tmp_path / "elsewhere"
    data = place.read_bytes()
    place.rename(elsewhere)
    if kind == "link":
        place.symlink_to(elsewhere)
    elif kind == "dangling link":
        place.symlink_to(tmp_path / "nowhere")
    elif kind == "loop":
        place.symlink_to(place)
    elif kind == "folder":
        place.mkdir()
    elif kind == "pipe":
        os.mkfifo(place)
    cache = refused(place.parent, {"folder": "a folder", "pipe": "not a regular file"}.get(kind, "a link"))
    assert os.path.lexists(place) == (kind == "folder")
    cache.store_bytes(KEY, CODE)
    assert cache.get(KEY) == CODE
    assert (ObjectCache(place.parent).get(KEY) == CODE) == (kind != "folder")
    assert elsewhere.read_bytes() == data, "what lies elsewhere is left alone"
    assert not (tmp_path / "nowhere").exists()


def test_a_hard_link_is_replaced_and_not_written_through(place: Path, tmp_path: Path) -> None:
    os.link(place, tmp_path / "elsewhere")
    data = place.read_bytes()
    cache = ObjectCache(place.parent)
    assert cache.get(KEY) == CODE and cache.messages == [], "what is signed is sound, whatever names it has"
    cache.store_bytes(KEY, b"new")
    assert (tmp_path / "elsewhere").read_bytes() == data and cache.get(KEY) == b"new"


def test_a_poisoned_folder_is_harmless_wherever_it_lies(place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In the working directory, behind a link, open to all: what is not signed is not loaded, what is signed is."""
    project = tmp_path / "project"
    shutil.copytree(place.parent, project / "code")
    (project / "code").chmod(0o777)
    (project / "link").symlink_to(project / "code")
    for named in (project / "code", project / "link"):
        monkeypatch.setenv(CACHE_VARIABLE, str(named))
        assert ObjectCache().get(KEY) == CODE
        file_of(named, KEY).write_bytes(bytes(32) + b"code of a stranger")
        refused(named, "not written by this user")
        ObjectCache().store_bytes(KEY, CODE)


def test_a_full_disk_ends_no_run(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cache = ObjectCache(folder)
    cache.prepare_folder()

    def full(part: str, path: Path) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))

    with monkeypatch.context() as patch:
        patch.setattr("antdsl.atomic_write._replace_file", full)
        in_memory(cache, "free some disk space")
    assert list(folder.iterdir()) == [], "nothing is left of what was begun"
    cache.store_bytes(KEY, CODE)
    assert ObjectCache(folder).get(KEY) == CODE


@pytest.mark.parametrize("prepared", [True, False])
@pytest.mark.parametrize("call", ["mkdir", "open", "stat", "lstat", "fstat", "scandir", "replace", "link"])
def test_whatever_the_system_refuses_ends_no_run(
    folder: Path, monkeypatch: pytest.MonkeyPatch, call: str, prepared: bool
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(errno.EROFS, os.strerror(errno.EROFS))

    if prepared:
        ObjectCache(folder).prepare_folder()
    cache = ObjectCache(folder)
    with monkeypatch.context() as patch:
        patch.setattr(os, call, refuse)
        cache.store_bytes(KEY, CODE)
        assert cache.get(KEY) == CODE
        messages = list(cache.messages)
    assert len(messages) <= 1 and all(os.strerror(errno.EROFS) in each or "private key" in each for each in messages)
    assert messages or prepared, "without a key nothing is stored"


def test_a_folder_that_is_only_read_is_read(place: Path) -> None:
    """A user who may write there nevertheless, such as root, does."""
    place.chmod(0o400)
    place.parent.chmod(0o500)
    try:
        cache = ObjectCache(place.parent)
        assert cache.get(KEY) == CODE and cache.messages == []
        cache.store_bytes(OTHER, CODE)
        assert cache.get(OTHER) == CODE
        assert bool(cache.messages) != file_of(place.parent, OTHER).exists()
    finally:
        place.parent.chmod(0o700)


@pytest.mark.parametrize("kind", ["file", "dangling link", "below a file"])
def test_a_folder_that_cannot_be_used_is_reported_once(tmp_path: Path, kind: str) -> None:
    named = tmp_path / "named"
    if kind == "dangling link":
        named.symlink_to(tmp_path / "nowhere")
    else:
        named.write_bytes(b"mine")
    in_memory(ObjectCache(named / "deep" if kind == "below a file" else named), f"not stored in `{named}")
    assert kind == "dangling link" or named.read_bytes() == b"mine"


@pytest.mark.parametrize("named", ["kept", "../kept", "~/kept", "."])
def test_a_path_that_does_not_begin_at_the_root_is_refused(monkeypatch: pytest.MonkeyPatch, named: str) -> None:
    monkeypatch.setenv(CACHE_VARIABLE, named)
    in_memory(ObjectCache(), "does not begin at the root")
    in_memory(ObjectCache(Path(named)), "does not begin at the root")
    assert not list(Path.cwd().iterdir())


def test_where_code_is_stored(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for system, usual in {"linux": ".cache", "darwin": "Library/Caches", "win32": "."}.items():
        monkeypatch.setattr(sys, "platform", system)
        assert user_folders.cache_folder() == home / usual


def test_the_home_of_the_password_database_counts_and_no_variable(tmp_path: Path, home: Path) -> None:
    ObjectCache().store_bytes(KEY, CODE)
    assert ObjectCache().get(KEY) == CODE
    assert file_of(user_folders.cache_folder() / "antdsl" / "native", KEY).is_file()
    assert signing.find_key_path() == user_folders.cache_folder() / "antdsl" / "key" and signing.find_key_path().is_relative_to(
        home
    )
    assert not list((tmp_path / "project").iterdir()), "HOME and XDG_CACHE_HOME lead here"


def test_without_a_home_code_stays_in_memory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def homeless() -> Path:
        raise FileNotFoundError(0, "the password database has no home folder for this user")

    for name in ("home_folder", "_find_local_app_data"):
        monkeypatch.setattr(user_folders, name, homeless)
    in_memory(ObjectCache(), "no home folder for this user")
    monkeypatch.setenv(CACHE_VARIABLE, str(tmp_path / "named"))
    in_memory(ObjectCache(), "no home folder for this user")
    assert not (tmp_path / "named").exists()


def test_an_empty_variable_keeps_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(CACHE_VARIABLE, "")
    cache = ObjectCache()
    cache.store_bytes(KEY, CODE)
    assert cache.get(KEY) == CODE and ObjectCache().get(KEY) is None and cache.messages == []
    assert not list((tmp_path / "home").iterdir()), "no key is created either"
    assert not list((tmp_path / "project").iterdir())


def test_memory_has_a_cap_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(CACHE_VARIABLE, "")
    monkeypatch.setattr(object_cache, "_MAX_MEMORY_BYTES", 3 * len(CODE))
    cache = ObjectCache()
    names = [compute_object_key(str(n), TARGET, versions=()) for n in range(4)]
    for name in names[:3]:
        cache.store_bytes(name, CODE)
    assert cache.get(names[0]) == CODE
    cache.store_bytes(names[3], CODE)
    assert [name for name in names if cache.get(name) is None] == [names[1]]


def test_what_was_used_longest_ago_goes_first(folder: Path) -> None:
    names = [compute_object_key(str(n), TARGET, versions=()) for n in range(6)]
    files = [file_of(folder, name) for name in names]
    size = signing.SIGNATURE_BYTES + len(CODE)
    cache = ObjectCache(folder, max_bytes=4 * size)
    for age, name in enumerate(names[:4]):
        cache.store_bytes(name, CODE)
        os.utime(files[age], (1_000 + age, 1_000 + age))
    mine = folder / "mine.object"
    mine.write_bytes(bytes(10 * size))
    os.utime(mine, (1, 1))
    left, being_written = (folder / f".{KEY[:40]}.{n:012x}.part" for n in (1, 2))
    for each in (left, being_written):
        each.write_bytes(CODE)
    os.utime(left, (time.time() - 7200,) * 2)
    assert cache.get(names[0]) == CODE  # used again
    cache.store_bytes(names[4], CODE)
    cache.store_bytes(names[5], CODE)
    assert [file.exists() for file in files] == [True, False, False, True, True, True]
    assert mine.exists() and being_written.exists() and not left.exists()
    assert cache.messages == []
    ObjectCache(folder, max_bytes=2 * size).store_bytes(names[3], CODE)
    assert files[3].exists() and sum(file.exists() for file in files) == 2
    for file in files:
        if file.exists():
            os.utime(file, (time.time() + 3600,) * 2)  # the clock went back
    ObjectCache(folder, max_bytes=size).store_bytes(names[0], CODE)
    assert [file.exists() for file in files] == [True, False, False, False, False, False]
    small = ObjectCache(folder, max_bytes=size - 1)
    small.store_bytes(KEY, CODE)
    assert "too many" in small.messages[0] and not file_of(folder, KEY).exists()


_WRITER = """
import sys
from pathlib import Path
from antdsl import user_folders
from antdsl.machine_code.llvm_compiler import Target
from antdsl.machine_code.object_cache import ObjectCache, compute_object_key

user_folders.home_folder = user_folders._find_local_app_data = lambda: Path(sys.argv[2])
names = [compute_object_key(str(n), Target("", "", ""), versions=()) for n in range(12)]
cache = ObjectCache(Path(sys.argv[1]), max_bytes=7 * 40_000)
found = 0
for turn in range(150):
    for n in (turn % 12, (turn - 1) % 12, (turn - 2) % 12):  # two of three were used a moment ago
        code = bytes([n]) * 40_000
        got = cache.get(names[n])
        assert got in (None, code)
        found += got is not None
        if got is None or turn % 3 == 0:
            cache.store_bytes(names[n], code)
assert not cache.messages, cache.messages
print(found)
"""


def test_two_processes_write_and_read_at_once(folder: Path, home: Path) -> None:
    """The cap is too small for all, so that each removes what the other reads. Both begin without a key."""
    command = [sys.executable, "-c", _WRITER, str(folder), str(home)]
    both = [
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=child_environment())
        for _ in range(2)
    ]
    for each in both:
        out, problems = each.communicate(timeout=120)
        assert each.returncode == 0, problems
        assert int(out) > 0
    assert all(place.name.endswith(".object") for place in folder.iterdir())
    assert sum(place.stat().st_size for place in folder.iterdir()) <= 7 * 40_000


def test_threads_of_a_run_share_a_cache(folder: Path) -> None:
    from concurrent.futures import ThreadPoolExecutor

    cache = ObjectCache(folder)

    def work(n: int) -> bool:
        name = compute_object_key(str(n % 4), TARGET, versions=())
        cache.store_bytes(name, bytes([n % 4]) * 10_000)
        return cache.get(name) == bytes([n % 4]) * 10_000

    with ThreadPoolExecutor(4) as pool:
        assert all(pool.map(work, range(200)))
    assert cache.messages == []
