"""Kernels that are compiled in advance: the same bytes as when compiled on use, loaded from the installation only, and only by
processors that run them and by the sources and the LLVM that they were compiled from."""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from children import child_environment
from compilers import need_llvmlite

import antdsl
from antdsl.machine_code import code_cache, library, llvm_compiler, object_cache, shipped_objects
from antdsl.machine_code.build_objects import build_object_files
from antdsl.machine_code.kernels.direct import argument_text
from antdsl.machine_code.llvm_compiler import Target
from antdsl.numerics import row_copies
from antdsl.numerics.elementary_loops import write_cosines

ENTRIES: list[library.LibraryEntry] = [write_cosines, row_copies.build_llvm_text]  # type: ignore[list-item]
KERNEL = """from antdsl.machine_code.kernels import F64, kernel
from shipped_numbers import NUMBER
@kernel
def value(x: F64) -> F64:
    return 2 * x + NUMBER
"""


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The folder that stands for that of the installation, and none of the user's."""
    need_llvmlite()
    monkeypatch.setattr(shipped_objects, "OBJECTS_FOLDER", tmp_path / "objects")
    monkeypatch.setenv(object_cache.CACHE_VARIABLE, "")
    code_cache.release_unused_code()
    yield tmp_path / "objects"
    object_cache.list_code_versions.cache_clear()
    object_cache.list_environment_versions.cache_clear()
    code_cache.release_unused_code()


