"""What reaches a state is made of operations that give one result on every processor: a house rule, and its exceptions."""

from __future__ import annotations

import ast
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[2] / "antdsl"
ROOMS = (
    "numerics",
    "casting",
    "ground",
    "senses",
    "fields",
    "runtime",
    "reload",
    "scene",
)  # what they give is, or becomes, a state
# of bodies/agents: so do they
POSING = (
    "affine", "blend_shapes", "blending", "deformers", "driving", "leg_chains", "machine_clips", "poses",
    "skinning", "varied_bodies",
)  # fmt: skip
# Of NumPy and math: their last bits depend on the processor, by what the library was compiled for or chooses when it runs.
FUNCTIONS = frozenset([
    "sin", "cos", "tan", "arcsin", "arccos", "arctan", "arctan2", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh",
    "exp", "exp2", "expm1", "log", "log2", "log10", "log1p", "pow", "power", "float_power", "cbrt", "hypot", "dist", "logaddexp",
    "interp", "sinc", "einsum", "dot", "vdot", "inner", "outer", "matmul", "tensordot", "linalg", "convolve", "correlate", "fft",
    "polyfit",
])  # fmt: skip
LIBRARIES = frozenset(["scipy", "skimage", "trimesh"])

# Where one of these is used all the same, and why no state differs by it.
ALLOWED = {
    "senses/overlaps.py": {"scipy": "a measure beside the state"},
    "runtime/binding/spacing.py": {"scipy": "a tree that says which places to measure"},
    "ground/mesh/creases.py": {"scipy": "a tree of places, compiled for all x86-64 processors alike"},
    "runtime/binding/start_findings.py": {"log10": "digits of a radius that is proposed in a message"},
    "runtime/motion_measures.py": {"arcsin": "a measure beside the state, counted in bins"},
    "runtime/sensing/neighbourhood.py": {"log2": "the width of cells: which pairs are found does not depend on it"},
    "runtime/sensing/pairs.py": {"scipy": "a tree that says how far to look: which pairs are the nearest does not depend on it"},
    "runtime/backends/native/search/search_grids.py": {"log2": "the same"},
    "runtime/notes/targets.py": {"scipy": "a tree that says which distances to measure"},
    "fields/pheromone.py": {"scipy": "a sparse matrix, compiled for all processors alike"},
    "fields/path_cost.py": {"scipy": "Dijkstra's search, compiled alike for all x86-64; only a beginning"},
    "fields/flow.py": {"scipy": "a tree of places, compiled for all x86-64 processors alike"},
    "runtime/binding/bind_flows.py": {"scipy": "the same trees"},
    "casting/curves.py": {
        "interp": "of one curve when it is bound: products and sums of single numbers",
        "scipy": "a tree that says which pieces to measure",
    },
    "ground/solid_feelers.py": {"scipy": "a tree that says which places to measure"},
    "runtime/sensing/nearest_pairs.py": {"scipy": "a tree that says which pairs to measure"},
    "ground/solid/volume.py": {"skimage": "a mesh to look at; its vertices are rounded to a 4096th of a voxel"},
    "ground/solid/voxelising.py": {"log10": "digits of a size of voxels that is proposed in a message"},
    "scene/staging/stage_things.py": {"interp": "of curves and moves: products and sums of single numbers"},
    "scene/notes/selection.py": {"scipy": "a tree that says which distances to measure"},
    "scene/staging/mesh_imports.py": {"scipy": "a tree of vertices to weld, compiled for all x86-64 processors alike"},
    "scene/geometry/closed_meshes.py": {"log2": "how many digits a mesh's places keep while it is told whether it is closed"},
}


def files(subpackage: str) -> list[Path]:
    """The files of a room; a file is its own."""
    path = PACKAGE / subpackage
    return [path] if path.is_file() else sorted(path.rglob("*.py"))


def used(path: Path) -> dict[str, int]:
    """What a file uses of these, with the first line of each."""
    uses: dict[str, int] = {}
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in ("np", "numpy", "math"):
            if node.attr in FUNCTIONS:
                uses.setdefault(node.attr, node.lineno)
        elif isinstance(node, ast.BinOp | ast.AugAssign) and isinstance(node.op, ast.MatMult):
            uses.setdefault("@", node.lineno)
        elif isinstance(node, ast.Import | ast.ImportFrom):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else [node.module or ""]
            for name in names:
                if name.split(".")[0] in LIBRARIES:
                    uses.setdefault(name.split(".")[0], node.lineno)
            if isinstance(node, ast.ImportFrom) and node.module in ("math", "numpy"):
                for alias in node.names:
                    if alias.name in FUNCTIONS:
                        uses.setdefault(alias.name, node.lineno)
        elif isinstance(node, ast.keyword) and node.arg == "fastmath":
            uses.setdefault("fastmath", node.value.lineno)
    return uses


def test_state_code_uses_only_reproducible_functions() -> None:
    messages, exempt = [], set()
    for subpackage in (*ROOMS, *(f"bodies/agents/{name}.py" for name in POSING)):
        for path in files(subpackage):
            name = str(path.relative_to(PACKAGE))
            for word, line in used(path).items():
                if word in ALLOWED.get(name, {}):
                    exempt.add((name, word))
                else:
                    messages.append(f"antdsl/{name}:{line} uses {word}: take antdsl.numerics.elementary or write the sum out")
    assert not messages, "\n".join(messages)
    stale = {(name, word) for name, words in ALLOWED.items() for word in words} - exempt
    assert not stale, f"nothing uses {sorted(stale)} any more"


def test_the_rule_detects_forbidden_calls(tmp_path: Path) -> None:
    text = "import math, scipy.spatial\nfrom math import exp\na = np.sin(x) + math.atan2(x, x)\nb = a @ a\nnjit(fastmath=True)\n"
    path = tmp_path / "a.py"
    path.write_text(text + "c = np.linalg.norm(a)\n", encoding="utf-8")
    assert set(used(path)) == {"scipy", "exp", "sin", "atan2", "@", "fastmath", "linalg"}
