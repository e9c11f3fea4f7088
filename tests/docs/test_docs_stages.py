"""The tables of stages from a phase to the processor name files and functions that exist, and so do the pages about the code."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PAGES = [ROOT / "docs" / f"implementation{part}.md" for part in ("", "_blocks", "_kernels", "_geometry", "_motion")]
TEXT = "\n".join(page.read_text(encoding="utf-8") for page in PAGES)
HEADERS = ("| stage | a contact | a foot | a ray |", "| stage | files and functions |")


def stages() -> list[list[str]]:
    """The cells of the tables, without headers."""
    lines, rows = TEXT.splitlines(), []
    for header in HEADERS:
        begin = lines.index(header) + 2
        end = next(k for k in range(begin, len(lines)) if not lines[k].startswith("|"))
        rows += [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[begin:end]]
    return rows


@cache
def names_in(path: Path) -> set[str]:
    """The functions, classes, methods and constants that a module defines."""
    names = set[str]()
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.add(node.name)
        if isinstance(node, ast.ClassDef):
            names |= {f"{node.name}.{each.name}" for each in node.body if isinstance(each, ast.FunctionDef)}
            names |= {each.name for each in node.body if isinstance(each, ast.FunctionDef)}
        if isinstance(node, ast.Assign | ast.AnnAssign):
            names |= {each.id for each in ast.walk(node) if isinstance(each, ast.Name)}
    return names


def test_the_stages_name_what_is_in_the_code() -> None:
    checked, missing = 0, []
    for row in stages():
        assert len(row) in (2, 4), row
        for cell in row[1:]:
            path: Path | None = None
            for word in re.findall(r"`([^`]+)`", cell):
                if "/" in word:
                    path = ROOT / "antdsl" / word
                    if not path.is_file():
                        missing.append(word)
                elif "(" not in word and word not in ("ray", "feet", "feelers"):
                    checked += 1
                    assert path is not None, f"`{word}` has no file before it"
                    if path.is_file() and word not in names_in(path):
                        missing.append(f"{path.name}: {word}")
    assert not missing
    assert checked > 25


def test_the_pages_name_files_that_exist() -> None:
    folders = [ROOT / name for name in ("antdsl", ".ci", "tests")]
    files = {path.as_posix() for folder in folders for path in folder.rglob("*")}
    words = re.findall(r"`([\w/.-]+\.(?:py|ll|ts|js))`", TEXT)
    assert len(words) > 100
    assert not [word for word in words if not any(file.endswith(f"/{word}") for file in files)]
