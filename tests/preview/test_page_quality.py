"""The page's sources pass their own checks: types, linter, formatter and unit tests."""

from __future__ import annotations

import json
import subprocess

import pytest
from test_page_fresh import WEB, new_enough

TOOLS = ("biome", "tsc", "vitest")


@pytest.mark.skipif(not new_enough(), reason="node 20.19 or newer runs the page's checks, and is not here")
@pytest.mark.skipif(
    not all((WEB / "node_modules" / ".bin" / tool).exists() for tool in TOOLS),
    reason="the page's tools are not installed: `npm ci` in antdsl/preview/web",
)
def test_the_page_passes_its_gate() -> None:
    got = subprocess.run(["npm", "run", "gate"], cwd=WEB, capture_output=True, text=True)
    assert got.returncode == 0, got.stdout + got.stderr


def test_the_gate_has_all_checks() -> None:
    scripts = json.loads((WEB / "package.json").read_text(encoding="utf-8"))["scripts"]
    assert all(f"npm run {part}" in scripts["gate"] for part in ("check", "lint", "format:check", "test"))


def test_the_lock_names_no_registry() -> None:
    lock = json.loads((WEB / "package-lock.json").read_text(encoding="utf-8"))
    assert not [name for name, package in lock["packages"].items() if "resolved" in package]
