"""A project folder in which every file that a careless program would execute or obey is a trap.

A trap that is executed appends its name to the file `TRAPPED` beside the folder. Modules stand for each top-level name of the
standard library and of all installed packages; other traps are configuration files of libraries, programs, and links."""

from __future__ import annotations

import os
import shutil
import sys
from functools import cache
from importlib.metadata import packages_distributions
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
# What Python and its tools run at start.
START_UP = ("sitecustomize", "usercustomize", "conftest", "setup", "noxfile", "fabfile")
# Names of programs that libraries start.
PROGRAMS = (
    "python", "python3", "uname", "ldconfig", "gcc", "cc", "ld", "objdump", "latex", "dvipng", "ffmpeg", "git", "ps",
    "antdsl",
)  # fmt: skip
# Libraries that are loaded by their bare name.
SHARED = ("libEGL.so.1", "libGL.so.1", "libusb-1.0.so.0", "libc.so.6", "libm.so.6", "libtbb.so.12", "libgomp.so.1", "libz.so.1")
PRELOAD = (
    "distributed: {scheduler: {preload: [trap_preload]}, worker: {preload: [trap_preload]}, nanny: {preload: [trap_preload]}}\n"
)
# Configuration files of libraries, each with a content that has an effect where it is read.
CONFIGURATION = {
    "matplotlibrc": "text.usetex: True\nbackend: module://trap_backend\n",
    ".matplotlib/matplotlibrc": "text.usetex: True\n",
    ".config/matplotlib/matplotlibrc": "text.usetex: True\nbackend: module://trap_backend\n",
    "dask.yaml": PRELOAD,
    ".dask/dask.yaml": PRELOAD,
    ".config/dask/dask.yaml": PRELOAD,
    "etc/dask/dask.yaml": PRELOAD,
    "distributed.yaml": PRELOAD,
    ".numba_config.yaml": "disable_jit: 1\n",
    ".llvmliterc": "trap\n",
    ".env": "PYTHONPATH=.\nPYTHONSTARTUP=json.py\nDASK_CONFIG=.\n",
    ".pythonrc": "import trap_backend\n",
    ".pythonrc.py": "import trap_backend\n",
    ".pystartup": "import trap_backend\n",
    ".ipython/profile_default/startup/trap.py": "import trap_backend\n",
    ".jupyter/jupyter_config.py": "import trap_backend\n",
    "pytest.ini": "[pytest]\naddopts = -p trap_backend\n",
    "tox.ini": "[pytest]\naddopts = -p trap_backend\n",
    "setup.cfg": "[tool:pytest]\naddopts = -p trap_backend\n",
    "pyproject.toml": "[tool.pytest.ini_options]\naddopts = '-p trap_backend'\n",
    "pyvenv.cfg": "home = .\ninclude-system-site-packages = true\n",
    "python311._pth": ".\nimport site\n",
    "trap.pth": "import trap_backend\n",
    "plugInfo.json": '{"Plugins": [{"Type": "python", "Name": "trap_backend", "Info": {}}]}\n',
    "plugin/usd/plugInfo.json": '{"Includes": ["*/"]}\n',
    ".usdrc": "trap\n",
    ".netrc": "machine localhost login trap password trap\n",
    ".gitconfig": "[core]\n\tpager = ./less\n",
    ".imageio/ffmpeg/ffmpeg": "#!/bin/sh\n",
    ".pygments": "trap\n",
    "logging.conf": "[loggers]\nkeys=root\n",
    "openblas.conf": "trap\n",
    "ld.so.preload": "libc.so.6\n",
    "fonts.conf": "<fontconfig/>\n",
    ".fonts.conf": "<fontconfig/>\n",
    ".cache/antdsl/native/" + "0" * 64 + ".o": "trap\n",
    "objects/x86-64-v3.objects": "trap\n",
    "objects/x86-64-v4.objects": "trap\n",
    "objects/aarch64.objects": "trap\n",
    "machine_code/objects/x86-64-v3.objects": "trap\n",
    ".cache/matplotlib/fontlist.json": "{}\n",
    ".local/state/antdsl/key": "0" * 32,
}
# Default places of results, which are links that lead out of the project.
LINKS = ("out", "cache/pictures", "cache_edited", "walker.svg", "scene.svg")


