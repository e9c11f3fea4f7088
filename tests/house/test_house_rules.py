"""The rules of the code: which package may import which, what no file may contain, how long a file may be, that every code has a
case."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest
from conftest import LONGEST
from house_counts import find_places, parsed
from page_groups import LANGUAGE_PAGES, SCENE_PAGES

from antdsl.bootstrap import QUICK_TEST_PATTERNS
from antdsl.diagnostics.codes import CODE_DESCRIPTIONS

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "antdsl"
FILES = sorted(PACKAGE.rglob("*.py"))

# From the ground floor up: a room imports the rooms before it, and itself. Files straight in the package stand among them.
ROOMS = (
    "__init__", "source", "diagnostics", "limits", "resources", "safe_read", "source_hash", "atomic_write", "child_processes",
    "user_folders", "packages",
    "cpu_budget", "bootstrap", "syntax", "program",
    "highlighting", "graphs", "machine_code", "numerics", "reader", "scene", "loading", "plan", "passes", "casting", "ground",
    "senses", "fields", "bodies", "runtime", "reload", "measures", "files", "pipeline", "checking", "outputs",
    "specs", "explain", "settling", "executors", "sweeps", "fitting", "api", "shots", "farm", "bench", "preview", "lsp",
    "mcp", "cli", "__main__",
)  # fmt: skip
# Ground floor rooms that import nothing above themselves, whatever their order here.
GROUND = frozenset(["source", "diagnostics", "limits", "resources", "safe_read", "source_hash", "atomic_write", "child_processes",
                    "user_folders", "packages",
                    "cpu_budget"])  # fmt: skip
# A list of the tree's node types, one after the other, is read as one thing.
LONG = frozenset(["syntax/nodes.py"])
FORBIDDEN_CALLS = frozenset(["eval", "exec", "compile", "__import__"])
FORBIDDEN_MODULES = frozenset(["pickle", "marshal", "shelve", "dill", "cloudpickle", "numexpr"])
FORBIDDEN_ATTRIBUTES = frozenset(
    [("np", "load"), ("numpy", "load"), ("yaml", "load"), ("yaml", "unsafe_load"), ("yaml", "full_load"), ("os", "system")]
)
FORBIDDEN_NAMES = frozenset(["utils", "util", "helpers", "common", "base", "manager", "misc"])
HEAVY = frozenset(
    ["open3d", "pxr", "scipy", "skimage", "trimesh", "mapbox_earcut", "PIL", "imageio_ffmpeg", "graphlay", "resvg_py"]
)
OPEN3D_MODULE = PACKAGE / "casting" / "open3d_module.py"


def subpackage_of(path: Path) -> str:
    parts = path.relative_to(PACKAGE).parts
    return parts[0].removesuffix(".py")


@cache
def nodes(path: Path) -> list[ast.AST]:
    """All nodes of a file's tree."""
    return list(ast.walk(parsed(path)))


