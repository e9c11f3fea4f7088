"""Every command, in a folder full of traps: no file of it is executed or obeyed, no foreign program starts, no socket is bound.

`ANTDSL_TRAP_PYTHON` names another interpreter with an antdsl to test, such as that of an older tree."""

from __future__ import annotations

import json
import os
import pwd
import subprocess
import sys
from dataclasses import dataclass
from fnmatch import fnmatch
from functools import cache
from pathlib import Path

import pytest
from tracing import Trace, traced
from traps import TrappedProject, copy_scene, module_names

from antdsl.cli import COMMANDS

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="strace is Linux's")
PYTHON = Path(os.environ.get("ANTDSL_TRAP_PYTHON", sys.executable))
SCENE = ("scene.yaml", "walker.ant", "ground.ply")
CACHE = ("cache", "cache/*", *SCENE)
# What a command makes and removes, to see whether it may write into a folder.
TRIAL = (".antdsl.*.part",)
# Files of the system that a program changes as it works, below these folders.
SYSTEM = ("/dev/null", "/dev/tty", "/dev/shm/", "/proc/self/", "/proc/thread-self/", "pipe:", "socket:")
# Programs other than Python that are started, found by the absolute entries of `PATH`, and why.
KNOWN_PROGRAMS = {"fc-list": "matplotlib lists the fonts of the system", "uname": "Python's `platform` asks for the processor"}


@dataclass(frozen=True)
class Case:
    """A command's words. `reads`: the project's files that it is to read; `writes`: the results that it is to make; `code`: how
    it ends; `sockets`: whether it listens on the loopback interface; `stdin`, `until`: how it is ended."""

    words: tuple[str, ...]
    reads: tuple[str, ...] = SCENE
    writes: tuple[str, ...] = ()
    codes: tuple[int, ...] = (0,)
    sockets: bool = False
    stdin: bytes = b""
    until: str = ""

    def __str__(self) -> str:
        return "_".join(self.words)


def message(method: str, number: int | None = None, **params: object) -> bytes:
    content = json.dumps({"jsonrpc": "2.0", "method": method, "params": params} | ({} if number is None else {"id": number}))
    return f"Content-Length: {len(content)}\r\n\r\n{content}".encode()


CALL = (
    b'{"jsonrpc":"2.0","id":1,"method":"initialize","params":{"protocolVersion":"2025-06-18","capabilities":{},'
    b'"clientInfo":{"name":"test","version":"1"}}}\n'
)
TALK = b"".join(
    [
        message("initialize", 1, processId=None, rootUri=None, capabilities={}),
        message("initialized"),
        message("shutdown", 2),
        message("exit"),
    ]
)

CASES: dict[str, tuple[Case, ...]] = {
    "new": (Case(("new", "fresh"), (), ("fresh", "fresh/*")),),
    "examples": (Case(("examples", "minimal", "fresh"), (), ("fresh", "fresh/*")),),
    "check": (
        Case(("check", "."), ("*.ant", "*.yaml", "*.ply", "*.usda"), codes=(1, 3)),
        Case(("check", "stage.yaml", "--cost"), (*SCENE, "stage.yaml", "ground.usda")),
    ),
    "fmt": (Case(("fmt", "--check", "walker.ant"), ("walker.ant",), codes=(0, 1)),),
    "run": (
        Case(("run", "scene.yaml", "--out", "ran"), SCENE, ("ran", "ran/*")),
        Case(("run", "scene.yaml"), codes=(2, 3)),  # its default folder is a link that leads out
        Case(("run", "scene.yaml", "other.yaml", "--out", "ran"), (*SCENE, "other.yaml"), ("ran", "ran/*")),
        Case(
            ("run", "scene.yaml", "other.yaml", "--out", "ran", "--scheduler", "local"),
            (*SCENE, "other.yaml"),
            ("ran", "ran/*"),
            sockets=True,
        ),
    ),
    "preview": (Case(("preview", "scene.yaml", "--port", "0", "--no-open"), sockets=True, codes=(0, 130), until="http://"),),
    "test": (Case(("test", "walker.ant")),),
    "sweep": (
        Case(("sweep", "scene.yaml", "--seeds", "2", "--jobs", "2", "--out", "swept"), SCENE, ("swept", "swept/*")),
        Case(("sweep", "scene.yaml", "--seeds", "2", "--jobs", "2"), SCENE, codes=(2, 3)),
    ),
    "fit": (Case(("fit", "scene.yaml", "--vary", "walker.pace=1mm/s..2mm/s", "--to", "no spec"), codes=(1,)),),
    "render": (
        Case(("render", "cache", "--width", "64", "--height", "36", "--out", "drawn"), CACHE, ("drawn", "drawn/*")),
        Case(("render", "cache", "--width", "64", "--height", "36"), CACHE, codes=(2, 3)),
    ),
    "edit": (
        Case(("edit", "cache", "--smooth", "orient:3", "--out", "smooth"), CACHE, ("smooth", "smooth/*")),
        Case(("edit", "cache", "--smooth", "orient:3"), CACHE, codes=(2, 3)),
    ),
    "export": tuple(
        Case(("export", "cache", "--to", f"shot.{ending}"), CACHE, ("shot.*", ".shot.*")) for ending in ("ply", "usda", "obj")
    ),
    "jobs": (
        Case(("jobs", "scene.yaml", "--out", "ran", "--to", "job.json"), SCENE, ("job.json", ".job.json.*.part")),
        Case(("jobs", "scene.yaml", "--to", "job.json"), SCENE, ("job.json", ".job.json.*.part"), codes=(2, 3)),
    ),
    "info": (Case(("info", "cache"), CACHE),),
    "body": (Case(("body", "ant", "--to", "ant.glb"), (), ("ant.glb", ".ant.glb.*.part")),),
    "explain": (Case(("explain", "cache", "--agent", "3", "--frame", "1"), CACHE),),
    "graph": (
        Case(("graph", "walker.ant", "--out", "chart.svg"), ("walker.ant", "scene.yaml"), ("chart.svg", ".chart.svg.*.part")),
        Case(("graph", "walker.ant"), ("walker.ant", "scene.yaml"), codes=(2, 3)),  # its default place is a link
    ),
    "plan": (Case(("plan", "walker.ant")),),
    "bench": (Case(("bench", "scene.yaml", "--pairs", "1", "--steps", "1", "--backend", "numpy"), SCENE),),
    "docs": (Case(("docs", "--to", "built"), (), ("built", "built/*", ".antdsl-docs-*")),),
    "doctor": (Case(("doctor",), ()),),
    "lsp": (Case(("lsp",), (), stdin=TALK),),
    "mcp": (Case(("mcp", "--root", "."), (), stdin=CALL),),
}
ALL = [case for cases in CASES.values() for case in cases]
SAMPLE = [CASES["check"][0], CASES["sweep"][0], CASES["body"][0]]
STARTS = {"script": (), "module": ("-m", "antdsl"), "safe": ("-P", "-m", "antdsl"), "no_environment": ("-E", "-m", "antdsl")}


