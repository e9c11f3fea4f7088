"""Counts of the code: `python tests/house_counts.py [TREE]` for this tree or another one, `--list` with the places.

Lines and files, the packages with most files in one folder, long functions, functions of many parameters, `Any`, imports inside
functions (of the package's own modules, and of others), modules that import each other in a circle, and file names that are in
several packages. None of the counts is a goal: they show where to look."""

from __future__ import annotations

import argparse
import ast
from collections import Counter, defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path

LONG, MANY = 60, 8
Function = ast.FunctionDef | ast.AsyncFunctionDef


def module(path: Path, root: Path) -> str:
    """The dotted name of a file."""
    return ".".join(path.relative_to(root).with_suffix("").parts).removesuffix(".__init__")


def imported(tree: ast.Module, modules: frozenset[str]) -> Iterator[tuple[str, int, bool]]:
    """What a file imports: the module's name, the line, and whether it stands inside a function. TYPE_CHECKING is left out."""
    stack: list[tuple[ast.AST, bool]] = [(tree, False)]
    while stack:
        node, inside = stack.pop()
        if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING":
            continue
        if isinstance(node, ast.Import):
            yield from ((alias.name, node.lineno, inside) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            for name in sorted({f"{node.module}.{alias.name}" for alias in node.names}):
                yield (name if name in modules else node.module), node.lineno, inside
        within = inside or isinstance(node, Function)
        statements = (
            each for each in ast.iter_child_nodes(node) if isinstance(each, ast.stmt | ast.excepthandler | ast.match_case)
        )
        stack += [(child, within) for child in statements]


def circles(graph: dict[str, set[str]]) -> list[list[str]]:
    """Groups of modules of which each reaches each (Tarjan 1972), without recursion."""
    index: dict[str, int] = {}
    low: dict[str, int] = {}
    open_, groups = [], []
    for start in sorted(graph):
        work = [(start, iter(sorted(graph[start])))] if start not in index else []
        if work:
            index[start] = low[start] = len(index)
            open_.append(start)
        while work:
            name, rest = work[-1]
            following = next(rest, None)
            if following is None:
                work.pop()
                if work:
                    low[work[-1][0]] = min(low[work[-1][0]], low[name])
                if low[name] == index[name]:
                    at = open_.index(name)
                    group, open_ = open_[at:], open_[:at]
                    groups += [sorted(group)] if len(group) > 1 else []
            elif following not in index:
                index[following] = low[following] = len(index)
                open_.append(following)
                work.append((following, iter(sorted(graph[following]))))
            elif following in open_:
                low[name] = min(low[name], index[following])
    return groups


def parameters(node: Function) -> int:
    """How many parameters a function has, `self` and `cls` left out."""
    names = [each.arg for each in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
    return len([name for name in names if name not in ("self", "cls")])


@cache
def parsed(path: Path) -> ast.Module:
    """The tree of a file."""
    return ast.parse(path.read_text(encoding="utf-8"))


def find_places(root: Path) -> dict[str, list[str]]:
    """By what is counted, every place of it."""
    package = root / "antdsl"
    files = {path: parsed(path) for path in sorted(package.rglob("*.py"))}
    modules = frozenset(module(path, root) for path in files)
    locations: dict[str, list[str]] = defaultdict(list)
    graph: dict[str, set[str]] = {name: set() for name in modules}
    for path, tree in files.items():
        own = path.relative_to(root).as_posix()
        for name, line, inside in imported(tree, modules):
            ours = name in modules
            if ours and name != module(path, root):
                graph[module(path, root)].add(name)
            if inside:
                locations["own imports inside functions" if ours else "others' imports inside functions"].append(
                    f"{own}:{line} {name}"
                )
        for node in ast.walk(tree):
            if isinstance(node, Function):
                length = (node.end_lineno or node.lineno) - node.lineno + 1
                if length > LONG:
                    locations[f"functions over {LONG} lines"].append(f"{own}:{node.lineno} {node.name} ({length})")
                if parameters(node) > MANY:
                    locations[f"functions of over {MANY} parameters"].append(
                        f"{own}:{node.lineno} {node.name} ({parameters(node)})"
                    )
            if isinstance(node, ast.Name) and node.id == "Any":
                locations["Any"].append(f"{own}:{node.lineno}")
    locations["circles of modules"] = [" ".join(group) for group in circles(graph)]
    names: dict[str, list[str]] = defaultdict(list)
    for path in files:
        names[path.name].append(path.relative_to(root).as_posix())
    locations["names that stand in several rooms"] = [
        " ".join(v) for k, v in sorted(names.items()) if len(v) > 1 and k != "__init__.py"
    ]
    return locations


def counts(root: Path) -> list[tuple[str, int | str]]:
    """The table that is printed: what is counted, and how many there are."""
    files = sorted((root / "antdsl").rglob("*.py"))
    lines = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in files}
    rooms = Counter(path.parent.relative_to(root).as_posix() for path in files)
    pages = [p for p in (root / "antdsl" / "preview" / "web" / "src").rglob("*.ts")]
    tests = sorted((root / "tests").rglob("*.py"))
    rows: list[tuple[str, int | str]] = [
        ("files of Python", len(files)),
        ("lines of Python", sum(lines.values())),
        ("median lines of a file", sorted(lines.values())[len(lines) // 2]),
        ("files of over 400 lines", sum(n > 400 for n in lines.values())),
        ("files of TypeScript", len(pages)),
        ("lines of TypeScript", sum(len(p.read_text(encoding="utf-8").splitlines()) for p in pages)),
        ("files of tests", len(tests)),
        ("lines of tests", sum(len(p.read_text(encoding="utf-8").splitlines()) for p in tests)),
        ("folders of over 16 files", sum(n > 16 for n in rooms.values())),
    ]
    rows += [(f"files in {subpackage}", n) for subpackage, n in rooms.most_common() if n > 16]
    return rows + [(name, len(where)) for name, where in sorted(find_places(root).items())]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tree", nargs="?", type=Path, default=Path(__file__).resolve().parent.parent)
    parser.add_argument("--list", action="store_true", help="with every place")
    options = parser.parse_args()
    for name, count in counts(options.tree):
        print(f"{count:>8}  {name}")
    if options.list:
        for name, where in sorted(find_places(options.tree).items()):
            print(f"\n{name}", *where, sep="\n  ")


if __name__ == "__main__":
    main()
