"""Machine code kept from run to run: what was put comes back, nothing comes back that is damaged or could be another's, and no
trouble with files ends a run."""

from __future__ import annotations

import errno
import os
import stat
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from children import child_environment
from compilers import need_llvmlite

from antdsl.machine_code import object_cache
from antdsl.machine_code.machine import Target, host, load, object_code
from antdsl.machine_code.object_cache import VARIABLE, ObjectCache, key, usual_folder, versions

TARGET = Target("x86_64-unknown-linux-gnu", "znver1", "+avx2,-fma")
KEY, OTHER = (key(text, TARGET, versions=("1",)) for text in ("one", "other"))
CODE = bytes(range(256)) * 8
rights = pytest.mark.skipif(not hasattr(os, "geteuid"), reason="this system says in other ways who may write")


@pytest.fixture(autouse=True)
def _project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A working directory, and a home beside it."""
    for name in ("project", "home"):
        (tmp_path / name).mkdir(mode=0o700)
    monkeypatch.chdir(tmp_path / "project")
    for name in (VARIABLE, "XDG_CACHE_HOME", "LOCALAPPDATA"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("USERPROFILE" if sys.platform == "win32" else "HOME", str(tmp_path / "home"))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "kept"


@pytest.fixture
def place(folder: Path) -> Path:
    """The file that has CODE under KEY."""
    cache = ObjectCache(folder)
    cache.put(KEY, CODE)
    [place] = folder.iterdir()
    assert ObjectCache(folder).get(KEY) == CODE
    assert cache.told == []
    return place


def refused(folder: Path, why: str) -> ObjectCache:
    """A cache that gives nothing for KEY and says once why."""
    cache = ObjectCache(folder)
    assert cache.get(KEY) is None
    assert len(cache.told) == 1 and why in cache.told[0], cache.told
    cache.get(KEY)
    return cache


def in_memory(cache: ObjectCache, why: str) -> None:
    """What is put into the cache is there for this run alone, which is told once."""
    for _ in range(2):
        cache.put(KEY, CODE)
        assert cache.get(KEY) == CODE
    assert len(cache.told) == 1 and why in cache.told[0], cache.told


@pytest.mark.parametrize("by_handle", [True, False])
def test_what_is_put_is_there_for_other_runs(folder: Path, monkeypatch: pytest.MonkeyPatch, by_handle: bool) -> None:
    if by_handle and not object_cache._BY_HANDLE:
        pytest.skip("this system opens no folders")
    monkeypatch.setattr(object_cache, "_BY_HANDLE", by_handle)
    first = ObjectCache(folder / "deep")
    assert first.get(KEY) is None and not folder.exists(), "nothing is made by looking"
    first.put(KEY, CODE)
    first.put(OTHER, b"")
    second = ObjectCache(folder / "deep")
    assert (second.get(KEY), second.get(OTHER)) == (CODE, b"")
    assert first.told == second.told == []
    assert len(list((folder / "deep").iterdir())) == 2
    if hasattr(os, "geteuid"):
        for each in (folder, folder / "deep", *(folder / "deep").iterdir()):
            assert each.stat().st_mode & 0o777 == (0o700 if each.is_dir() else 0o600)
    (folder / "deep" / f"{KEY}.object").write_bytes(b"x")
    assert second.get(KEY) is None and "cut short" in second.told[0]
    assert not (folder / "deep" / f"{KEY}.object").exists()


def test_a_kept_object_file_runs(folder: Path) -> None:
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
    name = key(text, host(), versions=versions())
    ObjectCache(folder).put(name, object_code(text, host()))
    kept = ObjectCache(folder).get(name)
    assert kept is not None
    numbers = (ctypes.c_double * 2)(1.5, 2.5)
    code = load(kept)  # whose functions are there as long as it is
    code.function("twice")((ctypes.c_void_p * 1)(ctypes.addressof(numbers)), 1, 2)
    assert list(numbers) == [1.5, 5.0]


def test_a_key_is_of_all_that_code_depends_on() -> None:
    need_llvmlite()

    def of(text: str, triple: str, cpu: str, features: str, *versions: str) -> str:
        return key(text, Target(triple, cpu, features), versions=versions)

    parts = ("text", "x86_64-unknown-linux-gnu", "znver1", "+avx2", "0.1.0", "22.1.0")
    others = [(*parts[:place], parts[place] + "0", *parts[place + 1 :]) for place in range(len(parts))]
    moved = [(*parts[:place], parts[place][:-1], parts[place][-1] + parts[place + 1], *parts[place + 2 :]) for place in range(5)]
    keys = [of(*each) for each in (parts, *others, *moved, parts[:-1])]
    assert len(set(keys)) == len(keys) == 13
    assert of(*parts) == keys[0] and len(keys[0]) == 64
    assert all(versions()) and versions() == versions()
    for wrong in ("", "../" + "0" * 61, "A" * 64, KEY + "\n"):
        with pytest.raises(ValueError):
            ObjectCache().get(wrong)
        with pytest.raises(ValueError):
            ObjectCache().put(wrong, b"")


def _flipped(data: bytes, at: int) -> bytes:
    return data[:at] + bytes([data[at] ^ 1]) + data[at + 1 :]


@pytest.mark.parametrize(
    ("damage", "why"),
    [
        (lambda data: _flipped(data, -1), "damaged"),
        (lambda data: _flipped(data, 60), "damaged"),  # the hash
        (lambda data: _flipped(data, 44), "damaged"),  # the length
        (lambda data: _flipped(data, 12), "another program"),
        (lambda data: _flipped(data, 8), "another form"),
        (lambda data: _flipped(data, 0), "another form"),
        (lambda data: data[:-1], "damaged"),
        (lambda data: data + b"\0", "damaged"),
        (lambda data: data[:40], "cut short"),
        (lambda data: b"", "cut short"),
        (lambda data: CODE, "another form"),
    ],
    ids=["body", "hash", "length", "key", "version", "magic", "short", "long", "header", "empty", "bare"],
)
def test_damaged_files_are_not_loaded_and_go(place: Path, damage: Callable[[bytes], bytes], why: str) -> None:
    data = place.read_bytes()
    damaged = damage(data)
    assert damaged != data
    place.write_bytes(damaged)
    cache = refused(place.parent, why)
    assert not place.exists() and "removed" in cache.told[0] and str(place) in cache.told[0]
    cache.put(KEY, CODE)
    assert ObjectCache(place.parent).get(KEY) == CODE


def test_the_code_of_another_program_is_not_loaded(place: Path) -> None:
    place.rename(place.with_name(f"{OTHER}.object"))
    cache = ObjectCache(place.parent)
    assert cache.get(OTHER) is None and "another program" in cache.told[0]


def test_a_file_that_is_too_large_is_not_read(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(object_cache, "_LARGEST", len(CODE) - 1)
    refused(place.parent, "are not read")
    assert not place.exists()
    cache = ObjectCache(place.parent)
    in_memory(cache, "more than are kept")
    assert not list(place.parent.iterdir())


@pytest.mark.parametrize("way", ["link", "hard link", "folder", "pipe", "writable"])
@rights
def test_files_that_others_may_have_made_are_not_loaded(place: Path, tmp_path: Path, way: str) -> None:
    elsewhere = tmp_path / "elsewhere"
    data = place.read_bytes()
    if way == "hard link":
        os.link(place, elsewhere)
    elif way == "writable":
        place.chmod(0o620)
    else:
        place.rename(elsewhere)
    if way == "link":
        place.symlink_to(elsewhere)
    elif way == "folder":
        place.mkdir()
    elif way == "pipe":
        os.mkfifo(place)
    why = {
        "link": "a link",
        "hard link": "a link",
        "folder": "a folder",
        "pipe": "not a regular file",
        "writable": "others may write",
    }
    cache = refused(place.parent, why[way])
    assert os.path.lexists(place) == (way == "folder")
    if way != "writable":
        assert elsewhere.read_bytes() == data, "what lies elsewhere is left alone"
    cache.put(KEY, CODE)
    assert cache.get(KEY) == CODE
    assert (ObjectCache(place.parent).get(KEY) == CODE) == (way != "folder")
    if way != "writable":
        assert elsewhere.read_bytes() == data


@pytest.mark.parametrize("by_handle", [True, False])
@rights
def test_a_folder_that_is_a_link_is_not_used(
    place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, by_handle: bool
) -> None:
    monkeypatch.setattr(object_cache, "_BY_HANDLE", by_handle)
    link = tmp_path / "link"
    link.symlink_to(place.parent)
    in_memory(refused(link, f"`{link}` is a link"), "is a link")
    assert list(place.parent.iterdir()) == [place]
    (tmp_path / "file").write_bytes(b"")
    in_memory(refused(tmp_path / "file", "is no folder"), "is no folder")


@pytest.mark.parametrize(("taken_by", "why"), [("link", "is not kept"), ("folder", "others may write")])
@rights
def test_a_folder_whose_place_is_taken_meanwhile_is_not_used(
    place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, taken_by: str, why: str
) -> None:
    """Between the look at it and its opening."""
    folder, plain = place.parent, object_cache._open_folder
    other = tmp_path / "other"
    other.mkdir()
    (other / place.name).write_bytes(place.read_bytes())
    other.chmod(0o777)

    def late(opened: Any, name: str | Path, *rest: Any) -> int:
        if name == folder.name and not (tmp_path / "moved").exists():
            folder.rename(tmp_path / "moved")
            if taken_by == "link":
                folder.symlink_to(tmp_path / "moved")
            else:
                other.rename(folder)
        return plain(opened, name, *rest)

    monkeypatch.setattr(object_cache, "_open_folder", late)
    cache = ObjectCache(folder)
    assert cache.get(KEY) is None and len(cache.told) == 1 and why in cache.told[0]


@rights
def test_the_usual_folder_is_looked_at_part_by_part(tmp_path: Path) -> None:
    """What stands above it is the user's choice, and may be a link to a larger disk."""
    usual = usual_folder()
    assert usual is not None and usual.is_relative_to(tmp_path / "home")
    (tmp_path / "disk").mkdir()
    usual.parents[1].parent.mkdir(exist_ok=True)
    usual.parents[1].symlink_to(tmp_path / "disk")
    first = ObjectCache()
    first.put(KEY, CODE)
    assert ObjectCache().get(KEY) == CODE and first.told == []
    assert (tmp_path / "disk" / "antdsl" / "native" / f"{KEY}.object").is_file()
    above = tmp_path / "disk" / "antdsl"
    above.chmod(0o770)
    cache = ObjectCache()
    assert cache.get(KEY) is None and f"others may write to `{usual.parent}`" in cache.told[0]
    above.chmod(0o700)
    above.rename(tmp_path / "moved")
    above.symlink_to(tmp_path / "moved")
    cache = ObjectCache()
    assert cache.get(KEY) is None and f"`{usual.parent}` is a link" in cache.told[0]