@cache
def imports(path: Path) -> list[tuple[str, int]]:
    """Absolute names that a file imports, with their lines; those under TYPE_CHECKING are left out: they are not imported."""
    hidden = {
        id(inner)
        for node in nodes(path)
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"
        for inner in ast.walk(node)
    }
    modules: list[tuple[str, int]] = []
    for node in nodes(path):
        if id(node) in hidden:
            continue
        if isinstance(node, ast.Import):
            modules += [(alias.name, node.lineno) for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            names = [f"{node.module}.{alias.name}" for alias in node.names] if node.module == "antdsl" else [node.module]
            modules += [(name, node.lineno) for name in names]
    return modules


def test_packages_import_lower_packages_only() -> None:
    offenders = []
    for path in FILES:
        own = subpackage_of(path)
        assert own in ROOMS, f"{own} has no place among the rooms"
        for name, line in imports(path):
            if name.split(".")[0] != "antdsl" or name == "antdsl":
                continue
            other = name.split(".")[1]
            if other not in ROOMS or other == own:  # a name of the package itself, such as __version__
                continue
            lower = other in GROUND if own in GROUND else own == "__init__" or ROOMS.index(other) < ROOMS.index(own)
            if not lower:
                offenders.append(f"{path}:{line} imports {name}")
    assert not offenders


def test_no_file_executes_text_or_unpickles() -> None:
    offenders = []
    for path in FILES:
        for name, line in imports(path):
            if name.split(".")[0] in FORBIDDEN_MODULES:
                offenders.append(f"{path}:{line} imports {name}")
            if name.split(".")[0] == "open3d" and path != OPEN3D_MODULE:
                offenders.append(f"{path}:{line}: Open3D has one door")
        for node in nodes(path):
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in FORBIDDEN_CALLS:
                offenders.append(f"{path}:{node.lineno} calls {node.func.id}")
            if (
                isinstance(node, ast.Attribute)
                and isinstance(node.value, ast.Name)
                and (node.value.id, node.attr) in FORBIDDEN_ATTRIBUTES
            ):
                offenders.append(f"{path}:{node.lineno} uses {node.value.id}.{node.attr}")
    assert not offenders


# Who else opens files to read them, and which.
OWN_FILES = {
    "bench/cases.py": "examples that come with antdsl",
    "bootstrap.py": "what antdsl needs, and which system this is",
    "cli/__init__.py": "the null device",
    "cli/commands/manual/docs.py": "pages that come with antdsl",
    "cli/commands/new.py": "files of a project that come with antdsl",
    "cli/printing/pages.py": "pages that come with antdsl",
    "diagnostics/exchange_formats.py": "pages that come with antdsl",
    "lsp/features/tokens.py": "the grammar",
    "mcp/pages.py": "pages that come with antdsl",
    "machine_code/library.py": "text in LLVM's language that comes with antdsl",
    "outputs/cache/lock.py": "its own lock, and what the system tells about a process",
    "preview/serving/page_files.py": "the page that comes with antdsl",
    "numerics/processor/host.py": "what the system tells about processors and memory",
    "cli/printing/messages.py": "the null device",
    "scene/paths.py": "folders, part by part",
    "scene/library_bodies.py": "the list of the bodies that come with the package",
    "reader/child.py": "the null device, pipes that it was given",
    "reader/client.py": "the null device",
    "reader/sandbox.py": "folders that are granted to Landlock",
    "reader/private_folder.py": "its own locks",
    "scene/geometry/usd/closure.py": "its own copies, to write them",
    "syntax/grammar.py": "the grammar",
    "syntax/parse_tables.py": "the grammar and its tables",
    "atomic_write.py": "its own files, to write them",
}
READING = frozenset(["open", "read_text", "read_bytes", "fromfile", "memmap", "loadtxt", "genfromtxt"])


def test_user_files_are_opened_by_one_module() -> None:
    """Elsewhere a pipe would be waited for, and an endless device read until no memory is left."""
    for path in FILES:
        if path.relative_to(PACKAGE).as_posix() in ("safe_read.py", *OWN_FILES):
            continue
        for node in nodes(path):
            if not isinstance(node, ast.Call) or ast.unparse(node.func).rpartition(".")[2] not in READING:
                continue
            called = ast.unparse(node.func)
            other = called.endswith(".open") and called not in ("os.open", "io.open")  # a session, a solid's bricks
            written = any(getattr(each, "value", None) in ("ab", "wb", "xb") for each in node.args)
            if other or written or called in ("read_bytes", "syntax.read_bytes", "text_files.read_bytes"):
                continue
            raise AssertionError(f"{path}:{node.lineno} opens a file by `{called}`, not by antdsl/safe_read.py")


# Who else writes files, and which.
OWN_WRITING = {
    "bench/cases.py": "copies of examples, in a folder that is removed",
    "bootstrap.py": "the stamp of the environment",
    "cli/__init__.py": "the null device",
    "cli/printing/messages.py": "the null device",
    "executors/input_bundle.py": "files of a project, in a folder of the worker's own",
    "graphs/png.py": "the font, in a temporary folder",
    "highlighting/textmate.py": "the highlighting that ships",
    "lsp/server.py": "standard output",
    "reader/child.py": "its answers",
    "reader/private_folder.py": "the lock of its folder",
    "scene/geometry/usd/closure.py": "its own copies, to write them",
    "sweeps/figures.py": "a file that antdsl/atomic_write.py has opened",
    "syntax/grammar.py": "the grammar that ships",
}
WRITING_MODES = frozenset(["a", "ab", "w", "wb", "x", "xb", "r+b", "r+"])


def test_files_are_written_atomically_by_one_module() -> None:
    """Other code might use the name of a user's file for the temporary file, leave a part of it after a crash, or not flush it
    to the disk."""
    moving = ("os.replace", "os.rename", "os.fsync", "tempfile.mkstemp", "tempfile.mkdtemp", "tempfile.NamedTemporaryFile")
    moving_folders = ("reader/private_folder.py", "cli/commands/manual/docs.py")
    for path in FILES:
        if path.relative_to(PACKAGE).as_posix() in ("atomic_write.py", *moving_folders):
            continue
        for node in nodes(path):
            if isinstance(node, ast.Call) and (ast.unparse(node.func) in moving or ast.unparse(node.func).endswith(".rename")):
                raise AssertionError(f"{path}:{node.lineno} moves a file into its place, not by antdsl/atomic_write.py")
            if isinstance(node, ast.Call) and path.relative_to(PACKAGE).as_posix() not in OWN_WRITING:
                called = ast.unparse(node.func)
                modes = [getattr(each, "value", None) for each in (*node.args[1:2], *(k.value for k in node.keywords))]
                opened = called in ("open", "io.open", "os.fdopen") and any(mode in WRITING_MODES for mode in modes)
                if opened or called.rpartition(".")[2] in ("write_text", "write_bytes", "savefig", "FileIO"):
                    raise AssertionError(f"{path}:{node.lineno} writes a file by `{called}`, not by antdsl/atomic_write.py")


def test_files_are_short_and_have_names_and_docstrings() -> None:
    offenders = []
    for path in FILES:
        lines = path.read_text(encoding="utf-8").splitlines()
        if str(path.relative_to(PACKAGE)) not in LONG and len(lines) > 400:
            offenders.append(f"{path} has {len(lines)} lines: it is usually two things")
        if path.stem in FORBIDDEN_NAMES:
            offenders.append(f"{path} is not named for what it does")
        if lines and not ast.get_docstring(parsed(path)):
            offenders.append(f"{path} does not say what it takes and gives")
    assert not offenders


def test_heavy_packages_are_imported_late() -> None:
    """`check` and `--help` never wait for them: they are imported inside functions wherever checking comes by."""
    for path in FILES:
        if subpackage_of(path) in ("numerics", "casting", "ground", "senses", "fields", "runtime", "reload", "bodies", "outputs"):
            continue
        for node in parsed(path).body:
            if isinstance(node, ast.Import | ast.ImportFrom):
                names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else [node.module or ""]
                for name in names:
                    assert name.split(".")[0] not in HEAVY, f"{path}:{node.lineno} imports {name} at once"


# What reads files by a C or C++ library, and runs in the reader's process only: nothing else imports it.
READ_BY_LIBRARIES = ("antdsl.scene.geometry.usd.child", "antdsl.bodies.files.usd_body", "antdsl.bodies.files.usd_shapes",
                     "antdsl.reader.images", "antdsl.reader.child")  # fmt: skip
WRITES_USD = ("antdsl.outputs.", "antdsl.scene.geometry.usd.errors", "antdsl.scene.geometry.usd")
COMPOSES_USD = frozenset(["FindOrOpen", "OpenMasked", "OpenAsAnonymous", "AddReference", "AddPayload", "subLayerPaths"])


def test_foreign_formats_are_read_in_the_reader_process_only() -> None:
    for path in FILES:
        module = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        if module.startswith(READ_BY_LIBRARIES):
            continue
        for name, line in imports(path):
            assert not name.startswith(READ_BY_LIBRARIES), f"{path}:{line} imports {name}"
            assert not name.startswith("pxr"), f"{path}:{line} imports {name}"
        for node in nodes(path):
            if isinstance(node, ast.Call) and ast.unparse(node.func) == "pxr":
                assert module.startswith(WRITES_USD), f"{path}:{node.lineno} uses USD"
            if isinstance(node, ast.Attribute):
                assert node.attr not in COMPOSES_USD, f"{path}:{node.lineno} opens a layer"
                opens = ast.unparse(node) in ("Image.open", "PillowImage.open", "PIL.Image.open", "usd.Stage.Open")
                assert not opens, f"{path}:{node.lineno} decodes an image or opens a stage"


def test_plan_and_lower_packages_do_not_import_numpy() -> None:
    for path in FILES:
        if subpackage_of(path) in ("source", "diagnostics", "limits", "resources", "syntax", "program", "plan", "passes"):
            for name, line in imports(path):
                assert name.split(".")[0] != "numpy", f"{path}:{line}"


def test_forbidden_words_are_not_shipped() -> None:
    folders = [PACKAGE, ROOT / "tests", ROOT / "docs", ROOT / "grammar", ROOT / "behaviours", ROOT / "examples"]
    texts = [p for f in folders for p in f.rglob("*") if p.suffix in (".py", ".md", ".ant", ".yaml", ".lark", ".toml")]
    outside = re.compile("/" + "work/|" + "shared/" + "(design|meshes|seeds)|\\bTO" + "DO\\b|\\bFIX" + "ME\\b")
    texts = [path for path in texts if "node_modules" not in path.parts]  # others' words, beside the extension for VS Code
    for path in [*texts, ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "CHANGELOG.md", ROOT / "pyproject.toml"]:
        match = outside.search(path.read_text(encoding="utf-8"))
        assert not match, f"{path} has {match[0]!r}"


def test_codes_are_kebab_case_and_given_once() -> None:
    tree = parsed(PACKAGE / "diagnostics" / "codes.py")
    keys = [k.value for node in ast.walk(tree) if isinstance(node, ast.Dict) for k in node.keys if isinstance(k, ast.Constant)]
    assert sorted(keys) == sorted(set(keys)), sorted({k for k in keys if keys.count(k) > 1})
    for code, meaning in CODE_DESCRIPTIONS.items():
        assert re.fullmatch("[a-z0-9]+(-[a-z0-9]+)*", code)
        assert meaning and not meaning.endswith(".") and "\n" not in meaning


def test_every_code_is_used_and_every_code_used_has_a_meaning() -> None:
    """A code is the first word of a complaint, so it is written out in the source of the room that complains."""
    written: set[str] = set()
    for path in FILES:
        if path.name != "codes.py":
            for node in nodes(path):
                if isinstance(node, ast.Constant) and isinstance(node.value, str):
                    written.add(node.value)
    parts = {text for text in written if re.fullmatch("[a-z]+-", text)}  # `unused-` and the kind of what is not used
    unused = {code for code in CODE_DESCRIPTIONS if code not in written and not any(code.startswith(part) for part in parts)}
    assert not unused, sorted(unused)
    complained = re.compile(
        r"(?:\.error|\.warning|PathRefused|complain|refuse|_error|_refuse)\(\s*(?:[a-z_.]+,\s*)?\"([a-z0-9]+(?:-[a-z0-9]+)+)\""
    )
    for path in FILES:
        for code in complained.findall(path.read_text(encoding="utf-8")):
            assert code in CODE_DESCRIPTIONS, f"{path}: `{code}`"


def test_named_test_files_exist() -> None:
    assert [pattern for pattern in QUICK_TEST_PATTERNS if not any(ROOT.glob(pattern))] == []
    names = {path.stem for path in (ROOT / "tests").rglob("test_*.py")}
    assert [name for name in LONGEST if name not in names] == []


def test_every_code_has_a_case() -> None:
    files = [p for p in (ROOT / "tests").rglob("*") if p.suffix in (".py", ".ant", ".yaml", ".txt")]
    files += [*LANGUAGE_PAGES, *SCENE_PAGES]
    words = {word for path in files for word in re.findall(r"[\w-]+", path.read_text(encoding="utf-8"))}
    assert not set(CODE_DESCRIPTIONS) - words


@pytest.mark.parametrize(
    "path",
    [p for f in ("behaviours", "examples") for p in sorted((ROOT / f).rglob("*.ant"))],
    ids=lambda p: str(p.relative_to(ROOT)),
)
def test_shipped_programs_have_no_findings(path: Path) -> None:
    from antdsl.pipeline import check_path

    _, report = check_path(path)
    assert not report.diagnostics, [(d.code, d.message, str(d.span)) for d in report.diagnostics]


@pytest.mark.parametrize(
    "path",
    [p for f in ("behaviours", "examples", "tests/programs") for p in sorted((ROOT / f).rglob("*.ant"))],
    ids=lambda p: str(p.relative_to(ROOT)),
)
def test_shipped_programs_are_formatted(path: Path) -> None:
    from antdsl import syntax

    source, report = syntax.read_program_file(path)
    assert source is not None, report.diagnostics
    text, _ = syntax.format(source)
    assert text == path.read_bytes().decode(), f"run `antdsl fmt {path.relative_to(ROOT)}`"


@pytest.mark.parametrize("path", sorted((ROOT / "examples").rglob("scene.yaml")), ids=lambda p: p.parent.name)
def test_example_scenes_have_no_findings(path: Path) -> None:
    from antdsl.pipeline import check_path

    program, report = check_path(path)
    assert program is not None and not report.diagnostics, [(d.code, d.message, str(d.span)) for d in report.diagnostics]


def test_no_circular_imports() -> None:
    assert not find_places(ROOT)["circles of modules"]


_DESCRIBED_NAME = re.compile(r"(?:^|[.\n;-] ?)`([a-z_]\w*)`(?: \w*[\[(][^\])]*[\])])?:")


def _names_in(node: ast.AST) -> set[str]:
    """All names and constants of a function or class, as text."""
    names = set()
    for each in ast.walk(node):
        match each:
            case ast.arg(arg=name) | ast.Attribute(attr=name) | ast.Name(id=name) | ast.FunctionDef(name=name):
                names.add(name)
            case ast.Constant(value=value):
                names.add(str(value))
    return names


def test_docstrings_describe_names_that_exist() -> None:
    """`name: text` in a docstring is about a parameter, attribute or local name; a rename must change both."""
    stale = []
    for path in FILES:
        for node in nodes(path):
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and (text := ast.get_docstring(node, clean=False)):
                described = {name for name in _DESCRIBED_NAME.findall(text) if isinstance(node, ast.FunctionDef) or "_" in name}
                if missing := sorted(described - _names_in(node)) if described else []:
                    stale += [f"{path.relative_to(PACKAGE)}:{node.lineno} {name}" for name in missing]
    assert not stale