@pytest.fixture
def compiled(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Texts that are compiled from now on."""
    texts: list[str] = []
    compile_ = llvm_compiler.compile_object
    monkeypatch.setattr(llvm_compiler, "compile_object", lambda text, target: texts.append(text) or compile_(text, target))
    return texts


def own() -> str:
    """The name of this machine's target."""
    name = shipped_objects.find_target_name(llvm_compiler.find_host_target())
    if name is None:
        pytest.skip("no objects are shipped for this machine")
    return name


def rows() -> llvm_compiler.LoadedCode:
    """The code of a text of the package, as in a process that begins."""
    code_cache.release_unused_code()
    return row_copies.build_llvm_text.code()


def test_objects_are_what_compiling_gives(folder: Path) -> None:
    assert build_object_files(folder, ENTRIES, shipped_objects.TARGET_BY_NAME) == 2 * len(shipped_objects.TARGET_BY_NAME)
    for name, target in shipped_objects.TARGET_BY_NAME.items():
        objects = shipped_objects.ObjectFile(shipped_objects.make_objects_path(folder, name))
        assert len(objects) == len(ENTRIES)
        for entry in ENTRIES:
            code = objects.get(shipped_objects.compute_shipped_key(entry.make_text_key(target), target))
            assert code == llvm_compiler.compile_object(entry.text(target), target)
            assert code[:4] == b"\x7fELF" and int.from_bytes(code[18:20], "little") == (62 if target.is_x86 else 183)
    assert build_object_files(folder, ENTRIES, shipped_objects.TARGET_BY_NAME) == 0, "what is there is not compiled again"


_BUILD = """
import sys
from pathlib import Path
from antdsl.machine_code import shipped_objects
from antdsl.machine_code.build_objects import build_object_files
from antdsl.machine_code.kernels.direct import argument_text
from antdsl.numerics import row_copies
from antdsl.numerics.elementary_loops import write_cosines
names = reversed(list(shipped_objects.TARGET_BY_NAME))
print(build_object_files(Path(sys.argv[1]), [row_copies.build_llvm_text, write_cosines], names))
"""


def test_two_builds_give_the_same_bytes(folder: Path, tmp_path: Path) -> None:
    """In other processes, with other hashes of texts, in another order and folder."""
    build_object_files(folder, ENTRIES, shipped_objects.TARGET_BY_NAME)
    (tmp_path / "elsewhere").mkdir()
    command = [sys.executable, "-c", _BUILD, str(tmp_path / "other")]
    ran = subprocess.run(
        command, env=child_environment(PYTHONHASHSEED="7"), cwd=tmp_path / "elsewhere", capture_output=True, text=True
    )
    assert ran.stdout == f"{2 * len(shipped_objects.TARGET_BY_NAME)}\n", ran.stderr
    assert sorted(path.name for path in folder.iterdir()) == sorted(f"{name}.objects" for name in shipped_objects.TARGET_BY_NAME)
    for path in folder.iterdir():
        data = path.read_bytes()
        assert data == (tmp_path / "other" / path.name).read_bytes()
        assert str(tmp_path).encode() not in data and str(Path(antdsl.__file__).parent).encode() not in data


def test_code_of_the_installation_is_used_before_any_is_compiled(
    folder: Path, compiled: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "user").mkdir(mode=0o700)
    monkeypatch.setenv(object_cache.CACHE_VARIABLE, str(tmp_path / "user"))
    build_object_files(folder, [*ENTRIES, argument_text.build_llvm_text], [own()])  # type: ignore[list-item]
    compiled.clear()
    kernel = type(write_cosines)(write_cosines.part.function)
    code_cache.release_unused_code()
    assert kernel.has_code()
    angles = np.linspace(-7, 7, 50, dtype=np.float32)
    result, expected = np.empty_like(angles), np.empty_like(angles)
    kernel(angles, result)
    write_cosines(angles, expected)
    rows()
    assert not compiled and np.array_equal(result, expected)
    assert not list((tmp_path / "user").iterdir()) and code_cache.take_messages() == []


# Where a bit is flipped: in the head (form, hash of the index, number of entries), in the index (key, position, size, hash), and
# in the code of the first object and of the last.
BYTE_OFFSETS = {
    "form": 3,
    "index hash": 20,
    "number": 48,
    "key": 60,
    "position": 88,
    "size": 96,
    "hash": 110,
    "first": 300,
    "last": -1,
}


@pytest.mark.parametrize("place", BYTE_OFFSETS.values(), ids=BYTE_OFFSETS)
def test_a_damaged_bit_is_found_and_the_code_compiled(folder: Path, compiled: list[str], place: int) -> None:
    build_object_files(folder, [row_copies.build_llvm_text], [own()])  # type: ignore[list-item]
    path = shipped_objects.make_objects_path(folder, own())
    data = bytearray(path.read_bytes())
    data[place] ^= 1
    path.write_bytes(data)
    compiled.clear()
    assert rows().function("rows") and len(compiled) == 1
    [message] = code_cache.take_messages()
    assert "damaged" in message and str(path) in message
    path.unlink()
    build_object_files(folder, [row_copies.build_llvm_text], [own()])  # type: ignore[list-item]
    compiled.clear()
    assert rows().function("rows") and not compiled and code_cache.take_messages() == []


@pytest.mark.parametrize("kind", ["short", "head", "empty", "folder", "bare"])
def test_a_file_of_another_form_is_not_used(folder: Path, compiled: list[str], kind: str) -> None:
    build_object_files(folder, [row_copies.build_llvm_text], [own()])  # type: ignore[list-item]
    path = shipped_objects.make_objects_path(folder, own())
    data = path.read_bytes()
    path.unlink()
    if kind == "folder":
        path.mkdir()
    else:
        bare = llvm_compiler.compile_object(
            row_copies.build_llvm_text(llvm_compiler.find_host_target()), llvm_compiler.find_host_target()
        )
        path.write_bytes({"short": data[:-1], "head": data[:20], "empty": b"", "bare": bare}[kind])
    compiled.clear()
    assert rows().function("rows") and len(compiled) == 1 and len(code_cache.take_messages()) == 1


def test_without_objects_code_is_compiled_and_nothing_is_said(compiled: list[str]) -> None:
    assert rows().function("rows") and len(compiled) == 1 and code_cache.take_messages() == []


@pytest.mark.parametrize("changed", ["IR_VERSION", "ABI_VERSION", "LLVM", "passes"])
def test_code_of_another_version_is_not_used(
    folder: Path, compiled: list[str], changed: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    import llvmlite.binding as llvm

    build_object_files(folder, [row_copies.build_llvm_text], [own()])  # type: ignore[list-item]
    if changed == "LLVM":
        monkeypatch.setattr(llvm, "llvm_version_info", (llvm.llvm_version_info[0] + 1, 0, 0))
    elif changed == "passes":
        (tmp_path / "machine.py").write_bytes(Path(llvm_compiler.__file__).read_bytes() + b"\n")
        monkeypatch.setattr(llvm_compiler, "__file__", str(tmp_path / "machine.py"))
    else:
        monkeypatch.setattr(object_cache, changed, "another")
    object_cache.list_code_versions.cache_clear()
    object_cache.list_environment_versions.cache_clear()
    compiled.clear()
    assert rows().function("rows") and len(compiled) == 1 and code_cache.take_messages() == []


def load(place: Path, monkeypatch: pytest.MonkeyPatch, number: float) -> Any:
    """A kernel in a file, as in a process that begins, with a number that is defined in another module."""
    numbers = type(sys)("shipped_numbers")
    numbers.NUMBER = number  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "shipped_numbers", numbers)
    spec = importlib.util.spec_from_file_location("shipped_value", place)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "shipped_value", module)
    spec.loader.exec_module(module)
    code_cache.release_unused_code()
    return module.value


