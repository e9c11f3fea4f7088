"""Sets up a checkout on a machine that has Python and nothing else, then runs the foraging example or the tests.

`python3 -m antdsl.bootstrap example`, `python3 -m antdsl.bootstrap test` and, while you write, `test --quick` and `gate`.
Standard library only: nothing is installed yet.
"""

from __future__ import annotations

import argparse
import ctypes
import hashlib
import importlib.util
import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent

# What Open3D loads from the system, and the Debian package that brings it.
SYSTEM_LIBRARIES = {"libEGL.so.1": "libegl1", "libGL.so.1": "libgl1", "libusb-1.0.so.0": "libusb-1.0-0"}
# What drives the tests of the preview's page loads this from the system.
DRIVER_LIBRARIES = {"libatomic.so.1": "libatomic1"}
# Browsers that those tests can use, by name of the command; the Debian package is called like the first.
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
# What `test --quick` runs: text, programs, plans, passes, diagnostics, and one shot on both backends.
QUICK_TEST_PATTERNS = (
    "tests/syntax/test_syntax_[egp]*.py",
    "tests/program/test_program.py",
    "tests/program/test_program_c*.py",
    "tests/plan/test_plan_*.py",
    "tests/plan/test_tables_agree.py",
    "tests/docs/test_docs_tables.py",
    "tests/passes/test_passes.py",
    "tests/diagnostics/test_diagnostics*.py",
    "tests/runtime/test_backends.py",
)
# What tests start, and the Debian package that brings it.
TEST_PROGRAMS = {"strace": "strace"}
APT_INSTALL_COMMAND = "apt-get install -y --no-install-recommends"
VENV_PACKAGE = "python3-venv"


def find_missing_packages(libraries: Mapping[str, str]) -> list[str]:
    """Return the Debian packages of the shared libraries that this machine cannot load (on Linux). `libraries`: the package of
    each library."""
    if not sys.platform.startswith("linux"):
        return []
    missing = []
    for library, package in libraries.items():
        try:
            ctypes.CDLL(library)
        except OSError:
            missing.append(package)
    return missing


def install_system_packages() -> None:
    """Install the system packages that Open3D needs. If this user is not allowed to, print the command for it and stop."""
    packages = find_missing_packages(SYSTEM_LIBRARIES)
    if not packages:
        return
    if not can_install():
        words = " ".join(packages)
        sys.exit(
            f"Open3D needs system libraries that are missing here; on Debian or Ubuntu, run as root:\n  "
            f"{APT_INSTALL_COMMAND} {words}"
        )
    install_packages(packages)


def install_browser() -> None:
    """Install Chromium for the tests of the preview page, if the system is Debian and this user is allowed to. Otherwise these
    tests are skipped."""
    packages = find_missing_packages(DRIVER_LIBRARIES)
    if not any(shutil.which(name) for name in BROWSERS):
        packages.insert(0, BROWSERS[0])
    if not packages:
        return
    words = "the tests of the preview's page will be skipped, because packages are missing; on Debian, run as root:"
    words += f"\n  {APT_INSTALL_COMMAND} {' '.join(packages)}"
    if not can_install() or not is_debian():
        print(words, flush=True)
        return
    try:
        install_packages(packages)
    except subprocess.CalledProcessError:
        print(words, flush=True)


def install_test_programs() -> None:
    """Install the programs that tests start, if this user is allowed to. Without these programs, tests fail; they are not
    skipped, because users rely on the features that they check."""
    packages = [package for name, package in TEST_PROGRAMS.items() if not shutil.which(name)]
    if not packages or not sys.platform.startswith("linux"):
        return
    if can_install():
        install_packages(packages)
    else:
        print(f"some tests will fail: they need {' '.join(packages)}; on Debian or Ubuntu, run as root:", flush=True)
        print(f"  {APT_INSTALL_COMMAND} {' '.join(packages)}", flush=True)


def is_debian() -> bool:
    """Return whether this system is Debian itself. On derived systems, packages with the same names may only point to another
    installer."""
    try:
        return "ID=debian" in Path("/etc/os-release").read_text(encoding="utf-8").split()
    except OSError:
        return False


def can_install() -> bool:
    """Return whether this user can install Debian packages."""
    return bool(shutil.which("apt-get")) and (os.geteuid() == 0 or bool(shutil.which("sudo")))


def install_packages(packages: list[str]) -> None:
    """Install Debian packages. Raises CalledProcessError if the installation fails."""
    print(f"installing system packages: {' '.join(packages)}", flush=True)
    prefix = [] if os.geteuid() == 0 else ["sudo"]
    env = {**os.environ, "DEBIAN_FRONTEND": "noninteractive"}
    subprocess.run([*prefix, "apt-get", "update", "-qq"], check=True, env=env)
    # A fresh system may be updating itself: wait for its lock.
    wait = ["-o", "DPkg::Lock::Timeout=300"]
    subprocess.run([*prefix, *APT_INSTALL_COMMAND.split(), *wait, *packages], check=True, env=env, stdout=subprocess.DEVNULL)