@pytest.mark.parametrize("mode", [0o702, 0o720])
@rights
def test_a_folder_that_others_may_write_to_is_not_used(place: Path, mode: int) -> None:
    place.parent.chmod(mode)
    in_memory(refused(place.parent, "others may write"), "others may write")
    assert list(place.parent.iterdir()) == [place]
    place.parent.chmod(0o755)
    assert ObjectCache(place.parent).get(KEY) == CODE, "others may read: nothing in it is secret"


@rights
def test_a_folder_in_one_where_anybody_may_move_it_is_not_used(place: Path, tmp_path: Path) -> None:
    tmp_path.chmod(0o777)
    in_memory(refused(place.parent, "anybody may move"), "anybody may move")
    tmp_path.chmod(0o1777)
    assert ObjectCache(place.parent).get(KEY) == CODE, "as in a system's folder for temporary files"


@rights
def test_what_belongs_to_another_user_is_not_used(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = place.read_bytes()
    own = os.geteuid()
    with monkeypatch.context() as patch:
        patch.setattr(os, "geteuid", lambda: own + 1)
        in_memory(refused(place.parent, "belongs to another user"), "belongs to another user")
    assert place.read_bytes() == data

    plain_fstat, plain_stat = os.fstat, os.stat

    def foreign(about: os.stat_result) -> Any:
        """The same of another owner, where it is a file."""
        values = list(about)
        values[stat.ST_UID] += stat.S_ISREG(about.st_mode)
        return os.stat_result(values, {"st_mtime_ns": about.st_mtime_ns})

    monkeypatch.setattr(os, "fstat", lambda handle: foreign(plain_fstat(handle)))
    monkeypatch.setattr(os, "stat", lambda path, **how: foreign(plain_stat(path, **how)))
    cache = refused(place.parent, "belongs to another user")
    assert "left where it is" in cache.told[0] and place.read_bytes() == data


def test_a_full_disk_ends_no_run(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cache = ObjectCache(folder)

    def full(path: Path, data: bytes) -> int:
        with open(path, "wb") as file:
            file.write(data[:10])
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", full)
        in_memory(cache, "make room")
    assert list(folder.iterdir()) == [], "nothing is left of what was begun"
    cache.put(KEY, CODE)
    assert ObjectCache(folder).get(KEY) == CODE


@pytest.mark.parametrize("call", ["mkdir", "open", "stat", "scandir", "replace"])
def test_whatever_the_system_refuses_ends_no_run(folder: Path, monkeypatch: pytest.MonkeyPatch, call: str) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(errno.EROFS, os.strerror(errno.EROFS))

    cache = ObjectCache(folder)
    with monkeypatch.context() as patch:
        patch.setattr(os, call, refuse)
        cache.put(KEY, CODE)
        assert cache.get(KEY) == CODE
        told = list(cache.told)
    assert len(told) == 1 and os.strerror(errno.EROFS) in told[0]


def test_a_folder_that_is_only_read_is_read(place: Path) -> None:
    """Whoever may write there nevertheless, such as root, does."""
    place.chmod(0o400)
    place.parent.chmod(0o500)
    try:
        cache = ObjectCache(place.parent)
        assert cache.get(KEY) == CODE and cache.told == []
        cache.put(OTHER, CODE)
        assert cache.get(OTHER) == CODE
        assert bool(cache.told) != (place.parent / f"{OTHER}.object").exists()
    finally:
        place.parent.chmod(0o700)


@pytest.mark.parametrize("named", ["kept", "../kept", "~/kept", "."])
def test_a_path_that_does_not_begin_at_the_root_is_refused(monkeypatch: pytest.MonkeyPatch, named: str) -> None:
    monkeypatch.setenv(VARIABLE, named)
    in_memory(ObjectCache(), "does not begin at the root")
    in_memory(ObjectCache(Path(named)), "does not begin at the root")
    assert not list(Path.cwd().iterdir())


def test_a_folder_in_the_working_directory_is_refused(place: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    project = tmp_path / "project"
    for inside in (project, project / "kept", project / "deep" / "kept", tmp_path / "elsewhere" / ".." / "project" / "kept"):
        in_memory(ObjectCache(inside), "lies in the working directory")
    assert not list(project.iterdir())
    (project / "deep").mkdir()
    for name, leads_to in (("way", project), ("deep way", project / "deep")):
        (tmp_path / name).symlink_to(leads_to)
        in_memory(ObjectCache(tmp_path / name / "kept"), "lies in the working directory")
    assert list(project.rglob("*")) == [project / "deep"]
    (project / "out").symlink_to(tmp_path)
    in_memory(ObjectCache(project / "out" / "kept"), "lies in the working directory")
    assert ObjectCache(project / ".." / "kept").get(KEY) == CODE
    monkeypatch.chdir(place.parent)
    in_memory(ObjectCache(place.parent), "lies in the working directory")


def test_a_home_is_no_project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for working in (tmp_path / "home", tmp_path):
        monkeypatch.chdir(working)
        cache = ObjectCache()
        cache.put(KEY, CODE)
        assert ObjectCache().get(KEY) == CODE and cache.told == []


def test_where_code_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    home = tmp_path / "home"
    for system, usual in {"linux": ".cache", "darwin": "Library/Caches", "win32": "AppData/Local"}.items():
        monkeypatch.setattr(sys, "platform", system)
        assert usual_folder() == home / usual / "antdsl" / "native"
    monkeypatch.setenv("LOCALAPPDATA", str(tmp_path / "local"))
    assert usual_folder() == tmp_path / "local" / "antdsl" / "native"
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setenv("XDG_CACHE_HOME", "relative")
    assert usual_folder() == home / ".cache" / "antdsl" / "native"
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "xdg"))
    ObjectCache().put(KEY, CODE)
    assert (tmp_path / "xdg" / "antdsl" / "native" / f"{KEY}.object").is_file()
    monkeypatch.setenv(VARIABLE, str(tmp_path / "named"))
    ObjectCache().put(KEY, CODE)
    assert (tmp_path / "named" / f"{KEY}.object").is_file()

    def homeless() -> Path:
        raise RuntimeError

    monkeypatch.delenv(VARIABLE)
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr(Path, "home", homeless)
    in_memory(ObjectCache(), "no home folder")


def test_an_empty_variable_keeps_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "")
    cache = ObjectCache()
    cache.put(KEY, CODE)
    assert cache.get(KEY) == CODE and ObjectCache().get(KEY) is None and cache.told == []
    assert not list((tmp_path / "home").iterdir()) and not list((tmp_path / "project").iterdir())