def test_every_command_has_cases() -> None:
    assert set(CASES) == {command.name for command in COMMANDS}
    assert {case.words[0] for case in ALL} == set(CASES)


def test_traps_stand_for_all_modules() -> None:
    names = set(module_names())
    assert {"json", "typing", "__future__", "multiprocessing", "encodings", "sitecustomize"} <= names
    assert {"numpy", "open3d", "llvmlite", "dask", "distributed", "matplotlib", "pxr", "typer", "_yaml"} <= names


@pytest.fixture(scope="module")
def cache_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache that the interpreter under test wrote, in a folder without traps."""
    folder = tmp_path_factory.mktemp("clean")
    copy_scene(folder)
    command = [str(PYTHON), "-P", "-m", "antdsl", "run", "scene.yaml", "--out", "cache", "--quiet"]
    subprocess.run(command, cwd=folder, check=True)
    return folder / "cache"


def environment(project: TrappedProject, **variables: str) -> dict[str, str]:
    left_out = ("PYTHONPATH", "PYTHONSAFEPATH", "PYTHONNOUSERSITE", "DASK_CONFIG", "MPLCONFIGDIR", "XDG_CACHE_HOME", "DISPLAY")
    inherited = {name: value for name, value in os.environ.items() if name not in left_out}
    return inherited | {"HOME": str(project.home), "TMPDIR": str(project.temporary)} | variables


@cache
def modules_of_python() -> frozenset[str]:
    """What Python imports before the first line of a package that `-m` starts: nothing keeps that from the working directory."""
    code = "import runpy, sys; print(*{name.partition('.')[0] for name in sys.modules})"
    process = subprocess.run([str(PYTHON), "-P", "-c", code], capture_output=True, text=True, check=True)
    return frozenset(process.stdout.split())


@cache
def installed_package() -> Path:
    """The folder of the package under test, which lies outside the environment where that was installed to be edited."""
    code = "import importlib.util; print(importlib.util.find_spec('antdsl').origin)"
    process = subprocess.run([str(PYTHON), "-P", "-c", code], capture_output=True, text=True, check=True)
    return Path(process.stdout.strip()).parent


def trapped_project(place: Path, cache_folder: Path | None, how: str = "script") -> TrappedProject:
    return TrappedProject(place, cache_folder, frozenset() if how in ("script", "safe") else modules_of_python())


def start(case: Case, project: TrappedProject, how: str, env: dict[str, str]) -> Trace:
    first = [str(PYTHON), *STARTS[how]] if STARTS[how] else [str(PYTHON.with_name("antdsl"))]
    return traced([*first, *case.words], project.folder, env, project.place / "trace", stdin=case.stdin, until=case.until)


def complaints(case: Case, project: TrappedProject, trace: Trace, settings: tuple[str, ...] = ()) -> list[str]:
    """What the command did that it may not do. `settings`: files of the project that libraries may read."""
    texts = [f"executed: {name}" for name in project.executed]
    texts += [f"written where a link leads: {path}" for path in project.led_out]
    texts += [f"program: {path}" for path in dict.fromkeys(trace.programs) if not is_known_program(path, project)]
    texts += [f"socket: {text}" for text in trace.sockets if not is_expected_socket(text, case)]
    for opened in trace.opened:
        inside = below(opened.name, project.folder) or below(opened.file or "/", project.folder)
        if inside is not None and not opened.folder and not matches(inside, (*TRIAL, *case.reads, *case.writes, *settings)):
            texts.append(f"opened: {inside}")
        if opened.writes and opened.file is not None:
            texts += [f"written: {opened.file}"] if not may_change(opened.file, case, project) else []
    texts += [f"changed: {path}" for path in trace.changed if not may_change(path, case, project)]
    return list(dict.fromkeys(texts))


def below(path: str, folder: Path) -> str | None:
    """The path from a folder on; None where it is not below it."""
    path = os.path.normpath(path)
    return path.removeprefix(f"{folder}/") if path.startswith(f"{folder}/") else None


def matches(path: str, patterns: tuple[str, ...]) -> bool:
    return any(fnmatch(path, pattern) for pattern in patterns)


def is_known_program(path: str, project: TrappedProject) -> bool:
    """Python and our own script, by an absolute path outside the project."""
    if not path.startswith("/") or below(path, project.place) is not None:
        return False
    own = {os.path.realpath(PYTHON), os.path.realpath(PYTHON.with_name("antdsl"))}
    return os.path.realpath(path) in own or os.path.basename(path) in KNOWN_PROGRAMS


def is_expected_socket(text: str, case: Case) -> bool:
    """The system's name service and its numbers for `uuid`; and the loopback interface, where the command listens there."""
    if "sa_family=AF_UNIX" in text:
        return text.startswith("connect") and any(name in text for name in ("/nscd/socket", "/uuidd/request"))
    loopback = 'inet_addr("127.0.0.1")' in text or 'inet_pton(AF_INET6, "::1"' in text
    return case.sockets and (loopback or text.startswith("listen"))