def ensure_environment(folder: Path, requirements: list[str]) -> Path:
    """Create the virtual environment and return the path of its Python. An existing one is replaced only if pyproject.toml has
    changed."""
    python = folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    fingerprint = hashlib.sha256((ROOT / "pyproject.toml").read_bytes() + repr(requirements).encode()).hexdigest()
    stamp = folder / "antdsl-installed"
    if python.exists() and stamp.exists() and stamp.read_text() == fingerprint:
        compile_kernels(python)  # an update of the checkout changes kernels
        return python
    print(f"setting up {folder} (Python packages, about 1 GB with Open3D; a few minutes the first time)", flush=True)
    stamp.unlink(missing_ok=True)
    # Debian's Python comes without what its `venv` needs.
    if importlib.util.find_spec("ensurepip") is None and is_debian() and can_install():
        install_packages([VENV_PACKAGE])
    if subprocess.run([sys.executable, "-m", "venv", str(folder)]).returncode:
        sys.exit(
            f"cannot create a virtual environment; on Debian or Ubuntu, run as root:\n  {APT_INSTALL_COMMAND} {VENV_PACKAGE}"
        )
    pip = [str(python), "-m", "pip", "--disable-pip-version-check", "install", "--quiet"]
    subprocess.run([*pip, "--editable", f"{ROOT}[test,quality]", *requirements], check=True)
    # An editable install compiles nothing. Where no bytecode may be written, every command would compile all modules again.
    subprocess.run([str(python), "-m", "compileall", "-q", str(ROOT / "antdsl")], check=False)
    # Installing has compiled the kernels with the LLVM of the build environment: nothing is left to do if it is the same here.
    compile_kernels(python)
    stamp.write_text(fingerprint)
    return python


def compile_kernels(python: Path) -> None:
    """Compile the kernels that have no current machine code, so that commands and tests need not. Takes 2 s if all have it."""
    subprocess.run([str(python), "-P", "-m", "antdsl.machine_code.build_objects", "--host"], check=False)


def run_example(python: Path, folder: Path) -> int:
    """Run an example: simulate foraging, then draw a still and a contact sheet. Return the exit code."""
    scene = ROOT / "examples" / "foraging" / "scene.yaml"
    antdsl = [str(python), "-P", "-m", "antdsl"]
    for command in ([*antdsl, "run", str(scene), "--out", str(folder)], [*antdsl, "render", str(folder), "--sheet"]):
        code = subprocess.run(command, cwd=ROOT).returncode
        if code:
            return code
    print(f"the cache and its picture are in {folder}")
    return 0


def run_tests(python: Path, is_quick: bool, arguments: list[str]) -> int:
    """Run the tests and return the exit code. `is_quick`: whether to run only the quick tests, in one process. Otherwise run the
    full suite as in CI, with one process per core; the tests of a file stay in one process."""
    files = (
        [path.relative_to(ROOT).as_posix() for pattern in QUICK_TEST_PATTERNS for path in sorted(ROOT.glob(pattern))]
        if is_quick
        else []
    )
    # The quick part is over before more processes have imported what they need.
    parallel = [] if is_quick else ["-n", "auto", "--dist", "loadfile", "--no-loadscope-reorder"]
    return subprocess.run([str(python), "-m", "pytest", "-q", *parallel, *arguments, *files], cwd=ROOT).returncode


def run_gate(python: Path) -> int:
    """Run the linter and formatter on all Python files, and type checks on the package. Return the exit code. If node and its
    packages are installed, also run the checks of the preview page."""
    tools = [[str(python), "-m", *words.split()] for words in ("ruff check .", "ruff format --check .", "mypy")]
    codes = [subprocess.run(tool, cwd=ROOT).returncode for tool in tools]
    page = ROOT / "antdsl" / "preview" / "web"
    if shutil.which("npm") and (page / "node_modules").is_dir():
        codes.append(subprocess.run(["npm", "run", "--silent", "gate"], cwd=page).returncode)
    else:
        print("the page's checks are skipped: they need node, and `npm ci` in antdsl/preview/web", flush=True)
    return max(codes)


def main() -> int:
    """Run the requested command. Return its exit code."""
    parser = argparse.ArgumentParser(prog="python3 -m antdsl.bootstrap", description=__doc__)
    parser.add_argument("job", choices=("example", "test", "gate"))
    parser.add_argument("--env", type=Path, default=ROOT / ".venv", help="folder of the virtual environment")
    parser.add_argument("--out", type=Path, default=ROOT / "out" / "foraging", help="folder of the example's cache")
    parser.add_argument("--require", action="append", default=[], help="a further requirement, such as open3d-cpu==0.18.0")
    parser.add_argument("--quick", action="store_true", help="run only the quick tests (a minute); they need no browser")
    arguments, rest = parser.parse_known_args()
    if sys.version_info < (3, 11):  # noqa: UP036 - any Python may run this script
        sys.exit("antdsl needs Python 3.11 or newer")
    if (rest or arguments.quick) and arguments.job != "test":
        parser.error(f"unknown option: {' '.join(rest or ['--quick'])}")
    try:
        install_system_packages()
        if arguments.job == "test" and not arguments.quick:
            install_browser()
            install_test_programs()
        python = ensure_environment(arguments.env.resolve(), arguments.require)
    except subprocess.CalledProcessError as failed:
        words = " ".join(map(str, failed.cmd))
        sys.exit(f"this command failed for the reason above; correct it and run again:\n  {words}")
    if arguments.job == "example":
        return run_example(python, arguments.out.resolve())
    if arguments.job == "gate":
        return run_gate(python)
    return run_tests(python, arguments.quick, rest)


if __name__ == "__main__":
    sys.exit(main())
