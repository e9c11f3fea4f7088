"""A wheel of this tree has the compiled kernels, and a run in an environment with it compiles none of them."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest
from children import child_environment
from compilers import need_llvmlite

from antdsl.machine_code import llvm_compiler, shipped_objects

ROOT = Path(__file__).resolve().parents[2]
# What the package's build reads.
BUILT = ("antdsl", "grammar", "behaviours", "examples", "docs")
FILES = (
    "pyproject.toml",
    ".ci/hatch_build.py",
    "README.md",
    "CONTRIBUTING.md",
    "CHANGELOG.md",
    "SECURITY.md",
    "LICENSE",
    ".gitignore",
)
# Runs a command of antdsl, and writes down which functions it had to compile.
_RECORD = """
import re, sys
from pathlib import Path
import antdsl
from antdsl.machine_code import llvm_compiler
assert Path(antdsl.__file__).is_relative_to(sys.prefix), antdsl.__file__
compile_ = llvm_compiler.compile_object
names = []
def recorded(text, target):
    names.extend(re.findall(r"^define void @([\\w.]+)\\(", text, re.M))
    return compile_(text, target)
llvm_compiler.compile_object = recorded
record = sys.argv.pop(1)
from antdsl import cli
try:
    cli.main()
finally:
    Path(record).write_text("\\n".join(names))
"""

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A wheel of a copy of this tree: building writes into it. Object files that are up to date are copied with it."""
    pytest.importorskip("hatchling")
    need_llvmlite()
    tree = tmp_path_factory.mktemp("tree")
    for name in BUILT:
        shutil.copytree(ROOT / name, tree / name, ignore=shutil.ignore_patterns("node_modules", "__pycache__", "out"))
    for name in FILES:
        (tree / name).parent.mkdir(exist_ok=True)
        shutil.copy(ROOT / name, tree / name)
    command = [sys.executable, "-P", "-m", "hatchling", "build", "-t", "wheel", "-d", "made"]
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    ran = subprocess.run(command, cwd=tree, env=environment, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stdout + ran.stderr
    [wheel_path] = (tree / "made").iterdir()
    return wheel_path


def test_a_wheel_has_the_objects_of_all_targets(wheel: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = [name for name in archive.namelist() if name.startswith("antdsl/machine_code/objects/")]
        archive.extractall(tmp_path, names)
    assert sorted(names) == sorted(f"antdsl/machine_code/objects/{name}.objects" for name in shipped_objects.TARGET_BY_NAME)
    counts = [len(shipped_objects.ObjectFile(tmp_path / name)) for name in names]
    assert min(counts) > 100 and sum((tmp_path / name).stat().st_size for name in names) < 4_000_000


@pytest.mark.parametrize("scene", ["minimal", "foraging"])
def test_an_installed_wheel_compiles_no_kernel(wheel: Path, tmp_path: Path, scene: str) -> None:
    if shipped_objects.find_target_name(llvm_compiler.find_host_target()) is None:
        pytest.skip("no objects are shipped for this machine")
    venv.create(tmp_path / "environment", with_pip=False)
    python = tmp_path / "environment" / "bin" / "python"
    place = subprocess.run(
        [str(python), "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"], capture_output=True, text=True, check=True
    )
    packages = Path(place.stdout.strip())
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(packages)
    others = [path for path in sys.path if path.endswith("site-packages")] or [sysconfig.get_path("purelib")]
    (packages / "others.pth").write_text("".join(f"{path}\n" for path in others))
    (tmp_path / "record.py").write_text(_RECORD)
    (tmp_path / "code").mkdir(mode=0o700)
    command = [str(python), "-P", "record.py", "names", "run", str(ROOT / "examples" / scene / "scene.yaml"), "--frames", "1..6"]
    environment = child_environment(ANTDSL_NATIVE_CACHE=str(tmp_path / "code"))
    del environment["PYTHONPATH"]
    ran = subprocess.run([*command, "--out", "out"], cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert ran.returncode == 0, ran.stderr[-3000:]
    compiled = (tmp_path / "names").read_text().split()
    # functions of a program are called after its species and their blocks
    assert [name for name in compiled if "." not in name] == []