def may_change(path: str, case: Case, project: TrappedProject) -> bool:
    """Results of the command, temporary files, stored code, and what Python stores of its modules."""
    path = os.path.normpath(os.path.join(os.path.realpath(os.path.dirname(path)), os.path.basename(path)))
    if (inside := below(path, project.folder)) is not None:
        return matches(inside, (*TRIAL, *case.writes))
    own = Path(pwd.getpwuid(os.getuid()).pw_dir)
    folders = [
        project.temporary,
        project.home / ".cache",
        project.home / ".config",
        project.home / ".local",
        own / ".cache/antdsl",
    ]
    folders += [own / ".local/state/antdsl"]
    folders += [Path(os.environ.get(name) or "/nowhere") for name in ("ANTDSL_NATIVE_CACHE", "ANTDSL_TABLE_CACHE")]
    stored = path.startswith((str(PYTHON.parents[1]), str(installed_package()))) and "/__pycache__/" in path
    return stored or path.startswith(SYSTEM) or any(below(path, folder) is not None for folder in folders)


def hold(case: Case, project: TrappedProject, how: str = "script", **variables: str) -> None:
    trace = start(case, project, how, environment(project, **variables))
    # A home folder's configuration is the user's own. It may be read, but no module that it names is imported.
    assert not complaints(case, project, trace, (".config/*",) if "HOME" in variables else ()), trace.output
    assert trace.code in case.codes, trace.output


@pytest.mark.parametrize("case", SAMPLE, ids=str)
def test_commands_leave_traps_alone(case: Case, tmp_path: Path) -> None:
    hold(case, trapped_project(tmp_path, None))


def test_started_as_a_module_it_leaves_traps_alone(tmp_path: Path) -> None:
    hold(CASES["fmt"][0], trapped_project(tmp_path, None, "module"), "module")


@pytest.mark.slow
@pytest.mark.parametrize("how", STARTS)
@pytest.mark.parametrize("case", ALL, ids=str)
def test_every_command_leaves_traps_alone(case: Case, how: str, tmp_path: Path, cache_folder: Path) -> None:
    hold(case, trapped_project(tmp_path, cache_folder, how), how)


# Settings of users that name the working directory by mistake, or, on purpose, a project of another user.
SETTINGS = {
    "home_in_project": {"HOME": "{folder}", "PYTHONNOUSERSITE": "1"},
    "cache_in_project": {
        "XDG_CACHE_HOME": "{folder}/.cache",
        "XDG_CONFIG_HOME": "{folder}/.config",
        "XDG_STATE_HOME": "{folder}",
    },
    "relative_path": {"PATH": ".:" + os.environ.get("PATH", "")},
    "empty_path": {"PATH": os.environ.get("PATH", "") + ":"},
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SETTINGS)
@pytest.mark.parametrize("case", ALL, ids=str)
def test_settings_lead_no_command_into_traps(case: Case, name: str, tmp_path: Path, cache_folder: Path) -> None:
    project = trapped_project(tmp_path, cache_folder)
    hold(case, project, **{key: value.format(folder=project.folder) for key, value in SETTINGS[name].items()})