def test_memory_has_a_cap_too(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "")
    monkeypatch.setattr(object_cache, "_IN_MEMORY", 3 * len(CODE))
    cache = ObjectCache()
    names = [key(str(n), TARGET, versions=()) for n in range(4)]
    for name in names[:3]:
        cache.put(name, CODE)
    assert cache.get(names[0]) == CODE
    cache.put(names[3], CODE)
    assert [name for name in names if cache.get(name) is None] == [names[1]]


def test_what_was_used_longest_ago_goes_first(folder: Path) -> None:
    names = [key(str(n), TARGET, versions=()) for n in range(6)]
    size = object_cache._HEADER.size + len(CODE)
    cache = ObjectCache(folder, cap=4 * size)
    for age, name in enumerate(names[:4]):
        cache.put(name, CODE)
        os.utime(folder / f"{name}.object", (1_000 + age, 1_000 + age))
    mine = folder / "mine.object"
    mine.write_bytes(bytes(10 * size))
    os.utime(mine, (1, 1))
    left, being_written = (folder / f".{KEY[:40]}.{n:012x}.part" for n in (1, 2))
    for each in (left, being_written):
        each.write_bytes(CODE)
    os.utime(left, (time.time() - 7200,) * 2)
    assert cache.get(names[0]) == CODE  # used again
    cache.put(names[4], CODE)
    cache.put(names[5], CODE)
    assert [name for name in names if not (folder / f"{name}.object").exists()] == [names[1], names[2]]
    assert mine.exists() and being_written.exists() and not left.exists()
    assert cache.told == []
    ObjectCache(folder, cap=2 * size).put(names[3], CODE)
    assert (folder / f"{names[3]}.object").exists() and len(list(folder.glob("?*.object"))) - mine.exists() == 2
    for each in folder.glob("?*.object"):
        os.utime(each, (time.time() + 3600,) * 2)  # the clock went back
    ObjectCache(folder, cap=size).put(names[0], CODE)
    assert [name for name in names if (folder / f"{name}.object").exists()] == names[:1]
    small = ObjectCache(folder, cap=size - 1)
    small.put(KEY, CODE)
    assert "more than are kept" in small.told[0] and not (folder / f"{KEY}.object").exists()


_WRITER = """
import sys
from pathlib import Path
from antdsl.machine_code.machine import Target
from antdsl.machine_code.object_cache import ObjectCache, key

names = [key(str(n), Target("", "", ""), versions=()) for n in range(12)]
cache = ObjectCache(Path(sys.argv[1]), cap=7 * 40_000)
found = 0
for turn in range(150):
    for n in (turn % 12, (turn - 1) % 12, (turn - 2) % 12):  # two of three were used a moment ago
        code = bytes([n]) * 40_000
        got = cache.get(names[n])
        assert got in (None, code)
        found += got is not None
        if got is None or turn % 3 == 0:
            cache.put(names[n], code)
assert not cache.told, cache.told
print(found)
"""


def test_two_processes_write_and_read_at_once(folder: Path) -> None:
    """The cap is too small for all, so that each removes what the other reads."""
    command = [sys.executable, "-c", _WRITER, str(folder)]
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
        name = key(str(n % 4), TARGET, versions=())
        cache.put(name, bytes([n % 4]) * 10_000)
        return cache.get(name) == bytes([n % 4]) * 10_000

    with ThreadPoolExecutor(4) as pool:
        assert all(pool.map(work, range(200)))
    assert cache.told == []