def test_a_changed_source_is_compiled(folder: Path, compiled: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its own file, a number of another module, and what writes texts."""
    place = tmp_path / "shipped_value.py"
    place.write_text(KERNEL)
    build_object_files(folder, [load(place, monkeypatch, 1.0)], [own()])
    compiled.clear()
    assert load(place, monkeypatch, 1.0)(2.0) == 5.0 and not compiled
    assert load(place, monkeypatch, 3.0)(2.0) == 7.0 and len(compiled) == 1
    place.write_text(KERNEL.replace("2 * x", "4 * x"))
    assert load(place, monkeypatch, 1.0)(2.0) == 9.0 and len(compiled) == 2
    place.write_text(KERNEL)
    assert load(place, monkeypatch, 1.0)(2.0) == 5.0 and len(compiled) == 2
    monkeypatch.setattr("antdsl.machine_code.kernels.source_key._hash_compiler_sources", lambda: "another version")
    assert load(place, monkeypatch, 1.0)(2.0) == 5.0 and len(compiled) == 3


def processor(*absent: str, of: str = "x86-64-v4", **extra_features: bool) -> Target:
    """What `machine.host` gives for a processor with all features of a level but some."""
    present = {word[1:]: True for word in shipped_objects.TARGET_BY_NAME[of].features.split(",") if word[0] == "+"}
    return Target(
        "x86_64-unknown-linux-gnu", "any", llvm_compiler.format_features(present | extra_features | dict.fromkeys(absent, False))
    )


def test_a_processor_gets_code_that_it_runs() -> None:
    assert shipped_objects.find_target_name(processor()) == "x86-64-v4"
    assert shipped_objects.find_target_name(processor(fma=True, fma4=True, xop=True)) == "x86-64-v4"
    # the first ones with such registers, which `machine` has no code with 512 bits for
    assert shipped_objects.find_target_name(processor("avx512vbmi2")) == "x86-64-v3"
    assert shipped_objects.find_target_name(processor(of="x86-64-v3", fma=True)) == "x86-64-v3"
    for feature in ("avx2", "bmi2", "f16c", "lzcnt", "movbe", "pclmul", "sse4.2"):
        assert shipped_objects.find_target_name(processor(feature)) is None
    for feature in ("avx512bw", "vpclmulqdq"):
        assert shipped_objects.find_target_name(processor(feature)) == "x86-64-v3"
    arm = Target("aarch64-unknown-linux-gnu", "neoverse-n1", "+neon,+fp-armv8")
    assert shipped_objects.find_target_name(arm) == "aarch64"
    for triple in ("arm64-apple-darwin23.1.0", "aarch64_be-unknown-linux-gnu", "aarch64-pc-windows-msvc"):
        assert shipped_objects.find_target_name(Target(triple, arm.cpu, arm.features)) is None
    for triple in ("x86_64-apple-darwin23.1.0", "x86_64-pc-windows-msvc", "i686-unknown-linux-gnu"):
        assert shipped_objects.find_target_name(Target(triple, "any", processor().features)) is None


def test_an_older_processor_loads_none(folder: Path, compiled: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """One that lacks instructions of all levels compiles for itself."""
    build_object_files(folder, ENTRIES, shipped_objects.TARGET_BY_NAME)
    plain = Target("x86_64-unknown-linux-gnu", "x86-64", "")
    targets = []
    compile_ = llvm_compiler.compile_object
    monkeypatch.setattr(llvm_compiler, "compile_object", lambda text, target: targets.append(target) or compile_(text, target))
    monkeypatch.setattr(llvm_compiler, "find_host_target", lambda: plain)
    assert not reload_cosines().has_code()
    rows()
    assert targets == [plain]


def reload_cosines() -> Any:
    code_cache.release_unused_code()
    return type(write_cosines)(write_cosines.part.function)


@pytest.mark.parametrize("name", shipped_objects.TARGET_BY_NAME)
def test_no_operations_are_fused(name: str) -> None:
    text = """define <8 x double> @sum(<8 x double> %a, <8 x double> %b, <8 x double> %c) {
  %product = fmul <8 x double> %a, %b
  %sum = fadd <8 x double> %product, %c
  ret <8 x double> %sum
}
"""
    for written in (text, f"; {llvm_compiler.ALL_PASSES_MARKER}\n{text}"):
        assembly = llvm_compiler.compile_assembly(written, shipped_objects.TARGET_BY_NAME[name])
        assert re.search(r"mul", assembly) and re.search(r"add", assembly) and not re.search(r"fn?m(add|la|sub)", assembly)
    wide = "zmm" in assembly
    assert wide == (name == "x86-64-v4")


def test_objects_are_those_of_the_installation(tmp_path: Path) -> None:
    """Whatever the working directory has and the environment says."""
    objects = tmp_path / "antdsl" / "machine_code" / "objects"
    objects.mkdir(parents=True)
    for name in shipped_objects.TARGET_BY_NAME:
        (objects / f"{name}.objects").write_bytes(b"trap")
    place = "from antdsl.machine_code import shipped_objects; print(shipped_objects.OBJECTS_FOLDER)"
    expected = Path(antdsl.__file__).resolve().parent / "machine_code" / "objects"
    for settings in ({}, dict.fromkeys((object_cache.CACHE_VARIABLE, "HOME", "XDG_CACHE_HOME"), str(tmp_path))):
        ran = subprocess.run(
            [sys.executable, "-P", "-c", place], env=child_environment(**settings), cwd=tmp_path, capture_output=True, text=True
        )
        assert ran.stdout == f"{expected}\n", ran.stderr


_ALL = """
import pkgutil
from importlib import import_module
import antdsl
from antdsl.machine_code import library
for each in pkgutil.walk_packages(antdsl.__path__, "antdsl."):
    if not each.name.endswith("__main__"):
        import_module(each.name)
own = {(each.__module__, each.__name__) for each in library._library_entries}
found = library.load_entries()
assert own == {(each.__module__, each.__name__) for each in found}, own
assert {each.__module__ for each in found} == set(library.list_modules())
print(len(found))
"""


def test_all_kernels_and_texts_of_the_package_are_found() -> None:
    """By importing only modules that have one: after importing all others there are no more."""
    ran = subprocess.run([sys.executable, "-P", "-c", _ALL], env=child_environment(), capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr[-3000:]
    assert int(ran.stdout) > 100


_LIGHT = """
import sys
class NumpyAndLlvmlite:
    def find_spec(self, name, path=None, target=None):
        top = name.partition(".")[0]
        if top not in ("numpy", "llvmlite", "antdsl") and top not in sys.stdlib_module_names and not top.startswith("_"):
            raise ModuleNotFoundError(f"{name} is not installed")
sys.meta_path.insert(0, NumpyAndLlvmlite())
from antdsl.machine_code import build_objects, library
assert len(library.load_entries()) > 100
"""


def test_compiling_in_advance_needs_numpy_and_llvmlite_only() -> None:
    """Which is what the build environment of a wheel has."""
    ran = subprocess.run([sys.executable, "-P", "-c", _LIGHT], env=child_environment(), capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr[-3000:]


@pytest.mark.parametrize("why", ["no llvmlite", "another processor"])
def test_where_nothing_can_be_compiled_in_advance_a_message_says_why(why: str, tmp_path: Path) -> None:
    patches = {
        "no llvmlite": "import sys\nsys.modules['llvmlite'] = sys.modules['llvmlite.binding'] = None\n",
        "another processor": "from antdsl.machine_code import llvm_compiler as m\n"
        "m.find_host_target = lambda: m.Target('riscv64-linux', '', '')\n",
    }
    (tmp_path / "sitecustomize.py").write_text(patches[why])
    command = [sys.executable, "-P", "-m", "antdsl.machine_code.build_objects", "--host"]
    ran = subprocess.run(command, env=child_environment(tmp_path), capture_output=True, text=True)
    assert ran.returncode == 1 and not ran.stdout
    assert ran.stderr.startswith("kernels are not compiled in advance, but when they are first used: ")
    assert ("llvmlite" if why == "no llvmlite" else "riscv64") in ran.stderr


def test_objects_are_ignored_by_git() -> None:
    root = Path(__file__).resolve().parents[2]
    ignored = (root / ".gitignore").read_text(encoding="utf-8").splitlines()
    assert os.path.relpath(Path(antdsl.__file__).parent / "machine_code" / "objects", root) + "/" in ignored
