"""The page that ships is the one that its sources make."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import subprocess
from pathlib import Path

import pytest

WEB = Path(__file__).resolve().parents[2] / "antdsl" / "preview" / "web"
PAGE = WEB.parent / "page"
SOURCES = ("index.html", "package.json", "package-lock.json", "tsconfig.json", "vite.config.ts")


def sources() -> list[str]:
    inner = [path.relative_to(WEB).as_posix() for path in (WEB / "src").rglob("*") if path.is_file()]
    return sorted([*SOURCES, *inner])


def test_the_page_was_built_from_these_sources() -> None:
    hashed = hashlib.sha256()
    for name in sources():
        hashed.update(f"{name}\n".encode())
        hashed.update((WEB / name).read_bytes().replace(b"\r\n", b"\n"))
    assert (PAGE / "sources.sha256").read_text() == hashed.hexdigest() + "\n", "`npm run build` in antdsl/preview/web"


def test_the_page_loads_nothing_from_elsewhere() -> None:
    html = (PAGE / "index.html").read_text(encoding="utf-8")
    assert not re.findall(r"""(?:src|href)=["'](?!\./|data:,)""", html)
    assert "style=" not in html and not re.search(r"<script(?![^>]*\bsrc=)", html)
    assert sorted(path.name for path in PAGE.iterdir()) == ["app.css", "app.js", "index.html", "licences.txt", "sources.sha256"]


def test_the_licences_of_what_is_built_in_are_handed_on() -> None:
    words = (PAGE / "licences.txt").read_text(encoding="utf-8")
    package = json.loads((WEB / "package.json").read_text(encoding="utf-8"))
    parts = {part.lstrip("\n").split("\n")[0]: part for part in re.split(r"\n-{80}\n", words)}
    used = {name for name in package["dependencies"] if any(f'"{name}"' in f.read_text() for f in (WEB / "src").rglob("*.ts"))}
    assert used <= parts.keys()
    assert all("copyright" in part.lower() for part in parts.values())


def test_dependencies_are_pinned() -> None:
    package, lock = (json.loads((WEB / name).read_text(encoding="utf-8")) for name in ("package.json", "package-lock.json"))
    for name in {**package["dependencies"], **package["devDependencies"]}:
        assert re.fullmatch(r"\d+\.\d+\.\d+", lock["packages"][f"node_modules/{name}"]["version"])


def new_enough() -> bool:
    if shutil.which("node") is None or shutil.which("npm") is None:
        return False
    said = subprocess.run(["node", "--version"], capture_output=True, text=True).stdout
    version_match = re.match(r"v(\d+)\.(\d+)", said)
    return version_match is not None and (int(version_match[1]), int(version_match[2])) >= (20, 19)


@pytest.mark.slow
@pytest.mark.skipif(not new_enough(), reason="node 20.19 or newer builds the page, and is not here")
def test_the_page_comes_out_the_same_when_it_is_built_again(tmp_path: Path) -> None:
    web = tmp_path / "web"
    shutil.copytree(WEB, web, ignore=shutil.ignore_patterns("node_modules"))
    got = subprocess.run(["npm", "ci", "--no-audit", "--no-fund"], cwd=web, capture_output=True, text=True)
    if got.returncode:
        pytest.skip(f"npm could not bring the packages: {got.stderr.strip().splitlines()[-1:]}")
    built = subprocess.run(["npm", "run", "build"], cwd=web, capture_output=True, text=True)
    assert built.returncode == 0, built.stdout + built.stderr
    for path in sorted(PAGE.iterdir()):
        assert (tmp_path / "page" / path.name).read_bytes() == path.read_bytes(), f"{path.name}: `npm run build`"
