"""`antdsl doctor`: lists what is installed, what is missing, and how to install it."""

from __future__ import annotations

from antdsl.cli.exits import CommandError, ExitCode
from antdsl.cli.printing.messages import print_result
from antdsl.packages import DISTRIBUTION_BY_MODULE

OPTIONAL_PACKAGES = {
    "imageio_ffmpeg": "films: pip install 'antdsl[video]'",
    "pxr": "sets and bodies in USD files: pip install 'antdsl[usd]'",
    "bpy": "pictures by Blender: pip install 'antdsl[blender]'",
    "matplotlib": "plots of sweeps: pip install 'antdsl[plots]'",
    "SALib": "sensitivity of sweeps: pip install 'antdsl[sensitivity]'",
    "distributed": "sweeps, shots and pictures on several machines: pip install 'antdsl[cluster]'",
    "pyarrow": "tables of sweeps as Parquet: pip install 'antdsl[parquet]'",
    "graphlay": "pictures of state machines: pip install 'antdsl[graph]'",
    "resvg_py": "pictures of state machines as PNG: pip install 'antdsl[graph]'",
    "pygls": "editors: pip install 'antdsl[lsp]'",
    "mcp": "assistants: pip install 'antdsl[mcp]'",
    "websockets": "the preview: pip install 'antdsl[preview]'",
    "furo": "this documentation in the browser: pip install 'antdsl[docs]'",
}


def run_doctor_command() -> None:
    """Check that everything antdsl needs is installed."""
    problems: list[str] = []
    _check_python(problems)
    _check_system_libraries(problems)
    for module, distribution in DISTRIBUTION_BY_MODULE.items():
        if module != "llvmlite":  # the check of machine code reports it
            _check_package(module, distribution, problems)
    for package, purpose in OPTIONAL_PACKAGES.items():
        _check_optional_package(package, purpose)
    _check_machine_code(problems)
    _check_tables()
    _check_sandbox(problems)
    _check_files(problems)
    if problems:
        raise CommandError(ExitCode.INPUT_OUTPUT, "\n" + "\n".join(f"to do: {problem}" for problem in problems))
    print_result("\nall is well")


def _print_check(name: str, is_ok: bool, details: str) -> None:
    print_result(f"{'ok     ' if is_ok else 'MISSING'} {name:<16} {details}".rstrip())


def _check_python(problems: list[str]) -> None:
    import platform
    import sys

    is_supported = sys.version_info >= (3, 11)
    _print_check("python", is_supported, f"{platform.python_version()} on {platform.system()} {platform.machine()}")
    if not is_supported:
        problems.append("install Python 3.11 or newer")


def _check_system_libraries(problems: list[str]) -> None:
    from antdsl.bootstrap import SYSTEM_LIBRARIES, find_missing_packages

    missing = find_missing_packages(SYSTEM_LIBRARIES)
    _print_check(
        "system libraries",
        not missing,
        ", ".join(missing) if missing else "libegl1 libgl1 libusb-1.0-0 or the equivalent packages",
    )
    if missing:
        problems.append(f"as root: apt-get install -y {' '.join(missing)}")


def _check_package(module: str, distribution: str, problems: list[str]) -> None:
    from importlib import import_module

    from antdsl.casting.open3d_module import load_open3d

    try:
        if module == "open3d":
            load_open3d()
        else:
            import_module(module)
    except Exception as problem:  # a broken binary package can raise anything
        _print_check(distribution, False, f"{type(problem).__name__}: {problem}"[:160])
        problems.append(
            f"pip install {distribution}"
            if module != "open3d"
            else "pip install open3d-cpu (Linux x86-64) or open3d, after the system libraries"
        )
        return
    _print_check(distribution, True, _find_installed_version(distribution))


def _find_installed_version(name: str) -> str:
    from importlib.metadata import PackageNotFoundError, version

    for candidate in (name, f"{name}-cpu"):
        try:
            return version(candidate)
        except PackageNotFoundError:
            continue
    return ""


def _check_optional_package(package: str, purpose: str) -> None:
    from importlib.util import find_spec

    words = "installed" if find_spec(package) is not None else f"not installed; needed for {purpose}"
    print_result(f"{'ok     ' if words == 'installed' else '-      '} {package:<16} {words}")


def _check_machine_code(problems: list[str]) -> None:
    from antdsl.machine_code import llvm_compiler
    from antdsl.machine_code.object_cache import ObjectCache

    reason = llvm_compiler.find_unavailability_reason()
    _print_check("machine code", not reason, reason or f"for {llvm_compiler.find_host_target().cpu}")
    if reason:
        problems.append(reason)
        return
    _check_kernels()
    object_cache = ObjectCache()
    object_cache.prepare_folder()
    for sentence in object_cache.messages:
        print_result(f"-       {'folder of code':<16} {sentence}")


def _check_kernels() -> None:
    """Print whether the installation has compiled kernels for this processor, this LLVM version and the current sources."""
    from antdsl.machine_code import llvm_compiler, shipped_objects
    from antdsl.numerics.elementary_loops import write_cosines

    host = llvm_compiler.find_host_target()
    if shipped_objects.find_object(write_cosines.make_text_key(host), host) is None:
        print_result(f"-       {'kernels':<16} compiled on first use, which takes some seconds once")
    else:
        print_result(f"ok      {'kernels':<16} compiled in advance for {shipped_objects.find_target_name(host)}")


def _check_tables() -> None:
    """Print whether computed tables of meshes are cached for later runs and, if not, why."""
    from antdsl.numerics import stored_tables

    table_store = stored_tables.open_store()
    table_store.prepare_folder()
    for sentence in table_store.messages:
        print_result(f"-       {'folder of tables':<16} {sentence}")


def _check_sandbox(problems: list[str]) -> None:
    """Print which sandbox layers confine the process that reads foreign formats."""
    from antdsl.reader.client import ReaderFailureError, find_active_layers

    try:
        active = find_active_layers()
    except ReaderFailureError as error:
        _print_check("reader", False, str(error))
        problems.append("allow this user to start processes and to write to the folder for temporary files")
        return
    landlock = f"Landlock {active['landlock']}" if active["landlock"] else "no Landlock"
    layers = ["rlimits" if active["rlimits"] else "no rlimits", landlock, "seccomp" if active["seccomp"] else "no seccomp"]
    weak = "" if active["seccomp"] else "; USD files need `antdsl --trust-usd …`"
    print_result(f"{'ok     ' if active['landlock'] and not weak else '-      '} {'reader':<16} {', '.join(layers)}{weak}")


def _check_files(problems: list[str]) -> None:
    from antdsl.resources import grammar_file, list_library_names

    is_complete = grammar_file("tables.json").is_file() and "steering" in list_library_names()
    _print_check(
        "antdsl's files",
        is_complete,
        "grammar, library of behaviours" if is_complete else "files are missing: install antdsl again",
    )
    if not is_complete:
        problems.append("install antdsl again")