@cache
def module_names() -> tuple[str, ...]:
    """Top-level names of all modules that this installation has, but those of the project itself."""
    installed = {name for name in packages_distributions() if name.isidentifier()}
    own = {"antdsl"}
    return tuple(sorted((set(sys.stdlib_module_names) | installed | set(START_UP) | {"trap_backend", "trap_preload"}) - own))


class TrappedProject:
    """A small scene among traps. `folder` is the project; beside it lie a home folder, one for temporary files, `elsewhere`, to
    which links lead, and `TRAPPED`, once a trap was executed."""

    def __init__(self, place: Path, cache_folder: Path | None, but: frozenset[str] = frozenset()) -> None:
        """With a copy of a cache, and without traps for some modules."""
        self.place = place
        self.folder, self.elsewhere, self.log = place / "project", place / "elsewhere", place / "TRAPPED"
        self.home, self.temporary = place / "home", place / "temporary"
        for folder in (self.folder, self.elsewhere, self.home, self.temporary):
            folder.mkdir(parents=True)
        copy_scene(self.folder)
        if cache_folder is not None:
            shutil.copytree(cache_folder, self.folder / "cache")
        self._modules(but)
        self._programs()
        for name, text in CONFIGURATION.items():
            file = self.folder / name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text, encoding="utf-8")
        for name in LINKS:
            if (self.folder / name).parent.is_dir():
                (self.folder / name).symlink_to(self.elsewhere / name.replace("/", "_"))
        (self.elsewhere / "out").mkdir()
        for name in ("pipe.ant", "pipe.yaml", "pipe.ply"):
            os.mkfifo(self.folder / name)

    def _trap(self, name: str) -> str:
        return f"open({str(self.log)!r}, 'a').write({name!r} + '\\n')\nraise SystemExit('a trap was executed: {name}')\n"

    def _modules(self, but: frozenset[str]) -> None:
        for number, name in enumerate(sorted(set(module_names()) - but)):
            if number % 2:
                (self.folder / f"{name}.py").write_text(self._trap(name), encoding="utf-8")
            else:
                (self.folder / name).mkdir(exist_ok=True)
                (self.folder / name / "__init__.py").write_text(self._trap(name), encoding="utf-8")

    def _programs(self) -> None:
        for name in PROGRAMS:
            file = self.folder / name
            if not file.exists():
                file.write_text(f"#!/bin/sh\necho program {name} >> '{self.log}'\nexit 1\n", encoding="utf-8")
                file.chmod(0o755)
        for name in SHARED:
            (self.folder / name).write_text("trap", encoding="utf-8")

    @property
    def executed(self) -> list[str]:
        """Names of traps that were executed."""
        return self.log.read_text(encoding="utf-8").split("\n")[:-1] if self.log.exists() else []

    @property
    def led_out(self) -> list[str]:
        """What was written where a link leads to."""
        return [str(path) for path in self.elsewhere.rglob("*") if path != self.elsewhere / "out"]


def copy_scene(folder: Path) -> None:
    """Put a scene of 20 agents into a folder, another of the same program, and one with a ground in USD."""
    example = ROOT / "examples" / "minimal"
    shutil.copy(example / "ground.ply", folder / "ground.ply")
    text = (example / "scene.yaml").read_text(encoding="utf-8").replace("count: 50", "count: 20").replace("1..240", "0..2")
    program = (example / "walker.ant").read_text(encoding="utf-8")
    (folder / "walker.ant").write_text(program + SPEC, encoding="utf-8")
    (folder / "scene.yaml").write_text(text, encoding="utf-8")
    (folder / "other.yaml").write_text("# other\n" + text, encoding="utf-8")
    (folder / "stage.yaml").write_text(text.replace("mesh: ground.ply", "usd: ground.usda"), encoding="utf-8")
    (folder / "ground.usda").write_text(USD, encoding="utf-8")


SPEC = '\nspec "walkers live" on "scene.yaml" {\n  for 0.1 s\n  always: count(walker) == 20\n}\n'
USD = """#usda 1.0
(
    metersPerUnit = 0.001
    upAxis = "Y"
)
def Mesh "ground"
{
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
    point3f[] points = [(-200, 0, -200), (-200, 0, 200), (200, 0, 200), (200, 0, -200)]
}
"""
